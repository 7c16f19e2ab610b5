"""Light that a filter has lost, given back to where it was lost.

A firefly has a small weight wherever it is averaged, so its light is gone, and with many of them
the picture is darker than what the renderer computed. With c the noisy beauty, o the denoised one
and G a Gaussian over tens of pixels, every lighting layer is multiplied by

    g = G(c) / G(o),    held to [1 / `MOST`, `MOST`]

(1 where either is not positive) of the beauty's three channels together: hues stay, layers that sum
to the beauty still do, and grey stays grey. The light of a firefly is so redistributed over its
surroundings, in proportion to what is there. That costs error, since G(c) has noise of its own
(docs/notes/denoiser.md), so it is done only where it is asked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import Role

#: Standard deviation of G, in pixels; it is computed on means over blocks of pixels.
SIGMA, BLOCK = 32, 8
#: Light is multiplied or divided by so much at most.
MOST = 1.5


def gain(before: FloatImage, after: FloatImage) -> FloatImage:
    """g ``(H, W, 1)`` of the beauty ``(H, W, C)`` before and after filtering."""
    one, two = _local(before), _local(after)
    dark = 1e-9 * np.abs(one).mean() + 1e-30  # where there is neither, nothing is changed
    lit = (one >= 0) & (two >= 0)  # beneath light that subtracts a ratio means nothing
    ratio = np.where(lit, (one + dark) / (np.where(lit, two, 0) + dark), 1)
    height, width = before.shape[:2]
    fine = _spread(np.clip(ratio, 1 / MOST, MOST), height, width)
    return np.asarray(fine[:, :, None], np.float32)


def keep_light(layers: Sequence[Layer], images: Sequence[FloatImage]) -> list[FloatImage]:
    """Filtered ``images`` of layers, the beauty first, with the light that the beauty has lost.

    Coverage stays as it is.
    """
    factor = gain(layers[0].data, images[0])
    return [
        image if layer.role is Role.ALPHA else image * factor
        for layer, image in zip(layers, images, strict=True)
    ]


# ------------------------------------------------------------------- private


def _local(image: FloatImage) -> FloatImage:
    """G of the channels' sum, on blocks; those at the border count as large as they are."""
    light = image.sum(axis=2, dtype=np.float64)
    height, width = light.shape
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    blocks = np.add.reduceat(np.add.reduceat(light, rows, axis=0), columns, axis=1)
    found: FloatImage = _gaussian(len(rows)) @ blocks @ _gaussian(len(columns))
    return found


def _gaussian(count: int) -> FloatImage:
    """Weights of all blocks for each ``(count, count)``; what lies outside has none."""
    at = np.arange(count) * (BLOCK / SIGMA)
    weights: FloatImage = np.exp(-0.5 * (at[:, None] - at) ** 2)
    return weights


def _spread(blocks: FloatImage, height: int, width: int) -> FloatImage:
    """From the blocks' centres to all pixels, linearly ``(H, W)``."""
    for axis, size in ((0, height), (1, width)):
        count = blocks.shape[axis]
        at = np.clip((np.arange(size) + 0.5) / BLOCK - 0.5, 0, count - 1)
        low = np.minimum(at.astype(int), max(0, count - 2))
        share = (at - low).reshape((-1, 1) if axis == 0 else (1, -1))
        high = np.minimum(low + 1, count - 1)
        one, two = np.take(blocks, low, axis), np.take(blocks, high, axis)
        blocks = one + share * (two - one)
    return blocks
