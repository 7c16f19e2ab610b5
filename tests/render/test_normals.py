"""The normal of a pixel is the one that its BSDF shades with, whatever nests what."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lambent.render.variant import mitsuba

mi = mitsuba()

import drjit as dr

from lambent.render.sampling import FrameSampler
from lambent.render.surface import describe

from . import scenes

#: Pixels along a side, and texels along a side of every map: one in a pixel.
SIZE = 8


def tilts(seed: int, most: float = 0.5) -> np.ndarray:
    """Unit normals ``(SIZE, SIZE, 3)`` about +z, a different one in each texel."""
    xy = np.random.default_rng(seed).uniform(-most, most, (SIZE, SIZE, 2))
    z = np.sqrt(1 - (xy**2).sum(axis=2, keepdims=True))
    return np.concatenate([xy, z], axis=2).astype(np.float32)


def texels(image: np.ndarray, smooth: bool = False) -> dict[str, Any]:
    """An image as a texture, its values as they are."""
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(image, dtype=np.float32)),
        "raw": True,
        "filter_type": "bilinear" if smooth else "nearest",
    }


NORMALS, OTHERS = tilts(1), tilts(2)
HEIGHTS = np.random.default_rng(3).uniform(0, 0.2, (SIZE, SIZE, 1))
DIFFUSE = {"type": "diffuse", "reflectance": 0.5}


def mapped(inner: dict[str, Any], normals: np.ndarray = NORMALS) -> dict[str, Any]:
    return {"type": "normalmap", "normalmap": texels(normals / 2 + 0.5), "inner": inner}


def bumped(inner: dict[str, Any]) -> dict[str, Any]:
    return {"type": "bumpmap", "height": texels(HEIGHTS, smooth=True), "scale": 0.7, "inner": inner}


def two_sided(*inner: dict[str, Any]) -> dict[str, Any]:
    return {"type": "twosided", **{f"inner{n}": one for n, one in enumerate(inner)}}


def masked(inner: dict[str, Any]) -> dict[str, Any]:
    return {"type": "mask", "opacity": 1.0, "inner": inner}


def blended(first: dict[str, Any], second: dict[str, Any], weight: float) -> dict[str, Any]:
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


#: Nestings around diffuse materials, whose density is the cosine to the normal they shade with.
NESTINGS = {
    "normal map": mapped(DIFFUSE),
    "bump map": bumped(DIFFUSE),
    "two-sided normal map": two_sided(mapped(DIFFUSE)),
    "two-sided bump map": two_sided(bumped(DIFFUSE)),
    "another map behind": two_sided(mapped(DIFFUSE), mapped(DIFFUSE, OTHERS)),
    "a bump map behind": two_sided(mapped(DIFFUSE), bumped(DIFFUSE)),
    "map of a two-sided material": mapped(two_sided(DIFFUSE)),
    "bump map of a two-sided material": bumped(two_sided(DIFFUSE)),
    "masked normal map": masked(mapped(DIFFUSE)),
    "masked two-sided bump map": masked(two_sided(bumped(DIFFUSE))),
    "normal map of a masked material": mapped(masked(DIFFUSE)),
    "first of a blend": blended(mapped(DIFFUSE), bumped(DIFFUSE), 0.0),
    "second of a blend": blended(bumped(DIFFUSE), mapped(DIFFUSE), 1.0),
    "normal map of a blend": mapped(blended(DIFFUSE, DIFFUSE, 0.3)),
    "normal map in a normal map": mapped(mapped(DIFFUSE, OTHERS)),
    "bump map in a normal map": mapped(bumped(DIFFUSE)),
    "two-sided normal map in a bump map": two_sided(bumped(mapped(DIFFUSE))),
}


def smooth_mesh(bsdf: Any) -> Any:
    """A bent square with vertex normals and texture coordinates."""
    side = 6
    v, u = (axis.ravel() for axis in np.mgrid[0:side, 0:side] / (side - 1))
    place = np.stack([2 * u - 1, 2 * v - 1, np.cos(2 * u) + np.sin(3 * v) / 2], axis=1)
    slope = np.stack([np.sin(2 * u), -np.cos(3 * v) * 0.75, np.ones_like(u)], axis=1)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + side], axis=1),
            np.stack([corner + 1, corner + side + 1, corner + side], axis=1),
        ]
    )
    props = mi.Properties()
    props["bsdf"] = bsdf
    mesh = mi.Mesh("bent", side * side, len(faces), props, True, True)
    params = mi.traverse(mesh)
    params["vertex_positions"] = place.astype(np.float32).ravel()
    params["vertex_normals"] = (
        (slope / np.linalg.norm(slope, axis=1, keepdims=True)).astype(np.float32).ravel()
    )
    params["vertex_texcoords"] = np.stack([u, v], axis=1).astype(np.float32).ravel()
    params["faces"] = faces.astype(np.uint32).ravel()
    params.update()
    return mesh


def hits(told: dict[str, Any], shape: str, behind: bool) -> tuple[Any, Any, Any, Any]:
    """Interactions of 32 x 32 camera rays with a curved thing, the rays, the BSDF, the scene."""
    bsdf = mi.load_dict(told)
    if shape == "sphere":
        thing: Any = {"type": "sphere", "flip_normals": behind, "bsdf": bsdf}
        eye = [0.5, 1, 5]
    else:
        thing = smooth_mesh(bsdf)
        eye = [0.5, 1, -5 if behind else 5]
    scene = mi.load_dict(
        {
            "type": "scene",
            "thing": thing,
            "sensor": {
                "type": "perspective",
                "fov": 30,
                "to_world": mi.ScalarTransform4f().look_at(eye, [0, 0, 0], [0, 1, 0]),
                "film": scenes.film(32),
            },
        }
    )
    at = dr.arange(mi.UInt32, 32 * 32)
    place = mi.Point2f(mi.Float(at % 32) + 0.5, mi.Float(at // 32) + 0.5) / 32
    ray, _ = scene.sensors()[0].sample_ray(mi.Float(0), mi.Float(0.5), place, mi.Point2f(0.5))
    return scene.ray_intersect(ray), ray, bsdf, scene


@pytest.mark.parametrize("behind", [False, True], ids=["front", "back"])
@pytest.mark.parametrize("shape", ["sphere", "mesh"])
@pytest.mark.parametrize("name", NESTINGS)
def test_normals_are_those_that_the_bsdf_shades_with(name, shape, behind):
    """π times the density of a diffuse BSDF is the cosine between direction and normal."""
    si, ray, bsdf, _scene = hits(NESTINGS[name], shape, behind)
    seen = describe(bsdf, si, si.is_valid())
    normal = mi.Vector3f(seen.normal) + dr.zeros(mi.Vector3f, 32 * 32)
    normal = dr.mulsign(normal, dr.dot(si.to_world(normal), -ray.d))
    np.testing.assert_allclose(np.array(dr.norm(normal)), 1, rtol=1e-5)
    met = 0
    for seed in range(3):
        out = np.random.default_rng(seed).normal(size=3)
        out[2] = abs(out[2]) + 1
        out = mi.Vector3f(*(out / np.linalg.norm(out)).tolist())
        out.z = dr.mulsign(mi.Float(out.z), si.wi.z)
        density = np.array(np.pi * bsdf.pdf(mi.BSDFContext(), si, out, si.is_valid()))
        cosine = np.array(dr.dot(normal, out))
        lit = density > 0
        met += lit.sum()
        np.testing.assert_allclose(cosine[lit], density[lit], atol=2e-6)
    turns = "two-sided" in name or "behind" in name
    assert met > 300 or (behind and not turns)  # one-sided materials are black behind


def picture(bsdf: dict[str, Any], place: Any, more: dict[str, Any] | None = None) -> Any:
    """A scene of a square on which every pixel shows one texel of its maps."""
    transform = mi.ScalarTransform4f
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "orthographic",
                "to_world": transform().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": scenes.film(SIZE),
            },
            "sky": {"type": "constant"},
            "square": {"type": "rectangle", "to_world": place, "bsdf": bsdf},
            **(more or {}),
        }
    )


def features(scene: Any) -> Any:
    return FrameSampler(scene, depth=4).sample(4, seed=1).frame()


@pytest.mark.parametrize("inner", [DIFFUSE, two_sided(DIFFUSE), {"type": "roughplastic"}])
@pytest.mark.parametrize("turn", [0, 180], ids=["front", "back"])
def test_a_normal_map_gives_mitsubas_own_shading_normal(inner, turn):
    place = mi.ScalarTransform4f().rotate([0, 1, 0], turn)
    scene = picture(mapped(inner), place)
    aov = mi.load_dict({"type": "aov", "aovs": "n:sh_normal"})
    theirs = np.array(mi.render(scene, integrator=aov, spp=4))
    theirs *= np.sign(theirs[..., 2:])  # towards the viewer
    frame = features(scene)
    for ours in (frame["normal"], frame.extras["first_normal"].data):
        np.testing.assert_allclose(ours, theirs, atol=2e-6)
    assert np.abs(theirs[..., :2]).max() > 0.3


def test_a_bump_map_gives_mitsubas_own_shading_normal():
    """Where the surface's frame is the world's: elsewhere Mitsuba 3.9 tells it in local axes."""
    scene = picture(
        {"type": "bumpmap", "height": ramp(), "scale": 0.5, "inner": DIFFUSE},
        mi.ScalarTransform4f(),
    )
    aov = mi.load_dict({"type": "aov", "aovs": "n:sh_normal"})
    theirs = np.array(mi.render(scene, integrator=aov, spp=4))
    inner = (slice(1, -1), slice(1, -1))  # a texture's ends are flat
    np.testing.assert_allclose(features(scene)["normal"][inner], theirs[inner], atol=2e-6)
    assert np.abs(theirs[inner][..., 0]).min() > 0.1


def ramp() -> dict[str, Any]:
    """Heights that rise evenly: one slope everywhere."""
    return texels(np.broadcast_to(np.arange(SIZE)[None, :, None] / SIZE, (SIZE, SIZE, 1)), True)


#: Normals of the texels as pixels show them: the first row of a texture lies below.
SHOWN = NORMALS[::-1]

WRAPPED = {
    "twosided": (two_sided(mapped(DIFFUSE)), SHOWN),
    "mask": (masked(mapped(DIFFUSE)), SHOWN),
    "blend": (
        blended(mapped(DIFFUSE), mapped(DIFFUSE, OTHERS), 0.25),
        0.75 * SHOWN + 0.25 * OTHERS[::-1],
    ),
    "mask of two-sided blend": (
        masked(two_sided(blended(mapped(DIFFUSE), DIFFUSE, 0.5))),
        SHOWN + np.array([0, 0, 1], np.float32),
    ),
    "normal map of a mirror on plastic": (
        mapped(blended({"type": "conductor"}, {"type": "plastic"}, 0.5)),
        SHOWN,
    ),
}


@pytest.mark.parametrize("name", WRAPPED)
def test_wrappers_do_not_hide_the_map(name):
    """What Mitsuba's ``sh_normal`` leaves out: maps inside of other BSDFs."""
    bsdf, wanted = WRAPPED[name]
    wanted = wanted / np.linalg.norm(wanted, axis=2, keepdims=True)
    frame = features(picture(bsdf, mi.ScalarTransform4f()))
    np.testing.assert_allclose(frame["normal"], wanted, atol=2e-6)


