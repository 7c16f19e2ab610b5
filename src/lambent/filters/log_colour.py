"""The colour of a frame as filters compare it: by ratios.

Radiance has no upper end, and its noise grows with it. A range distance on radiance itself would
take every lamp apart and melt every shadow. Hence g = ln(exposure·c + 0.02): a step of 0.1 is ten
per cent anywhere above the dark tones; below them (0.02 where mid-grey is 0.18) steps fade out, so
that noise in the black does not count. Negative radiance counts as black.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lambent.frame.layer import FloatImage

#: Exposed radiance that is dark: about three stops below mid-grey.
DARK = 0.02


def log_colour(colour: NDArray[np.float32], exposure: float) -> FloatImage:
    """ln(exposure·c + `DARK`) of radiance ``(H, W, C)``; what is not finite stays so."""
    with np.errstate(invalid="ignore"):
        light = np.maximum(colour, np.float32(0))
        light *= np.float32(exposure)
        light += np.float32(DARK)
        return np.asarray(np.log(light, out=light))
