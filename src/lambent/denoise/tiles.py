"""Cutting a picture into tiles so that filtering it fits into a given memory.

Every tile is filtered with a margin as wide as the filter can see, and only its core is kept, so
the result equals the untiled one up to float rounding. Tiles begin on multiples of `ALIGNMENT`:
networks that halve the resolution several times give the same answer only for such shifts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lambent.errors import OptionError
from lambent.filters.denoiser import Denoiser
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.memory import show_size
from lambent.progress import Progress, part_of

#: Tiles begin on multiples of this; 2^5 serves networks and pyramids of up to five halvings.
ALIGNMENT = 32

#: Cores smaller than this would spend nearly all work on margins.
SMALLEST_CORE = 64


@dataclass(frozen=True)
class Window:
    """Rows ``top:bottom`` and columns ``left:right``."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def pixels(self) -> int:
        """How many pixels it holds."""
        return (self.bottom - self.top) * (self.right - self.left)


@dataclass(frozen=True)
class Tile:
    """What is kept of a tile, and what is filtered to get it."""

    core: Window
    outer: Window


@dataclass(frozen=True)
class Plan:
    """Tiles that cover a picture once, and the working memory of the largest, in bytes."""

    tiles: tuple[Tile, ...]
    margin: int
    working_bytes: int

    def describe(self) -> str:
        """The plan in a few words."""
        if len(self.tiles) == 1:
            return f"in one piece, {show_size(self.working_bytes)} of working memory"
        rows = len({t.core.top for t in self.tiles})
        columns = len(self.tiles) // rows
        outer = max(self.tiles, key=lambda t: t.outer.pixels).outer
        return (
            f"in {len(self.tiles)} tiles ({columns}x{rows}) of at most "
            f"{outer.right - outer.left}x{outer.bottom - outer.top} with a margin of "
            f"{self.margin}, {show_size(self.working_bytes)} of working memory"
        )


def plan_tiles(
    height: int, width: int, bytes_per_pixel: int, margin: int, budget: int | None
) -> Plan:
    """The fewest filtered pixels whose tiles each fit into ``budget`` bytes (None: no limit).

    Raises `OptionError` where even the smallest sensible tile does not fit.
    """
    whole = Window(0, height, 0, width)
    if budget is None or whole.pixels * bytes_per_pixel <= budget:
        return Plan((Tile(whole, whole),), margin, whole.pixels * bytes_per_pixel)
    allowed = budget // max(bytes_per_pixel, 1)
    best: tuple[int, int, int] | None = None
    for core_w in _core_sizes(width):
        outer_w = min(width, core_w + 2 * margin + ALIGNMENT)
        core_h = min(height, allowed // outer_w - 2 * margin - ALIGNMENT)
        if allowed // outer_w >= height:
            core_h = height
        if core_h < height:
            core_h = core_h // ALIGNMENT * ALIGNMENT
        if core_h < min(SMALLEST_CORE, height):
            continue
        outer_h = min(height, core_h + 2 * margin + ALIGNMENT)
        work = -(-width // core_w) * -(-height // core_h) * outer_w * outer_h
        if best is None or work < best[0]:
            best = (work, core_w, core_h)
    if best is None:
        side = SMALLEST_CORE + 2 * margin + ALIGNMENT
        least = min(side, width) * min(side, height) * bytes_per_pixel
        raise OptionError(
            f"of the memory allowed, {show_size(max(budget, 0))} are left to filter in, but a "
            f"tile with its margin of {margin} pixels needs {show_size(least)}",
            remedy=f"allow {show_size(least - budget)} more with --max-memory, or take another "
            "model",
        )
    _, core_w, core_h = best
    tiles = tuple(
        _tile(top, left, core_h, core_w, height, width, margin)
        for top in range(0, height, core_h)
        for left in range(0, width, core_w)
    )
    return Plan(tiles, margin, max(t.outer.pixels for t in tiles) * bytes_per_pixel)


def filter_tiles(
    denoiser: Denoiser,
    frame: Frame,
    layers: Sequence[Layer],
    plan: Plan,
    progress: Progress | None = None,
) -> list[FloatImage]:
    """Filter ``layers`` of ``frame`` with a denoiser that was fitted to the whole frame.

    Returns one float32 array ``(H, W, C)`` for each layer, sizes and channels as they were.
    """
    total = sum(tile.outer.pixels for tile in plan.tiles)
    if len(plan.tiles) == 1:
        return denoiser.watched(progress).filter_layers(frame, layers)
    results = [np.empty(layer.data.shape, np.float32) for layer in layers]
    done = 0
    for tile in plan.tiles:
        outer, core = tile.outer, tile.core
        piece = frame.crop(outer.top, outer.bottom, outer.left, outer.right)
        cut = [
            layer.with_data(layer.data[outer.top : outer.bottom, outer.left : outer.right])
            for layer in layers
        ]
        worker = denoiser
        if progress is not None:
            worker = denoiser.watched(part_of(progress, done, outer.pixels, total))
        inner = (
            slice(core.top - outer.top, core.bottom - outer.top),
            slice(core.left - outer.left, core.right - outer.left),
        )
        for result, cleaned in zip(results, worker.filter_layers(piece, cut), strict=True):
            result[core.top : core.bottom, core.left : core.right] = cleaned[inner]
        done += outer.pixels
        if progress is not None:
            progress(done, total, "filtering")
    return results


# ------------------------------------------------------------------- private


def _core_sizes(extent: int) -> list[int]:
    """Core widths to try: the whole, and aligned shares of it."""
    sizes = {extent}
    for count in range(2, max(3, extent // SMALLEST_CORE + 1)):
        share = -(-extent // count)
        sizes.add(min(extent, -(-share // ALIGNMENT) * ALIGNMENT))
    return sorted(sizes, reverse=True)


def _tile(
    top: int, left: int, core_h: int, core_w: int, height: int, width: int, margin: int
) -> Tile:
    core = Window(top, min(height, top + core_h), left, min(width, left + core_w))
    outer = Window(
        max(0, core.top - margin) // ALIGNMENT * ALIGNMENT,
        min(height, core.bottom + margin),
        max(0, core.left - margin) // ALIGNMENT * ALIGNMENT,
        min(width, core.right + margin),
    )
    return Tile(core, outer)
