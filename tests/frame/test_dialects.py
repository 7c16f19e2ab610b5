"""Dialects on files made by hand: each renderer's names, views, overrides, plug-ins, and fuzz."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from dialect_files import exr, named, part, parts, rgb, roles, xyz
from hypothesis import given, settings
from hypothesis import strategies as st

from lambent.errors import LambentError, LayerError, UnknownNameError
from lambent.frame.dialects import DIALECTS, Dialect, Rule, identify
from lambent.frame.exr import ExrFile
from lambent.frame.role import INFO, Role, Space, Stat

RGBA = ["R", "G", "B", "A"]


# ------------------------------------------------------------------------- one test a renderer


def test_pbrt() -> None:
    """The gbuffer film; its variance is that of the samples and needs their number."""
    channels = [*"RGB", *rgb("Albedo"), *xyz("P"), "dzdx", "dzdy", *xyz("N"), *xyz("Ns"), "u", "v"]
    channels += [*rgb("Variance"), *rgb("RelativeVariance")]
    found = identify(exr(*channels, header={"samplesPerPixel": 16}))
    assert (found.dialect, found.spp) == ("pbrt", 16)
    assert roles(found) == {
        "colour": "RGB",
        "albedo": "Albedo",
        "normal": "Ns",
        "position": "P",
        "colour.variance": "Variance",
    }
    assert found.of(Role.COLOUR, Stat.VARIANCE).scale == 1 / 16
    assert found.of(Role.NORMAL).space is Space.CAMERA
    assert named(found, "other") >= {"N", "RelativeVariance", "dzdx", "UV"}

    without = identify(exr(*channels))
    assert without.dialect == "pbrt"  # by names
    assert without.of(Role.COLOUR, Stat.VARIANCE) is None
    assert any("samples per pixel" in note for note in without.notes)
    told = identify(exr(*channels), spp=4)
    assert told.of(Role.COLOUR, Stat.VARIANCE).scale == 0.25


def test_pbrt_early_names() -> None:
    """Early pbrt-v4 wrote Px, Py, Pz without dots."""
    channels = [*"RGB", *rgb("Albedo"), "Px", "Py", "Pz", "dzdx", "dzdy", "Nx", "Ny", "Nz"]
    found = identify(exr(*channels, "Nsx", "Nsy", "Nsz", *rgb("RelativeVariance")))
    assert found.dialect == "pbrt"
    assert roles(found) == {"colour": "RGB", "albedo": "Albedo", "normal": "Ns", "position": "P"}


def test_mitsuba_names_of_the_user() -> None:
    """Layers are told by their components; a vector without a telling name has no role."""
    nested = [*rgb("my_image"), "my_image.A"]
    channels = [*nested, "far.T", *rgb("a.albedo"), *xyz("sh_normal"), *xyz("geo"), *xyz("what")]
    found = identify(exr(*channels, "shape.I", header={"generatedBy": "Mitsuba version 3.6.0"}))
    assert roles(found) == {
        "colour": "my_image",  # there is no bare R G B
        "alpha": "my_image.A",
        "depth": "far",
        "albedo": "a.albedo",
        "normal": "sh_normal",
    }
    assert named(found, "id") == {"shape"}
    assert named(found, "other") == {"geo", "what"}


def test_renderman() -> None:
    """``mse`` is a variance of the mean, ``_var`` one of the samples."""
    channels = [*rgb("Ci"), "a", *rgb("mse"), *rgb("albedo"), *rgb("albedo_var"), *xyz("normal")]
    channels += [*xyz("normal_mse"), "zfiltered", "zfiltered_var", "sampleCount", *rgb("diffuse")]
    channels += [*rgb("diffuse_mse"), *rgb("specular"), *rgb("directDiffuse"), *xyz("backward")]
    found = identify(exr(*(c.lower() if c[:-1].endswith(".") else c for c in channels)))
    assert found.dialect == "renderman"
    assert roles(found) == {
        "colour": "ci",
        "alpha": "a",
        "colour.variance": "mse",
        "albedo": "albedo",
        "normal": "normal",
        "normal.variance": "normal_mse",
        "depth": "zfiltered",
        "diffuse": "diffuse",
        "diffuse.variance": "diffuse_mse",
        "specular": "specular",
        "motion": "backward",
    }
    assert len(found.of(Role.MOTION).channels) == 2
    assert "directdiffuse" in named(found, "lighting")
    with_spp = identify(exr(*channels), spp=32)
    assert with_spp.of(Role.ALBEDO, Stat.VARIANCE).scale == 1 / 32


def test_arnold() -> None:
    """AA_samples is the root of the samples per pixel; noice's variance is not used."""
    channels = [*RGBA, *rgb("N"), "Z", *xyz("P"), *rgb("diffuse_albedo"), *rgb("denoise_albedo")]
    channels += [*rgb("diffuse_direct"), *rgb("diffuse_indirect"), *rgb("RGBA_key"), "RGBA_key.A"]
    channels += [*rgb("variance"), *rgb("crypto_object00"), *rgb("specular"), *rgb("coat")]
    found = identify(exr(*channels, header={"arnold/version": "7.3", "arnold/AA_samples": 4}))
    assert (found.dialect, found.spp) == ("arnold", 16)
    assert roles(found) == {
        "colour": "RGB",
        "alpha": "A",
        "normal": "N",
        "depth": "Z",
        "position": "P",
        "albedo": "denoise_albedo",
        "diffuse_albedo": "diffuse_albedo",
        "specular": "specular",
    }
    assert named(found, "lighting") == {"diffuse_direct", "diffuse_indirect", "RGBA_key", "coat"}
    assert named(found, "id") == {"crypto_object00"}
    assert "variance" in named(found, "other")


