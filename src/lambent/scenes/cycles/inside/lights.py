"""Lights: skies, suns, windows, lamps with shades, small strong ones, and glowing things."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from .dice import Colour, Dice
from .materials import lamp
from .nodes import Tree
from .placing import dress, look_at
from .shapes import superellipsoid
from .textures import factor

#: Names of the physical sky by version, newest first.
SKIES = ("MULTIPLE_SCATTERING", "NISHITA", "SINGLE_SCATTERING")


def world(dice: Dice, kind: str | None = None, strength: float = 1.0) -> str:
    """The world: a physical sky, a gradient, a studio of soft boxes, clouds, or dark."""
    kind = kind or dice.weighted(sky=4, gradient=2, studio=2, clouds=2, dark=1)
    made = bpy.data.worlds.new("world")
    if not made.node_tree:
        made.use_nodes = True
    bpy.context.scene.world = made
    tree = Tree(made.node_tree)
    colour: Any = (0.0, 0.0, 0.0)
    if kind == "sky":
        node = tree.add("TexSky")
        for name in SKIES:
            try:
                node.raw.sky_type = name
                break
            except TypeError:
                continue
        node.raw.sun_elevation = dice.pick((dice.uniform(0.03, 0.3), dice.uniform(0.3, 1.3)))
        node.raw.sun_rotation = dice.uniform(0, 2 * math.pi)
        node.raw.sun_disc = dice.chance(0.85)
        node.raw.sun_size = math.radians(dice.log(0.5, 8.0))
        node.raw.sun_intensity = dice.log(0.2, 1.0)
        colour, strength = node.out(), strength * 0.12
    elif kind == "dark":
        colour, strength = dice.colour(0.5, 0.5), strength * dice.pick((0.0, 0.02, 0.05))
    else:
        direction = tree.coordinates("Generated")
        up = tree.add("SeparateXYZ", direction).out("Z")
        if kind == "gradient":
            low, high = dice.warmth(), dice.warmth()
            stops = [
                (0.0, tuple(0.15 * c for c in low)),
                (0.5, low),
                (0.6, tuple(0.7 * c for c in high)),
                (1.0, high),
            ]
            half = tree.math("MULTIPLY_ADD", up, 0.5, 0.5)
            colour = tree.ramp(half, stops, "EASE")  # type: ignore[arg-type]
            strength *= dice.uniform(0.4, 1.0)
        elif kind == "clouds":
            value = factor(tree, dice, dice.log(1.5, 4), "noise")
            blue, white = dice.colour(0.8, 0.5), tuple(1.5 * c for c in dice.warmth())
            colour = tree.ramp(value, [(0.4, blue), (0.65, white)])  # type: ignore[list-item]
            strength *= dice.uniform(0.5, 1.2)
        else:  # studio: bright cells on a dark ground
            node = tree.add("TexVoronoi", Vector=direction, Scale=dice.uniform(1.0, 2.5))
            mask = tree.ramp(node.out("Distance"), [(0.25, (1, 1, 1)), (0.32, (0, 0, 0))])
            glow = tree.mix(mask, (0.06, 0.06, 0.07), tuple(min(1.0, c) for c in dice.warmth()))
            colour, strength = glow, strength * dice.uniform(2.0, 6.0)
    # Left alone, Cycles evaluates a procedural world at up to 4096 x 2048 places for its importance
    # map: seconds for each scene, ten times what the picture itself takes.
    made.cycles.sampling_method, made.cycles.sample_map_resolution = "MANUAL", 512
    surface = tree.add("Background", Color=colour, Strength=strength).out()
    tree.add("OutputWorld", Surface=surface)
    return kind


def light(
    kind: str, eye: Sequence[float], target: Sequence[float], watts: float, colour: Colour,
    size: float = 0.1, **properties: Any,
) -> Any:  # fmt: skip
    """A lamp of Blender (``AREA``, ``SPOT``, ``POINT``, ``SUN``) that shines on a target."""
    made = bpy.data.lights.new(kind.lower(), kind)
    made.energy, made.color = watts, colour
    if kind == "AREA":
        made.size = size
    elif kind != "SUN":
        made.shadow_soft_size = size
    for name, value in properties.items():
        setattr(made, name, value)
    thing = bpy.data.objects.new(kind.lower(), made)
    bpy.context.scene.collection.objects.link(thing)
    look_at(thing, eye, target)
    return thing


def key_lights(dice: Dice, centre: Sequence[float], radius: float, watts: float = 60.0) -> None:
    """Key, fill and rim around a subject of some radius: from a soft studio to one hard spot.

    ``watts`` is what lights a subject of radius 1 well; it grows with the square.
    """
    watts *= radius * radius
    for n in range(dice.whole(1, 3)):
        # From the sides and the front (-y): behind the subject there may be a wall.
        angle, height = dice.uniform(-math.pi - 0.35, 0.35), dice.uniform(0.5, 2.0)
        eye = [
            centre[0] + 2.0 * radius * math.cos(angle),
            centre[1] + 2.0 * radius * math.sin(angle),
            centre[2] + height * radius,
        ]
        power = watts * dice.log(0.5, 2.0) / (1 + n)
        kind = dice.weighted(AREA=4, SPOT=2, POINT=2)
        if kind == "AREA":
            shape = dice.pick(("SQUARE", "DISK", "RECTANGLE"))
            made = light(
                kind, eye, centre, power, dice.warmth(), radius * dice.log(0.05, 1.2), shape=shape
            )
            if shape == "RECTANGLE":
                made.data.size_y = made.data.size * dice.log(0.1, 1.0)
        elif kind == "SPOT":
            light(
                kind, eye, centre, 5 * power, dice.warmth(), radius * dice.log(0.005, 0.15),
                spot_size=dice.uniform(0.4, 1.2), spot_blend=dice.uniform(0, 1),
            )  # fmt: skip
        else:
            light(kind, eye, centre, 3 * power, dice.warmth(), radius * dice.log(0.005, 0.2))


def bulb(dice: Dice, where: Sequence[float], size: float, watts: float) -> Any:
    """A glowing body in view; its radiance is such that it gives off about ``watts``."""
    thing = superellipsoid(dice, 12, 20)
    thing.scale = (size,) * 3
    thing.location = where
    area = 4 * math.pi * (0.45 * size) ** 2
    dress(thing, lamp(dice.warmth(), watts / (math.pi * max(area, 1e-6))))
    return thing


def strip(dice: Dice, start: Sequence[float], end: Sequence[float], watts: float) -> Any:
    """A tube of light between two points."""
    from .shapes import tube

    made = tube(dice, np.array([start, end], float), dice.log(0.008, 0.03), name="strip")
    length = float(np.linalg.norm(np.subtract(end, start)))
    area = 2 * math.pi * made.data.bevel_depth * length
    dress(made, lamp(dice.warmth(), watts / (math.pi * max(area, 1e-6))))
    return made
