"""Roles of every file in the shared test data, and of our own Cycles render."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dialect_files import named, part, roles

from lambent.errors import DeepFileError
from lambent.frame.dialects import identify
from lambent.frame.exr import ExrFile, decode
from lambent.frame.role import Role, Space

# file -> dialect, spp, {view: {role: layer}}, some lighting layers, number of id layers
RGBA = {"colour": "RGB", "alpha": "A"}
EXPECTED = {
    "arnold_id_multipart": ("arnold", 1, {"": {"colour": "RGBA", "alpha": "RGBA.A"}}, set(), 2),
    "arnold_multichannel_tiled": ("arnold", 36, {"": RGBA}, set(), 21),
    "arnold_three_cryptomattes_tiled": ("arnold", 36, {"": {}}, set(), 21),
    "cycles_box_4096spp": ("blender", 4096, {"": RGBA}, set(), 0),
    "gaffer_weird_part_names": ("generic", None, {"": RGBA}, set(), 0),
    "mitsuba3_aov_cornell": (
        "mitsuba",
        None,
        {
            "": {
                "colour": "RGB",
                "albedo": "albedo",
                "depth": "dd.y",
                "normal": "nn",
                "position": "pos",
            }
        },
        {"img"},
        1,
    ),
    "nuke_multiview_singlepart": (
        "generic",
        None,
        {"right": {**RGBA, "depth": "depth"}, "left": {**RGBA, "depth": "depth"}, "": {}},
        set(),
        4,
    ),
    "openexr_beachball_multipart_stereo": (
        "generic",
        None,
        {
            "right": {"colour": "rgba", "alpha": "rgba.A", "depth": "depth"},
            "left": {"colour": "rgba", "alpha": "rgba.A", "depth": "depth"},
        },
        set(),
        2,
    ),
    "openexr_beachball_singlepart_stereo": (
        "generic",
        None,
        {"right": {**RGBA, "depth": "Z"}, "left": {**RGBA, "depth": "Z"}},
        set(),
        2,
    ),
    "openexr_displaywindow_t08": ("generic", None, {"": {"colour": "RGB"}}, set(), 0),
    "openexr_luminance_chroma_rec709": ("generic", None, {"": {"colour": "Y"}}, set(), 0),
    "openexr_mipmap_colorcodedlevels": ("generic", None, {"": RGBA}, set(), 0),
    "openexr_nan_inf": ("generic", None, {"": {"colour": "RGB"}}, set(), 0),
    "vray_cornell_layers_cryptomatte": (
        "vray",
        None,
        {"": {**RGBA, "albedo": "diffuse", "normal": "normals", "emission": "selfIllum"}},
        {"lighting", "GI", "SSS", "reflect", "refract", "specular"},
        8,
    ),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_shared_file(shared_data: Path, name: str) -> None:
    """The roles a person would give, found without any flag."""
    dialect, spp, views, lighting, ids = EXPECTED[name]
    found = identify(decode(shared_data / "exr" / f"{name}.exr"))
    assert (found.dialect, found.spp) == (dialect, spp)
    for view, expected in views.items():
        assert roles(found, view) == expected
    assert named(found, "lighting") == lighting
    assert sum(layer.role is Role.ID for layer in found.layers) == ids


def test_every_shared_file_is_expected(shared_data: Path) -> None:
    """A file that joins the data needs a line here; deep files are refused before roles matter."""
    there = {path.stem for path in (shared_data / "exr").glob("*.exr")}
    assert there - set(EXPECTED) == {"openexr_deep_trunks"}
    with pytest.raises(DeepFileError):
        decode(shared_data / "exr" / "openexr_deep_trunks.exr")


def test_every_channel_has_a_layer(shared_data: Path) -> None:
    """Nothing is lost: each channel of each file is in exactly one layer."""
    for path in sorted((shared_data / "exr").glob("*.exr")):
        if path.stem == "openexr_deep_trunks":
            continue
        exr = decode(path)
        there = sorted((part.index, name) for part in exr.parts for name in part.channels)
        assert sorted(c for layer in identify(exr).layers for c in layer.channels) == there


def test_sequence_frame(shared_data: Path) -> None:
    """Common names without any header."""
    found = identify(decode(shared_data / "sequence" / "cornell-orbit" / "noisy_00.exr"))
    assert roles(found) == {
        "colour": "RGB",
        "albedo": "albedo",
        "depth": "depth",
        "motion": "motion",
        "normal": "normal",
    }
    assert found.of(Role.NORMAL).space is Space.UNKNOWN  # the file does not tell


def test_mitsuba_spaces(shared_data: Path) -> None:
    """Mitsuba's vectors are in world space, its depth misses are 0."""
    found = identify(decode(shared_data / "exr" / "mitsuba3_aov_cornell.exr"))
    assert found.of(Role.NORMAL).space is Space.WORLD
    assert found.of(Role.POSITION).space is Space.WORLD
    assert 0.0 in found.of(Role.DEPTH).miss


def test_vray_normals(shared_data: Path) -> None:
    """Camera space by V-Ray's documentation; in this file they are unit vectors in [-1, 1]."""
    exr = decode(shared_data / "exr" / "vray_cornell_layers_cryptomatte.exr")
    found = identify(exr).of(Role.NORMAL)
    assert found.space is Space.CAMERA
    n = np.stack([exr.parts[p].channels[c].data for p, c in found.channels], -1)
    length = np.linalg.norm(n.astype(np.float32), axis=-1)
    assert np.median(length) == pytest.approx(1, abs=0.01)