def test_arnold_parts() -> None:
    """Multi-part: the part's name is the layer's."""
    named_parts = (("RGBA", "R G B A"), ("N", "X Y Z"), ("Z", "Z"), ("diffuse_albedo", "R G B"))
    found = identify(parts(*named_parts, header={"arnold/version": "7"}))
    assert roles(found) == {
        "colour": "RGBA",
        "alpha": "RGBA.A",
        "normal": "N",
        "depth": "Z",
        "diffuse_albedo": "diffuse_albedo",
    }


def test_vray_diffuse_is_an_albedo() -> None:
    """V-Ray's ``diffuse`` is a filter colour, not light."""
    channels = [*RGBA, *rgb("diffuse"), *rgb("rawGI"), *rgb("lighting"), *rgb("GI"), "noiseLevel"]
    found = identify(exr(*channels, *xyz("bumpNormals"), *xyz("normals"), *rgb("reflectionFilter")))
    assert found.dialect == "vray"
    assert roles(found) == {
        "colour": "RGB",
        "alpha": "A",
        "albedo": "diffuse",
        "normal": "bumpNormals",
        "specular_albedo": "reflectionFilter",
    }
    assert named(found, "lighting") == {"lighting", "GI"}


def test_houdini() -> None:
    """Karma: C, N, P, light by lobe."""
    channels = [*rgb("C"), "C.A", *xyz("N"), *xyz("P"), *rgb("albedo"), "depth.Z"]
    channels += [*rgb("directdiffuse"), *rgb("indirectdiffuse"), *rgb("combineddiffuse")]
    found = identify(exr(*channels, *rgb("glossytransmission"), *rgb("beautyunshadowed")))
    assert found.dialect == "houdini"
    assert roles(found) == {
        "colour": "C",
        "alpha": "C.A",
        "normal": "N",
        "position": "P",
        "albedo": "albedo",
        "depth": "depth",
        "diffuse": "combineddiffuse",
    }
    assert named(found, "lighting") == {"directdiffuse", "indirectdiffuse", "glossytransmission"}
    assert "beautyunshadowed" in named(found, "other")


def test_luxcore() -> None:
    """Film channels in capitals."""
    channels = [*rgb("RGB_IMAGEPIPELINE"), *rgb("ALBEDO"), *xyz("AVG_SHADING_NORMAL"), "DEPTH"]
    found = identify(exr(*channels, *rgb("DIRECT_DIFFUSE"), *rgb("EMISSION"), "MATERIAL_ID"))
    assert found.dialect == "luxcore"
    assert roles(found) == {
        "colour": "RGB_IMAGEPIPELINE",
        "albedo": "ALBEDO",
        "normal": "AVG_SHADING_NORMAL",
        "depth": "DEPTH",
        "emission": "EMISSION",
    }
    assert named(found, "id") == {"MATERIAL_ID"}


def test_appleseed() -> None:
    """AOVs as parts beside ``beauty``."""
    found = identify(parts(("beauty", "R G B A"), ("albedo", "R G B"), ("normal", "R G B"),
                           ("direct_glossy", "R G B"), ("pixel_time", "R G B"),
                           ("depth", "Z")))  # fmt: skip
    assert found.dialect == "appleseed"
    assert roles(found) == {
        "colour": "beauty",
        "alpha": "beauty.A",
        "albedo": "albedo",
        "normal": "normal",
        "depth": "depth",
    }


def test_lambents_own_renders() -> None:
    """The header tells; what is of the first hit has no role, and says why."""
    channels = [*rgb(""), *rgb("albedo"), *rgb("first_albedo"), *rgb("first_albedo_variance")]
    found = identify(exr(*channels, header={"lambent_render": "{}"}))
    assert found.dialect == "lambent"
    assert roles(found)["albedo"] == "albedo"
    reasons = [layer.why for layer in found.layers if layer.name.startswith("first_")]
    assert len(reasons) == 2
    assert all("of the first hit" in why for why in reasons)


def test_falcor() -> None:
    """Pass and output; the guide normal is the one made for denoising."""
    channels = [*rgb("PathTracer.color"), *rgb("GBufferRT.posW"), *rgb("GBufferRT.normW")]
    channels += [*rgb("GBufferRT.guideNormalW"), *rgb("GBufferRT.diffuseOpacity")]
    found = identify(exr(*channels, "GBufferRT.linearZ.R", "GBufferRT.mvec.R", "GBufferRT.mvec.G"))
    assert found.dialect == "falcor"
    assert roles(found) == {
        "colour": "PathTracer.color",
        "position": "GBufferRT.posW",
        "normal": "GBufferRT.guideNormalW",
        "albedo": "GBufferRT.diffuseOpacity",
        "depth": "GBufferRT.linearZ",
    }


