"""A still life by a window, with a lamp: the example scene, made by code alone (CC0).

    python examples/still_life/make_scene.py [--preview] [--spp 12] [--reference-spp 4096]

Everything a denoiser must keep is on this table: thin twigs and brass wires, the weave of a cloth,
wood grain, an engraving, the light through a glass ball, blurred reflections in gold, soft shadows
of window bars, and the colour that walls and oranges throw on their neighbours. `scene` gives the
dictionary for ``mitsuba.load_dict``; run as a program this file renders ``noisy.exr`` and
``reference.exr`` beside itself (needs ``pip install lambent[bench]``).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from shapes import Mesh, dodecahedron, runner, smooth_profile, turned, twig
from textures import Texture, engraving, pages, peel, plaid, plaster, wood

HERE = Path(__file__).resolve().parent
SIZE = (480, 300)

Vector = tuple[float, float, float]


# ------------------------------------------------------------------- materials


def colour(r: float, g: float, b: float) -> dict[str, Any]:
    """A constant linear RGB colour."""
    return {"type": "rgb", "value": [r, g, b]}


def matte(reflectance: dict[str, Any]) -> dict[str, Any]:
    """A diffuse surface, the same on both sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": reflectance}}


def glazed(reflectance: dict[str, Any], alpha: float = 0.05) -> dict[str, Any]:
    """A diffuse surface under a clear coat of roughness ``alpha``."""
    return {
        "type": "twosided",
        "bsdf": {"type": "roughplastic", "diffuse_reflectance": reflectance, "alpha": alpha},
    }


#: Index of refraction and absorption at red, green and blue.
GOLD = ((0.143, 0.375, 1.442), (3.983, 2.386, 1.603))
BRASS = ((0.444, 0.527, 1.094), (3.695, 2.765, 1.829))


def metal(kind: tuple[Vector, Vector], alpha: float) -> dict[str, Any]:
    """A rough conductor."""
    eta, k = kind
    rough = {"type": "roughconductor", "eta": colour(*eta), "k": colour(*k), "alpha": alpha}
    return {"type": "twosided", "bsdf": rough}


def textured(mi: Any, image: Texture, repeat: tuple[float, float] = (1, 1)) -> dict[str, Any]:
    """An image of reflectance, tiled ``repeat`` times."""
    scale = mi.ScalarTransform3f().scale([*repeat])
    return {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True, "to_uv": scale}


# ---------------------------------------------------------------------- shapes


