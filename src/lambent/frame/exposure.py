"""Exposure: the factor that takes the typical luminance of radiance to mid-grey, 0.18.

Typical is the log-average, over pixels or over blocks of pixels. They differ on a noisy picture
(the logarithm of a block's mean does not fall for the black pixels in it), and neither can take the
other's place: `auto_exposure` is how pictures are shown and what filters were tuned at;
`block_exposure` is Open Image Denoise's own, at which its networks and ours were trained.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.layer import FloatImage
from lambent.frame.luma import luminance

#: What the typical luminance becomes.
KEY = 0.18
#: Pixels darker than this share of the mean do not count.
_DARK = 1e-4
#: Side of a block in pixels, and the luminance at which a block is black.
_BLOCK, _BLACK = 16, 1e-8
#: The luminance that Open Image Denoise computes with.
_LUMINANCE = np.array([0.212671, 0.715160, 0.072169], np.float32)


def auto_exposure(image: NDArray[Any]) -> float:
    """The factor that takes the log-average luminance of ``(H, W, 3)`` to `KEY`.

    Pixels that are not finite or darker than a ten-thousandth of the mean do not count: a black
    background shall not blow out the picture. An all-black image has exposure 1.
    """
    y = luminance(image)
    y = y[np.isfinite(y) & (y > 0)]
    if y.size == 0:
        return 1.0
    y = y[y > _DARK * float(y.mean())]
    if y.size == 0:
        return 1.0
    return float(KEY / math.exp(float(np.mean(np.log(y, dtype=np.float64)))))


def block_exposure(colour: FloatImage) -> float:
    """The input scale that OIDN finds for an HDR image ``(H, W, 1 or 3)``.

    The log-average, over blocks of about 16x16 pixels, of the mean luminance is taken to 0.18;
    blocks darker than 1e-8 do not count. NaN and negative values count as 0. An image without
    light has scale 1. OIDN computes the same in lower precision: the results of a scale given and
    one found differ by 3e-6 of the brightest pixel at most (measured).
    """
    light = np.clip(np.nan_to_num(colour, nan=0.0), 0.0, np.finfo(np.float32).max)
    y = light[..., 0] if light.shape[2] == 1 else light @ _LUMINANCE
    for axis in (0, 1):
        size = y.shape[axis]
        blocks = -(-size // _BLOCK)
        edges = np.arange(blocks + 1) * size // blocks
        widths = np.diff(edges).reshape((-1, 1) if axis == 0 else (1, -1))
        y = np.add.reduceat(y, edges[:-1], axis=axis, dtype=np.float64) / widths
    y = y[y > _BLACK]
    if y.size == 0:
        return 1.0
    return float(KEY / np.exp2(np.log2(y).mean()))