def test_pbrt_variance_of_early_versions() -> None:
    """``rgbVariance`` is what ``Variance`` is today."""
    channels = [*"RGB", "Nsx", "Nsy", "Nsz", *rgb("rgbVariance"), *rgb("rgbRelativeVariance")]
    found = identify(exr(*channels, header={"Software": "pbrt-v4", "samplesPerPixel": 8}))
    assert found.of(Role.COLOUR, Stat.VARIANCE).name == "rgbVariance"
    assert found.of(Role.COLOUR, Stat.VARIANCE).scale == 1 / 8
    assert "rgbRelativeVariance" in named(found, "other")
    told = identify(exr(*channels, header={"Software": "pbrt-v4"}), spp=4)
    assert told.of(Role.COLOUR, Stat.VARIANCE).scale == 0.25


def test_redshift() -> None:
    """``DiffuseFilter`` is an albedo, ``…Raw`` no part of the sum."""
    channels = [*RGBA, *rgb("DiffuseLighting"), *rgb("DiffuseLightingRaw"), *rgb("DiffuseFilter")]
    channels += [*rgb("GlobalIllumination"), *rgb("SpecularLighting"), *rgb("Reflections")]
    channels += [*rgb("ReflectionsFilter"), *rgb("BumpNormals"), *rgb("Normals"), "Depth.Z"]
    channels += [*rgb("DiffuseLighting_key"), *rgb("PuzzleMatte1"), *rgb("Emission")]
    found = identify(exr(*channels, *rgb("MotionVectors"), *rgb("WorldPosition")))
    assert found.dialect == "redshift"
    assert roles(found) == {
        "colour": "RGB",
        "alpha": "A",
        "albedo": "DiffuseFilter",
        "specular_albedo": "ReflectionsFilter",
        "normal": "BumpNormals",
        "depth": "Depth",
        "position": "WorldPosition",
        "emission": "Emission",
    }
    assert named(found, "lighting") == {
        "DiffuseLighting", "GlobalIllumination", "SpecularLighting", "Reflections",
        "DiffuseLighting_key",
    }  # fmt: skip
    assert named(found, "other") >= {"DiffuseLightingRaw", "Normals", "MotionVectors"}
    assert named(found, "id") == {"PuzzleMatte1"}


def test_corona() -> None:
    """The prefixes are proof; CESSENTIAL elements are the light."""
    channels = [*RGBA, *rgb("CESSENTIAL_Direct"), *rgb("CESSENTIAL_Indirect")]
    channels += [*rgb("CESSENTIAL_Emission"), *rgb("CShading_Albedo"), *rgb("CShading_SourceColor")]
    channels += [*rgb("CGeometry_NormalsShading"), "CGeometry_ZDepth.Z", *rgb("CMasking_ID")]
    channels += [*rgb("CShading_LightSelect_key"), *rgb("CShading_RawComponent")]
    found = identify(exr(*channels, *rgb("CGeometry_NormalsDotProduct")))
    assert found.dialect == "corona"
    assert roles(found) == {
        "colour": "RGB",
        "alpha": "A",
        "emission": "CESSENTIAL_Emission",
        "albedo": "CShading_Albedo",
        "normal": "CGeometry_NormalsShading",
        "depth": "CGeometry_ZDepth",
    }
    assert named(found, "lighting") == {
        "CESSENTIAL_Direct", "CESSENTIAL_Indirect", "CShading_LightSelect_key",
    }  # fmt: skip
    assert named(found, "id") == {"CMasking_ID"}
    assert "CShading_RawComponent" in named(found, "other")


OCTANE = [
    "DenoiseAlbedo", "DenoiseNormal", "NormalShading", "Emitters", "Diffuse", "ReflectionDirect",
    "ReflectionFilterBeauty", "DenoisedBeauty", "LightID1", "MotionVector",
]  # fmt: skip


@pytest.mark.parametrize("scope", ["", "ViewLayer."])
def test_octane(scope: str) -> None:
    """Alone, and through Blender, whose header and view layers its plug-in writes."""
    channels = [c for name in OCTANE for c in rgb(scope + name)] + [f"{scope}ZDepth.Z"]
    beauty = f"{scope}Combined" if scope else "Beauty"
    header = {"BlenderMultiChannel": "x"} if scope else {}
    found = identify(exr(*channels, *rgb(beauty), header=header))
    assert found.dialect == ("blender" if scope else "octane")
    assert roles(found) == {
        "colour": beauty,
        "albedo": f"{scope}DenoiseAlbedo",
        "normal": f"{scope}DenoiseNormal",
        "specular_albedo": f"{scope}ReflectionFilterBeauty",
        "emission": f"{scope}Emitters",
        "depth": f"{scope}ZDepth",
    }
    light = {"Diffuse", "ReflectionDirect", "LightID1"}
    assert named(found, "lighting") == {scope + name for name in light}
    assert {scope + "DenoisedBeauty", scope + "MotionVector"} <= named(found, "other")


def test_octane_names_of_its_menus() -> None:
    """As its documentation spells them."""
    channels = [*rgb("Beauty"), *rgb("Denoiser albedo"), *rgb("Normal (shading)"), "Z-Depth.Z"]
    found = identify(exr(*channels, *rgb("Denoised beauty"), *rgb("Diffuse filter")))
    assert found.dialect == "octane"
    assert roles(found) == {
        "colour": "Beauty",
        "albedo": "Denoiser albedo",
        "normal": "Normal (shading)",
        "depth": "Z-Depth",
    }


