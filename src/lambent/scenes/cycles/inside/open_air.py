"""Open scenes: courts between buildings, and land with rocks, trees of leaf cards and water."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from .dice import Colour, Dice
from .layout import Layout
from .lights import bulb, light, world
from .materials import fog, make, poster
from .placing import copy, dress, place, spots
from .shapes import box, grid_faces, mesh, plane, rock, some_object, tube


def leaf_card(dice: Dice) -> Any:
    """A leaf of six corners, a little folded, one unit long."""
    fold = dice.uniform(0.02, 0.2)
    points = [
        (0, 0, 0),
        (0.3, 0.2, fold),
        (0.75, 0.16, fold),
        (1, 0, 0),
        (0.75, -0.16, fold),
        (0.3, -0.2, fold),
    ]
    return mesh("leaf", points, [(0, 1, 2, 3), (0, 3, 4, 5)])


def court(dice: Dice) -> Layout:
    """A square with buildings around, things in the middle, under a sky or by night."""
    palette = dice.palette()
    night = dice.chance(0.2)
    world(dice.child("world"), "dark" if night else dice.weighted(sky=5, gradient=1, clouds=2))
    ground = dress(
        plane(80, 80, "ground"), make(dice, palette, dice.weighted(stone=5, matte=2, wood=1))
    )
    ground.location = (0, 0, 0)
    if not night and dice.chance(0.4):
        light(
            "SUN",
            (dice.uniform(-3, 3), dice.uniform(-3, 3), dice.uniform(1, 4)),
            (0, 0, 0),
            dice.log(1, 6),
            dice.warmth(),
            angle=math.radians(dice.log(0.3, 5)),
        )
    for n in range(dice.whole(5, 11)):
        part = dice.child("house", n)
        a, r = part.uniform(0, 2 * math.pi), part.uniform(9, 18)
        _house(part, palette, (r * math.cos(a), r * math.sin(a)), part.pick((0.0, math.pi / 2, a)))
    for n, (x, y) in enumerate(spots(dice, dice.whole(3, 9), (-5, -5), (5, 5), 1.6)):
        part = dice.child("thing", n)
        kind = part.weighted(thing=4, column=2, tree=2, post=1.5, bench=1)
        if kind == "tree":
            tree(part, palette, (x, y), part.uniform(2.5, 5))
        elif kind == "column":
            place(
                dress(some_object(part, "lathe"), make(part, palette, "stone")),
                (x, y, 0),
                part.uniform(1.0, 2.2),
            )
        elif kind == "post":
            dress(tube(part, [(x, y, 0), (x, y, 3)], 0.05), make(part, palette, "metal"))
            bulb(part, (x, y, 3), 0.35, 250 if night else 40)
        elif kind == "bench":
            place(
                dress(box((1.6, 0.5, 0.45)), make(part, palette, "wood")),
                (x, y, 0),
                1,
                part.uniform(0, 3),
            )
        else:
            place(
                dress(some_object(part), make(part, palette)),
                (x, y, 0),
                part.log(0.8, 2.8),
                part.uniform(0, 6.3),
            )
    if night:
        for _ in range(2):
            light(
                "SPOT",
                (dice.uniform(-7, 7), dice.uniform(-7, 7), 6),
                (0, 0, 0.5),
                3000,
                dice.warmth(),
                0.1,
                spot_size=1.0,
            )
    if dice.chance(0.12):
        dress(box((40, 40, 12), (0, 0, 5)), fog(dice, dice.log(0.004, 0.015)))
    return Layout("court", (0, 0, 1.2), 4.0, None, (0.4, 6.0))


def _house(dice: Dice, palette: list[Colour], at: tuple[float, float], turn: float) -> None:
    """A block with rows of windows (Array modifiers), a roof, a sign."""
    w, d, floors = dice.uniform(3, 8), dice.uniform(3, 6), dice.whole(1, 5)
    h = 2.8 * floors + 0.6
    root = place(
        dress(
            box((w, d, h)), make(dice, palette, dice.weighted(stone=4, matte=3, wood=1, metal=0.5))
        ),
        (*at, 0),
        1,
        turn,
    )
    glass = (
        make(dice, [(0.04, 0.05, 0.06)], "gloss")
        if dice.chance(0.75)
        else make(dice, palette, "emissive")
    )
    count = max(1, int(w / dice.uniform(1.0, 2.0)))
    for side in (-1, 1):
        pane = dress(
            box(
                (0.55 * w / count, 0.06, dice.uniform(1.0, 1.8)),
                (-w / 2 + 0.5 * w / count, side * d / 2, 1.6),
            ),
            glass,
        )
        for axis, step, many in ((0, w / count, count), (2, 2.8, floors)):
            modifier = pane.modifiers.new("array", "ARRAY")
            modifier.use_relative_offset, modifier.use_constant_offset = False, True
            modifier.constant_offset_displace = tuple(step if k == axis else 0.0 for k in range(3))
            modifier.count = many
        pane.parent = root
    roof = dice.pick(("flat", "gable", "cornice"))
    if roof == "gable":
        z = h + dice.uniform(1, 2.5)
        points = [
            (-w / 2 - 0.3, -d / 2 - 0.3, h),
            (w / 2 + 0.3, -d / 2 - 0.3, h),
            (w / 2 + 0.3, d / 2 + 0.3, h),
            (-w / 2 - 0.3, d / 2 + 0.3, h),
            (-w / 2, 0, z),
            (w / 2, 0, z),
        ]
        made = mesh("roof", points, [(0, 1, 5, 4), (2, 3, 4, 5), (0, 4, 3), (1, 2, 5)])
        dress(made, make(dice, palette, dice.pick(("stone", "wood", "metal")))).parent = root
    elif roof == "cornice":
        dress(box((w + 0.5, d + 0.5, 0.3), (0, 0, h)), make(dice, palette, "stone")).parent = root
    if dice.chance(0.4):
        sign = dress(plane(dice.uniform(1, 3), 0.8), poster(dice, palette, dice.pick((0.0, 3.0))))
        sign.location, sign.rotation_euler = (0, -d / 2 - 0.08, 2.9), (math.pi / 2, 0, 0)
        sign.parent = root


def tree(dice: Dice, palette: list[Colour], at: tuple[float, float], height: float) -> None:
    """A trunk with branches, and leaf cards in clouds around their ends."""
    bark = make(dice, palette, "wood")
    crown = [
        np.array((0, 0, 0.75 * height)) + dice.unit() * dice.uniform(0.1, 0.25) * height
        for _ in range(dice.whole(4, 9))
    ]
    for end in crown:
        start = (0, 0, dice.uniform(0.2, 0.5) * height)
        middle = (np.array(start) + end) / 2 + dice.unit() * 0.08 * height
        made = dress(tube(dice, [(0, 0, 0), start, middle, end], 0.012 * height), bark)
        made.location = (*at, 0)
    card = dress(leaf_card(dice), make(dice, palette, "leaf"))
    leaves = dice.whole(60, 260)
    size = height * dice.uniform(0.05, 0.12)
    for n in range(leaves):
        leaf = copy(card)
        where = crown[n % len(crown)] + dice.unit() * height * 0.16 * dice.uniform(0.2, 1.0)
        leaf.location = (where[0] + at[0], where[1] + at[1], where[2])
        leaf.rotation_euler = tuple(dice.uniform(0, 6.3) for _ in range(3))
        leaf.scale = (size * dice.uniform(0.6, 1.3),) * 3
    bpy.data.objects.remove(card)


def land(dice: Dice) -> Layout:
    """Hills, rocks and trees scattered over them, perhaps water, under a sky."""
    palette = dice.palette()
    world(dice.child("world"), dice.weighted(sky=5, clouds=2, gradient=1))
    n, span = 110, 36.0
    side = np.linspace(-span / 2, span / 2, n)
    x, y = np.meshgrid(side, side, indexing="ij")
    z = np.zeros_like(x)
    for octave in range(6):
        f = dice.uniform(0.1, 0.3) * 1.9**octave
        turn, phase = dice.uniform(0, 6.3), dice.uniform(0, 6.3)
        wave = np.sin(f * (x * math.cos(turn) + y * math.sin(turn)) + phase) * np.sin(
            f * (y * math.cos(turn) - x * math.sin(turn)) + 2 * phase
        )
        z += dice.uniform(0.5, 1.6) * 0.55**octave * wave
    z *= dice.log(0.3, 1.2)
    z += 0.004 * (x**2 + y**2)
    kinds = dice.weighted(matte=3, stone=3, leafy=2)
    material = make(
        dice,
        palette if kinds != "leafy" else [(0.1, 0.16, 0.04), (0.2, 0.2, 0.06), (0.06, 0.1, 0.03)],
        "matte" if kinds == "leafy" else kinds,
    )
    dress(mesh("land", np.stack([x, y, z], -1).reshape(-1, 3), grid_faces(n, n), True), material)

    def ground(a: float, b: float) -> float:
        i = int(np.clip(np.searchsorted(side, a), 0, n - 1))
        j = int(np.clip(np.searchsorted(side, b), 0, n - 1))
        return float(z[i, j])

    if dice.chance(0.4):
        water = dress(
            plane(span, span, "water"),
            make(dice, [(0.02, 0.05, 0.06)], dice.pick(("gloss", "glass"))),
        )
        water.location = (0, 0, float(np.quantile(z, dice.uniform(0.2, 0.45))))
    stones = [
        dress(rock(dice.child("rock", k)), make(dice.child("stone", k), palette, "stone"))
        for k in range(3)
    ]
    for a, b in spots(dice, dice.whole(15, 60), (-12, -12), (12, 12), 0.7):
        place(thing := copy(dice.pick(stones)), (0, 0, 0))
        size = dice.log(0.15, 1.6)
        thing.location, thing.scale = (a, b, ground(a, b) - 0.1 * size), (size,) * 3
        thing.rotation_euler = (dice.normal(0, 0.2), dice.normal(0, 0.2), dice.uniform(0, 6.3))
    for stone in stones:
        bpy.data.objects.remove(stone)
    for k, (a, b) in enumerate(spots(dice, dice.whole(2, 7), (-9, -9), (9, 9), 2.5)):
        before = set(bpy.context.scene.objects)
        tree(dice.child("tree", k), palette, (a, b), dice.uniform(2, 6))
        for made in set(bpy.context.scene.objects) - before:
            made.location[2] += ground(a, b)
    if dice.chance(0.6):
        for k, (a, b) in enumerate(spots(dice, dice.whole(1, 4), (-4, -4), (4, 4), 2.0)):
            thing = dress(
                some_object(dice.child("thing", k)), make(dice.child("stuff", k), palette)
            )
            place(thing, (a, b, ground(a, b) - 0.1), dice.uniform(1, 3), dice.uniform(0, 6))
    return Layout(
        "land",
        (0, 0, float(z.mean()) + 0.8),
        5.0,
        None,
        (float(z.max()) * 0.4 + 0.8, float(z.max()) + 5),
    )
