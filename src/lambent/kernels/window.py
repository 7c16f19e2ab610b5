"""Weighted means over a square window: ĉ_p = Σ_q w_pq c_q / Σ_q w_pq, with any weight.

The weight is a Python function on Dr.Jit arrays, traced into the kernel. Box, Gaussian, bilateral
and cross-bilateral filters are one such function each (`lambent.filters`).

One kernel holds the taps of one or a few rows of the window; the groups of rows are launches of
the same kernel. Each launch reads all planes and adds to sums in memory: more rows in one move
fewer bytes (three rows instead of one: a third less time for a bilateral filter).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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

#: Loads in one kernel: more save memory traffic, but lengthen the compilation (250: one second).
_LOADS = 250
#: Taps in one kernel at most.
_TAPS = 33
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
    (None: zeros). ``weight`` must do the same each time: its compiled kernel is
    found again by what it computes.

    Only pixels inside the image where guide and targets are finite take part; the weights are
    renormalised over those. A pixel without any weight keeps its value. Returns float32 (H, W, C).
    """
    height, width, _ = targets.shape
    module = backend(device)
    layout = Layout(height, width, radius)
    seen = Planes.of(guide, layout, module) if guide is not None else None
    if spatial is None:
        spatial = np.zeros((2 * radius + 1, 2 * radius + 1))
    centre = seen.views() if seen is not None else []
    knobs = constants(numbers, module)
    sums = WeightedSums(targets, valid_pixels(guide, targets), layout, module)
    loads = len(centre) + min(targets.shape[2], _CHANNELS) + 1
    for taps in _launches(radius, loads):
        weights = []
        for dx, dy in taps:
            near = seen.views(dx, dy) if seen is not None else []
            (factor,) = constants([spatial[dy + radius, dx + radius]], module)
            weights.append((dx, dy, weight(centre, near, knobs, factor)))
        sums.add(weights)
    return sums.mean()


def _launches(radius: int, loads: int) -> Iterator[list[tuple[int, int]]]:
    """The offsets (dx, dy) of a window, launch by launch; ``loads``: how many a tap needs.

    Whole rows, or, of very wide windows, parts that are cut at the same dx in every row.
    """
    steps = range(-radius, radius + 1)
    side = len(steps)
    rows = min(_LOADS // (side * loads), _TAPS // side)
    if rows >= 1:
        for first in range(0, side, rows):
            yield [(dx, dy) for dy in steps[first : first + rows] for dx in steps]
        return
    count = max(1, min(_TAPS, max(_LOADS // loads, 11)))
    for dy in steps:
        for first in range(0, side, count):
            yield [(dx, dy) for dx in steps[first : first + count]]


class WeightedSums:
    """Σ_q w_pq c_q and Σ_q w_pq, fed with the weights of a few offsets at a time.

    ``targets`` ``(H, W, C)``; ``valid`` ``(H, W)``: 0 at pixels that take no part; ``layout`` with
    a border of at least the greatest offset.
    Few channels are summed in the kernel that computes the weights. With many the weights are
    stored, and every group of channels reads them.
    """

    def __init__(
        self, targets: NDArray[Any], valid: NDArray[Any], layout: Layout, module: Any
    ) -> None:
        import drjit as dr

        self._targets = targets
        self._mask = Planes.of(valid, layout, module)
        if not valid.all():
            targets = np.where(valid[:, :, None] > 0, targets, np.float32(0))
        self._layout = layout
        self._groups = [
            Planes.of(targets[:, :, first : first + _CHANNELS], layout, module)
            for first in range(0, targets.shape[2], _CHANNELS)
        ]
        self._sums = [
            [dr.zeros(module.Float, layout.size) for _ in range(len(g))] for g in self._groups
        ]
        self._total = dr.zeros(module.Float, layout.size)
        dr.eval(self._sums, self._total)

    def add(self, weights: Sequence[tuple[int, int, Any]]) -> None:
        """Add (dx, dy, w): the weights w of the neighbours at (dx, dy).

        Where there is no neighbour, or where it takes no part, w may be anything finite.
        """
        import drjit as dr

        if len(self._groups) > 1:
            dr.eval([w for _, _, w in weights])
        # the mask is a channel like the others: 0 where a pixel takes no part
        for dx, dy, w in weights:
            self._total = dr.fma(w, self._mask.view(0, dx, dy), self._total)
        for planes, sums in zip(self._groups, self._sums, strict=True):
            for dx, dy, w in weights:
                for channel, value in enumerate(planes.views(dx, dy)):
                    sums[channel] = dr.fma(w, value, sums[channel])
            dr.eval(sums, self._total)

    def mean(self) -> FloatImage:
        """The weighted mean ``(H, W, C)``; a pixel without any weight keeps its value."""
        parts = [to_image([s / self._total for s in sums], self._layout) for sums in self._sums]
        whole = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)
        return keep_untouched(whole, self._targets)


def keep_untouched(result: FloatImage, targets: NDArray[Any]) -> FloatImage:
    """``result`` with the pixels that got no weight (NaN) as they are in ``targets``."""
    if all_finite(result):
        return result
    return np.where(np.isnan(result), targets, result).astype(np.float32, copy=False)