def test_unreal() -> None:
    """Movie Render Queue puts the pass and the material in front."""
    front = "FinalImageMovieRenderQueue_"
    channels = [*RGBA, *rgb(front + "WorldDepth"), *rgb(front + "WorldNormal")]
    channels += [*rgb("FinalImageBaseColor"), *rgb(front + "MotionVectors")]
    found = identify(exr(*channels, *rgb("ActorHitProxyMask00"), header={"unreal/job": "x"}))
    assert found.dialect == "unreal"
    assert roles(found) == {
        "colour": "RGB",
        "alpha": "A",
        "depth": front + "WorldDepth",
        "normal": front + "WorldNormal",
        "albedo": "FinalImageBaseColor",
    }
    assert found.of(Role.DEPTH).channels == ((0, front + "WorldDepth.R"),)
    assert named(found, "id") == {"ActorHitProxyMask00"}
    assert identify(exr(*channels)).dialect == "unreal"  # by names


def test_vray_as_hosts_write_it() -> None:
    """VRay in front, a number behind, components before or after it."""
    channels = [*RGBA, *rgb("VRayDiffuseFilter"), *rgb("VRayLighting_1"), *rgb("VRayBumpNormals")]
    channels += [*(f"VRayGlobalIllumination.{c}.002" for c in "RGB"), *rgb("VRayLightSelect_key")]
    channels += [*(f"{c}.VRayReflection" for c in "RGB"), "VRayZDepth.R", *rgb("VRayRawLighting")]
    found = identify(exr(*channels))
    assert found.dialect == "vray"
    assert roles(found) == {
        "colour": "RGB",
        "alpha": "A",
        "albedo": "VRayDiffuseFilter",
        "normal": "VRayBumpNormals",
        "depth": "VRayZDepth",
    }
    assert named(found, "lighting") == {
        "VRayLighting_1", "VRayGlobalIllumination.002", "VRayLightSelect_key", "VRayReflection",
    }  # fmt: skip
    assert "VRayRawLighting" in named(found, "other")


def test_vray_for_nuke() -> None:
    channels = ["R", "G", "B", *rgb("diffuse"), *xyz("bump_normals"), *rgb("gi"), *rgb("gi_raw")]
    found = identify(exr(*channels, *rgb("self_illumination"), *rgb("atmospheric_effects")))
    assert found.dialect == "vray"
    assert roles(found) == {
        "colour": "RGB",
        "albedo": "diffuse",
        "normal": "bump_normals",
        "emission": "self_illumination",
    }
    assert named(found, "lighting") == {"gi", "atmospheric_effects"}


def test_our_own_frames() -> None:
    """The names that `benchmarks/frames.py` writes."""
    channels = [*"RGB", *rgb("albedo"), *xyz("normal"), "depth.Z", *xyz("position")]
    channels += [*rgb("variance"), *rgb("albedo_variance"), *xyz("normal_variance")]
    channels += ["depth_variance.Z", *rgb("half_a"), *rgb("half_b"), *rgb("albedo_half_a")]
    found = identify(exr(*channels, header={"spp": 16}))
    assert (found.dialect, found.spp) == ("generic", 16)
    assert roles(found) == {
        "colour": "RGB",
        "albedo": "albedo",
        "normal": "normal",
        "depth": "depth",
        "position": "position",
        "colour.variance": "variance",
        "albedo.variance": "albedo_variance",
        "normal.variance": "normal_variance",
        "depth.variance": "depth_variance",
        "colour.half_a": "half_a",
        "colour.half_b": "half_b",
        "albedo.half_a": "albedo_half_a",
    }
    assert found.of(Role.COLOUR, Stat.VARIANCE).scale == 1  # of the mean already


# ----------------------------------------------------------------------------- generic behaviour


def test_lone_vector_has_no_role() -> None:
    """Nothing is guessed from three numbers."""
    found = identify(exr("R", "G", "B", *xyz("thing"), "X", "Y", "Z"))
    assert roles(found) == {"colour": "RGB"}
    assert named(found, "other") == {"thing", "XYZ"}


def test_bare_depth_and_lower_case() -> None:
    found = identify(exr("r", "g", "b", "a", "Z"))
    assert roles(found) == {"colour": "RGB", "alpha": "a", "depth": "Z"}


def test_single_luminance_is_a_colour() -> None:
    assert roles(identify(exr("Y", "A"))) == {"colour": "Y", "alpha": "A"}


def test_colour_missing_is_no_error() -> None:
    """The frame has none, and its message lists what there is."""
    from lambent.frame.frame import Frame
    from lambent.frame.layer import Layer

    found = identify(exr(*rgb("mystery"), *rgb("crypto00")))
    assert roles(found) == {}
    frame = Frame.from_layers(
        Layer(layer.role, np.zeros((2, 2, len(layer.channels))), name=layer.name)
        for layer in found.layers
    )
    message = str(frame.missing(Role.COLOUR))
    assert "mystery" in message
    assert "--map" in message


