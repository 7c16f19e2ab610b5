"""Viewpoints worth a picture: chosen among random ones by what rays meet.

The scene is known here only by the boxes around its parts. A coarse grid of rays through each
candidate tells how near things are, how many are seen and how evenly; views from inside a thing,
or of one wall, or of nothing, are dropped, and of the rest the richest are kept that differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lambent.scenes.mitsuba.geometry import Array
from lambent.scenes.mitsuba.plan import HALF_FRAME, CameraPlan, look_at

#: A random candidate: where from, where to.
Candidate = Callable[[np.random.Generator], tuple[Array, Array]]

_GRID = (7, 9)


def choose(
    rng: np.random.Generator,
    boxes: Sequence[tuple[Array, Array]],
    candidate: Candidate,
    *,
    count: int = 6,
    clearance: float = 0.35,
    focal: tuple[float, float] = (18, 55),
    tries: int = 90,
    medium: int | None = None,
    background: bool = False,
    lens: float = 0.35,
) -> list[CameraPlan]:
    """``count`` cameras (at least 4) among ``tries`` candidates.

    ``clearance`` is the least distance in metres to what is seen; ``focal`` the range of focal
    lengths in mm; ``background`` says that rays may miss everything (a sky); ``lens`` is the share
    of cameras with depth of field.
    """
    low = np.array([b[0] for b in boxes])
    high = np.array([b[1] for b in boxes])
    things = (high - low).max(1) < 6 * clearance  # the others are walls, floors, the house
    found: list[tuple[float, CameraPlan, Array]] = []
    for attempt in range(tries):
        origin, target = candidate(rng)
        length = float(np.exp(rng.uniform(*np.log(focal))))
        pose = look_at(origin, target, rng.normal(0, 0.02) if rng.random() < 0.3 else 0.0)
        # Standards fall as tries run out: a camera must be found.
        slack = 1.0 if attempt < tries * 0.7 else 0.4
        inflated = clearance * 0.5 * slack
        if np.any(np.all((origin > low - inflated) & (origin < high + inflated), -1)):
            continue
        distance, seen = _look(pose, length, low, high)
        score = _score(distance, seen, things, clearance * slack, background)
        if score <= 0:
            continue
        middle = distance[_GRID[0] // 2, _GRID[1] // 2]
        focus = float(middle if np.isfinite(middle) else np.linalg.norm(target - origin))
        radius = 0.0
        if rng.random() < lens:
            stop = np.exp(rng.uniform(np.log(1.8), np.log(11)))
            radius = float(np.clip(length / 2000 / stop, 0, 0.012 * focus))
        found.append((score, CameraPlan(pose, length, radius, max(focus, 0.05), medium), origin))
    found.sort(key=lambda f: -f[0])
    kept: list[tuple[float, CameraPlan, Array]] = []
    for near in (0.35, 0.12, 0.0):  # first well apart, then whatever is left
        for item in found:
            if len(kept) >= count:
                break
            if any(item is k for k in kept):
                continue
            if all(_apart(item[1], k[1], clearance) > near for k in kept):
                kept.append(item)
    return [k[1] for k in kept]


def _apart(a: CameraPlan, b: CameraPlan, unit_length: float) -> float:
    turn = 1 - float(a.to_world[:3, 2] @ b.to_world[:3, 2])
    move = float(np.linalg.norm(a.to_world[:3, 3] - b.to_world[:3, 3]))
    return turn + 0.15 * move / unit_length


def _look(pose: Array, length: float, low: Array, high: Array) -> tuple[Array, Array]:
    """Distances ``(7, 9)`` and numbers of the boxes that a grid of rays meets first."""
    rows, columns = _GRID
    half = HALF_FRAME / length
    y, x = np.meshgrid(
        np.linspace(0.7, -0.7, rows) * half, np.linspace(-0.95, 0.95, columns) * half, indexing="ij"
    )
    d = x[..., None] * pose[:3, 0] + y[..., None] * pose[:3, 1] + pose[:3, 2]
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d = np.where(np.abs(d) < 1e-9, 1e-9, d)[..., None, :]
    t0, t1 = (low - pose[:3, 3]) / d, (high - pose[:3, 3]) / d
    enter, leave = np.minimum(t0, t1).max(-1), np.maximum(t0, t1).min(-1)
    t = np.where((enter <= leave) & (enter > 0), enter, np.inf)
    number = t.argmin(-1)
    distance = np.take_along_axis(t, number[..., None], -1)[..., 0]
    return distance, np.where(np.isfinite(distance), number, -1)


def _score(
    distance: Array, seen: Array, things: Array, clearance: float, background: bool
) -> float:
    size = distance.size
    if (distance < clearance).mean() > 0.04 or distance.min() < 0.3 * clearance:
        return 0.0
    missed = float((seen < 0).mean())
    if missed > (0.6 if background else 0.25):
        return 0.0
    numbers, counts = np.unique(seen, return_counts=True)
    is_thing = (numbers >= 0) & things[numbers]
    on_things = counts[is_thing].sum() / size
    if len(counts) < 3 or is_thing.sum() < 2 or on_things < 0.08:
        return 0.0
    share = counts / size
    spread = -float((share * np.log(share)).sum())
    finite = distance[np.isfinite(distance)]
    depth = float(np.log(np.percentile(finite, 90) / np.percentile(finite, 10) + 1e-6))
    return spread + 0.3 * min(depth, 2) + min(float(on_things), 0.4)
