"""Weighted means with weights that a network predicted: a window of logits for every pixel.

ĉ_p = Σ_q w_pq c_q with w_pq = exp(z_pq) / Σ exp(z_pq') over the window's pixels that lie in the
image (Bako et al. 2017, eq. 5 and 6; `lambent.learn.networks.kernels` is the form for training).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import FloatImage, Layout, backend
from lambent.kernels.window import WeightedSums

#: Taps in one launch.
_TAPS = 24


def predicted_window(targets: NDArray[Any], logits: FloatImage, device: str = "auto") -> FloatImage:
    """``targets`` ``(H, W, C)`` filtered with ``logits`` ``(k², H, W)``; all channels alike.

    Logit i k + j is that of the pixel at (j - k//2, i - k//2) from the filtered one. Target pixels
    that are not finite take no part.
    """
    side = _side(logits)
    height, width, _ = targets.shape
    module = backend(device)
    import drjit as dr

    layout = Layout(height, width, max(side // 2, 1))
    valid = np.isfinite(targets).all(axis=2).astype(np.float32)
    sums = WeightedSums(targets, valid, layout, module)
    # the largest logit becomes 0, so that no exponential overflows; of those that count, since
    # beside one that does not they could all vanish
    most = _plane(_greatest(logits, valid), layout, module)
    for first in range(0, side * side, _TAPS):
        weights = []
        for tap in range(first, min(first + _TAPS, side * side)):
            dy, dx = divmod(tap, side)
            # one that does not count may be the greater one: held, lest it overflow
            weight = dr.exp(dr.minimum(_plane(logits[tap], layout, module) - most, 0))
            weights.append((dx - side // 2, dy - side // 2, weight))
        sums.add(weights)
    return sums.mean()


def weights_at(logits: FloatImage, x: int, y: int) -> FloatImage:
    """The weights ``(H, W)`` that the pixel (x, y) gives the image's pixels."""
    side = _side(logits)
    _, height, width = logits.shape
    r = side // 2
    window = logits[:, y, x].reshape(side, side)
    top, left = max(0, r - y), max(0, r - x)
    bottom, right = min(side, height - y + r), min(side, width - x + r)
    inside = window[top:bottom, left:right]
    weights = np.exp(inside - inside.max())
    found = np.zeros((height, width), np.float32)
    found[y - r + top : y - r + bottom, x - r + left : x - r + right] = weights / weights.sum()
    return found


# ------------------------------------------------------------------- private


def _greatest(logits: FloatImage, valid: FloatImage) -> FloatImage:
    """Of each pixel, its greatest logit whose pixel lies in the image and is ``valid``."""
    side = _side(logits)
    r = side // 2
    height, width = valid.shape
    around = np.pad(np.where(valid > 0, np.float32(0), np.float32(-np.inf)), r,
                    constant_values=-np.inf)  # fmt: skip
    found = np.full((height, width), -np.inf, np.float32)
    for tap, logit in enumerate(logits):
        y, x = divmod(tap, side)
        np.maximum(found, logit + around[y : y + height, x : x + width], out=found)
    return np.where(np.isfinite(found), found, np.float32(0))


def _plane(image: FloatImage, layout: Layout, module: Any) -> Any:
    """An image ``(H, W)`` as rows of the layout's stride."""
    rows = np.zeros((layout.height, layout.stride), np.float32)
    rows[:, : layout.width] = image
    return module.Float(rows.reshape(-1))


def _side(logits: FloatImage) -> int:
    side = round(len(logits) ** 0.5)
    assert side * side == len(logits)
    assert side % 2 == 1
    return side
