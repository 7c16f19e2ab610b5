"""Cameras: several good viewpoints of a scene, judged by rays that are cast into it.

A candidate is drawn around the subject. A grid of rays tells how far one sees, how many things are
in view and how much the depth varies; what stands inside a thing or before a near wall falls out.
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from .dice import Dice
from .layout import Layout
from .placing import look_at

RAYS = 10


def add_cameras(dice: Dice, layout: Layout, count: int) -> list[str]:
    """Add ``count`` cameras, the best of many candidates each; their names."""
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    names = []
    for n in range(count):
        best: tuple[float, Any] | None = None
        for k in range(10):
            part = dice.child(n, k)
            camera = _candidate(part, layout)
            score, middle = _judge(graph, camera)
            if best is None or score > best[0]:
                if best is not None:
                    bpy.data.objects.remove(best[1])
                camera["middle"] = middle
                best = score, camera
            else:
                bpy.data.objects.remove(camera)
        assert best is not None
        camera = best[1]
        camera.name = f"camera {n}"
        lens = dice.child("lens", n)
        if lens.chance(0.35):
            camera.data.dof.use_dof = True
            camera.data.dof.focus_distance = max(camera["middle"] * lens.uniform(0.7, 1.3), 0.05)
            camera.data.dof.aperture_fstop = lens.log(0.8, 5.6) * min(
                1.0, 2.0 / layout.radius + 0.1
            )
        names.append(camera.name)
    bpy.context.scene.camera = bpy.context.scene.objects[names[0]]
    return names


def _candidate(dice: Dice, layout: Layout) -> Any:
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    bpy.context.scene.collection.objects.link(camera)
    data.lens = dice.log(18, 85) if layout.inside is None else dice.log(14, 40)
    data.clip_start, data.clip_end = 0.01, 1000
    target = [c + layout.radius * 0.5 * dice.uniform(-1, 1) for c in layout.centre]
    target[2] = max(0.1, target[2])
    if layout.inside is not None:
        low, high = layout.inside
        eye = [dice.uniform(a + 0.3, b - 0.3) for a, b in zip(low, high, strict=True)]
        eye[2] = dice.uniform(*layout.eye_height)
    else:
        # Far enough that the subject fills about the picture, sometimes a detail of it.
        fill = dice.log(0.35, 1.2)
        distance = layout.radius * fill * data.lens / 18.0 + 0.1 * layout.radius
        a = dice.uniform(0.0, 2 * math.pi)
        if layout.kind in ("stage", "still life"):  # these have a front
            a = dice.uniform(0.4 - math.pi, -0.4)
        z = dice.uniform(*layout.eye_height)
        flat = math.sqrt(max(distance**2 - (z - target[2]) ** 2, 0.2 * distance**2))
        eye = [target[0] + flat * math.cos(a), target[1] + flat * math.sin(a), z]
    look_at(camera, eye, target, dice.normal(0, 0.04))
    return camera


def hits(graph: Any, camera: Any, window: Any = (0.0, 0.0, 1.0, 1.0), aspect: float = 1.0) -> Any:
    """Distances ``(RAYS, RAYS)`` of what is seen (inf: nothing) and the names of the things."""
    matrix = np.array(camera.matrix_world)
    half = 0.5 * camera.data.sensor_width / camera.data.lens
    left, top, right, bottom = window
    depth = np.full((RAYS, RAYS), np.inf)
    names: list[str] = []
    for i in range(RAYS):
        for j in range(RAYS):
            x = left + (j + 0.5) / RAYS * (right - left)
            y = top + (i + 0.5) / RAYS * (bottom - top)
            ray = matrix[:3, :3] @ np.array(
                [(2 * x - 1) * half * min(aspect, 1), (1 - 2 * y) * half / max(aspect, 1), -1]
            )
            ray /= np.linalg.norm(ray)
            hit, where, _, _, thing, _ = bpy.context.scene.ray_cast(
                graph, matrix[:3, 3].tolist(), ray.tolist()
            )
            if hit:
                depth[i, j] = max(np.linalg.norm(np.array(where) - matrix[:3, 3]), 1e-3)
                names.append(thing.name)
    return depth, names


def _judge(graph: Any, camera: Any) -> tuple[float, float]:
    bpy.context.view_layer.update()
    depth, names = hits(graph, camera)
    seen = np.isfinite(depth)
    if not seen.any():
        return -10.0, 1.0
    near = float((depth < 0.25).mean())
    middle = float(np.median(depth[seen]))
    spread = float(np.std(np.log(depth[seen])))
    things = len(set(names))
    biggest = max(names.count(name) for name in set(names)) / depth.size
    empty = 1.0 - float(seen.mean())
    score = 0.12 * min(things, 20) + min(spread, 1.0) - 6 * near - max(0.0, empty - 0.4) - biggest
    return score, middle


def best_window(dice: Dice, camera: Any, share: float, aspect: float) -> list[float]:
    """The part of the picture ``[left, top, right, bottom]`` of this share with most to see."""
    if share >= 1.0:
        return [0.0, 0.0, 1.0, 1.0]
    graph = bpy.context.evaluated_depsgraph_get()
    best: tuple[float, list[float]] | None = None
    for _ in range(5):
        x, y = dice.uniform(0, 1 - share), dice.uniform(0, 1 - share)
        window = [x, y, x + share, y + share]
        depth, names = hits(graph, camera, window, aspect)
        seen = np.isfinite(depth)
        spread = float(np.std(np.log(depth[seen]))) if seen.any() else 0.0
        score = 0.3 * len(set(names)) + spread + float(seen.mean()) + dice.uniform(0, 0.5)
        if best is None or score > best[0]:
            best = score, window
    assert best is not None
    return best[1]
