"""From radiance to something a screen can show: the one tone map of Lambent.

sRGB transfer of the value clipped to [0, 1], at the automatic exposure of `exposure`, or
another. One exposure serves all images of a comparison.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.exposure import auto_exposure


def srgb(linear: NDArray[Any]) -> NDArray[np.float32]:
    """The sRGB transfer of values clipped to [0, 1]."""
    x = np.clip(np.nan_to_num(linear, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055).astype(
        np.float32
    )


def inverse_srgb(encoded: NDArray[Any]) -> NDArray[np.float32]:
    """Display values in [0, 1] to linear ones."""
    x = np.asarray(encoded, np.float32)
    return np.where(x <= 0.04045, x / 12.92, np.power((np.maximum(x, 0) + 0.055) / 1.055, 2.4))


def display(image: NDArray[Any], exposure: float | None = None) -> NDArray[np.float32]:
    """Radiance ``(H, W, 3)`` to display values in [0, 1] at an exposure (None: automatic)."""
    if exposure is None:
        exposure = auto_exposure(image)
    return srgb(np.asarray(image, np.float32) * np.float32(exposure))


def to_uint8(image: NDArray[Any], exposure: float | None = None) -> NDArray[np.uint8]:
    """Radiance ``(H, W, 3)`` to 8-bit display values."""
    return (display(image, exposure) * 255 + 0.5).astype(np.uint8)


def to_png(image: NDArray[Any], exposure: float | None = None) -> bytes:
    """Radiance ``(H, W, 3)`` to the bytes of a PNG."""
    pixels = to_uint8(image, exposure)
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    return png_of(pixels[:, :, :3])


def png_of(pixels: NDArray[np.uint8]) -> bytes:
    """Display values ``(H, W, 3)`` to the bytes of a PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()
