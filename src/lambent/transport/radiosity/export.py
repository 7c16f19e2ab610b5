"""A solution for other programs: meshes with light in their vertices, and lightmaps.

Colours are linear radiance (B / π, W/m²/sr), in floats, as rendered: a viewer that expects colours
in [0, 1] needs an exposure, which `mesh` can be given. Of a two-sided surface the brighter side is
exported, triangle by triangle, since neither format knows sides.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import EngineError, OptionError
from lambent.frame.atomic import atomic, check_target
from lambent.transport.radiosity.integrator import RadiosityView
from lambent.transport.radiosity.smooth import at_vertices, vertices_of
from lambent.transport.radiosity.solution import RadiositySolution
from lambent.transport.surfaces import CYLINDER, DISK, SPHERE, TRIANGLE, Array, Surfaces

#: Pieces around a sphere, disk or cylinder.
ROUND = 32


@dataclass(frozen=True, eq=False)
class LitMesh:
    """``position`` ``(V, 3)``, ``colour`` ``(V, 3)`` linear radiance, ``triangle`` ``(F, 3)``."""

    position: Array
    colour: NDArray[np.float32]
    triangle: NDArray[np.int32]


def mesh(
    solution: RadiositySolution, scene: Any, surfaces: Surfaces, exposure: float = 1.0
) -> LitMesh:
    """The patches as triangles with the radiance of their corners, times ``exposure``.

    Spheres, disks and cylinders become `ROUND` pieces around and half as many along.
    """
    solution.check(surfaces)
    patches = solution.patches_on(surfaces)
    vertices = vertices_of(patches)
    there = solution.live.astype(float)
    light = np.asarray(solution.radiosity, np.float64) / np.pi * exposure
    # a lamp has light, too, though it may reflect none
    shown = np.maximum(there, (solution.emission.max(axis=1) > 0).astype(float))
    colours = [at_vertices(vertices, patches, light[s::2], shown[s::2]) for s in (0, 1)]
    leaf_prim = patches.cells.prim[patches.leaf]
    patch = np.repeat(np.arange(len(patches)), np.diff(patches.start))
    power = light.sum(axis=1)
    back = power[1::2][patch] > power[0::2][patch]
    flat = surfaces.kind[leaf_prim] == TRIANGLE
    index = vertices.leaf_corners[flat, :3] + back[flat, None] * vertices.count
    normal = surfaces.normal[leaf_prim[flat]] * np.where(back[flat], -1, 1)[:, None]
    position = np.concatenate([vertices.position, vertices.position])
    colour = np.concatenate(colours)
    triangles = _facing(index, position, normal)
    round_ = _round(solution, scene, surfaces, exposure)
    triangles = np.concatenate([triangles, round_.triangle + len(position)])
    position = np.concatenate([position, round_.position])
    colour = np.concatenate([colour, round_.colour])
    used, compact = np.unique(triangles, return_inverse=True)
    return LitMesh(
        position[used],
        colour[used].astype(np.float32),
        compact.reshape(-1, 3).astype(np.int32),
    )


def write_ply(path: str | os.PathLike[str], lit: LitMesh, overwrite: bool = False) -> None:
    """A binary PLY with float colours. Raises `OutputError`, `EngineError`."""
    plyfile = _needed("plyfile")
    vertex = np.empty(
        len(lit.position),
        [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "f4"), ("green", "f4"), ("blue", "f4")],
    )
    for k, name in enumerate("xyz"):
        vertex[name] = lit.position[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        vertex[name] = lit.colour[:, k]
    face = np.empty(len(lit.triangle), [("vertex_indices", "i4", (3,))])
    face["vertex_indices"] = lit.triangle
    data = plyfile.PlyData(
        [
            plyfile.PlyElement.describe(vertex, "vertex"),
            plyfile.PlyElement.describe(face, "face"),
        ],
        text=False,
        byte_order="<",
        comments=["colours: linear radiance"],
    )
    with atomic(path, overwrite) as handle:
        data.write(handle)


def write_gltf(path: str | os.PathLike[str], lit: LitMesh, overwrite: bool = False) -> None:
    """A binary glTF 2.0 (``.glb``) with float vertex colours and an unlit material.

    Raises `OutputError`, `EngineError`.
    """
    g = _needed("pygltflib")
    parts = [
        lit.triangle.astype(np.uint32).ravel().tobytes(),
        lit.position.astype(np.float32).tobytes(),
        lit.colour.astype(np.float32).tobytes(),
    ]
    views, at = [], 0
    for k, part in enumerate(parts):
        target = g.ELEMENT_ARRAY_BUFFER if k == 0 else g.ARRAY_BUFFER
        views.append(g.BufferView(buffer=0, byteOffset=at, byteLength=len(part), target=target))
        at += len(part)
    low, high = (
        getattr(lit.position.astype(np.float32), f)(axis=0).tolist() for f in ("min", "max")
    )
    count = len(lit.position)
    document = g.GLTF2(
        asset=g.Asset(version="2.0", generator="Lambent"),
        scene=0,
        scenes=[g.Scene(nodes=[0])],
        nodes=[g.Node(mesh=0)],
        meshes=[
            g.Mesh(
                primitives=[
                    g.Primitive(
                        attributes=g.Attributes(POSITION=1, COLOR_0=2), indices=0, material=0
                    )
                ]
            )
        ],
        materials=[
            g.Material(
                doubleSided=True,
                extensions={"KHR_materials_unlit": {}},
                pbrMetallicRoughness=g.PbrMetallicRoughness(baseColorFactor=[1, 1, 1, 1]),
            )
        ],
        extensionsUsed=["KHR_materials_unlit"],
        accessors=[
            g.Accessor(
                bufferView=0, componentType=g.UNSIGNED_INT, count=3 * len(lit.triangle),
                type=g.SCALAR,
            ),
            g.Accessor(
                bufferView=1, componentType=g.FLOAT, count=count, type=g.VEC3, min=low, max=high
            ),
            g.Accessor(bufferView=2, componentType=g.FLOAT, count=count, type=g.VEC3),
        ],
        bufferViews=views,
        buffers=[g.Buffer(byteLength=at)],
    )  # fmt: skip
    document.set_binary_blob(b"".join(parts))
    content = b"".join(document.save_to_bytes())
    with atomic(path, overwrite) as handle:
        handle.write(content)


@dataclass(frozen=True, eq=False)
class Lightmap:
    """``image`` ``(H, W, 3)``: irradiance in W/m². ``uv`` ``(P, 3, 2)``: of every primitive the
    texture coordinates of its parameters (0, 0), (1, 0), (0, 1), v downwards. ``covered``
    ``(H, W)``. ``corner`` ``(P, 3, 3)``: the same three points in the world.
    """

    image: NDArray[np.float32]
    uv: Array
    covered: NDArray[np.bool_]
    corner: Array
    kind: NDArray[np.int32]


def lightmap(solution: RadiositySolution, scene: Any, surfaces: Surfaces) -> Lightmap:
    """Irradiance as an image: every primitive has a square of it, as fine as its patches.

    A triangle uses the upper left half of its square. Of two-sided surfaces every texel has the
    brighter side. Raises `FileError` for another scene.
    """
    integrator = RadiosityView.of(solution)
    integrator.prepare(scene)
    cells = solution.patches_on(surfaces).cells
    depth = np.zeros(len(surfaces), np.int64)
    edge = np.abs(cells.corner[:, 1] - cells.corner[:, 0]).max(axis=1)
    level = np.rint(-np.log2(np.maximum(edge, 1e-6))).astype(np.int64)
    np.maximum.at(depth, cells.prim, level)
    # one more texel than cells, so that texel centres lie on corners
    side = (1 << depth) + 1
    order = np.argsort(-side, kind="stable")
    width = int(2 ** np.ceil(np.log2(max(np.sqrt((side.astype(float) ** 2).sum()), side.max()))))
    place = np.zeros((len(side), 2), np.int64)
    x = y = row = 0
    for k in order:  # shelves of falling height
        if x + side[k] > width:
            x, y, row = 0, y + row, 0
        place[k] = x, y
        x += side[k]
        row = max(row, int(side[k]))
    height = int(y + row)
    prims, columns, rows, ab = [], [], [], []
    for s in np.unique(side):
        some = np.flatnonzero(side == s)
        j, i = np.mgrid[0:s, 0:s]
        a, b = (i / max(s - 1, 1)).ravel(), (j / max(s - 1, 1)).ravel()
        prims.append(np.repeat(some, s * s))
        columns.append((place[some, 0][:, None] + i.ravel()).ravel())
        rows.append((place[some, 1][:, None] + j.ravel()).ravel())
        ab.append(np.tile(np.c_[a, b], (len(some), 1)))
    prim, points = np.concatenate(prims), np.concatenate(ab)
    flat = surfaces.kind[prim] == TRIANGLE
    outside = flat & (points.sum(axis=1) > 1 + 1e-9)
    points[outside] /= points[outside].sum(axis=1, keepdims=True)  # the slanted side goes on
    light = np.maximum(*(integrator.at(prim, points, s) for s in (0, 1)))
    image = np.zeros((height, width, 3), np.float32)
    covered = np.zeros((height, width), bool)
    image[np.concatenate(rows), np.concatenate(columns)] = light
    covered[np.concatenate(rows), np.concatenate(columns)] = True
    low = (place + 0.5) / (width, height)
    reach = (side[:, None] - 1) / np.array([width, height])
    uv = np.stack([low, low + reach * (1, 0), low + reach * (0, 1)], axis=1)
    count = len(surfaces)
    three = np.tile([[0.0, 0], [1, 0], [0, 1]], (count, 1))
    corner = surfaces.points(np.repeat(np.arange(count), 3), three)[0].reshape(count, 3, 3)
    return Lightmap(image, uv, covered, corner, surfaces.kind)


def write_lightmap(path: str | os.PathLike[str], made: Lightmap, overwrite: bool = False) -> Path:
    """The image as EXR, and beside it ``NAME.uv.json``: where every triangle is in it.

    A triangle is known by its corners in the world, since Mitsuba merges meshes as it loads.
    """
    from lambent.frame.files import write
    from lambent.frame.frame import Frame

    beside = check_target(Path(path).with_suffix(".uv.json"), overwrite)
    write(path, Frame.from_arrays(colour=made.image), overwrite=overwrite)
    kinds = {TRIANGLE: "triangle", SPHERE: "sphere", DISK: "disk", CYLINDER: "cylinder"}
    document = {
        "image": Path(path).name,
        "unit": "irradiance, W/m^2",
        "origin": "upper left; u to the right, v downwards",
        "primitives": [
            {
                "kind": kinds[int(kind)],
                "corners": np.round(corner, 6).tolist(),
                "uv": np.round(uv, 7).tolist(),
            }
            for kind, corner, uv in zip(made.kind, made.corner, made.uv, strict=True)
        ],
    }
    with atomic(beside, overwrite) as handle:
        handle.write(json.dumps(document).encode())
    return beside


def export(
    solution: RadiositySolution,
    scene: Any,
    surfaces: Surfaces,
    path: str | os.PathLike[str],
    exposure: float = 1.0,
    overwrite: bool = False,
) -> None:
    """By the name's ending: ``.ply``, ``.glb``. Raises `OptionError` for others."""
    suffix = Path(path).suffix.lower()
    if suffix not in (".ply", ".glb"):
        raise OptionError(f"'{suffix}' is not a mesh format", remedy="take .ply or .glb")
    write = write_ply if suffix == ".ply" else write_gltf
    write(path, mesh(solution, scene, surfaces, exposure), overwrite)


