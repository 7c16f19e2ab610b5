"""Symmetric mean absolute percentage error.

    SMAPE(x, r) = mean_{p,c} |x_c - r_c| / (|x_c| + |r_c| + ε),   ε = 0.01                (1)

as used for Monte Carlo denoising by T. Vogels, F. Rousselle, B. McWilliams et al., "Denoising with
Kernel Prediction and Asymmetric Loss Functions", 2018 (ε is that of Lambent's definition).

- Transfer: none; linear radiance. Data range: [0, 1), 0 is best. Robust against fireflies, since
  no pixel can count for more than 1; it weighs dark pixels as much as bright ones.
- A pixel of the image that is not finite counts 1.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lambent.metrics.metric import Metric
from lambent.metrics.pair import FloatArray, Pair

EPSILON = 0.01


def smape(image: Any, reference: Any) -> float:
    """SMAPE of equation (1), a number in [0, 1].

    ``image``, ``reference``: ``(H, W, 3)`` linear radiance. Raises `LayerError` for shapes that
    differ.
    """
    return _score(Pair.of(image, reference, 1.0))


def smape_map(image: Any, reference: Any) -> FloatArray:
    """The mean over channels of the summands of (1) for each pixel ``(H, W)``."""
    return _map(Pair.of(image, reference, 1.0))


def _map(pair: Pair) -> FloatArray:
    return pair.kept("smape", lambda: _make(pair))


def _make(pair: Pair) -> FloatArray:
    below = np.abs(pair.image)
    below += np.abs(pair.reference)
    below += np.float32(EPSILON)
    ratio = np.subtract(pair.image, pair.reference)
    np.abs(ratio, out=ratio)
    ratio /= below
    error = (ratio[..., 0] + ratio[..., 1] + ratio[..., 2]) / np.float32(3)
    error[pair.bad] = 1.0
    return np.asarray(error, np.float32)


def _score(pair: Pair) -> float:
    return pair.mean(_map(pair))


SMAPE = Metric(
    "smape",
    "SMAPE",
    score=_score,
    error_map=_map,
    about="Mean of |x − r| / (|x| + |r| + 0.01), linear radiance; 0 is best, 1 the worst.",
)
