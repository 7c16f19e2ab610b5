"""Procedural textures: a factor in about [0, 1] made of Blender's noises, and colours over it.

`factor` draws one of the textures at a scale, often distorted by another; `coloured` puts a palette
on it; `picture` paints a random image (for posters and screens).
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from .dice import Colour, Dice
from .nodes import Tree


def vector(tree: Tree, dice: Dice, scale: float, which: str = "Object") -> Any:
    """Coordinates, turned and scaled, sometimes bent by a noise."""
    socket = tree.coordinates(which)
    stretch = [dice.log(0.5, 2.0) if dice.chance(0.25) else 1.0 for _ in range(3)]
    socket = tree.add(
        "Mapping",
        Vector=socket,
        Location=tuple(dice.uniform(-20, 20) for _ in range(3)),
        Rotation=tuple(dice.normal(0, 0.5) if dice.chance(0.5) else 0.0 for _ in range(3)),
        Scale=tuple(scale * s for s in stretch),
    ).out()
    if dice.chance(0.25):
        bend = tree.add("TexNoise", Vector=socket, Scale=dice.log(0.5, 3), Detail=2.0)
        offset = tree.add(
            "VectorMath", bend.out("Color"), (0.5, 0.5, 0.5), operation="SUBTRACT"
        ).out()
        amount = dice.log(0.1, 1.0)
        offset = tree.add("VectorMath", offset, (amount,) * 3, operation="MULTIPLY").out()
        socket = tree.add("VectorMath", socket, offset, operation="ADD").out()
    return socket


def factor(tree: Tree, dice: Dice, scale: float, kind: str | None = None) -> Any:
    """A socket with a texture's value. ``scale``: features per unit of length."""
    where = vector(tree, dice, scale)
    kind = kind or dice.weighted(
        noise=5,
        ridge=1.5,
        voronoi=2.5,
        cells=1.5,
        crackle=2,
        wave=2,
        rings=1,
        brick=1.5,
        checker=1.2,
        magic=0.8,
        dots=1,
        stripes=1.2,
        fabric=1.2,
    )
    if kind == "noise":
        return tree.add(
            "TexNoise",
            Vector=where,
            Scale=1.0,
            Detail=dice.uniform(1, 9),
            Roughness=dice.uniform(0.4, 0.75),
            Distortion=dice.pick((0.0, 0.0, 0.6, 2.0)),
        ).out("Factor|Fac")
    if kind == "ridge":
        noise = tree.add("TexNoise", Vector=where, Scale=1.0, Detail=6.0).out("Factor|Fac")
        return tree.math("ABSOLUTE", tree.math("MULTIPLY_ADD", noise, 4.0, -2.0))
    if kind == "voronoi":
        node = tree.add("TexVoronoi", Vector=where, Scale=1.5, Randomness=dice.uniform(0.3, 1.0))
        return node.out("Distance")
    if kind == "cells":
        node = tree.add(
            "TexVoronoi",
            Vector=where,
            Scale=1.5,
            distance=dice.pick(("EUCLIDEAN", "MANHATTAN", "CHEBYCHEV")),
        )
        return tree.add("SeparateColor", node.out("Color")).out()
    if kind == "crackle":
        node = tree.add("TexVoronoi", Vector=where, Scale=1.5, feature="DISTANCE_TO_EDGE")
        return tree.math("SMOOTH_MIN", tree.math("MULTIPLY", node.out(), dice.log(4, 20)), 1.0, 0.1)
    if kind in ("wave", "rings"):
        return tree.add(
            "TexWave",
            Vector=where,
            Scale=dice.log(0.3, 1.0),
            wave_profile=dice.pick(("SIN", "SAW", "TRI")),
            Distortion=dice.log(0.3, 12),
            Detail=dice.uniform(0, 5),
            Detail_Scale=dice.log(0.5, 3),
            wave_type="RINGS" if kind == "rings" else "BANDS",
        ).out("Factor|Fac")
    if kind == "brick":
        node = tree.add(
            "TexBrick",
            Vector=where,
            Scale=1.0,
            Color1=(0.4, 0.4, 0.4),
            Color2=(0.9, 0.9, 0.9),
            Mortar=(0.05, 0.05, 0.05),
            Mortar_Size=dice.log(0.008, 0.04),
            Bias=dice.uniform(-0.5, 0.5),
            Mortar_Smooth=dice.uniform(0, 0.5),
            Row_Height=dice.uniform(0.2, 0.5),
            offset=dice.pick((0.5, 0.5, 0.0, 0.33)),
        )
        return tree.add("SeparateColor", node.out("Color")).out()
    if kind == "checker":
        return tree.add("TexChecker", Vector=where, Scale=1.0).out("Factor|Fac")
    if kind == "magic":
        node = tree.add(
            "TexMagic",
            Vector=where,
            Scale=1.0,
            Distortion=dice.uniform(0.5, 3),
            turbulence_depth=dice.whole(1, 5),
        )
        return node.out("Factor|Fac")
    if kind == "dots":
        node = tree.add("TexVoronoi", Vector=where, Scale=1.5, Randomness=dice.pick((0.0, 0.6)))
        return tree.math("LESS_THAN", node.out("Distance"), dice.uniform(0.2, 0.45))
    if kind == "stripes":
        saw = tree.add("TexWave", Vector=where, Scale=dice.log(0.2, 0.6), wave_profile="SAW")
        return tree.math("GREATER_THAN", saw.out("Factor|Fac"), dice.uniform(0.2, 0.8))
    # fabric: two waves woven
    across = tree.add("TexWave", Vector=where, Scale=3.0, bands_direction="X", Distortion=0.4)
    along = tree.add("TexWave", Vector=where, Scale=3.0, bands_direction="Y", Distortion=0.4)
    return tree.math("MAXIMUM", across.out("Factor|Fac"), along.out("Factor|Fac"))


