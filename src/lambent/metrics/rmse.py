"""Root of the mean squared error.

    RMSE(x, r) = sqrt( mean_{p,c} (x_c - r_c)² )                                          (1)

- Transfer: none; linear radiance. Epsilon: none. Data range: [0, ∞), in the unit of radiance, 0 is
  best. Bright pixels decide it; for rendered images read relMSE first.
- A pixel of the image that is not finite gets the larger of a black pixel's error and the worst
  finite one's.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lambent.metrics.metric import Metric
from lambent.metrics.pair import FloatArray, Pair


def rmse(image: Any, reference: Any) -> float:
    """RMSE of equation (1), a number in [0, ∞), in the unit of the images.

    ``image``, ``reference``: ``(H, W, 3)`` linear radiance. Raises `LayerError` for shapes that
    differ.
    """
    return _score(Pair.of(image, reference, 1.0))


def rmse_map(image: Any, reference: Any) -> FloatArray:
    """The root of the mean over channels of (x - r)² for each pixel ``(H, W)``."""
    return _map(Pair.of(image, reference, 1.0))


def _squared(pair: Pair) -> FloatArray:
    return pair.kept("squared error", lambda: _make(pair))


def _make(pair: Pair) -> FloatArray:
    difference = pair.image - pair.reference
    with np.errstate(over="ignore"):
        squared = np.einsum("hwc,hwc->hw", difference, difference) / np.float32(3)
    squared = np.asarray(squared, np.float32)
    if pair.bad.any():
        sound = squared[~pair.bad]
        worst = float(sound.max()) if sound.size else 0.0
        squared[pair.bad] = np.maximum(squared[pair.bad], worst)
    return squared


def _map(pair: Pair) -> FloatArray:
    return np.sqrt(_squared(pair))


def _score(pair: Pair) -> float:
    return math.sqrt(pair.mean(_squared(pair)))


RMSE = Metric(
    "rmse",
    "RMSE",
    score=_score,
    error_map=_map,
    scale="log",
    limits=(1e-4, 10.0),
    unit="radiance",
    about="Root of the mean squared error, linear radiance; 0 is best. Bright pixels decide it.",
)
