"""Weighted means over a list of offsets, with the sum of the weights.

As `lambent.kernels.window`, but for any offsets (a line, a disc), and it tells Σw too: SURE needs
the weight of the pixel itself, 1/Σw; a filter along one axis needs a line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import (
    FloatImage,
    Layout,
    Planes,
    backend,
    constants,
    to_image,
    valid_pixels,
)
from lambent.kernels.window import Weight, keep_untouched

#: Taps in one kernel, and target channels in one.
_TAPS = 6
_CHANNELS = 8


def weighted_taps(
    targets: NDArray[Any],
    guide: NDArray[Any],
    offsets: Sequence[tuple[int, int]],
    weight: Weight,
    factors: Sequence[float] | None = None,
    device: str = "auto",
) -> tuple[FloatImage, FloatImage]:
    """Means of ``targets`` ``(H, W, C)`` over ``offsets`` (dx, dy), and Σw ``(H, W)``.

    ``weight(p, q, [], factor)`` sees the channels of ``guide`` ``(H, W, G)`` at the pixel and at
    the neighbour and the offset's entry of ``factors`` (None: zeros). Pixels outside the image, or
    where guide or targets are not finite, take no part; a pixel without any weight keeps its value.
    """
    height, width, channels = targets.shape
    module = backend(device)
    border = max(max(abs(dx), abs(dy)) for dx, dy in offsets)
    layout = Layout(height, width, border)
    mask = Planes.of(valid_pixels(guide, targets), layout, module)
    seen = Planes.of(guide, layout, module)
    if factors is None:
        factors = [0.0] * len(offsets)
    means = np.empty((height, width, channels), np.float32)
    total = np.empty((height, width), np.float32)
    for first in range(0, channels, _CHANNELS):
        part = slice(first, first + _CHANNELS)
        planes = Planes.of(targets[:, :, part], layout, module)
        sums = _accumulate(planes, seen, mask, layout, offsets, weight, factors, module)
        image = to_image([*(value / sums[-1] for value in sums[:-1]), sums[-1]], layout)
        means[:, :, part] = image[:, :, :-1]
        total = image[:, :, -1]
    return keep_untouched(means, targets), total


def square(radius: int) -> list[tuple[int, int]]:
    """The offsets of a window of ``2·radius + 1`` pixels a side, row by row."""
    steps = range(-radius, radius + 1)
    return [(dx, dy) for dy in steps for dx in steps]


def _accumulate(
    planes: Planes,
    seen: Planes,
    mask: Planes,
    layout: Layout,
    offsets: Sequence[tuple[int, int]],
    weight: Weight,
    factors: Sequence[float],
    module: Any,
) -> list[Any]:
    """Σ w·target for every channel, then Σ w."""
    import drjit as dr

    sums = [dr.zeros(module.Float, layout.size) for _ in range(len(planes) + 1)]
    dr.eval(sums)
    centre = seen.views()
    for start in range(0, len(offsets), _TAPS):
        for (dx, dy), number in zip(
            offsets[start : start + _TAPS], factors[start : start + _TAPS], strict=True
        ):
            (factor,) = constants([number], module)
            w = weight(centre, seen.views(dx, dy), [], factor) * mask.view(0, dx, dy)
            for channel, value in enumerate(planes.views(dx, dy)):
                sums[channel] = dr.fma(w, value, sums[channel])
            sums[-1] += w
        dr.eval(sums)
    return sums
