"""Weighted means over pixels that a statistical test cannot tell apart.

The pixels i and j take part in each other's mean if, in every channel,

    (m_i − m_j)² ≤ t² (v_i + v_j)                                                              (1)

with the means m, the variances v of those means, and t the quantile of Student's distribution
(Welch's test; Sakai et al. 2024, see `lambent.filters.statmc`). With the same number of samples n
everywhere and ν = 2n − 2 degrees of freedom t is one number, and (1) is, with d = m² − t² v for
each pixel,

    d_i + d_j ≤ 2 m_i m_j,                                                                     (2)

which loads two values a channel and pixel. (2) loses all digits where m² ≫ t² v; (1) costs one
operation more and does not, so (1) it is, with t² v made beforehand.

A member's weight is exp(−|i − j|²/2σ² − Σ_g (g_i − g_j)²/2σ_g²) on feature channels g: symmetric,
as the test is. Windows are discs. With noise levels u the weight is multiplied by min(1, u_i/u_j):
a member that is noisier than the pixel itself gives less.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import backend
from lambent.kernels.exponential import exp_weight
from lambent.kernels.extremes import smaller

Image = NDArray[np.float32]

#: Taps in one turn of the loop.
_UNROLLED = 4
#: Target channels in one kernel.
_CHANNELS = 8
#: The mean of a pixel outside the image: no test accepts it.
_OUTSIDE = 1e18


def welch_mean(
    targets: Image,
    mean: Image,
    bound: Image,
    features: Image,
    radius: int,
    sigma: float,
    device: str = "auto",
    noise: Image | None = None,
) -> Image:
    """Means of ``targets`` ``(H, W, C)`` over the members of every pixel's disc.

    ``mean`` ``(H, W, M)``: what is tested; ``bound`` ``(H, W, M)``: t² times the variance of each
    mean, so that pixels belong together where (m_i − m_j)² ≤ bound_i + bound_j in all channels.
    ``features`` ``(H, W, G)``, already divided by √2 σ_g. ``sigma``: of the spatial Gaussian, in
    pixels. ``noise`` ``(H, W)``, positive: member j weighs min(1, noise_i/noise_j) times as much.
    The pixel itself always takes part, with weight 1. Returns float32 ``(H, W, C)``.
    """
    parts = [
        _welch_mean(
            targets[:, :, c : c + _CHANNELS], mean, bound, features, radius, sigma, device, noise
        )
        for c in range(0, targets.shape[2], _CHANNELS)
    ]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)


def _welch_mean(
    targets: Image,
    mean: Image,
    bound: Image,
    features: Image,
    radius: int,
    sigma: float,
    device: str,
    noise: Image | None,
) -> Image:
    import drjit as dr

    jit = backend(device)
    height, width = targets.shape[:2]
    pitch = width + 2 * radius
    m = _planes(jit, mean, radius, _OUTSIDE)
    b = _planes(jit, bound, radius, 0.0)
    g = _planes(jit, features, radius, 0.0)
    y = _planes(jit, targets, radius, 0.0)
    quiet = [] if noise is None else _planes(jit, np.float32(1) / noise[:, :, None], radius, 0.0)
    index = dr.arange(jit.UInt32, height * width)
    row = index // width
    here = (row + radius) * pitch + (index - row * width) + radius
    mp, bp, gp, yp, up = (
        [dr.gather(jit.Float, p, here) for p in planes] for planes in (m, b, g, y, quiet)
    )
    level = [dr.rcp(u) for u in up]
    offsets, spatial = disc(radius, sigma)
    steps = jit.Int32((offsets[:, 1] * pitch + offsets[:, 0]).astype(np.int32))
    fall = jit.Float(spatial)

    def taps(t: Any, total: Any, *sums: Any) -> tuple[Any, ...]:
        out = list(sums)
        for i in range(_UNROLLED):
            q = jit.UInt32(jit.Int32(here) + dr.gather(jit.Int32, steps, t + i))
            exponent = dr.gather(jit.Float, fall, t + i)
            member = jit.Bool(True)
            for plane, limits, centre, limit in zip(m, b, mp, bp, strict=True):
                d = dr.gather(jit.Float, plane, q) - centre
                member &= d * d <= dr.gather(jit.Float, limits, q) + limit
            for plane, centre in zip(g, gp, strict=True):
                d = dr.gather(jit.Float, plane, q) - centre
                exponent = dr.fma(-d, d, exponent)
            w = dr.select(member, exp_weight(exponent), 0)
            for plane, centre in zip(quiet, level, strict=True):
                w *= smaller(dr.gather(jit.Float, plane, q) * centre, jit.Float(1))
            total += w
            for c, plane in enumerate(y):
                out[c] = dr.fma(w, dr.gather(jit.Float, plane, q), out[c])
        return (t + _UNROLLED, total, *out)

    done = dr.while_loop((jit.UInt32(0), jit.Float(1.0), *yp), lambda t, *_: t < len(offsets), taps)
    scale = dr.rcp(done[1])
    means = [value * scale for value in done[2:]]
    dr.eval(means)
    return np.stack([value.numpy().reshape(height, width) for value in means], axis=2)


def _planes(jit: Any, image: Image, pad: int, outside: float) -> list[Any]:
    """The channels of an image, padded, flat on the device."""
    return [
        jit.Float(np.pad(image[:, :, c], pad, constant_values=outside).astype(np.float32).ravel())
        for c in range(image.shape[2])
    ]


def disc(radius: int, sigma: float) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Offsets (dx, dy) within ``radius`` without the centre, and −|offset|²/2σ² of each.

    Filled up to a multiple of the loop's step with copies of the centre that weigh nothing.
    """
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    square = dx**2 + dy**2
    keep = (square <= radius**2) & (square > 0)
    offsets = np.stack([dx[keep], dy[keep]], axis=1)
    fall = -square[keep] / (2.0 * sigma**2)
    missing = -len(offsets) % _UNROLLED
    offsets = np.concatenate([offsets, np.zeros((missing, 2), offsets.dtype)])
    fall = np.concatenate([fall, np.full(missing, -1e30)])
    return offsets.astype(np.int32), fall.astype(np.float32)