def test_layers_of_a_view_have_names_of_their_own() -> None:
    """Frames find extra layers by name: two images of one layer must not share it."""
    found = identify(exr(*rgb("a"), *xyz("a"), "a.U", "a.V", "a.foo"))
    names = [layer.name for layer in found.layers]
    assert len(set(names)) == len(names) == 4


def test_second_albedo_is_carried_along() -> None:
    found = identify(exr("R", "G", "B", *rgb("albedo"), *rgb("basecolor")))
    assert found.of(Role.ALBEDO).name == "albedo"
    second = next(layer for layer in found.layers if layer.name == "basecolor")
    assert second.role is Role.OTHER
    assert "'albedo' is taken" in second.why


def test_every_finding_has_a_reason() -> None:
    found = identify(exr(*RGBA, *rgb("albedo"), *rgb("nonsense"), "id"))
    assert found.why
    assert all(layer.why for layer in found.layers)


def test_names_that_are_no_text_can_be_shown() -> None:
    """EXR names are bytes; what is no UTF-8 must not break a print or a JSON file later."""
    wrong = b"caf\xe9".decode("utf-8", "surrogateescape")
    found = identify(exr("R", "G", "B", *rgb(wrong), wrong))
    for layer in found.layers:
        (layer.name + layer.why).encode("utf-8")
    assert "caf\\udce9" in named(found, "other")
    assert (0, f"{wrong}.R") in [c for layer in found.layers for c in layer.channels]
    with pytest.raises(UnknownNameError) as caught:
        identify(exr("R", "G", "B", *rgb(wrong)), {"albedo": "nothing"})
    str(caught.value).encode("utf-8")


# ------------------------------------------------------------------------------------------ views


def test_views_by_prefix_without_header() -> None:
    """``left.`` and ``right.`` are views even where no attribute says so."""
    found = identify(exr("R", "G", "B", "left.R", "left.G", "left.B", "left.albedo.R",
                         "left.albedo.G", "left.albedo.B"))  # fmt: skip
    assert found.views == ("right", "left")
    assert roles(found, "left") == {"colour": "RGB", "albedo": "albedo"}
    assert roles(found, "right") == {"colour": "RGB"}


def test_views_by_part_names() -> None:
    found = identify(parts(("beauty_left", "R G B A"), ("beauty_right", "R G B A"),
                           ("albedo.left", "R G B"), ("albedo.right", "R G B")))  # fmt: skip
    assert found.views == ("left", "right")
    expected = {"colour": "beauty", "alpha": "beauty.A", "albedo": "albedo"}
    assert roles(found, "left") == roles(found, "right") == expected


@pytest.mark.parametrize("mark", [".", "_", "-", " "])
@pytest.mark.parametrize("view", ["main", "cam1", "Left"])
def test_the_view_of_a_part_is_no_part_of_its_name(mark: str, view: str) -> None:
    """As Nuke and others write a file of one view or of any."""
    rgba, albedo = "R G B A", "albedo.red albedo.green albedo.blue"
    layers = {"rgba": rgba, "depth": "depth.Z", "albedo": albedo, "N": "X Y Z"}
    file = parts(*((f"{name}{mark}{view}", channels, view) for name, channels in layers.items()))
    found = identify(file)
    assert found.views == (view,)
    assert roles(found, view) == {
        "colour": "rgba",
        "alpha": "rgba.A",
        "depth": "depth",
        "albedo": "albedo",
        "normal": "N",
    }
    by_part = identify(file, {"position": f"N{mark}{view}"})  # as the file's parts are shown
    assert by_part.of(Role.POSITION, view=view).name == "N"


def test_main_without_a_declaration() -> None:
    """Where every part has it; a light group called main stays one."""
    found = identify(parts(("rgba.main", "R G B A"), ("depth.main", "Z"), ("N.main", "X Y Z")))
    assert found.views == ()
    assert roles(found) == {"colour": "rgba", "alpha": "rgba.A", "depth": "depth", "normal": "N"}
    found = identify(parts(("RGBA", "R G B A"), ("RGBA_main", "R G B"), ("diffuse_main", "R G B")))
    assert roles(found) == {"colour": "RGBA", "alpha": "RGBA.A"}
    assert "RGBA_main" in named(found, "lighting")
    assert "diffuse_main" in {layer.name for layer in found.layers}


def test_a_light_group_named_as_the_view() -> None:
    found = identify(parts(("RGBA", "R G B A", "main"), ("RGBA_main", "R G B", "main")))
    assert roles(found, "main") == {"colour": "RGBA", "alpha": "RGBA.A"}
    assert named(found, "lighting", "main") == {"RGBA_main"}


def test_main_in_channels() -> None:
    """Nuke writes the view in front of a channel, the standard before its last part."""
    channels = ["main.R", "main.G", "main.B", "depth.main.Z", *(f"main.albedo.{c}" for c in "RGB")]
    expected = {"colour": "RGB", "depth": "depth", "albedo": "albedo"}
    assert roles(identify(exr(*channels))) == expected
    declared = identify(exr(*channels, header={"multiView": ["main"]}))
    assert roles(declared, "main") == expected
    mixed = identify(exr("R", "G", "B", "main.R", "main.G", "main.B"))
    assert roles(mixed) == {"colour": "RGB"}
    assert "main" in {layer.name for layer in mixed.layers}


