"""How many samples a frame seems to have, where its file tells neither samples nor variances.

A network that does not know how noisy a frame may be smooths fine patterns of light in a clean one:
told the true number of samples it had two thirds of its error at 1,024 samples a pixel with
albedo and normal alone. A single pixel cannot tell noise from texture; a whole frame nearly can.

The noise is measured with the mask that sees no planes and no edges along the axes,

          1 -2  1
    L =  -2  4 -2      σ = quantile of |L u| / (6 · that of a normal distribution),          (1)
          1 -2  1

("Fast Noise Variance Estimation", Immerkaer 1996, eq. 2; there the mean, here the third quartile of
pixels that differ from their neighbours at all: black surroundings are no evidence) of u, the mean
over the channels of log(1 + 16 x), x the exposed colour over the albedo. The medians of σ over
crops of the training data fall with the samples n as

    log2 σ = a - b log2 n                                                                    (2)

whose inverse is the guess, held to [1, `MOST`]. Texture raises σ, so a frame is taken for noisier
than it is, not for cleaner. The network is told the guess in place of the samples, and that it is
one, as it was in training with guesses of crops (`learn.batches`). Frames of 1 and 4 samples would
be 3 % better off without, those of 16 and more up to twice as bad (docs/notes/denoiser.md).
"""

from __future__ import annotations

import numpy as np

from lambent.denoise.inputs import SLOPE, albedo_of, divisor
from lambent.filters.features import variance_of
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role

#: a and b of (2), with an albedo and without (1,260 levels of 500 training crops).
WITH_ALBEDO, WITHOUT = (-0.15, 0.45), (-0.6, 0.42)
#: What seems cleaner is told to have so many.
MOST = 4096.0
#: The third quartile of the absolute values of a normal distribution.
QUARTILE = 1.1503
#: What differs less from its neighbours is no evidence; how many pixels are enough; rows looked at.
LEAST, ENOUGH, ROWS = 1e-5, 200, 64


def seeming_samples(frame: Frame, exposure: float) -> float | None:
    """Samples a pixel that a frame seems to have; None where the file tells them, or a variance.

    ``exposure``: of the whole frame. None also where too few pixels differ from their neighbours.
    """
    if frame.spp or variance_of(frame, Role.COLOUR) is not None:
        return None
    return guess(frame.colour, albedo_of(frame), exposure)


def guess(colour: FloatImage, albedo: FloatImage | None, exposure: float) -> float | None:
    """The inverse of (2) for pictures ``(H, W, 3)``; None where there is no evidence."""
    sigma = noise(colour, albedo, exposure)
    if not sigma:
        return None
    a, b = WITHOUT if albedo is None else WITH_ALBEDO
    return float(np.clip(2.0 ** ((a - np.log2(sigma)) / b), 1, MOST))


def noise(colour: FloatImage, albedo: FloatImage | None, exposure: float) -> float:
    """σ of (1), from `ROWS` rows; 0 where too few pixels differ from their neighbours."""
    height, width = colour.shape[:2]
    if height < 3 or width < 3:
        return 0.0
    rows = np.linspace(1, height - 2, min(ROWS, height - 2)).astype(int)
    lines = []
    for offset in (-1, 0, 1):
        x = np.nan_to_num(colour[rows + offset], nan=0, posinf=0, neginf=0) * np.float32(exposure)
        if albedo is not None:
            x = x / divisor(np, np.nan_to_num(albedo[rows + offset], nan=0, posinf=0, neginf=0))
        lines.append(np.log1p(SLOPE * np.maximum(x, 0)).mean(axis=2))
    above, here, below = lines
    across = above + below - 2 * here  # the mask is the product of 1 -2 1 down and across
    seen = np.abs(across[:, :-2] + across[:, 2:] - 2 * across[:, 1:-1])
    seen = seen[seen > LEAST]
    return float(np.quantile(seen, 0.75)) / (6 * QUARTILE) if seen.size >= ENOUGH else 0.0