def mesh(mi: Any, name: str, body: Mesh, bsdf: dict[str, Any], at: Vector = (0, 0, 0)) -> Any:
    """A smooth mesh moved to ``at``."""
    vertices, faces, uv = body
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    shape = mi.Mesh(
        name,
        len(vertices),
        len(faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = (vertices + np.float32(at)).ravel()
    parameters["faces"] = faces.ravel()
    parameters["vertex_texcoords"] = uv.ravel()
    parameters.update()
    shape.recompute_vertex_normals()
    return shape


def box(mi: Any, centre: Vector, size: Vector, bsdf: dict[str, Any], turn: float = 0) -> dict:
    """A box, turned about the vertical by ``turn`` degrees."""
    place = (
        mi.ScalarTransform4f()
        .translate([*centre])
        .rotate([0, 1, 0], turn)
        .scale([s / 2 for s in size])
    )
    return {"type": "cube", "to_world": place, "bsdf": bsdf}


def panel(
    mi: Any,
    centre: Vector,
    towards: Vector,
    size: tuple[float, float],
    bsdf: dict,
    up: Vector = (0, 1, 0),
) -> dict[str, Any]:
    """A rectangle that faces ``towards``."""
    target = [c + t for c, t in zip(centre, towards, strict=True)]
    place = mi.ScalarTransform4f().look_at(origin=[*centre], target=target, up=[*up])
    place = place @ mi.ScalarTransform4f().scale([size[0] / 2, size[1] / 2, 1])
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def ball(centre: Any, radius: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    """A sphere."""
    return {"type": "sphere", "center": [*map(float, centre)], "radius": radius, "bsdf": bsdf}


def rod(a: Any, b: Any, radius: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    """A thin cylinder from ``a`` to ``b``."""
    return {
        "type": "cylinder",
        "p0": [*map(float, a)],
        "p1": [*map(float, b)],
        "radius": radius,
        "bsdf": bsdf,
    }


# ------------------------------------------------------------------- the scene


def scene(mi: Any, size: tuple[int, int] = SIZE) -> dict[str, Any]:
    """The scene as a dictionary for ``mitsuba.load_dict``; one unit is ten centimetres."""
    things: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 12}}
    things["sensor"] = {
        "type": "perspective",
        "fov": 36.5,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=[0.15, 3.5, 12.2], target=[0.05, 1.88, 0], up=[0, 1, 0]
        ),
        "film": {
            "type": "hdrfilm",
            "width": size[0],
            "height": size[1],
            "pixel_format": "rgb",
            "rfilter": {"type": "box"},
        },
    }
    for part in (room, window, table, vase, bowl, glass, wires, books, lamp, picture):
        for name, thing in part(mi).items():
            things[f"{part.__name__}_{name}"] = thing
    return things


def room(mi: Any) -> dict[str, Any]:
    """A plastered wall behind, a terracotta one to the right, and a ceiling; open otherwise."""
    wall = matte(textured(mi, plaster(), (2, 1.5)))
    return {
        "back": panel(mi, (0, 4, -3.6), (0, 0, 1), (20, 14), wall),
        "right": panel(mi, (7.2, 4, 2), (-1, 0, 0), (20, 14), matte(colour(0.52, 0.20, 0.10))),
        "ceiling": panel(
            mi, (0, 10, 2), (0, -1, 0), (20, 20), matte(colour(0.7, 0.68, 0.62)), (0, 0, 1)
        ),
    }


def window(mi: Any) -> dict[str, Any]:
    """Daylight from the left, behind a frame with bars."""
    white = matte(colour(0.75, 0.74, 0.7))
    light = panel(mi, (-6.6, 4.6, 2.2), (1, 0, 0), (4.4, 5.2), matte(colour(0, 0, 0)))
    light["emitter"] = {"type": "area", "radiance": colour(14.0, 16.5, 20.0)}
    parts: dict[str, Any] = {"light": light}
    for k, z in enumerate((0, 1.47, 2.93, 4.4)):
        parts[f"post{k}"] = box(mi, (-6.3, 4.6, z), (0.3, 5.4, 0.22), white)
    for k, y in enumerate((2.0, 4.6, 7.2)):
        parts[f"bar{k}"] = box(mi, (-6.3, y, 2.2), (0.3, 0.22, 4.6), white)
    return parts


def table(mi: Any) -> dict[str, Any]:
    """A table of planks with a plaid runner over its front edge."""
    top = glazed(textured(mi, wood(), (1, 1)), 0.18)
    cloth = mesh(
        mi,
        "cloth",
        runner(4.0, 5.4, 1.3),
        matte(textured(mi, plaid(), (1, 1.65))),
        (-0.9, 0.02, 2.02),
    )
    return {
        "top": panel(mi, (0, 0, -0.8), (0, 1, 0), (13, 5.6), top, (0, 0, -1)),
        "edge": box(mi, (0, -0.16, -0.81), (13, 0.3, 5.6), glazed(colour(0.13, 0.06, 0.028), 0.2)),
        "cloth": cloth,
    }


def vase(mi: Any) -> dict[str, Any]:
    """A fluted vase of rough gold with twigs and berries."""
    outside = smooth_profile(
        [
            (0.34, 0.0),
            (0.36, 0.06),
            (0.52, 0.4),
            (0.72, 0.95),
            (0.62, 1.5),
            (0.33, 1.95),
            (0.24, 2.25),
            (0.34, 2.5),
            (0.30, 2.48),
            (0.2, 2.25),
            (0.2, 1.9),
        ]
    )
    at = (-3.05, 0.0, -1.0)
    parts: dict[str, Any] = {
        "body": mesh(mi, "vase", turned(outside, 256, 24, 0.09), metal(GOLD, 0.17), at)
    }
    bark = matte(colour(0.085, 0.05, 0.03))
    berry = glazed(colour(0.50, 0.018, 0.02), 0.08)
    for k, heading in enumerate(
        ((-0.55, 1, 0.15), (-0.1, 1, -0.2), (0.42, 1, 0.25), (0.15, 1, 0.5))
    ):
        start = (at[0], 2.0, at[2])
        rods, berries = twig(start, heading, 2.5 - 0.2 * k, seed=20 + k)
        for n, (a, b) in enumerate(rods):
            parts[f"twig{k}_{n}"] = rod(a, b, 0.022, bark)
        for n, p in enumerate(berries):
            parts[f"berry{k}_{n}"] = ball(p, 0.075, berry)
    return parts


def bowl(mi: Any) -> dict[str, Any]:
    """A blue glazed bowl with oranges."""
    profile = smooth_profile(
        [
            (0.42, 0.0),
            (0.42, 0.10),
            (0.62, 0.22),
            (1.05, 0.55),
            (1.28, 0.95),
            (1.33, 1.0),
            (1.25, 0.97),
            (1.0, 0.58),
            (0.55, 0.27),
            (0.05, 0.2),
        ]
    )
    at = (-0.4, 0.04, -0.7)
    skin = glazed(textured(mi, peel()), 0.22)
    parts: dict[str, Any] = {
        "body": mesh(mi, "bowl", turned(profile, 160), glazed(colour(0.02, 0.06, 0.19), 0.06), at)
    }
    places = ((-0.52, 0.83, 0.18), (0.45, 0.84, 0.32), (0.08, 0.86, -0.52), (0.0, 1.50, 0.06))
    for k, (x, y, z) in enumerate(places):
        parts[f"orange{k}"] = ball((at[0] + x, at[1] + y, at[2] + z), 0.5, skin)
    return parts


def glass(mi: Any) -> dict[str, Any]:
    """A clear ball, which throws caustics on the cloth."""
    clear = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return {"ball": ball((-1.5, 0.62, 1.2), 0.58, clear)}


def wires(mi: Any) -> dict[str, Any]:
    """A dodecahedron of brass wire."""
    corners, edges = dodecahedron()
    corners = corners @ np.array([[0.86, 0, 0.51], [0, 1, 0], [-0.51, 0, 0.86]])
    corners = corners * 0.78
    corners = corners + np.array([1.15, 0.06 - corners[:, 1].min(), 0.95])
    brass = metal(BRASS, 0.12)
    parts: dict[str, Any] = {
        f"edge{k}": rod(corners[i], corners[j], 0.028, brass) for k, (i, j) in enumerate(edges)
    }
    for k, p in enumerate(corners):
        parts[f"knot{k}"] = ball(p, 0.05, brass)
    return parts


def books(mi: Any) -> dict[str, Any]:
    """Two books; the lamp stands on the table behind them."""
    leaves = matte(textured(mi, pages()))
    parts: dict[str, Any] = {}
    stack = (
        ((3.0, 0.0, 0.15), (2.3, 0.42, 1.6), -14, (0.04, 0.13, 0.09)),
        ((3.05, 0.42, 0.1), (2.0, 0.32, 1.4), 8, (0.33, 0.05, 0.035)),
    )
    for k, ((x, y, z), (w, h, d), turn, cover) in enumerate(stack):
        cloth = glazed(colour(*cover), 0.3)
        parts[f"pages{k}"] = box(
            mi, (x, y + h / 2, z), (w - 0.12, h - 0.07, d - 0.08), leaves, turn
        )
        parts[f"low{k}"] = box(mi, (x, y + 0.025, z), (w, 0.05, d), cloth, turn)
        parts[f"high{k}"] = box(mi, (x, y + h - 0.025, z), (w, 0.05, d), cloth, turn)
    return parts


def lamp(mi: Any) -> dict[str, Any]:
    """A brass stand, a warm bulb, and a paper shade that lets light through."""
    at = (2.9, 0.0, -1.75)
    stand = smooth_profile(
        [
            (0.62, 0.0),
            (0.6, 0.06),
            (0.2, 0.16),
            (0.09, 0.4),
            (0.16, 0.62),
            (0.08, 0.85),
            (0.06, 1.9),
            (0.06, 2.35),
            (0.01, 2.4),
        ]
    )
    shade = np.array([(1.12, 2.15), (1.05, 2.4), (0.95, 2.75), (0.85, 3.1), (0.75, 3.45)])
    paper = {
        "type": "principledthin",
        "base_color": colour(0.86, 0.72, 0.50),
        "roughness": 0.9,
        "diff_trans": 1.1,
        "spec_trans": 0.0,
        "eta": 1.1,
    }
    bulb = ball((at[0], 2.75, at[2]), 0.22, matte(colour(0, 0, 0)))
    bulb["emitter"] = {"type": "area", "radiance": colour(62.0, 33.0, 12.5)}
    return {
        "stand": mesh(mi, "stand", turned(stand, 96), metal(BRASS, 0.2), at),
        "shade": mesh(mi, "shade", turned(shade, 96), paper, (at[0], 0, at[2])),
        "bulb": bulb,
    }


def picture(mi: Any) -> dict[str, Any]:
    """An engraving in a thin dark frame on the wall."""
    x, y, z, w, h = 0.1, 4.0, -3.55, 1.9, 2.4
    dark = glazed(colour(0.05, 0.03, 0.02), 0.15)
    return {
        "print": panel(
            mi, (x, y, z), (0, 0, 1), (w, h), matte(textured(mi, engraving()[::-1].copy()))
        ),
        "left": box(mi, (x - w / 2, y, z), (0.12, h + 0.12, 0.14), dark),
        "right": box(mi, (x + w / 2, y, z), (0.12, h + 0.12, 0.14), dark),
        "low": box(mi, (x, y - h / 2, z), (w, 0.12, 0.14), dark),
        "high": box(mi, (x, y + h / 2, z), (w, 0.12, 0.14), dark),
    }


def rounded(layers: dict[str, Any]) -> dict[str, Any]:
    """Albedo and normal in steps of 1/512: finer than any filter sees, and much smaller."""
    return {
        name: (letters, np.round(image * 512) / 512 if name in ("albedo", "normal") else image)
        for name, (letters, image) in layers.items()
    }


def main() -> None:
    """Render the example."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preview", action="store_true", help="write preview.png only")
    parser.add_argument("--spp", type=int, default=12)
    parser.add_argument("--reference-spp", type=int, default=4096)
    parser.add_argument("--out", type=Path, default=HERE)
    parser.add_argument("--checkpoint", type=Path, default=HERE / "reference.npz")
    parser.add_argument(
        "--frames", type=Path, help="a folder for frames with all layers, as benchmarks/frames.py"
    )
    arguments = parser.parse_args()
    sys.path.insert(0, str(HERE.parent.parent / "benchmarks"))
    import frames

    mi = frames.start_mitsuba()
    built = mi.load_dict(scene(mi))
    if arguments.frames:
        for spp in (4, 16, 64):
            path = arguments.frames / f"still-life-{spp}spp.exr"
            if not path.exists():
                frames.write_exr(path, frames.noisy_layers(frames.noisy(built, spp)), spp=spp)
    moments = frames.noisy(built, arguments.spp)
    if arguments.preview:
        from lambent.frame.tonemap import to_png

        (arguments.out / "preview.png").write_bytes(to_png(moments.mean[..., :3]))
        return
    layers = frames.noisy_layers(moments)
    kept = rounded({k: layers[k] for k in ("", "albedo", "normal", "depth")})
    frames.write_exr(arguments.out / "noisy.exr", kept, half=tuple(kept), spp=arguments.spp)
    found = frames.reference(built, arguments.reference_spp, arguments.checkpoint)
    beauty = {"": ("RGB", found.mean[..., :3])}
    frames.write_exr(arguments.out / "reference.exr", beauty, half=("",), spp=found.count)
    if arguments.frames:
        frames.write_reference(arguments.frames / "still-life-reference.exr", found)


if __name__ == "__main__":
    main()
