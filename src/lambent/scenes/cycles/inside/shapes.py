"""Shapes: meshes from formulas, curves, letters, and the modifiers that people put on them.

Every function makes an object about one unit in size, standing on z = 0 around the origin, links it
to the scene and returns it. `some_object` draws one of them for a still life or a shelf.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from .dice import Dice

Vertices = Sequence[Sequence[float]]
WORDS = (
    "light",
    "Ars",
    "no 7",
    "CAFE",
    "&",
    "Open",
    "1984",
    "north",
    "Q",
    "echo",
    "LUMEN",
    "R2",
    "tea",
    "42",
    "Hotel",
    "ab",
    "Sol",
    "void",
    "Kino",
    "?!",
    "atlas",
    "EXIT",
    "g",
    "plan B",
    "Zeit",
)


def mesh(name: str, vertices: Any, faces: Any, smooth: bool = False) -> Any:
    """An object of a mesh, with a UV map for flat quads."""
    made = bpy.data.meshes.new(name)
    made.from_pydata(np.asarray(vertices, float).tolist(), [], [tuple(f) for f in faces])
    made.update()
    if smooth:
        made.polygons.foreach_set("use_smooth", [True] * len(made.polygons))
    thing = bpy.data.objects.new(name, made)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def grid_faces(
    rows: int, columns: int, round_rows: bool = False, round_columns: bool = False
) -> Any:
    """Quads of a grid of points ``rows × columns``, closed around where asked."""
    faces = []
    for i in range(rows if round_rows else rows - 1):
        for j in range(columns if round_columns else columns - 1):
            a, b = (i + 1) % rows, (j + 1) % columns
            faces.append((i * columns + j, i * columns + b, a * columns + b, a * columns + j))
    return faces


def box(size: Sequence[float] = (1, 1, 1), centre: Sequence[float] | None = None) -> Any:
    """A box; without a centre it stands on z = 0."""
    x, y, z = (s / 2 for s in size)
    cx, cy, cz = centre if centre is not None else (0, 0, z)
    corners = [(i * x, j * y, k * z) for k in (-1, 1) for j in (-1, 1) for i in (-1, 1)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    made = mesh("box", [(cx + a, cy + b, cz + c) for a, b, c in corners], faces)
    return made


def plane(width: float, height: float, name: str = "plane") -> Any:
    """A rectangle in the xy-plane around the origin, with a UV map."""
    x, y = width / 2, height / 2
    made = mesh(name, [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], [(0, 1, 2, 3)])
    layer = made.data.uv_layers.new(name="UVMap")
    layer.data.foreach_set("uv", [0, 0, 1, 0, 1, 1, 0, 1])
    return made


def superellipsoid(dice: Dice, rows: int = 40, columns: int = 64) -> Any:
    """|x|^p + |y|^p + |z|^q = 1, from pillows over balls to dice with rounded edges."""
    e1, e2 = dice.pick((0.2, 0.5, 1.0, 1.0, 1.6)), dice.pick((0.2, 0.5, 1.0, 1.0, 1.6))
    v, u = np.meshgrid(
        np.linspace(-math.pi / 2, math.pi / 2, rows),
        np.linspace(-math.pi, math.pi, columns, endpoint=False),
        indexing="ij",
    )

    def power(values: Any, exponent: float) -> Any:
        return np.sign(values) * np.abs(values) ** exponent

    radii = [dice.uniform(0.35, 0.5) for _ in range(3)]
    points = np.stack(
        [
            radii[0] * power(np.cos(v), e1) * power(np.cos(u), e2),
            radii[1] * power(np.cos(v), e1) * power(np.sin(u), e2),
            radii[2] * (1 + power(np.sin(v), e1)),
        ],
        -1,
    ).reshape(-1, 3)
    return mesh("superellipsoid", points, grid_faces(rows, columns, False, True), True)


def lathe(dice: Dice, kind: str | None = None, sides: int = 48) -> Any:
    """A profile turned around z: vases, bowls, bottles, columns, pawns."""
    kind = kind or dice.pick(("vase", "bowl", "bottle", "column", "pawn"))
    profile = _profile(dice, kind)
    turn = np.linspace(0, 2 * math.pi, sides, endpoint=False)
    points = np.stack(
        [
            profile[:, None, 0] * np.cos(turn),
            profile[:, None, 0] * np.sin(turn),
            np.repeat(profile[:, None, 1], sides, 1),
        ],
        -1,
    ).reshape(-1, 3)
    made = mesh(kind, points, grid_faces(len(profile), sides, False, True), True)
    if kind in ("vase", "pawn", "bowl") or dice.chance(0.3):
        subdivide(made, 1 if kind == "bowl" else 2)
    elif kind == "column":
        made.data.polygons.foreach_set("use_smooth", [False] * len(made.data.polygons))
    return made


def _profile(dice: Dice, kind: str) -> Any:
    """Radius and height ``(N, 2)`` of a turned thing, from the bottom's middle to the top's."""
    if kind == "bowl":
        radius = dice.uniform(0.35, 0.55)
        t = np.linspace(0.15, 1, 10)
        outer = np.stack([radius * np.sqrt(t), 0.45 * t**1.6], -1)
        inner = outer[::-1] * (0.92, 1.0) + (0, 0.02)
        return np.concatenate([[(0, outer[0, 1])], outer, inner, [(0, inner[-1, 1])]])
    if kind == "bottle":
        body, neck = dice.uniform(0.14, 0.24), dice.uniform(0.05, 0.08)
        outside = [(0, 0), (body, 0), (body, 0.55), (body * 0.95, 0.62), (neck, 0.8), (neck, 1.0)]
        rim = [(neck * 1.3, 1.0), (neck * 1.3, 1.05), (neck * 0.7, 1.05), (neck * 0.7, 0.8)]
        inside = [(body * 0.85, 0.58), (body * 0.85, 0.05), (0, 0.05)]
        return np.array([*outside, *rim, *inside])
    count = dice.whole(5, 11)
    z = np.linspace(0, 1.0 if kind != "column" else 2.2, count)
    r = np.array([dice.uniform(0.12, 0.42) for _ in range(count)])
    if kind == "vase":
        r = 0.22 + 0.16 * np.sin(z * dice.uniform(3, 7) + dice.uniform(0, 6))
    return np.concatenate([[(0, 0)], np.stack([r, z], -1), [(0, z[-1])]])


def torus(dice: Dice, rows: int = 48, columns: int = 24) -> Any:
    """A ring, sometimes a knot-like one, lying on the ground."""
    small = dice.uniform(0.06, 0.18)
    p, q = dice.pick(((1, 0), (1, 0), (2, 3), (3, 2), (2, 5)))
    rows = rows * max(p, 1) * 2
    t = np.linspace(0, 2 * math.pi * p if q else 2 * math.pi, rows, endpoint=False)
    wobble = (q / p) * t if q else 0 * t
    radius = 0.36 + (0.14 * np.cos(wobble) if q else 0.0 * t)
    path = np.stack([radius * np.cos(t), radius * np.sin(t), 0.14 * np.sin(wobble)], -1)
    if q:
        small *= 0.5
    tangent = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, (0, 0, 1.0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    a = np.linspace(0, 2 * math.pi, columns, endpoint=False)[None, :, None]
    points = path[:, None] + small * (np.cos(a) * side[:, None] + np.sin(a) * up[:, None])
    points = points.reshape(-1, 3)
    points[:, 2] -= points[:, 2].min()
    return mesh("torus", points, grid_faces(rows, columns, True, True), True)


def extrusion(dice: Dice) -> Any:
    """A star, a gear or a crooked polygon, pulled up and twisted."""
    count = dice.whole(3, 14)
    per = dice.pick((1, 2, 4))
    a = np.linspace(0, 2 * math.pi, count * per, endpoint=False)
    r = np.where(
        np.arange(count * per) % max(per, 1) < max(per // 2, 1), 0.45, dice.uniform(0.2, 0.42)
    )
    if per == 1:
        r = 0.45 * np.array([dice.uniform(0.6, 1.0) for _ in a])
    height, twist, taper = dice.log(0.15, 1.4), dice.pick((0, 0, 0.8, 2.5)), dice.uniform(0.5, 1.1)
    levels = 2 if twist == 0 else 24
    points = [
        (
            (1 + (taper - 1) * t) * rr * math.cos(aa + twist * t),
            (1 + (taper - 1) * t) * rr * math.sin(aa + twist * t),
            height * t,
        )
        for t in np.linspace(0, 1, levels)
        for aa, rr in zip(a, r, strict=True)
    ]
    n = len(a)
    faces = grid_faces(levels, n, False, True)
    made = mesh(
        "extrusion",
        points,
        [*faces, tuple(range(n))[::-1], tuple(range(n * (levels - 1), n * levels))],
    )
    if dice.chance(0.6):
        bevel(made, dice.log(0.008, 0.04))
    return made


def rock(dice: Dice) -> Any:
    """A ball pushed in and out by Blender's noise textures (Displace)."""
    made = superellipsoid(dice, 48, 72)
    displace(made, dice, dice.uniform(0.15, 0.45), dice.log(0.15, 0.6))
    if dice.chance(0.4):
        displace(made, dice, 0.06, 0.08)
    return made


