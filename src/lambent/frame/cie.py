"""CIE XYZ to linear RGB of Rec. 709 and back, for renderers that write films of XYZ.

An EXR's chromaticities do not matter here: beside X, Y and Z they describe XYZ itself (Mitsuba
writes red at x = 1, y = 0). Colours outside the gamut become negative and come back unharmed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lambent.frame.luma import REC709, rgb_to_xyz

_TO_XYZ = rgb_to_xyz(np.array(REC709, np.float64).reshape(4, 2))
_TO_RGB = np.linalg.inv(_TO_XYZ)


def rgb_from_xyz(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """CIE XYZ ``(H, W, 3)`` to linear RGB; values that are not finite make their pixel so."""
    return np.asarray(xyz @ _TO_RGB.T.astype(np.float32))


def xyz_from_rgb(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear RGB ``(H, W, 3)`` to CIE XYZ."""
    return np.asarray(rgb @ _TO_XYZ.T.astype(np.float32))
