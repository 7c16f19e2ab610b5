"""Still lifes: things on a table or a sweep, a few or many, in a studio or before a wall."""

from __future__ import annotations

import math

import bpy

from .dice import Dice
from .layout import Layout
from .lights import key_lights, world
from .materials import make, poster
from .placing import copy, dress, place, spots
from .shapes import bevel, box, coil, grid_faces, mesh, plane, some_object


def still_life(dice: Dice) -> Layout:
    """Two to twelve things on a ground of about two metres."""
    palette = dice.palette()
    _ground(dice.child("ground"), palette)
    if dice.chance(0.5):
        world(dice.child("world"), dice.weighted(studio=4, gradient=2, clouds=1, sky=2))
        if dice.chance(0.4):
            key_lights(dice.child("lights"), (0, 0, 0.4), 1.0)
    else:
        world(dice.child("world"), "dark")
        key_lights(dice.child("lights"), (0, 0, 0.4), 1.0)
    count = dice.pick((2, 3, 5, 7, 9, 12))
    size = 1.5 / math.sqrt(count)
    for n, (x, y) in enumerate(spots(dice, count, (-1, -0.8), (1, 0.8), 0.55 * size)):
        part = dice.child("thing", n)
        thing = dress(some_object(part), make(part.child("material"), palette))
        place(thing, (x, y, 0), size * part.log(0.6, 1.3), part.uniform(0, 6.3))
    if dice.chance(0.35):
        _scattered(dice.child("scattered"), palette)
    if dice.chance(0.25):
        wire = place(dress(coil(dice), make(dice, palette, "metal")), (0, 0.3, 0), 1.6)
        wire.scale[2] *= 0.3
    return Layout("still life", (0, 0, 0.28), 0.85, None, (0.15, 2.2))


def _ground(dice: Dice, palette: list[tuple[float, float, float]]) -> None:
    style = dice.weighted(table=3, sweep=3, corner=2, floor=2)
    material = make(
        dice, palette, dice.weighted(wood=3, stone=2, matte=3, gloss=1.5, fabric=2, metal=0.4)
    )
    if style == "sweep":
        profile = [(-3.0, 0.0), (0.8, 0.0)]
        profile += [
            (0.8 + 0.8 * math.sin(a), 0.8 - 0.8 * math.cos(a)) for a in (0.3, 0.6, 0.9, 1.2, 1.5708)
        ]
        profile += [(1.6, 4.0)]
        points = [(x, y, z) for x in (-4.0, 4.0) for y, z in profile]
        dress(mesh("sweep", points, grid_faces(2, len(profile)), True), material)
        return
    if style == "table":
        top = dress(box((2.8, 2.2, 0.1), (0, 0, -0.05)), material)
        bevel(top, 0.02)
        floor = dress(plane(14, 14, "floor"), make(dice, palette, "wood"))
        floor.location = (0, 0, -0.9)
    else:
        dress(plane(14, 14, "floor"), material)
    if style in ("corner", "table"):
        y = 1.3 if style == "corner" else 2.5
        wall = dress(
            box((12, 0.1, 6), (0, y, 2)), make(dice, palette, dice.pick(("matte", "stone", "wood")))
        )
        wall.name = "wall"
        if dice.chance(0.5):
            picture = dress(
                plane(dice.uniform(0.5, 1.6), dice.uniform(0.5, 1.2)), poster(dice, palette)
            )
            picture.location, picture.rotation_euler = (
                (dice.uniform(-0.8, 0.8), y - 0.06, 0.9),
                (math.pi / 2, 0, 0),
            )


def _scattered(dice: Dice, palette: list[tuple[float, float, float]]) -> None:
    """Many small copies of one thing lying about: beads, sweets, screws."""
    seed = dress(
        some_object(dice, dice.pick(("superellipsoid", "torus", "extrusion", "rounded_box"))),
        make(dice, palette),
    )
    for x, y in spots(dice, dice.whole(20, 90), (-1.1, -1), (1.1, 0.9), 0.06):
        thing = copy(seed)
        thing.location = (x, y, 0.0)
        thing.scale = (dice.log(0.04, 0.09),) * 3
        thing.rotation_euler = (0, 0, dice.uniform(0, 6.3))
    bpy.data.objects.remove(seed)
