"""Pixels in which nothing was hit.

Renderers write what they like there: depth 0 (Mitsuba, Cycles' denoising depth), 1e10 (Cycles),
65504, 1e30, 8.5e37, infinity. None of it is damage, and none of it is changed in a frame: whoever
looks at depth or position asks `miss_mask` first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import INFO, Role

#: Distances from here on are misses, whatever the renderer.
FAR = 1e10


def miss_mask(frame: Frame) -> NDArray[np.bool_]:
    """``(H, W)``: True where depth, position or normal say that nothing was hit.

    A depth of 0, of `FAR` and beyond, or of one of the role's miss values; a position that is not
    finite or that far; a position and a normal that are both exactly 0. All False for a frame
    without these layers.
    """
    miss = np.zeros((frame.height, frame.width), bool)
    depth, position = frame.get(Role.DEPTH), frame.get(Role.POSITION)
    normal = frame.get(Role.NORMAL)
    if depth is not None:
        miss |= missing_depth(depth[:, :, 0])
    if position is not None:
        miss |= (np.isinf(position) | (np.abs(position) >= FAR)).any(axis=2)
    if position is not None and normal is not None:
        miss |= (position == 0).all(axis=2) & (normal == 0).all(axis=2)
    return miss


def missing_depth(depth: FloatImage) -> NDArray[np.bool_]:
    """Where a depth of any shape is no distance; the sign does not matter."""
    z = np.abs(depth)
    miss = (z == 0) | (z >= FAR)
    for value in INFO[Role.DEPTH].misses:
        if value < FAR:
            miss |= z == np.float32(value)
    return np.asarray(miss)
