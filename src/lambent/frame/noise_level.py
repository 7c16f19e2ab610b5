"""The standard deviation of white noise, from the pixels alone: one number for a picture.

Each takes differences that a smooth picture has none of, and a robust statistic of them. They are
not exchangeable: filters and networks were tuned on their own one. What a frame tells of its noise
(variances, half buffers) is `lambent.filters.features.variance_of`; whether neighbouring pixels
share their noise is `lambent.frame.noise`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: The third quartile of the absolute values of a normal distribution.
QUARTILE = 1.1503
#: What differs less from its neighbours is no evidence; how many pixels are enough.
LEAST, ENOUGH = 1e-5, 200


def haar_level(image: NDArray[np.float32]) -> float:
    """σ of white noise in ``(H, W, C)``.

    Median of the absolute diagonal Haar details (a - b - c + d)/2 over 0.6745 (Donoho and
    Johnstone 1994): flat regions and straight edges have none, so what is left is noise. Blocks
    with equal pixels (black background) do not count. 0 for an image without any details.
    """
    top, bottom = image[:-1:2, :, :], image[1::2, :, :]
    detail = (top - bottom)[:, :-1:2] - (top - bottom)[:, 1::2]
    detail = np.abs(detail[np.isfinite(detail) & (detail != 0)])
    return float(np.median(detail)) / 2 / 0.6745 if detail.size else 0.0


def laplacian_level(
    above: NDArray[np.float32], here: NDArray[np.float32], below: NDArray[np.float32]
) -> float:
    """σ of white noise in rows ``(N, W)``, given with those above and below them.

    "Fast Noise Variance Estimation" (Immerkaer 1996, eq. 2): the mask sees no planes and no edges
    along the axes,

              1 -2  1
        L =  -2  4 -2      σ = quantile of |L u| / (6 · that of a normal distribution),          (1)
              1 -2  1

    there with the mean, here with the third quartile of pixels that differ from their neighbours
    at all: black surroundings are no evidence. 0 where fewer than `ENOUGH` do.
    """
    across = above + below - 2 * here  # the mask is the product of 1 -2 1 down and across
    seen = np.abs(across[:, :-2] + across[:, 2:] - 2 * across[:, 1:-1])
    seen = seen[seen > LEAST]
    return float(np.quantile(seen, 0.75)) / (6 * QUARTILE) if seen.size >= ENOUGH else 0.0


def grain(image: NDArray[np.float32]) -> float:
    """The median absolute second difference along the rows of ``(H, W)``; texture counts, too.

    Pixels that are not finite do not count; NaN where there are none to compare.
    """
    with np.errstate(invalid="ignore"):
        second = np.abs(image[:, 2:] - 2 * image[:, 1:-1] + image[:, :-2])
    second = second[np.isfinite(second)]
    return float(np.median(second)) if second.size else float("nan")
