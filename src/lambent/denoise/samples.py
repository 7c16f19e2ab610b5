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

whose inverse is the guess. Texture raises σ, so a frame is taken for noisier than it is, not for
cleaner; and only frames that seem to have `CLEAN` samples and more get a guess at all: for noisy
ones it made errors larger, as the network then sees the noise itself.
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
#: Guesses below are not told; what seems cleaner is told to have `MOST`.
CLEAN, MOST = 64.0, 256.0
#: The third quartile of the absolute values of a normal distribution.
QUARTILE = 1.1503
#: Rows that are looked at, and how many differing pixels are evidence.
ROWS, ENOUGH = 64, 200


def told_samples(frame: Frame, exposure: float) -> float | None:
    """Samples a pixel that the network is told: the frame's, else a guess, else None.

    ``exposure``: of the whole frame. Where there is a variance there is no need to guess.
    """
    if frame.spp:
        return float(frame.spp)
    if variance_of(frame, Role.COLOUR) is not None:
        return None
    albedo = albedo_of(frame)
    sigma = noise(frame.colour, albedo, exposure)
    if not sigma:
        return None
    a, b = WITHOUT if albedo is None else WITH_ALBEDO
    samples = 2.0 ** ((a - np.log2(sigma)) / b)
    return min(float(samples), MOST) if samples >= CLEAN else None


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
    seen = seen[seen > 1e-5]
    return float(np.quantile(seen, 0.75)) / (6 * QUARTILE) if seen.size >= ENOUGH else 0.0
