"""Frames as renderers with splatted pixel filters write them, made from box-filtered ones.

Mitsuba and pbrt spread a sample at x over the pixels p around it, with weights f(x - p), and divide
by the sum of the weights that a pixel has received. Neighbouring pixels then share samples, and
their noise is alike. A crop holds pixel means, not samples, so the samples are made up: the n of a
pixel are taken as up to `GROUPS` groups with the pixel's mean value, each at a random place in its
pixel. Means, correlation and the noise of the weights themselves come out as with a real splat;
what is lost is that a pixel's samples differ, which a mean cannot tell.

The reference of such a frame is what infinitely many samples would give: the same, with weights
averaged over the pixel (`expected`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lambent.frame.layer import FloatImage

#: Samples of a pixel are taken together in so many groups at most: more would be all but even.
GROUPS = 4


@dataclass(frozen=True)
class Filter:
    """A separable pixel filter: ``reach`` in whole pixels of the window, f of the distance."""

    name: str
    reach: int
    f: Callable[[FloatImage], FloatImage]


def _tent(x: FloatImage) -> FloatImage:
    return np.maximum(np.float32(0), 1 - np.abs(x))


def _gaussian(x: FloatImage) -> FloatImage:
    """Mitsuba's default: deviation 0.5, cut at 4 deviations, where it is 0."""
    return np.maximum(np.float32(0), np.exp(-2 * x * x) - np.float32(np.exp(-8)))


def _mitchell(x: FloatImage) -> FloatImage:
    """Mitchell and Netravali 1988, B = C = 1/3, radius 2."""
    x = np.abs(x)
    near = (7 * x**3 - 12 * x**2 + 16 / 3) / 6
    far = (-7 / 3 * x**3 + 12 * x**2 - 20 * x + 32 / 3) / 6
    return np.where(x < 1, near, np.where(x < 2, far, 0)).astype(np.float32)


FILTERS = (
    Filter("tent", 1, _tent),
    Filter("gaussian", 2, _gaussian),
    Filter("mitchell", 2, _mitchell),
)


def splatted(image: FloatImage, spp: float, kind: Filter, rng: np.random.Generator) -> FloatImage:
    """``image`` ``(C, H, W)`` of ``spp`` samples a pixel, splatted. Same shape.

    All channels of a pixel have the same samples: pass colour and features in one stack.
    """
    total, weight = np.zeros_like(image), np.zeros(image.shape[1:], np.float32)
    for _ in range(int(min(max(spp, 1), GROUPS))):
        at = rng.random((2, *image.shape[1:]), np.float32) - np.float32(0.5)
        steps = range(-kind.reach, kind.reach + 1)
        down = [kind.f(np.float32(dy) - at[0]) for dy in steps]
        across = [kind.f(np.float32(dx) - at[1]) for dx in steps]
        for dy, fy in zip(steps, down, strict=True):
            for dx, fx in zip(steps, across, strict=True):
                _spread(image, fy * fx, dy, dx, total, weight)
    # Mitchell's lobes may take nearly all of a pixel's weight away: renderers leave it at that
    safe = np.where(np.abs(weight) < 0.05, np.float32(0.05), weight)
    return (total / safe).astype(np.float32)


def expected(image: FloatImage, kind: Filter) -> FloatImage:
    """``image`` ``(C, H, W)`` under the filter, with infinitely many samples a pixel."""
    at = (np.arange(64, dtype=np.float32) + np.float32(0.5)) / 64 - np.float32(0.5)
    steps = range(-kind.reach, kind.reach + 1)
    line = np.array([kind.f(np.float32(d) - at).mean() for d in steps], np.float32)
    total, weight = np.zeros_like(image), np.zeros(image.shape[1:], np.float32)
    for dy, fy in zip(steps, line, strict=True):
        for dx, fx in zip(steps, line, strict=True):
            _spread(image, np.full(image.shape[1:], fy * fx, np.float32), dy, dx, total, weight)
    return total / weight


def _spread(
    image: FloatImage, w: FloatImage, dy: int, dx: int, total: FloatImage, weight: FloatImage
) -> None:
    """Add w · image, shifted by (dy, dx), and w to their sums."""
    h, w_ = image.shape[1:]
    rows, columns = slice(max(0, dy), h + min(0, dy)), slice(max(0, dx), w_ + min(0, dx))
    up, left = slice(max(0, -dy), h + min(0, -dy)), slice(max(0, -dx), w_ + min(0, -dx))
    total[:, rows, columns] += w[up, left] * image[:, up, left]
    weight[rows, columns] += w[up, left]
