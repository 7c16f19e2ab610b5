"""Weighted means over a square window: ĉ_p = Σ_q w_pq c_q / Σ_q w_pq, with any weight.

The weight is a Python function on Dr.Jit arrays, traced into the kernel. Box, Gaussian, bilateral
and cross-bilateral filters are one such function each (`lambent.filters`).

One kernel holds the taps of one row of the window; the rows are launches of the same kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import (
    FloatImage,
    Layout,
    Planes,
    all_finite,
    backend,
    constants,
    to_image,
    valid_pixels,
)

#: ``weight(p, q, k, s)``: guide channels at the pixel and at the neighbour (lists of ``Float``),
#: the numbers given as ``numbers``, and the entry of ``spatial`` for this offset.
Weight = Callable[[list[Any], list[Any], list[Any], Any], Any]

#: Taps in one kernel: more only lengthen the compilation.
_TAPS = 11
#: Target channels in one kernel: their sums stay in registers beside the guide.
_CHANNELS = 8


def weighted_window(
    targets: NDArray[Any],
    guide: NDArray[Any] | None,
    radius: int,
    weight: Weight,
    numbers: Sequence[float] = (),
    spatial: NDArray[Any] | None = None,
    device: str = "auto",
) -> FloatImage:
    """Weighted means of ``targets`` ``(H, W, C)`` over windows of ``2·radius + 1`` pixels a side.

    ``guide`` ``(H, W, G)`` is what ``weight`` sees (None: nothing). ``spatial``
    ``(2r+1, 2r+1)``, indexed [dy + r, dx + r], is handed to ``weight`` as its last argument
    (None: zeros). ``weight`` must be a module-level function: its compiled kernel is kept by it.

    Only pixels inside the image where guide and targets are finite take part; the weights are
    renormalised over those. A pixel without any weight keeps its value. Returns float32 (H, W, C).
    """
    height, width, channels = targets.shape
    module = backend(device)
    layout = Layout(height, width, radius)
    mask = Planes.of(valid_pixels(guide, targets), layout, module)
    seen = Planes.of(guide, layout, module) if guide is not None else None
    if spatial is None:
        spatial = np.zeros((2 * radius + 1, 2 * radius + 1))
    result = np.empty((height, width, channels), np.float32)
    for first in range(0, channels, _CHANNELS):
        part = targets[:, :, first : first + _CHANNELS]
        planes = Planes.of(part, layout, module)
        result[:, :, first : first + _CHANNELS] = _window(
            planes, seen, mask, layout, weight, numbers, spatial, module
        )
    return keep_untouched(result, targets)


def keep_untouched(result: FloatImage, targets: NDArray[Any]) -> FloatImage:
    """``result`` with the pixels that got no weight (NaN) as they are in ``targets``."""
    if all_finite(result):
        return result
    return np.where(np.isnan(result), targets, result).astype(np.float32, copy=False)


def _window(
    planes: Planes,
    seen: Planes | None,
    mask: Planes,
    layout: Layout,
    weight: Weight,
    numbers: Sequence[float],
    spatial: NDArray[Any],
    module: Any,
) -> FloatImage:
    import drjit as dr

    radius = layout.border
    sums = [dr.zeros(module.Float, layout.size) for _ in range(len(planes) + 1)]
    dr.eval(sums)
    centre = seen.views() if seen is not None else []
    knobs = constants(numbers, module)
    side = 2 * radius + 1
    for dy in range(-radius, radius + 1):
        for start in range(0, side, _TAPS):
            for dx in range(start - radius, min(start + _TAPS, side) - radius):
                near = seen.views(dx, dy) if seen is not None else []
                (factor,) = constants([spatial[dy + radius, dx + radius]], module)
                w = weight(centre, near, knobs, factor) * mask.view(0, dx, dy)
                for channel, value in enumerate(planes.views(dx, dy)):
                    sums[channel] = dr.fma(w, value, sums[channel])
                sums[-1] += w
            dr.eval(sums)
    return to_image([value / sums[-1] for value in sums[:-1]], layout)