# ---------------------------------------------------------------------------- Cycles 5.0, our own

CYCLES = Path(__file__).parent.parent / "data" / "cycles_50_multilayer.exr"

CYCLES_ROLES = {
    "colour": "Noisy Image",
    "alpha": "Noisy Image.A",
    "albedo": "Denoising Albedo",
    "normal": "Denoising Normal",
    "depth": "Denoising Depth",
    "position": "Position",
    "motion": "Vector",
    "emission": "Emission",
    "diffuse_albedo": "Diffuse Color",
    "specular_albedo": "Glossy Color",
}
CYCLES_LIGHT = {
    "Diffuse Direct",
    "Diffuse Indirect",
    "Glossy Direct",
    "Glossy Indirect",
    "Transmission Direct",
    "Transmission Indirect",
    "Volume Direct",
    "Volume Indirect",
    "Environment",
    "Combined_lamp",
    "Combined_cube",
}
OLD = {
    "Diffuse Direct": "DiffDir",
    "Diffuse Indirect": "DiffInd",
    "Diffuse Color": "DiffCol",
    "Glossy Direct": "GlossDir",
    "Glossy Indirect": "GlossInd",
    "Glossy Color": "GlossCol",
    "Transmission Direct": "TransDir",
    "Transmission Indirect": "TransInd",
    "Transmission Color": "TransCol",
    "Volume Direct": "VolumeDir",
    "Volume Indirect": "VolumeInd",
    "Emission": "Emit",
    "Environment": "Env",
    "Ambient Occlusion": "AO",
    "Object Index": "IndexOB",
    "Material Index": "IndexMA",
}


def in_layer(names: dict[str, str] | set[str], layer: str) -> dict[str, str] | set[str]:
    if isinstance(names, dict):
        return {role: f"{layer}.{name}" for role, name in names.items()}
    return {f"{layer}.{name}" for name in names}


def test_cycles_50_parts() -> None:
    """Blender 5.0.1 as it writes: a part for each pass."""
    found = identify(decode(CYCLES))
    assert (found.dialect, found.spp) == ("blender", 8)
    assert roles(found) == in_layer(CYCLES_ROLES, "ViewLayer")
    assert named(found, "lighting") == in_layer(CYCLES_LIGHT, "ViewLayer")
    assert any("already denoised" in note for note in found.notes)
    assert found.of(Role.NORMAL).space is Space.CAMERA
    assert [c for _, c in found.of(Role.MOTION).channels] == [
        f"ViewLayer.Vector.{c}" for c in "XYZW"
    ]
    ids = named(found, "id")
    assert {"ViewLayer.Object Index", "ViewLayer.CryptoObject00"} <= ids


def test_cycles_denoising_normal_is_in_camera_space() -> None:
    """The table's claim, measured: the visible side of things has z < 0, unlike world space."""
    exr = decode(CYCLES)
    by_name = {p.name: p for p in exr.parts}
    camera = by_name["ViewLayer.Denoising Normal"].channels["ViewLayer.Denoising Normal.Z"].data
    world = by_name["ViewLayer.Normal"].channels["ViewLayer.Normal.Z"].data
    assert np.mean(camera[camera != 0] < 0.05) > 0.99
    assert np.mean(world) > 0.2  # the floor looks up


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("layer", ["ViewLayer", "RenderLayer", "My.Layer 01"])
def test_cycles_interleaved(old: bool, layer: str) -> None:
    """One part, as Blender up to 4.x writes it, in new and old pass names, any view layer."""
    source = decode(CYCLES)
    channels = {}
    for p in source.parts:
        for name, channel in p.channels.items():
            _, pass_name, component = name.split(".")
            pass_name = OLD.get(pass_name, pass_name) if old else pass_name
            channels[f"{layer}.{pass_name}.{component}"] = channel.data
    header = {"BlenderMultiChannel": "Blender V2.55.1 and newer", f"cycles.{layer}.samples": "64"}
    found = identify(ExrFile(Path("old.exr"), (part(0, channels, header=header),)))
    rename = OLD if old else {}
    expected = {role: rename.get(name, name) for role, name in CYCLES_ROLES.items()}
    assert (found.dialect, found.spp) == ("blender", 64)
    assert roles(found) == in_layer(expected, layer)
    light = {rename.get(name, name) for name in CYCLES_LIGHT}
    assert named(found, "lighting") == in_layer(light, layer)


def test_cycles_without_header() -> None:
    """The names alone are proof enough (a file that went through another program)."""
    source = decode(CYCLES)
    bare = ExrFile(
        Path("x.exr"),
        tuple(
            type(p)(p.index, p.name, "", {}, p.channels, p.data_window, p.display_window)
            for p in source.parts
        ),
    )
    assert identify(bare).dialect == "blender"


def test_cycles_not_denoised() -> None:
    """Without ``Noisy Image`` the colour is ``Combined``."""
    source = decode(CYCLES)
    kept = tuple(p for p in source.parts if "Noisy" not in p.name)
    found = identify(ExrFile(source.path, kept))
    assert found.of(Role.COLOUR).name == "ViewLayer.Combined"
    assert found.of(Role.ALPHA).name == "ViewLayer.Combined.A"
    assert not found.notes
