"""How many samples a frame seems to have, where its file tells neither samples nor variances.

A network that does not know how noisy a frame may be smooths fine patterns of light in a clean one:
told the true number of samples it had two thirds of its error at 1,024 samples a pixel with
albedo and normal alone. A single pixel cannot tell noise from texture; a whole frame nearly can.

The noise σ is `frame.noise_level.laplacian_level` of the mean over the channels of log(1 + 16 x), x
the exposed colour over the albedo. The medians of σ over crops of the training data fall with the
samples n as

    log2 σ = a - b log2 n                                                                    (1)

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
from lambent.frame.noise_level import laplacian_level
from lambent.frame.role import Role

#: a and b of (1), with an albedo and without (1,260 levels of 500 training crops).
WITH_ALBEDO, WITHOUT = (-0.15, 0.45), (-0.6, 0.42)
#: What seems cleaner is told to have so many.
MOST = 4096.0
#: Rows looked at.
ROWS = 64


def seeming_samples(frame: Frame, exposure: float) -> float | None:
    """Samples a pixel that a frame seems to have; None where the file tells them, or a variance.

    ``exposure``: of the whole frame. None also where too few pixels differ from their neighbours.
    """
    if frame.spp or variance_of(frame, Role.COLOUR) is not None:
        return None
    return guess(frame.colour, albedo_of(frame), exposure)


def guess(colour: FloatImage, albedo: FloatImage | None, exposure: float) -> float | None:
    """The inverse of (1) for pictures ``(H, W, 3)``; None where there is no evidence."""
    sigma = noise(colour, albedo, exposure)
    if not sigma:
        return None
    a, b = WITHOUT if albedo is None else WITH_ALBEDO
    return float(np.clip(2.0 ** ((a - np.log2(sigma)) / b), 1, MOST))


def noise(colour: FloatImage, albedo: FloatImage | None, exposure: float) -> float:
    """σ, from `ROWS` rows; 0 where too few pixels differ from their neighbours."""
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
    return laplacian_level(*lines)
