"""Structural similarity of what a screen shows.

Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image Quality Assessment: From Error
Visibility to Structural Similarity", 2004, equation (13):

    SSIM = (2 µx µy + C1)(2 σxy + C2) / ((µx² + µy² + C1)(σx² + σy² + C2))

with a Gaussian window of σ = 1.5 in 11x11 pixels (section III-C), C1 = (0.01 L)², C2 = (0.03 L)².

- Transfer: the display transform of `lambent.frame.tonemap` at the reference's exposure, so the
  data range L is 1. Range of SSIM: [-1, 1], 1 is best. DSSIM = (1 - SSIM) / 2 in [0, 1], 0 is best.
- Departures: taken for R, G and B each and averaged (the paper has grey images), so that coloured
  noise counts; the mean leaves out the border of 5 pixels where the window sticks out (in images
  of fewer than 11 rows or columns it does not, and the window sees the image mirrored).
- A pixel of the image that is not finite counts as the display value farthest from the reference.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lambent.metrics.metric import Metric
from lambent.metrics.pair import FloatArray, Pair

SIGMA = 1.5
RADIUS = 5
K1 = 0.01
K2 = 0.03

#: Rows filtered at a time, so that the five images of a strip stay in the cache.
STRIP = 48


def ssim(image: Any, reference: Any, exposure: float | None = None) -> float:
    """Mean SSIM over pixels and channels, in [-1, 1].

    ``image``, ``reference``: ``(H, W, 3)`` linear radiance. ``exposure``: the factor before the
    tone map (None: the reference's automatic one). Raises `LayerError` for shapes that differ.
    """
    return _score(Pair.of(image, reference, exposure))


def dssim(image: Any, reference: Any, exposure: float | None = None) -> float:
    """(1 - SSIM) / 2, in [0, 1]; arguments as in `ssim`."""
    return (1.0 - ssim(image, reference, exposure)) / 2.0


def ssim_map(image: Any, reference: Any, exposure: float | None = None) -> FloatArray:
    """SSIM around each pixel, mean over channels ``(H, W)``."""
    return _map(Pair.of(image, reference, exposure))


def _score(pair: Pair) -> float:
    similarity = _map(pair)
    counted = pair.counted
    if min(similarity.shape) > 2 * RADIUS:
        inner = (slice(RADIUS, -RADIUS), slice(RADIUS, -RADIUS))
        similarity, counted = similarity[inner], counted[inner]
    chosen = similarity[counted]
    return float(chosen.mean(dtype=np.float64)) if chosen.size else float("nan")


def _map(pair: Pair) -> FloatArray:
    return pair.kept("ssim", lambda: _make(pair.display_image, pair.display_reference))


def _make(x: FloatArray, y: FloatArray) -> FloatArray:
    height, width, channels = x.shape
    total = np.zeros((height, width), np.float32)
    weights = _window()
    for channel in range(channels):
        a = np.pad(x[:, :, channel], RADIUS, mode="symmetric")
        b = np.pad(y[:, :, channel], RADIUS, mode="symmetric")
        for top in range(0, height, STRIP):
            bottom = min(top + STRIP, height)
            rows = slice(top, bottom + 2 * RADIUS)
            total[top:bottom] += _strip(a[rows], b[rows], weights)
    total /= np.float32(channels)
    return total


def _strip(a: FloatArray, b: FloatArray, weights: FloatArray) -> FloatArray:
    """SSIM of the inner part of two padded strips."""
    stack = np.stack([a, b, a * a, b * b, a * b])
    mx, my, xx, yy, xy = _filtered(stack, weights)
    c1, c2 = np.float32(K1**2), np.float32(K2**2)
    mxy = mx * my
    squares = mx * mx + my * my
    above = (2 * mxy + c1) * (2 * (xy - mxy) + c2)
    below = (squares + c1) * ((xx + yy - squares) + c2)
    return np.asarray(above / below, np.float32)


def _filtered(stack: FloatArray, weights: FloatArray) -> FloatArray:
    """Separable Gaussian of ``(N, H + 2r, W + 2r)`` to ``(N, H, W)``; symmetric taps folded."""
    for axis in (1, 2):
        length = stack.shape[axis] - 2 * RADIUS

        def tap(offset: int, source: FloatArray = stack, axis: int = axis, n: int = length) -> Any:
            where = [slice(None)] * 3
            where[axis] = slice(RADIUS + offset, RADIUS + offset + n)
            return source[tuple(where)]

        result = tap(0) * weights[0]
        both = np.empty_like(result)
        for offset in range(1, RADIUS + 1):
            np.add(tap(-offset), tap(offset), out=both)
            both *= weights[offset]
            result += both
        stack = result
    return stack


def _window() -> FloatArray:
    """Weights of the taps at offset 0 … RADIUS; the whole window sums to 1."""
    half = np.exp(-0.5 * (np.arange(RADIUS + 1) / SIGMA) ** 2)
    return np.asarray(half / (half[0] + 2 * half[1:].sum()), np.float32)


def _dssim_map(pair: Pair) -> FloatArray:
    return (np.float32(1) - _map(pair)) / np.float32(2)


SSIM = Metric(
    "ssim",
    "SSIM",
    score=_score,
    better="higher",
    about="Structural similarity of display values (RGB mean, Gaussian window σ 1.5, range 1); "
    "1 is best.",
)

DSSIM = Metric(
    "dssim",
    "DSSIM",
    score=lambda pair: (1.0 - _score(pair)) / 2.0,
    error_map=_dssim_map,
    about="(1 − SSIM) / 2; 0 is best.",
)
