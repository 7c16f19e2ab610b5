"""Means with separable weights: box and Gaussian, along the rows and then along the columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import (
    FloatImage,
    Layout,
    Plane,
    Planes,
    backend,
    constants,
    to_image,
    valid_pixels,
)
from lambent.kernels.window import keep_untouched


def separable_mean(
    targets: NDArray[Any],
    taps: Sequence[float],
    valid: NDArray[Any] | None = None,
    device: str = "auto",
) -> FloatImage:
    """Weighted means of ``targets`` ``(H, W, C)`` with weights ``taps[dx + r]·taps[dy + r]``.

    ``taps``: 2·r + 1 numbers >= 0. ``valid`` ``(H, W)``: 0 at pixels that take no part (pixels that
    are not finite never do). Weights are renormalised over the pixels that take part; a pixel
    that none reaches keeps its value. Returns float32 ``(H, W, C)``.
    """
    import drjit as dr

    radius = len(taps) // 2
    module = backend(device)
    height, width, channels = targets.shape
    layout = Layout(height, width, radius + 1)
    mask = valid_pixels(targets) if valid is None else valid_pixels(targets) * valid
    mask = np.asarray(mask, np.float32)
    factors = constants(taps, module)
    offsets = range(-radius, radius + 1)

    def spread(image: FloatImage) -> Any:
        """One channel, summed along both axes."""
        planes = Planes.of(image, layout, module)
        along = module.Float(0)
        for dx, factor in zip(offsets, factors, strict=True):
            along = dr.fma(factor, planes.view(0, dx, 0, radius), along)
        dr.eval(along)
        rows = Plane(layout, radius, along, module)
        across = module.Float(0)
        for dy, factor in zip(offsets, factors, strict=True):
            across = dr.fma(factor, rows.view(0, dy), across)
        dr.eval(across)
        dr.sync_thread()  # the planes go out of scope here
        return across

    total = spread(mask)
    whole = bool(mask.all())
    sums = []
    for channel in range(channels):
        image = np.asarray(targets[:, :, channel], np.float32)
        sums.append(spread(image if whole else np.where(mask > 0, image, np.float32(0))) / total)
    return keep_untouched(to_image(sums, layout), targets)