def letters(dice: Dice) -> Any:
    """A word standing upright, extruded and bevelled."""
    curve = bpy.data.curves.new("letters", "FONT")
    curve.body = dice.pick(WORDS)
    curve.extrude, curve.bevel_depth = dice.log(0.02, 0.15), dice.pick((0.0, 0.01, 0.02))
    curve.size = 0.8
    curve.align_x = "CENTER"
    made = _linked("letters", curve)
    made.rotation_euler = (math.pi / 2, 0, dice.uniform(-0.5, 0.5))
    made.location = (0, 0, 0.02)
    return made


def tube(
    dice: Dice, points: Any, thickness: float, closed: bool = False, name: str = "tube"
) -> Any:
    """A smooth curve through points ``(N, 3)``, round in section."""
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions = "3D"
    curve.bevel_depth, curve.bevel_resolution, curve.resolution_u = thickness, 3, 8
    spline = curve.splines.new("NURBS" if len(points) > 3 else "POLY")
    spline.points.add(len(points) - 1)
    flat = np.ones((len(points), 4))
    flat[:, :3] = points
    spline.points.foreach_set("co", flat.ravel())
    spline.use_endpoint_u, spline.use_cyclic_u = True, closed
    if len(points) > 3:
        spline.order_u = 4
    return _linked(name, curve)