# ------------------------------------------------------------------- private


def _facing(index: NDArray[Any], position: Array, normal: Array) -> NDArray[Any]:
    """Triangles whose corners go round counter-clockwise, seen from where ``normal`` points."""
    p = position[index]
    own = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    turned = (own * normal).sum(axis=1) < 0
    return np.where(turned[:, None], index[:, ::-1], index)


def _round(solution: RadiositySolution, scene: Any, surfaces: Surfaces, exposure: float) -> LitMesh:
    """Curved primitives as grids: smooth irradiance, reflectance and emission of the patch."""
    curved = np.flatnonzero((surfaces.kind != TRIANGLE) & (surfaces.area > 0))
    if not len(curved):
        return LitMesh(np.zeros((0, 3)), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    integrator = RadiosityView.of(solution)
    integrator.prepare(scene)
    around, along = ROUND, ROUND // 2
    j, i = np.mgrid[0 : along + 1, 0 : around + 1]
    grid = np.c_[(i / around).ravel(), (j / along).ravel()]
    corner = (j[:-1, :-1] * (around + 1) + i[:-1, :-1]).ravel()
    right, down = corner + 1, corner + around + 1
    faces = np.concatenate(
        [np.stack([corner, right, down], 1), np.stack([right, down + 1, down], 1)]
    )
    positions, colours, triangles = [], [], []
    for count, prim in enumerate(curved):
        ab = grid[:, ::-1] if surfaces.kind[prim] == DISK else grid  # of a disk, b goes around
        prims = np.full(len(ab), prim)
        place, normal = surfaces.points(prims, ab)
        patch = integrator.patch_at(prims, ab)
        sides = []
        for side in (0, 1):
            face = 2 * patch + side
            arrives = integrator.at(prims, ab, side)
            sides.append(solution.emission[face] + solution.reflectance[face] * arrives)
        back = sides[1].sum() > sides[0].sum()
        middle = normal[faces].mean(axis=1) * (-1 if back else 1)
        positions.append(place)
        colours.append(sides[int(back)] / np.pi * exposure)
        triangles.append(_facing(faces, place, middle) + count * len(ab))
    return LitMesh(
        np.concatenate(positions),
        np.concatenate(colours).astype(np.float32),
        np.concatenate(triangles).astype(np.int32),
    )


def _needed(name: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise EngineError(
            f"this needs the package {name}", remedy="pip install 'lambent[transport]'"
        ) from error
