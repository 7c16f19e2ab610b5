"""Placing things: instances, materials, turning things towards a point, and what stands where."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import bpy
import mathutils  # type: ignore[import-not-found]
import numpy as np

from .dice import Dice


def dress(thing: Any, material: Any) -> Any:
    """The thing, with its only material."""
    if thing.data is not None and hasattr(thing.data, "materials"):
        thing.data.materials.clear()
        thing.data.materials.append(material)
    return thing


def place(thing: Any, where: Sequence[float], size: float = 1.0, turn: float = 0.0) -> Any:
    """The thing moved, scaled and turned about z, relative to how it was made."""
    thing.location = [size * a + b for a, b in zip(thing.location, where, strict=True)]
    thing.scale = [size * s for s in thing.scale]
    thing.rotation_euler[2] += turn
    return thing


def copy(thing: Any) -> Any:
    """Another object with the same mesh (an instance for Cycles)."""
    made = thing.copy()
    bpy.context.scene.collection.objects.link(made)
    return made


def look_at(thing: Any, eye: Sequence[float], target: Sequence[float], roll: float = 0.0) -> None:
    """Put a camera or a lamp at ``eye``, its -z towards ``target``."""
    back = np.asarray(eye, float) - np.asarray(target, float)
    back /= max(float(np.linalg.norm(back)), 1e-9)
    right = np.cross((0.0, 0.0, 1.0) if abs(back[2]) < 0.999 else (0.0, 1.0, 0.0), back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    c, s = math.cos(roll), math.sin(roll)
    right, up = c * right + s * up, c * up - s * right
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = right, up, back, eye
    thing.matrix_world = mathutils.Matrix(matrix.tolist())  # bare lists would be taken as columns


def spots(
    dice: Dice, count: int, low: Sequence[float], high: Sequence[float], apart: float
) -> list[tuple[float, float]]:
    """Up to ``count`` places on the ground, none nearer to another than ``apart``."""
    found: list[tuple[float, float]] = []
    for _ in range(count * 12):
        x, y = dice.uniform(low[0], high[0]), dice.uniform(low[1], high[1])
        if all((x - a) ** 2 + (y - b) ** 2 > apart * apart for a, b in found):
            found.append((x, y))
        if len(found) == count:
            break
    return found
