"""Histograms of error maps, one below the other on one axis, as SVG that needs no script."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lambent.report.page import escape

WIDTH = 560
HEIGHT = 46
BINS = 80


@dataclass(frozen=True)
class Axis:
    """What the histograms of one metric share. "log" needs positive limits."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    def place(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Values to [0, 1] along the axis; what lies outside is put at its end."""
        if self.scale == "log":
            t = np.log(np.maximum(values, self.low) / self.low) / np.log(self.high / self.low)
        else:
            t = (np.asarray(values, np.float64) - self.low) / (self.high - self.low)
        return np.asarray(np.clip(t, 0, 1), np.float64)

    def ticks(self) -> list[tuple[float, str]]:
        """Places and labels."""
        if self.scale == "log":
            first, last = round(np.log10(self.low)), round(np.log10(self.high))
            values = [10.0**e for e in range(first, last + 1)]
            return [(float(self.place(np.array(v))), f"{v:g}") for v in values]
        steps = np.linspace(self.low, self.high, 6)
        return [(float(self.place(np.array(v))), f"{v:.3g}") for v in steps]


def counts(values: NDArray[Any], axis: Axis) -> NDArray[np.int64]:
    """Number of pixels in each of `BINS` equal steps along the axis; they sum to the pixels."""
    index = np.minimum((axis.place(values) * BINS).astype(np.int64), BINS - 1)
    return np.bincount(index.ravel(), minlength=BINS)


def histograms(maps: Mapping[str, NDArray[Any]], axis: Axis, what: str) -> str:
    """Markup: for each image its histogram, its median and its 99th percentile.

    ``maps``: ``(H, W)`` per image. Bars of all images have the same scale.
    """
    found = {name: counts(values, axis) for name, values in maps.items()}
    top = max((int(c.max()) for c in found.values()), default=0) or 1
    rows = []
    for name, values in maps.items():
        if not values.size:
            continue
        middle, high = (float(v) for v in np.percentile(values, [50, 99]))
        label = f"{what} of {name}: half of the pixels below {middle:.3g}, 99 % below {high:.3g}"
        rows.append(
            f'<div class="histogram"><span class="name">{escape(name)}</span>'
            f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none" role="img" '
            f'aria-label="{escape(label)}">{_bars(found[name], top)}'
            f"{_line(axis, middle, 'median')}{_line(axis, high, 'high')}</svg>"
            f'<span class="facts"><b>{middle:.3g}</b><span>{high:.3g}</span></span></div>'
        )
    ticks = "".join(f"<span>{label}</span>" for _, label in axis.ticks())
    scale = (
        f'<div class="histogram scale"><span class="name"></span><div class="ticks">{ticks}</div>'
        '<span class="facts"><span>median</span><span>99 %</span></span></div>'
    )
    return "".join(rows) + scale


def _bars(count: NDArray[np.int64], top: int) -> str:
    # The square root keeps rare large errors, which are what one looks for, in sight.
    heights = np.sqrt(count / top) * (HEIGHT - 4)
    step = WIDTH / len(count)
    path = [f"M0 {HEIGHT}"]
    for i, h in enumerate(heights):
        path.append(f"V{HEIGHT - h:.1f}H{(i + 1) * step:.1f}")
    return f'<path class="bars" d="{"".join(path)}V{HEIGHT}Z"/>'


def _line(axis: Axis, value: float, kind: str) -> str:
    x = float(axis.place(np.array(value))) * WIDTH
    return f'<path class="{kind}" d="M{x:.1f} 2V{HEIGHT}"/>'