def test_the_other_side_of_a_two_sided_map_is_its_mirror_image():
    place = mi.ScalarTransform4f().rotate([0, 1, 0], 180)
    frame = features(picture(two_sided(mapped(DIFFUSE)), place))
    # Turned about y, texels run from right to left, x becomes -x, and the near side is -z.
    wanted = SHOWN[:, ::-1] * np.array([-1, 1, 1], np.float32)
    np.testing.assert_allclose(frame["normal"], wanted, atol=2e-6)


def test_maps_are_seen_in_mirrors_and_through_glass():
    """A mirror at 45 degrees shows a wall at the left; a pane stands before both."""
    transform = mi.ScalarTransform4f
    wall = transform().translate([-3, 0, 0]).rotate([0, 1, 0], 90)
    mirror = {
        "type": "rectangle",
        "to_world": transform().rotate([0, 1, 0], -45).scale([1.5, 1, 1]),
        "bsdf": {"type": "conductor"},
    }
    pane = {
        "type": "rectangle",
        "to_world": transform().translate([0, 0, 3]),
        "bsdf": {"type": "thindielectric"},
    }
    frame = features(picture(two_sided(mapped(DIFFUSE)), wall, {"mirror": mirror, "pane": pane}))
    through = frame["roughness"][..., 0] == 1  # all four samples passed the pane
    assert through.sum() > SIZE
    # The wall's own z is the world's x, its x is the world's -z; a mirror swaps left and right.
    local = SHOWN[:, ::-1]
    wanted = np.stack([local[..., 2], local[..., 1], -local[..., 0]], axis=2)
    np.testing.assert_allclose(frame["normal"][through], wanted[through], atol=5e-6)