def test_view_in_a_channel_of_a_part_of_that_view() -> None:
    file = parts(("a", "albedo.left.R albedo.left.G albedo.left.B", "left"),
                 ("b", "R G B left.R left.G left.B", "left"))  # fmt: skip
    found = identify(file)
    assert found.of(Role.ALBEDO, view="left").name == "albedo"
    assert {layer.name for layer in found.layers} == {"albedo", "b", "left"}


def test_parts_that_openimageio_named() -> None:
    found = identify(parts(("subimage00", "R G B A"), ("subimage01", "R G B")))
    assert roles(found) == {"colour": "RGB", "alpha": "A"}
    assert named(found, "other") == {"subimage01"}
    found = identify(parts(("subimage00", "R G B"), ("subimage01", "R G B")),
                     {"colour": "subimage01", "albedo": "subimage00"})  # fmt: skip
    assert roles(found) == {"colour": "subimage01", "albedo": "RGB"}


def test_blender_views() -> None:
    """Blender's multi-view: the view behind the pass."""
    channels = [f"ViewLayer.{p}.{v}.{c}" for p in ("Combined", "Denoising Albedo")
                for v in ("left", "right") for c in "RGB"]  # fmt: skip
    header = {"multiView": ["left", "right"], "BlenderMultiChannel": "x"}
    found = identify(exr(*channels, header=header))
    for view in ("left", "right"):
        assert roles(found, view) == {
            "colour": "ViewLayer.Combined",
            "albedo": "ViewLayer.Denoising Albedo",
        }


def test_a_layer_called_left_is_no_view() -> None:
    found = identify(exr("left.R", "left.G", "left.B", "top.R", "top.G", "top.B"))
    assert found.views == ()
    assert named(found, "other") == {"left", "top"}


def test_shared_layers_serve_every_view() -> None:
    found = identify(exr("R", "G", "B", "left.R", "left.G", "left.B", "mask.left.m", "both.x",
                         "both.y", header={"multiView": ["right", "left"]}))  # fmt: skip
    assert found.of(Role.COLOUR, view="right").channels[0] == (0, "R")
    assert next(layer for layer in found.layers if layer.name == "both").view == ""


# ------------------------------------------------------------------------------------ view layers


def two_view_layers() -> ExrFile:
    channels = []
    for layer in ("fore", "back.001"):
        for name in ("Combined", "Denoising Albedo", "DiffDir"):
            channels += rgb(f"{layer}.{name}")
    header = {
        "BlenderMultiChannel": "x",
        "cycles.fore.samples": "16",
        "cycles.back.001.samples": "4",
    }
    return exr(*channels, *rgb("Composite.Combined"), header=header)


def test_first_view_layer_gives_the_roles() -> None:
    """Light of another view layer is not part of this beauty, so it is only carried along."""
    found = identify(two_view_layers())
    assert roles(found) == {"colour": "fore.Combined", "albedo": "fore.Denoising Albedo"}
    assert named(found, "lighting") == {"fore.DiffDir"}
    assert "back.001.DiffDir" in named(found, "other")
    assert found.spp == 16
    assert any("back.001" in note for note in found.notes)


def test_the_richest_view_layer_gives_the_roles() -> None:
    """In one part channels come in the order of the alphabet, which means nothing."""
    channels = [*rgb("Aside.Combined"), *rgb("ViewLayer.Combined"), *rgb("ViewLayer.DiffCol")]
    found = identify(exr(*channels, *rgb("ViewLayer.Denoising Albedo")))
    assert found.of(Role.COLOUR).name == "ViewLayer.Combined"


def test_composite_only_without_view_layers() -> None:
    header = {"BlenderMultiChannel": "x"}
    assert roles(identify(exr(*rgb("Composite.Combined"), header=header))) == {
        "colour": "Composite.Combined"
    }


def test_blender_50_stereo_parts() -> None:
    """As Blender 5.0.1 names them: the view behind the part's name and in its attribute."""
    described = []
    for layer in ("ViewLayer.Combined", "ViewLayer.Noisy Image", "ViewLayer.Denoising Albedo"):
        for view in ("left", "right"):
            channels = dict.fromkeys(f"{layer}.{c}" for c in "RGB")
            described.append(part(len(described), channels, f"{layer}-{view}", view))
    found = identify(ExrFile(Path("x.exr"), tuple(described)))
    assert (found.dialect, found.views) == ("blender", ("left", "right"))
    for view in found.views:
        assert roles(found, view) == {
            "colour": "ViewLayer.Noisy Image",
            "albedo": "ViewLayer.Denoising Albedo",
        }


def test_another_view_layer_by_its_colour() -> None:
    """--map colour=… switches everything, the samples too."""
    found = identify(two_view_layers(), {"colour": "back.001.Combined"})
    assert roles(found) == {"colour": "back.001.Combined", "albedo": "back.001.Denoising Albedo"}
    assert named(found, "lighting") == {"back.001.DiffDir"}
    assert found.spp == 4


def test_pass_name_means_that_of_the_view_layer_in_use() -> None:
    found = identify(two_view_layers(), {"colour": "back.001.Combined", "albedo": "DiffDir"})
    assert found.of(Role.ALBEDO).name == "back.001.DiffDir"
    assert identify(two_view_layers(), {"albedo": "DiffDir"}).of(Role.ALBEDO).name == "fore.DiffDir"