def coloured(tree: Tree, dice: Dice, value: Any, colours: list[Colour]) -> Any:
    """A palette over a factor: hard bands, a smooth ramp, or two colours that differ little."""
    style = dice.weighted(ramp=3, two=3, bands=1.5, subtle=3)
    first = dice.pick(colours)
    if style == "subtle":
        return tree.ramp(value, [(0.25, first), (0.75, dice.near(first, 0.35))])
    if style == "two":
        second = dice.pick(colours)
        edge = dice.uniform(0.35, 0.6)
        width = dice.pick((0.02, 0.1, 0.25))
        return tree.ramp(value, [(edge - width, first), (edge + width, second)])
    count = dice.whole(3, 5)
    stops = [((n + dice.uniform(0.2, 0.8)) / count, dice.pick(colours)) for n in range(count)]
    return tree.ramp(value, stops, "CONSTANT" if style == "bands" else "EASE")


def picture(dice: Dice, colours: list[Colour], size: int = 192) -> Any:
    """A painted image ``(size, size)``: washes, discs, bars, lines, grain; for a poster."""
    rng = dice.arrays
    y, x = np.mgrid[0:size, 0:size].astype(np.float32) / size
    image = np.empty((size, size, 3), np.float32)
    a, b = np.array(dice.pick(colours)), np.array(dice.pick(colours))
    angle = dice.uniform(0, 6.3)
    t = np.clip(0.5 + (x - 0.5) * np.cos(angle) + (y - 0.5) * np.sin(angle), 0, 1)[..., None]
    image[:] = a * (1 - t) + b * t
    for _ in range(dice.whole(3, 30)):
        colour = np.array(dice.pick(colours) if dice.chance(0.7) else dice.vivid(), np.float32)
        cx, cy, r = dice.uniform(), dice.uniform(), dice.log(0.02, 0.35)
        shape = dice.pick(("disc", "bar", "ring", "line", "blob"))
        if shape == "disc":
            inside = (x - cx) ** 2 + (y - cy) ** 2 < r * r
        elif shape == "ring":
            inside = np.abs(np.hypot(x - cx, y - cy) - r) < 0.15 * r
        elif shape == "bar":
            inside = (np.abs(x - cx) < r) & (np.abs(y - cy) < r * dice.log(0.1, 1.0))
        elif shape == "line":
            turn = dice.uniform(0, 3.2)
            inside = np.abs((x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)) < 0.03 * r + 0.003
        else:
            wave = np.sin(x * dice.uniform(5, 40) + dice.uniform(0, 6)) * np.sin(
                y * dice.uniform(5, 40)
            )
            inside = (wave > 0.4) & (np.hypot(x - cx, y - cy) < 1.5 * r)
        image[inside] = colour * dice.uniform(0.4, 1.0)
    if dice.chance(0.5):  # lines of print
        for row in range(dice.whole(4, 14)):
            top, height = 0.1 + row * 0.06, 0.02
            words = np.repeat(rng.random(size // 6 + 1) > 0.25, 6)[:size]
            inside = (np.abs(y - top) < height / 2) & words[None, :] & (x > 0.1) & (x < 0.9)
            image[inside] *= 0.15
    image *= 1 + 0.15 * rng.normal(size=(size, size, 1)).astype(np.float32)
    pixels = np.ones((size, size, 4), np.float32)
    pixels[..., :3] = np.clip(image, 0.0, 1.0)
    made = bpy.data.images.new("picture", size, size, float_buffer=True)
    made.colorspace_settings.name = "Linear Rec.709"
    made.pixels.foreach_set(pixels.ravel())
    made.update()
    return made