@pytest.mark.parametrize("bsdf", [mapped(DIFFUSE), bumped(DIFFUSE)], ids=["normal", "bump"])
def test_light_of_a_mapped_diffuse_surface_is_diffuse(bsdf):
    """The Lambertian part has the cosine to the mapped normal, not to the plain one."""
    frame = features(picture(two_sided(bsdf), mi.ScalarTransform4f()))
    assert frame["diffuse"].min() > 0.05
    assert np.abs(frame["specular"]).max() < 1e-6 * frame.colour.max()


def test_a_metal_under_a_map_reflects_as_at_the_mapped_angle():
    """Fresnel's reflectance is that of the angle to the mapped normal."""
    metal = {"type": "conductor", "material": "Cr"}
    unshadowed = dict(mapped(metal), use_shadowing_function=False)
    si, _, bsdf, _scene = hits(unshadowed, "sphere", False)
    seen = np.array(describe(bsdf, si, si.is_valid()).specular)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5), si.is_valid())
    there = np.array(weight)[0] > 0
    assert there.sum() > 200
    np.testing.assert_allclose(seen[:, there], np.array(weight)[:, there], rtol=1e-4)


def test_an_empty_texel_of_a_normal_map_is_the_plain_normal():
    normals = NORMALS.copy()
    normals[3, 4] = 0
    frame = features(picture(mapped(DIFFUSE, normals), mi.ScalarTransform4f()))
    assert np.isfinite(frame["normal"]).all()
    np.testing.assert_allclose(frame["normal"][SIZE - 4, 4], [0, 0, 1], atol=2e-6)
