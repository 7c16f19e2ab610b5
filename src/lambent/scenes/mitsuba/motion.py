"""Short clips: cameras travel, and some things slide, turn, fall or swing.

Paths are smooth in time (constant or eased velocity over the clip); steps are of the size that one
sees in films, up to some percent of the picture's width a frame.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from lambent.errors import OptionError
from lambent.scenes.mitsuba.geometry import Array, rotate, translate
from lambent.scenes.mitsuba.noise import generator
from lambent.scenes.mitsuba.plan import CameraPlan, ScenePlan


def animate(plan: ScenePlan, frames: int = 6, seed: int | None = None) -> ScenePlan:
    """``plan`` with paths for its cameras and for about half of its movable things.

    ``seed`` of the motion; None: the plan's own. Raises `OptionError` for less than one frame.
    """
    if frames < 1:
        raise OptionError(f"a clip of {frames} frames makes no sense", remedy="take 1 or more")
    rng = generator(plan.seed if seed is None else seed, 77, frames)
    names = sorted({s.movable for s in plan.shapes if s.movable})
    chosen: dict[str, Array] = {}
    for name in names:
        whole = [s for s in plan.shapes if s.movable == name]
        move = rng.random() < 0.55 or len(names) <= 2
        low = np.min([s.geometry.bounds[0] for s in whole], 0)
        high = np.max([s.geometry.bounds[1] for s in whole], 0)
        path = _object_path(rng, whole[0].to_world, high - low, frames)
        if move:
            chosen[name] = path
    shapes = tuple(
        dataclasses.replace(s, path=chosen[s.movable]) if s.movable in chosen else s
        for s in plan.shapes
    )
    still = rng.random() < 0.15
    cameras = tuple(
        c if still else dataclasses.replace(c, path=_camera_path(rng, c, frames))
        for c in plan.cameras
    )
    return dataclasses.replace(plan, shapes=shapes, cameras=cameras, frames=frames)


def _object_path(rng: np.random.Generator, start: Array, size: Array, frames: int) -> Array:
    """Places ``(T, 4, 4)`` of a thing of ``size`` metres that rests at ``start``."""
    scale = float(np.max(size[:2])) + 1e-6
    kind = rng.choice(["slide", "turn", "tumble", "lift"], p=[0.35, 0.3, 0.15, 0.2])
    step = scale * rng.uniform(0.02, 0.12)
    direction = rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(direction), np.sin(direction), 0]) * step
    spin = rng.uniform(-0.15, 0.15)
    axis = rng.normal(size=3)
    poses = []
    for t in range(frames):
        if kind == "slide":
            pose = translate(*(along * t)) @ start @ rotate("z", 0.2 * spin * t)
        elif kind == "turn":
            pose = start @ rotate("z", (spin + np.sign(spin) * 0.05) * t)
        elif kind == "tumble":
            fly = along * t + [0, 0, step * (t * 0.9 - 0.06 * t * t)]
            pose = translate(*fly) @ start @ rotate(axis, spin * 1.5 * t)
        else:
            pose = translate(0, 0, step * t) @ start @ rotate("z", spin * t)
        poses.append(pose)
    return np.array(poses)


def _camera_path(rng: np.random.Generator, camera: CameraPlan, frames: int) -> Array:
    """A dolly, a pan, an orbit about the focus, or a hand-held mixture ``(T, 4, 4)``."""
    kind = rng.choice(["dolly", "pan", "orbit", "hand"], p=[0.3, 0.25, 0.3, 0.15])
    pose, reach = camera.to_world, camera.focus_distance
    angle = np.radians(camera.fov) * rng.uniform(0.005, 0.04) * rng.choice([-1, 1])
    move = reach * rng.uniform(0.004, 0.025) * rng.normal(size=3) * [1, 0.5, 1]
    focus = pose[:3, 3] + pose[:3, 2] * reach
    jitter = rng.normal(0, 1, (frames, 3))
    poses = []
    for t in range(frames):
        if kind == "dolly":
            now = pose @ translate(*(move * t))
        elif kind == "pan":
            now = translate(*pose[:3, 3]) @ rotate("z", angle * t) @ translate(*-pose[:3, 3]) @ pose
        elif kind == "orbit":
            now = translate(*focus) @ rotate("z", angle * t) @ translate(*-focus) @ pose
        else:
            now = pose @ translate(*(move * t + 0.002 * reach * jitter[t]))
            now = now @ rotate("y", 0.3 * angle * t + 0.003 * jitter[t, 0])
        poses.append(now)
    return np.array(poses)
