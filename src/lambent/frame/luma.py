"""Luminance; and luminance/chroma images: Y with RY and BY at half resolution, to RGB and back.

From "Technical Introduction to OpenEXR" (Kainz, Bogart, Stanczyk, 2009), section Luminance/Chroma
Images:

    RY = (R - Y) / Y,    BY = (B - Y) / Y,    Y = w_r R + w_g G + w_b B                     (1)

where the weights w come from the file's chromaticities (Rec. 709 unless told). We depart from
OpenEXR's own reader in the filter between the resolutions: linear interpolation up, and down the
samples at even pixels, in place of its 27-tap filters. So an unchanged picture stays what it was.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Chromaticities (x, y of red, green, blue, white) of Rec. 709.
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)

#: Luminance of linear Rec. 709.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


def luminance(image: NDArray[Any]) -> NDArray[np.float32]:
    """``(H, W, 3)`` linear Rec. 709 to luminance ``(H, W)``."""
    if image.shape[-1] == 1:
        return np.asarray(image[..., 0], np.float32)
    return np.asarray(image[..., :3] @ LUMINANCE, np.float32)


def weights(header: Mapping[str, Any]) -> NDArray[np.float32]:
    """The luminance weights ``(3,)`` of a file's primaries; they sum to 1."""
    given = header.get("chromaticities")
    xy = given if isinstance(given, tuple) and len(given) == 8 else REC709
    points = np.array(xy, np.float64).reshape(4, 2)
    if (points[:, 1] == 0).any():
        points = np.array(REC709).reshape(4, 2)
    amounts = rgb_to_xyz(points)[1]
    return (amounts / amounts.sum()).astype(np.float32)


def rgb_to_xyz(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix ``(3, 3)`` from linear RGB to CIE XYZ.

    ``points`` ``(4, 2)``: x and y of red, green, blue and white; white has Y = 1.
    """
    # Columns: XYZ of the primaries at Y = 1; solve for the amounts that make white.
    xyz = np.stack([points[:, 0], points[:, 1], 1 - points.sum(axis=1)]) / points[:, 1]
    amounts = np.linalg.solve(xyz[:, :3], xyz[:, 3])
    return np.asarray(xyz[:, :3] * amounts)


def to_rgb(
    y: NDArray[Any], ry: NDArray[Any], by: NDArray[Any], w: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Y ``(H, W)`` and chroma of any smaller size to linear RGB ``(H, W, 3)``, eq. (1)."""
    height, width = y.shape
    y = np.asarray(y, np.float32)
    rgb = np.empty((height, width, 3), np.float32)
    rgb[:, :, 0] = (enlarge(ry, height, width) + 1) * y
    rgb[:, :, 2] = (enlarge(by, height, width) + 1) * y
    rgb[:, :, 1] = (y - w[0] * rgb[:, :, 0] - w[2] * rgb[:, :, 2]) / w[1]
    return rgb


def from_rgb(
    rgb: NDArray[Any], w: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Linear RGB ``(H, W, 3)`` to Y, RY, BY at full resolution, eq. (1). Black has no chroma."""
    rgb = np.asarray(rgb, np.float32)
    y = rgb @ w
    safe = np.where(y == 0, np.float32(1), y)
    chroma = np.where((y == 0)[:, :, None], np.float32(0), (rgb - y[:, :, None]) / safe[:, :, None])
    return y, chroma[:, :, 0], chroma[:, :, 2]


def enlarge(image: NDArray[Any], height: int, width: int) -> NDArray[np.float32]:
    """``(h, w)`` to ``(height, width)`` by linear interpolation; samples sit on even pixels."""
    out = np.asarray(image, np.float32)
    for axis, size in ((0, height), (1, width)):
        count = out.shape[axis]
        if count == size:
            continue
        at = np.arange(size, dtype=np.float32) * count / size
        low = np.minimum(at.astype(np.int64), count - 1)
        share = (at - low).astype(np.float32)
        share = share[:, None] if axis == 0 else share[None, :]
        high = np.minimum(low + 1, count - 1)
        out = out.take(low, axis) * (1 - share) + out.take(high, axis) * share
    return out
