"""Motion for clips: the camera travels, turns or rests; some things slide, turn or fall."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from .dice import Dice
from .layout import Layout


def animate(dice: Dice, layout: Layout, cameras: list[str], frames: int) -> None:
    """Keyframes over ``frames`` frames, one before the first and one after the last."""
    first, last = 0, frames + 1
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, frames
    for name in cameras:
        _camera(dice.child(name), scene.objects[name], layout, first, last)
    movable = [
        o
        for o in scene.objects
        if o.type in ("MESH", "CURVE", "FONT")
        and o.parent is None
        and not o.hide_render
        and 0.02 < max(o.dimensions) < 0.8 * layout.radius + 0.5
        and o.name.split(".")[0] not in ("floor", "wall", "land", "leaf")
    ]
    movable.sort(key=lambda o: o.name)
    groups = sorted((o for o in scene.objects if o.name.startswith("group")), key=lambda o: o.name)
    count = dice.pick((0, 1, 2, 4))
    for n, thing in enumerate(dice.some([*movable, *groups], count)):
        _thing(dice.child("thing", n), thing, layout, first, last)
    for action in bpy.data.actions:
        _straight(action)


def _camera(dice: Dice, camera: Any, layout: Layout, first: int, last: int) -> None:
    kind = dice.weighted(rest=1, travel=3, turn=2, orbit=2)
    span = last - first
    camera.keyframe_insert("location", frame=first)
    camera.keyframe_insert("rotation_euler", frame=first)
    # The sensor is about 1 wide at distance 1: steps in shares of what is seen a frame.
    step = dice.log(0.003, 0.04) * span
    if kind == "travel":
        move = dice.unit() * step * max(camera["middle"], 0.1)
        if layout.inside is not None:
            low, high = layout.inside
            end = np.clip(
                np.array(camera.location) + move, np.array(low) + 0.15, np.array(high) - 0.15
            )
            move = end - np.array(camera.location)
        camera.location = (np.array(camera.location) + move).tolist()
    elif kind == "turn":
        camera.rotation_euler[2] += dice.pick((-1, 1)) * step
        camera.rotation_euler[0] += dice.normal(0, 0.3) * step
    elif kind == "orbit":
        angle = dice.pick((-1, 1)) * step
        offset = np.array(camera.location) - np.array(layout.centre)
        c, s = math.cos(angle), math.sin(angle)
        turned = (c * offset[0] - s * offset[1], s * offset[0] + c * offset[1], offset[2])
        if layout.inside is None:
            camera.location = (np.array(layout.centre) + turned).tolist()
        camera.rotation_euler[2] += angle
    camera.keyframe_insert("location", frame=last)
    camera.keyframe_insert("rotation_euler", frame=last)


def _thing(dice: Dice, thing: Any, layout: Layout, first: int, last: int) -> None:
    span = last - first
    thing.keyframe_insert("location", frame=first)
    thing.keyframe_insert("rotation_euler", frame=first)
    step = dice.log(0.005, 0.05) * span * layout.radius
    if dice.chance(0.7):
        move = dice.unit() * step
        move[2] = abs(move[2]) * 0.5
        thing.location = (np.array(thing.location) + move).tolist()
    if dice.chance(0.6):
        thing.rotation_euler[2] += dice.pick((-1, 1)) * dice.log(0.01, 0.12) * span
    thing.keyframe_insert("location", frame=last)
    thing.keyframe_insert("rotation_euler", frame=last)


def _straight(action: Any) -> None:
    """Even speed: Blender eases in and out by default."""
    curves = getattr(action, "fcurves", None)
    if curves is None:  # Blender 5: curves lie in layers, strips and slots
        curves = [
            curve
            for layer in action.layers
            for strip in layer.strips
            for bag in strip.channelbags
            for curve in bag.fcurves
        ]
    for curve in curves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
