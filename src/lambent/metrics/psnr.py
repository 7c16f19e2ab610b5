"""Peak signal-to-noise ratio of what a screen shows.

    PSNR(x, r) = 10 log10( 1 / mean_{p,c} (d(x)_c - d(r)_c)² )  dB                        (1)

with d the display transform of `lambent.frame.tonemap`: sRGB transfer of the value clipped to
[0, 1], at the reference's automatic exposure (log-average luminance to 0.18) for both images.

- Epsilon: none. Data range of d: [0, 1], so the peak is 1. Higher is better; equal images give ∞.
- A pixel of the image that is not finite counts as the display value farthest from the reference.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lambent.metrics.metric import Metric
from lambent.metrics.pair import Pair


def psnr(image: Any, reference: Any, exposure: float | None = None) -> float:
    """PSNR of equation (1) in dB; ``math.inf`` for images that show the same.

    ``image``, ``reference``: ``(H, W, 3)`` linear radiance. ``exposure``: the factor before the
    tone map (None: the reference's automatic one). Raises `LayerError` for shapes that differ.
    """
    return _score(Pair.of(image, reference, exposure))


def _score(pair: Pair) -> float:
    difference = pair.display_image - pair.display_reference
    squared = np.einsum("hwc,hwc->hw", difference, difference) / np.float32(3)
    mean = pair.mean(squared)
    return math.inf if mean == 0 else -10.0 * math.log10(mean)


PSNR = Metric(
    "psnr",
    "PSNR",
    score=_score,
    better="higher",
    unit="dB",
    about="Peak signal-to-noise ratio of display values (sRGB, clipped to [0, 1], the reference's "
    "exposure); higher is better.",
)