# -------------------------------------------------------------------------------------- overrides


@pytest.mark.parametrize(
    "asked", ["Group.MyLayer", "MyLayer", "mylayer", "Group.MyLayer.R", "GROUP.MYLAYER"]
)
def test_override_by_any_name(asked: str) -> None:
    found = identify(exr("R", "G", "B", *rgb("albedo"), *rgb("Group.MyLayer")), {"albedo": asked})
    assert found.of(Role.ALBEDO).name == "Group.MyLayer"
    assert "--map" in found.of(Role.ALBEDO).why
    assert "albedo" in named(found, "other")


def test_override_by_part() -> None:
    file = parts(("one", "R G B"), ("two", "R G B"), ("three", "x.R x.G x.B"))
    found = identify(file, {"colour": "two", "albedo": "three.x"})
    assert roles(found) == {"colour": "two", "albedo": "x"}


def test_override_of_a_statistic() -> None:
    found = identify(exr("R", "G", "B", *rgb("noise")), {"colour.variance": "noise"})
    assert found.of(Role.COLOUR, Stat.VARIANCE).name == "noise"


def test_override_alpha_follows_the_colour() -> None:
    found = identify(exr(*RGBA, *rgb("other"), "other.A"), {"colour": "other"})
    assert roles(found) == {"colour": "other", "alpha": "other.A"}
    assert named(found, "lighting") == {"RGB"}


def test_override_in_every_view() -> None:
    file = parts(("rgba", "R G B", "left"), ("rgba", "R G B", "right"),
                 ("x", "R G B", "left"), ("x", "R G B", "right"))  # fmt: skip
    found = identify(file, {"albedo": "x"})
    assert roles(found, "left") == roles(found, "right") == {"colour": "rgba", "albedo": "x"}


def test_unknown_layer_names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="did you mean albedo") as caught:
        identify(exr("R", "G", "B", *rgb("albedo")), {"albedo": "albdo"})
    assert "x.exr" in str(caught.value)


def test_unknown_role() -> None:
    with pytest.raises(UnknownNameError, match="no role 'albdo'"):
        identify(exr("R", "G", "B"), {"albdo": "RGB"})


def test_wrong_channel_count() -> None:
    with pytest.raises(LayerError, match="needs 3 channels, this has 1"):
        identify(exr("R", "G", "B", "depth.Z"), {"normal": "depth"})


def test_channels_joined_by_name() -> None:
    found = identify(exr("0", "1", "2", "3"), {"colour": "0, 1,2", "alpha": "3"})
    assert found.of(Role.COLOUR).channels == ((0, "0"), (0, "1"), (0, "2"))
    assert found.of(Role.ALPHA).channels == ((0, "3"),)
    assert not found.of(Role.COLOUR).cie


def test_joined_channels_leave_the_others() -> None:
    """Every channel stays in a layer, and an alpha with its colour."""
    found = identify(exr(*RGBA, *xyz("v"), "w"), {"colour": "B,G,R", "motion": "v.X,w"})
    assert found.of(Role.COLOUR).channels == ((0, "B"), (0, "G"), (0, "R"))
    assert found.of(Role.ALPHA).channels == ((0, "A"),)
    assert found.of(Role.MOTION).channels == ((0, "v.X"), (0, "w"))
    held = sorted(name for layer in found.layers for _, name in layer.channels)
    assert held == sorted([*RGBA, *xyz("v"), "w"])


def test_joined_channels_of_every_view_and_of_parts() -> None:
    file = parts(("x", "a b c", "left"), ("x", "a b c", "right"))
    found = identify(file, {"colour": "a,b,c"})
    assert found.of(Role.COLOUR, view="left").channels == ((0, "a"), (0, "b"), (0, "c"))
    assert found.of(Role.COLOUR, view="right").channels == ((1, "a"), (1, "b"), (1, "c"))
    file = parts(("one", "v"), ("two", "v"), ("three", "v"))
    found = identify(file, {"colour": "one.v,TWO.v,three.v"})
    assert [index for index, _ in found.of(Role.COLOUR).channels] == [0, 1, 2]


def test_a_layer_with_a_comma_in_its_name() -> None:
    found = identify(exr(*rgb("a,b")), {"colour": "a,b"})
    assert found.of(Role.COLOUR).name == "a,b"


def test_wrong_joins_name_the_channels() -> None:
    with pytest.raises(UnknownNameError, match=r"no channel '5'(.|\n)*Known: 0, 1, 2"):
        identify(exr("0", "1", "2"), {"colour": "0,1,5"})
    with pytest.raises(LayerError, match="needs 1 or 3 channels, this has 2"):
        identify(exr("0", "1", "2"), {"colour": "0,1"})
    with pytest.raises(LayerError, match="different channels"):
        identify(exr("0", "1", "2"), {"colour": "0,1,1"})
    with pytest.raises(UnknownNameError, match="Known: 0, 1, 2"):
        identify(exr("0", "1", "2"), {"colour": "rgb"})


