"""Warping: an image read at places that move from pixel to pixel.

``warp(image, motion)`` at pixel p is the image at p + motion(p), bilinear between pixel centres.
Where that place lies outside the image there is nothing to read: such pixels are 0 and told in a
mask.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError
from lambent.frame.layer import FloatImage
from lambent.kernels.extremes import greater, smaller
from lambent.startup import engine


def warp(
    image: FloatImage, motion: FloatImage, device: str = "auto"
) -> tuple[FloatImage, NDArray[np.bool_]]:
    """The image ``(H, W, C)`` at p + motion, and where that is inside ``(H, W)``.

    ``motion``: ``(H, W, 2)`` or more channels, in pixels, x right and y down; only the first two
    are read. Raises `LayerError` for sizes that differ, `EngineError` without LLVM or CUDA.
    """
    height, width, channels = image.shape
    if motion.shape[:2] != (height, width) or motion.shape[2] < 2:
        raise LayerError(
            f"has shape {motion.shape}, the image {image.shape}",
            layer="motion",
            remedy="motion needs the size of the image and two channels",
        )
    import importlib

    import drjit as dr

    ad = importlib.import_module(f"drjit.{engine(device)}")
    pixel = dr.arange(ad.UInt32, width * height)
    row = pixel // width
    column = pixel - row * width
    step = [ad.Float(np.ascontiguousarray(motion[:, :, k], np.float32).ravel()) for k in range(2)]
    x, y = ad.Float(column) + step[0], ad.Float(row) + step[1]
    # A place up to half a pixel beyond the outermost centres still lies in the image.
    inside = (x >= -0.5) & (y >= -0.5) & (x <= width - 0.5) & (y <= height - 0.5)
    x, y = (
        smaller(greater(dr.select(inside, v, 0), ad.Float(0)), ad.Float(size - 1))
        for v, size in ((x, width), (y, height))
    )
    left, top = (
        smaller(ad.Int32(dr.floor(v)), ad.Int32(max(size - 2, 0)))
        for v, size in ((x, width), (y, height))
    )
    fx, fy = x - ad.Float(left), y - ad.Float(top)
    right, bottom = smaller(left + 1, ad.Int32(width - 1)), smaller(top + 1, ad.Int32(height - 1))
    planes = []
    for c in range(channels):
        plane = ad.Float(np.ascontiguousarray(image[:, :, c], np.float32).ravel())
        planes.append(_bilinear(dr, plane, width, left, right, top, bottom, fx, fy, inside))
    dr.eval(planes, inside)
    result = np.stack([np.array(p, np.float32) for p in planes], axis=-1)
    mask = np.array(inside, bool).reshape(height, width)
    return np.ascontiguousarray(result.reshape(height, width, channels)), mask


def _bilinear(
    dr: Any,
    plane: Any,
    width: int,
    left: Any,
    right: Any,
    top: Any,
    bottom: Any,
    fx: Any,
    fy: Any,
    inside: Any,
) -> Any:
    def at(row: Any, column: Any) -> Any:
        return dr.gather(type(plane), plane, row * width + column, inside)

    upper = dr.lerp(at(top, left), at(top, right), fx)
    lower = dr.lerp(at(bottom, left), at(bottom, right), fx)
    return dr.select(inside, dr.lerp(upper, lower, fy), 0)
