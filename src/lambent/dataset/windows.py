"""Crops where there is something to learn.

A quick render of the whole view is scored window by window: how noisy it is in relation to its
brightness, and how much happens in its features (edges of albedo, normal and depth). A share of
the crops is drawn in proportion to the score, the rest evenly over all windows that are neither
black nor trivially smooth. The density of each draw in relation to an even one is recorded, so
that a loss can undo the choice (importance sampling: weight by 1 / density).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.dataset.source import Window
from lambent.frame.frame import Frame
from lambent.frame.luma import luminance
from lambent.frame.role import Role, Stat

#: A window darker than this share of the view's bright parts is black.
BLACK = 0.002
#: A window whose score is below this is trivially smooth.
SMOOTH = 0.02
#: Two crops of a view share at most this part of their area.
OVERLAP = 0.3


@dataclass(frozen=True)
class Choice:
    """A crop: where, how interesting, and how likely it was in relation to an even draw."""

    window: Window
    score: float
    density: float


def choose(
    pilot: Frame,
    view: tuple[int, int],
    edge: int,
    count: int,
    uniform: float,
    random: np.random.Generator,
) -> tuple[Choice, ...]:
    """``count`` windows of ``edge`` pixels in a view ``(width, height)``; fewer if none are fit.

    ``pilot``: the view at any size, colour with variance. Windows lie on a lattice with a random
    shift. Once no window is left that overlaps little, overlap is allowed.
    """
    interest, light = maps(pilot)
    columns = _lattice(view[0], edge, random)
    rows = _lattice(view[1], edge, random)
    x, y = (a.ravel() for a in np.meshgrid(columns, rows))
    scores = _means(interest, x, y, edge, view)
    lights = _means(light, x, y, edge, view)
    bright = float(np.percentile(light, 95))
    fit = (scores > SMOOTH) & (lights > BLACK * bright) & (lights > 0)
    if not fit.any():
        return ()
    density = np.where(fit, uniform / fit.sum() + (1 - uniform) * scores / scores[fit].sum(), 0.0)
    chosen: list[Choice] = []
    free = fit.copy()
    for _ in range(count):
        if not free.any():
            free = fit.copy()
        weights = np.where(free, density, 0.0)
        k = int(random.choice(len(x), p=weights / weights.sum()))
        window = Window(int(x[k]), int(y[k]), edge)
        chosen.append(Choice(window, float(scores[k]), float(density[k] * fit.sum())))
        free &= _shared(x, y, window) <= OVERLAP
    return tuple(chosen)


def maps(pilot: Frame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How much there is to learn at each pixel ``(H, W)``, in [0, 2]; and the luminance."""
    colour = np.nan_to_num(pilot.colour.astype(np.float64))
    light = luminance(colour).astype(np.float64)
    variance = pilot.get(Role.COLOUR, Stat.VARIANCE)
    spread = np.zeros_like(light)
    if variance is not None:
        spread = np.sqrt(np.maximum(np.nan_to_num(variance.astype(np.float64)).mean(axis=2), 0))
    floor = 0.05 * float(light.mean()) + 1e-12
    noise = spread / (light + floor)
    edges = sum(
        (_edges(pilot, role, scale) for role, scale in _FEATURES), start=np.zeros_like(light)
    )
    return np.minimum(noise, 1.0) + np.minimum(edges, 1.0), light


#: Features whose edges count, and the step that counts fully.
_FEATURES = ((Role.ALBEDO, 0.2), (Role.NORMAL, 0.5), (Role.DEPTH, 0.1))


def _edges(pilot: Frame, role: Role, scale: float) -> NDArray[np.float64]:
    image = pilot.get(role)
    if image is None:
        return np.zeros((pilot.height, pilot.width))
    values = np.nan_to_num(image.astype(np.float64), posinf=0.0, neginf=0.0)
    if role is Role.DEPTH:
        values = np.log1p(np.clip(values, 0, 1e10))
    steps = np.zeros(values.shape[:2])
    steps[:, 1:] += np.abs(np.diff(values, axis=1)).mean(axis=2)
    steps[1:] += np.abs(np.diff(values, axis=0)).mean(axis=2)
    return steps / scale


def _lattice(length: int, edge: int, random: np.random.Generator) -> NDArray[np.int64]:
    """Starts of windows along one axis, a quarter of the edge apart, shifted at random."""
    step = max(edge // 4, 1)
    last = length - edge
    starts = np.arange(random.integers(step), last + 1, step)
    return starts if len(starts) else np.array([random.integers(last + 1)])


def _means(
    image: NDArray[np.float64], x: Any, y: Any, edge: int, view: tuple[int, int]
) -> NDArray[np.float64]:
    """The mean of a map over each window, by its summed-area table."""
    height, width = image.shape
    table = np.zeros((height + 1, width + 1))
    table[1:, 1:] = image.cumsum(0).cumsum(1)
    left, right = _scaled(x, edge, width / view[0], width)
    top, bottom = _scaled(y, edge, height / view[1], height)
    total = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
    return total / ((right - left) * (bottom - top))


def _scaled(start: Any, edge: int, scale: float, length: int) -> tuple[Any, Any]:
    low = np.minimum(np.floor(start * scale).astype(int), length - 1)
    high = np.clip(np.ceil((start + edge) * scale).astype(int), low + 1, length)
    return low, high


def _shared(x: Any, y: Any, window: Window) -> NDArray[np.float64]:
    """The part of the area that every window has in common with one."""
    wide = np.clip(window.edge - np.abs(x - window.x), 0, None)
    high = np.clip(window.edge - np.abs(y - window.y), 0, None)
    return wide * high / window.edge**2
