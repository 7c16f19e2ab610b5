"""Tangles and stages: tubes, wires and letters in a dark box, with lights among them."""

from __future__ import annotations

import math

import bpy
import numpy as np

from .dice import Dice
from .layout import Layout
from .lights import bulb, key_lights, light, strip, world
from .materials import fog, make, poster
from .placing import copy, dress, place, spots
from .shapes import box, letters, plane, some_object, tube


def tangle(dice: Dice) -> Layout:
    """Tubes and wires that wind through a space, some of them lit or of glass."""
    palette = dice.palette()
    if dice.chance(0.5):
        world(dice.child("world"), dice.weighted(studio=3, gradient=2, sky=1))
    else:
        world(dice.child("world"), "dark")
        key_lights(dice.child("lights"), (0, 0, 0.8), 1.2)
    floor = dress(
        plane(20, 20, "floor"), make(dice, palette, dice.pick(("matte", "gloss", "stone", "wood")))
    )
    floor.location = (0, 0, -0.02)
    for n in range(dice.whole(4, 18)):
        part = dice.child("tube", n)
        count = part.whole(4, 14)
        points = np.cumsum(part.arrays.normal(size=(count, 3)) * 0.45, 0)
        points -= points.mean(0)
        points[:, 2] = np.abs(points[:, 2]) + 0.05
        made = tube(part, points, part.log(0.006, 0.12), part.chance(0.3))
        dress(
            made, make(part.child("material"), palette, "emissive" if part.chance(0.06) else None)
        )
    for n in range(dice.whole(0, 5)):
        part = dice.child("thing", n)
        thing = dress(some_object(part), make(part, palette))
        place(thing, (part.uniform(-1, 1), part.uniform(-1, 1), 0), part.uniform(0.4, 0.9))
    if dice.chance(0.4):
        start = dice.unit() * 0.8
        strip(dice, (start[0], start[1], 0.1), (-start[0], start[1], 1.6), dice.log(10, 60))
    return Layout("tangle", (0, 0, 0.7), 1.1, None, (0.2, 2.5))


def stage(dice: Dice) -> Layout:
    """Words, signs and repeated blocks on a dark floor under spots and neon; sometimes haze."""
    palette = dice.palette()
    world(dice.child("world"), "dark")
    dress(
        plane(40, 40, "floor"),
        make(dice, palette, dice.weighted(gloss=4, stone=2, wood=2, metal=1)),
    )
    wall = dress(
        box((14, 0.2, 8), (0, 3.2, 3)),
        make(dice, palette, dice.pick(("stone", "matte", "wood", "film"))),
    )
    wall.name = "wall"
    for n, (x, y) in enumerate(spots(dice, dice.whole(2, 5), (-2.2, -1), (2.2, 2.4), 1.0)):
        part = dice.child("word", n)
        thing = letters(part) if part.chance(0.5) else some_object(part)
        glowing = part.chance(0.3)
        dress(thing, make(part, palette, "emissive" if glowing else None))
        place(thing, (x, y, 0), part.uniform(0.7, 1.5))
    if dice.chance(0.6):
        block = dress(
            some_object(
                dice.child("block"),
                dice.pick(("rounded_box", "extrusion", "lathe", "superellipsoid")),
            ),
            make(dice.child("blocks"), palette),
        )
        step, many = dice.uniform(0.5, 0.9), dice.whole(3, 7)
        for i in range(many):
            for j in range(many):
                thing = copy(block)
                thing.location = ((i - many / 2) * step * 1.5, 2.6 - j * step * 0.6, 0)
                size = dice.uniform(0.25, 0.5) * (0.6 + 0.8 * dice.uniform())
                thing.scale = (size, size, size * dice.log(0.6, 2.5))
                thing.rotation_euler = (0, 0, dice.uniform(0, 6.3))
        bpy.data.objects.remove(block)
    for n in range(dice.whole(1, 3)):
        part = dice.child("spot", n)
        light(
            "SPOT",
            (part.uniform(-4, 4), part.uniform(-4, 1), part.uniform(2.5, 5)),
            (part.uniform(-1.5, 1.5), part.uniform(-0.5, 2), 0.4),
            part.log(600, 2500),
            part.warmth(),
            part.log(0.01, 0.2),
            spot_size=part.uniform(0.4, 1.1),
            spot_blend=part.uniform(0, 1),
        )
    for n in range(dice.whole(0, 4)):
        part = dice.child("neon", n)
        x, z = part.uniform(-3, 3), part.uniform(0.3, 3)
        a = part.pick((0.0, math.pi / 2, part.uniform(0, 3)))
        strip(
            part, (x, 3.0, z), (x + math.cos(a) * 1.4, 3.0, z + math.sin(a) * 1.4), part.log(15, 80)
        )
    if dice.chance(0.4):
        bulb(
            dice,
            (dice.uniform(-2, 2), dice.uniform(0, 2), dice.uniform(0.4, 2)),
            dice.log(0.05, 0.4),
            dice.log(30, 120),
        )
    if dice.chance(0.5):
        sign = dress(
            plane(dice.uniform(1, 3), dice.uniform(0.8, 2)),
            poster(dice, palette, dice.pick((0.0, 2.0, 4.0))),
        )
        sign.location, sign.rotation_euler = (
            (dice.uniform(-2, 2), 3.05, dice.uniform(1.2, 2.5)),
            (math.pi / 2, 0, 0),
        )
    if dice.chance(0.2):
        dress(box((13, 6, 6), (0, 0, 3.01)), fog(dice, dice.log(0.02, 0.1)))
    return Layout("stage", (0, 1.0, 0.7), 1.8, None, (0.3, 2.5))
