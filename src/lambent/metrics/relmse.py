"""Relative mean squared error, the measure most denoising papers report.

    relMSE(x, r) = mean_p  mean_c (x_c - r_c)² / (mean_c(r_c)² + ε),   ε = 0.01          (1)

after F. Rousselle, C. Knaus, M. Zwicker, "Adaptive Sampling and Reconstruction using Greedy Error
Minimization", 2011. In (1) the denominator is the square of the mean of the reference's channels,
(mean_c r_c)², not the mean of their squares: for a grey pixel both are the same.

- Transfer: none; linear radiance. Data range: [0, ∞), 0 is best. Not independent of exposure: ε
  is in squared radiance.
- A handful of fireflies can dominate (1). `trim` leaves out the worst pixels; Lambent prints the
  value with and without the worst 0.1 %.
- The reference is noisy too. With r = R + n the numerator expects (x - R)² + Var n, so subtracting
  the variance of the reference's pixel means makes it unbiased, the denominator held fixed. What
  the denominator's own noise leaves is small: for grey R with independent noise in the channels
  about 4 (x - R) Var n / (3 R³), which is of both signs. A pixel's value may be negative; clipping
  it would bring the bias back, so nothing is clipped.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lambent.errors import OptionError
from lambent.metrics.metric import Metric
from lambent.metrics.pair import FloatArray, Pair

EPSILON = 0.01

#: The part of the pixels, the worst ones, that the trimmed value leaves out.
TRIM = 0.001


def relmse(
    image: Any,
    reference: Any,
    trim: float = 0.0,
    *,
    reference_variance: Any = None,
) -> float:
    """relMSE of equation (1), a number in [0, ∞).

    ``image``, ``reference``: ``(H, W, 3)`` linear radiance. ``trim``: the fraction of the pixels,
    the worst, to leave out (rounded down to whole pixels; 0.001 is the customary one).
    ``reference_variance``: ``(H, W, 3)`` variance of the reference's pixel means, subtracted.
    Raises `LayerError` for shapes that differ, `OptionError` for a trim outside [0, 1).
    """
    return _score(Pair.of(image, reference, 1.0, reference_variance), trim)


def expected_relmse(colour: Any, variance: Any, epsilon: float = EPSILON) -> float:
    """relMSE that a picture ``(H, W, 3)`` without bias has by the variance of its pixel means.

    The worst 0.1 % of the pixels are left out: their variance says little. ``epsilon``: in place
    of `EPSILON`, for radiance in other units.
    """
    noise = np.asarray(variance).mean(axis=2, dtype=np.float64)
    return trimmed_mean(
        relative(noise, np.asarray(colour).mean(axis=2, dtype=np.float64), epsilon), TRIM
    )


def relative(squared: Any, centre: Any, epsilon: Any = EPSILON) -> Any:
    """The summand of (1) from (x - r)² and the mean of r's channels: arrays or tensors."""
    return squared / (centre * centre + epsilon)


def trimmed_mean(error: FloatArray, trim: float) -> float:
    """Mean of ``error`` without the fraction ``trim`` of its values, the largest; NaN of none.

    What is left out is rounded down to whole values. Raises `OptionError` for a trim outside
    [0, 1).
    """
    if not 0 <= trim < 1:
        raise OptionError(f"trim is {trim}", remedy="give a fraction from 0 to below 1")
    chosen = error.ravel()
    drop = int(trim * chosen.size)
    if drop:
        chosen = np.partition(chosen, chosen.size - drop)[: chosen.size - drop]
    return float(chosen.mean(dtype=np.float64)) if chosen.size else float("nan")


def relmse_map(image: Any, reference: Any, *, reference_variance: Any = None) -> FloatArray:
    """The summands of (1) for each pixel ``(H, W)``; 0 where the reference is not finite."""
    return _map(Pair.of(image, reference, 1.0, reference_variance))


def _map(pair: Pair) -> FloatArray:
    return pair.kept("relmse", lambda: _make(pair))


def _make(pair: Pair) -> FloatArray:
    r = pair.reference
    difference = pair.image - r
    with np.errstate(over="ignore"):
        squared = np.einsum("hwc,hwc->hw", difference, difference) / np.float32(3)
        if pair.reference_variance is not None:
            variance = np.where(pair.counted[:, :, None], pair.reference_variance, 0)
            squared = squared - variance.mean(axis=2, dtype=np.float32)
        centre = (r[..., 0] + r[..., 1] + r[..., 2]) / np.float32(3)
        error = np.asarray(relative(squared, centre), np.float32)
    if pair.bad.any():
        # `pair.image` is black at bad pixels, so `error` is that of a black pixel there.
        sound = error[~pair.bad]
        worst = float(sound.max()) if sound.size else 0.0
        error[pair.bad] = np.maximum(error[pair.bad], worst)
    return error


def _score(pair: Pair, trim: float) -> float:
    error = _map(pair)
    return trimmed_mean(error if pair.counted.all() else error[pair.counted], trim)


RELMSE = Metric(
    "relmse",
    "relMSE",
    score=lambda pair: _score(pair, 0.0),
    error_map=_map,
    scale="log",
    limits=(1e-4, 10.0),
    about="Mean of squared error over squared reference + 0.01, linear radiance; 0 is best.",
)

RELMSE_TRIMMED = Metric(
    "relmse-trimmed",
    "relMSE −0.1 %",
    score=lambda pair: _score(pair, TRIM),
    error_map=_map,
    scale="log",
    limits=(1e-4, 10.0),
    about="relMSE without the worst 0.1 % of the pixels: what is left when fireflies do not count.",
)