def coil(dice: Dice) -> Any:
    """A wire wound up: springs, spirals, a tangle."""
    turns, n = dice.whole(3, 12), 160
    t = np.linspace(0, 1, n)
    a = 2 * math.pi * turns * t
    style = dice.pick(("spring", "cone", "ball", "tangle"))
    r = {"spring": 0.3 + 0 * t, "cone": 0.45 * (1 - t), "ball": 0.4 * np.sin(math.pi * t)}.get(
        style, 0.3
    )
    points = np.stack([r * np.cos(a), r * np.sin(a), 0.04 + 0.9 * t], -1)
    if style == "tangle":
        k = dice.arrays.integers(1, 6, size=3)
        phase = dice.arrays.uniform(0, 6, size=3)
        points = np.stack(
            [0.4 * np.sin(k[i] * 2 * math.pi * t * 2 + phase[i]) for i in range(3)], -1
        )
        points[:, 2] += 0.45
    return tube(dice, points, dice.log(0.004, 0.035), name="wire")


def cage(dice: Dice) -> Any:
    """A wire frame of a polyhedron (Wireframe modifier)."""
    bpy.ops.mesh.primitive_ico_sphere_add(
        subdivisions=dice.whole(1, 2), radius=0.45, location=(0, 0, 0.45)
    )
    made = bpy.context.object
    modifier = made.modifiers.new("wire", "WIREFRAME")
    modifier.thickness = dice.log(0.01, 0.05)
    return made


def monkey(dice: Dice) -> Any:
    """Blender's own head, smoothed."""
    bpy.ops.mesh.primitive_monkey_add(size=0.9, location=(0, 0, 0.42))
    made = bpy.context.object
    made.data.polygons.foreach_set("use_smooth", [True] * len(made.data.polygons))
    made.rotation_euler = (dice.uniform(-0.5, 0.1), 0, dice.uniform(0, 6.3))
    subdivide(made, 2)
    return made


def rounded_box(dice: Dice, size: Sequence[float] | None = None) -> Any:
    """A box with bevelled edges."""
    made = box(size or [dice.uniform(0.3, 0.8) for _ in range(3)])
    bevel(made, dice.log(0.005, 0.06))
    return made


def carved(dice: Dice) -> Any:
    """A box or ball with a piece cut out (Boolean), or hollowed (Solidify)."""
    made = box([0.8, 0.8, 0.8])
    cutter = superellipsoid(dice, 24, 32)
    cutter.location = (dice.uniform(-0.3, 0.3), dice.uniform(-0.5, 0.1), dice.uniform(0.1, 0.4))
    cutter.scale = (1.0, 1.0, 1.0)
    cutter.hide_render = True
    cutter.parent = made
    modifier = made.modifiers.new("cut", "BOOLEAN")
    modifier.object, modifier.operation = cutter, "DIFFERENCE"
    return made


def stack(dice: Dice) -> Any:
    """The same slab many times, turned a little each time (Array with an object offset)."""
    made = rounded_box(dice, (dice.uniform(0.3, 0.7), dice.uniform(0.3, 0.7), 0.07))
    turn = bpy.data.objects.new("turn", None)
    bpy.context.scene.collection.objects.link(turn)
    turn.rotation_euler = (0, 0, dice.pick((0.05, 0.2, 0.5)))
    turn.location = (0, 0, 0.08)
    turn.parent = made
    modifier = made.modifiers.new("array", "ARRAY")
    modifier.count = dice.whole(4, 12)
    modifier.use_relative_offset = False
    modifier.use_object_offset, modifier.offset_object = True, turn
    return made