# ------------------------------------------------------------------ Student's distribution


@lru_cache(maxsize=64)
def t_quantile(alpha: float, freedom: float) -> float:
    """The t with P(|T| > t) = ``alpha`` for Student's T with ``freedom`` degrees (inf: normal).

    By bisection of `t_tail`: exact to 1e-9, for ``alpha`` in (0, 1) and freedom > 0.
    """
    low, high = 0.0, 1.0
    while t_tail(high, freedom) > alpha:
        high *= 2.0
    for _ in range(80):
        middle = (low + high) / 2
        if t_tail(middle, freedom) > alpha:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def t_tail(t: float, freedom: float) -> float:
    """P(|T| > t) for Student's T: the regularised incomplete beta I_{ν/(ν+t²)}(ν/2, 1/2)."""
    if math.isinf(freedom):
        return math.erfc(t / math.sqrt(2.0))
    x = freedom / (freedom + t * t)
    return _beta(x, freedom / 2, 0.5)


def _beta(x: float, a: float, b: float) -> float:
    """Regularised incomplete beta function, by its continued fraction (Lentz's method)."""
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    if x > (a + 1.0) / (a + b + 2.0):  # where the fraction converges slowly: the other tail
        return 1.0 - _beta(1.0 - x, b, a)
    front = math.exp(
        math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    )
    tiny = 1e-300
    c, d = 1.0, 1.0 - (a + b) * x / (a + 1.0)
    d = 1.0 / (d if abs(d) > tiny else tiny)
    value = d
    for k in range(1, 500):
        for term in (
            k * (b - k) * x / ((a + 2 * k - 1) * (a + 2 * k)),
            -(a + k) * (a + b + k) * x / ((a + 2 * k) * (a + 2 * k + 1)),
        ):
            d = 1.0 + term * d
            d = 1.0 / (d if abs(d) > tiny else tiny)
            c = 1.0 + term / c
            c = c if abs(c) > tiny else tiny
            value *= c * d
        if abs(c * d - 1.0) < 1e-14:
            break
    return front * value / a