@pytest.mark.parametrize("name", ["R", "Z", "Y", "V", "luminance"])
def test_one_channel_as_colour(name: str) -> None:
    assert identify(exr(name), {"colour": name}).of(Role.COLOUR).channels == ((0, name),)
    if name != "Y":  # the luminance, which is a colour anyway
        assert identify(exr(name)).of(Role.COLOUR) is None


def test_films_of_cie_xyz() -> None:
    """Mitsuba's are known; elsewhere the user says it. Three channels by name are as they stand."""
    header = {"generatedBy": "Mitsuba version 3.9.1"}
    found = identify(exr("X", "Y", "Z", "A", header=header))
    assert roles(found) == {"colour": "XYZ", "alpha": "A"}
    assert found.of(Role.COLOUR).cie
    assert any("CIE XYZ" in note for note in found.notes)
    assert identify(exr("R", "G", "B", "X", "Y", "Z", header=header)).of(Role.COLOUR).name == "RGB"
    assert identify(exr("X", "Y", "Z")).of(Role.COLOUR) is None
    assert identify(exr("X", "Y", "Z"), {"colour": "XYZ"}).of(Role.COLOUR).cie
    assert not identify(exr("X", "Y", "Z"), {"colour": "X,Y,Z"}).of(Role.COLOUR).cie
    with pytest.raises(LayerError, match="cannot be read"):
        identify(exr("R", "G", "B", *xyz("v")), {"colour.variance": "v"})


# --------------------------------------------------------------------------------------- plug-ins


def test_plugin_dialect() -> None:
    """A dialect of somebody else, in a session; its proof beats the common names."""
    own = Dialect(
        "mine",
        "My renderer",
        rules=(Rule("paint", Role.ALBEDO, "the paint"),),
        header=("renderer=mine.*",),
        spp=((r"rays=(\d+)", 1),),
    )
    DIALECTS.register("mine", own)
    try:
        found = identify(exr(*RGBA, *rgb("paint"), *xyz("normal"),
                             header={"renderer": "mine 2.0", "rays": 7}))  # fmt: skip
        assert (found.dialect, found.spp) == ("mine", 7)
        assert roles(found) == {"colour": "RGB", "alpha": "A", "albedo": "paint",
                                "normal": "normal"}  # fmt: skip
    finally:
        DIALECTS._own.pop("mine")
        DIALECTS._loaded.pop("mine")


@pytest.mark.parametrize("name", list(DIALECTS))
def test_tables_are_sound(name: str) -> None:
    """Patterns compile, roles take the statistics they are given, sources are named."""
    dialect = DIALECTS[name]
    assert dialect.name == name
    assert dialect.verified
    for pattern in (*dialect.header, *dialect.names, *(p for p, _ in dialect.spp)):
        re.compile(pattern)
    for rule in dialect.rules:
        for pattern in (rule.pattern, rule.component, rule.without):
            re.compile(pattern)
        assert rule.stat is Stat.MEAN or INFO[rule.role].channels
        assert not rule.per_sample or rule.stat is Stat.VARIANCE


# ------------------------------------------------------------------------------------------- fuzz

NAME = st.one_of(
    st.text(max_size=12),
    st.lists(
        st.sampled_from(
            ["R", "G", "B", "A", "X", "Y", "Z", "W", "RY", "BY", "U", "left", "right", "ViewLayer",
             "Combined", "Noisy Image", "albedo", "Ns", "crypto00", "", "T", "I", "variance", "nn"]
        ),
        min_size=1,
        max_size=4,
    ).map(".".join),
)  # fmt: skip
HEADER = st.dictionaries(
    st.sampled_from(["multiView", "generatedBy", "spp", "BlenderMultiChannel", "samplesPerPixel",
                     "arnold/AA_samples", "cryptomatte/1/name", "cycles.a.samples", "x"]),
    st.one_of(st.text(max_size=6), st.integers(), st.floats(), st.lists(st.text(max_size=5))),
    max_size=4,
)  # fmt: skip
PART = st.tuples(st.lists(NAME, max_size=9, unique=True), st.text(max_size=8),
                 st.sampled_from(["", "left", "right", "é"]), HEADER)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(st.lists(PART, max_size=3), st.dictionaries(st.sampled_from(["albedo", "colour", "z", "?"]),
                                                   NAME, max_size=1))  # fmt: skip
def test_never_a_crash(described: list, overrides: dict[str, str]) -> None:
    """Any channel list gives layers or one of our errors, and every channel has one layer."""
    made = [part(i, names, *rest) for i, (names, *rest) in enumerate(described)]
    file = ExrFile(Path("x.exr"), tuple(made))
    try:
        found = identify(file, overrides)
    except LambentError:
        assert overrides
        return
    there = sorted((p.index, name) for p in file.parts for name in p.channels)
    held = [c for layer in found.layers for c in layer.channels]
    assert len(set(held)) == len(held)
    assert set(held) <= set(there)
    keys = [(layer.view, layer.name) for layer in found.layers]
    assert len(set(keys)) == len(keys)
    unique = [(la.view, la.role, la.stat) for la in found.layers
              if la.role not in (Role.LIGHTING, Role.ID, Role.OTHER)]  # fmt: skip
    assert len(set(unique)) == len(unique)
    for layer in found.layers:
        allowed = INFO[layer.role].channels
        assert not allowed or len(layer.channels) in allowed