def screwed(dice: Dice) -> Any:
    """A line wound up by the Screw modifier: shells, spirals, springs of ribbon."""
    n = 9
    x = np.linspace(0.12, dice.uniform(0.3, 0.45), n)
    z = 0.12 * np.sin(np.linspace(0, dice.uniform(2, 7), n))
    made = bpy.data.meshes.new("screwed")
    made.from_pydata(
        [(a, 0, 0.15 + b) for a, b in zip(x, z, strict=True)],
        [(i, i + 1) for i in range(n - 1)],
        [],
    )
    thing = _linked("screwed", made)
    modifier = thing.modifiers.new("screw", "SCREW")
    modifier.screw_offset = dice.uniform(0.0, 0.35)
    modifier.angle = 2 * math.pi
    modifier.iterations = dice.whole(1, 3)
    modifier.steps = modifier.render_steps = dice.whole(12, 48)
    modifier.use_smooth_shade = True
    solid = thing.modifiers.new("thick", "SOLIDIFY")
    solid.thickness = dice.log(0.01, 0.05)
    return thing


def blob(dice: Dice) -> Any:
    """Balls melted together (Remesh), smooth or in voxels."""
    made = superellipsoid(dice, 16, 24)
    others = []
    for _ in range(dice.whole(2, 4)):
        ball = superellipsoid(dice, 16, 24)
        size = dice.uniform(0.4, 0.8)
        others.append(
            np.array([v.co for v in ball.data.vertices]) * size
            + dice.arrays.uniform(-0.3, 0.3, 3) * (1, 1, 0)
            + (0, 0, dice.uniform(0, 0.5))
        )
        bpy.data.objects.remove(ball)
    faces = [tuple(p.vertices) for p in made.data.polygons]
    points = [np.array([v.co for v in made.data.vertices]), *others]
    count = len(points[0])
    joined = mesh(
        "blob",
        np.concatenate(points),
        [tuple(i + k * count for i in f) for k in range(len(points)) for f in faces],
        True,
    )
    bpy.data.objects.remove(made)
    modifier = joined.modifiers.new("remesh", "REMESH")
    blocks = dice.chance(0.25)
    modifier.mode = "BLOCKS" if blocks else "VOXEL"
    if blocks:
        modifier.octree_depth = dice.whole(3, 5)
    else:
        modifier.voxel_size, modifier.use_smooth_shade = 0.03, True
        smooth = joined.modifiers.new("smooth", "SMOOTH")
        smooth.factor, smooth.iterations = 0.5, dice.whole(2, 12)
    return joined


SHAPES = {
    "superellipsoid": 3.0,
    "lathe": 4.0,
    "torus": 1.5,
    "extrusion": 2.0,
    "rock": 1.2,
    "letters": 1.0,
    "coil": 1.2,
    "cage": 0.7,
    "monkey": 0.7,
    "rounded_box": 2.5,
    "carved": 1.0,
    "stack": 1.0,
    "screwed": 1.0,
    "blob": 0.8,
}


def some_object(dice: Dice, kind: str | None = None) -> Any:
    """One of all these shapes, about one unit in size, on the ground."""
    kind = kind or dice.weighted(**SHAPES)
    return globals()[kind](dice)


# ------------------------------------------------------------------------------------- modifiers


def subdivide(thing: Any, levels: int) -> None:
    """A Subdivision Surface modifier."""
    modifier = thing.modifiers.new("subsurf", "SUBSURF")
    modifier.levels = modifier.render_levels = levels


def bevel(thing: Any, width: float) -> None:
    """A Bevel modifier of two segments."""
    modifier = thing.modifiers.new("bevel", "BEVEL")
    modifier.width, modifier.segments = width, 3
    modifier.limit_method = "ANGLE"


def displace(thing: Any, dice: Dice, strength: float, size: float) -> None:
    """A Displace modifier with one of Blender's textures of noise."""
    kind = dice.pick(("CLOUDS", "MUSGRAVE", "VORONOI", "STUCCI", "CLOUDS"))
    texture = bpy.data.textures.new("bumps", kind)
    texture.noise_scale = size
    modifier = thing.modifiers.new("displace", "DISPLACE")
    modifier.texture, modifier.strength, modifier.mid_level = texture, strength, 0.5
    modifier.texture_coords = "LOCAL"


def _linked(name: str, content: Any) -> Any:
    thing = bpy.data.objects.new(name, content)
    bpy.context.scene.collection.objects.link(thing)
    return thing
