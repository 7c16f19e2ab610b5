"""Curves of positive values, drawn as SVG, for every page that shows how something went."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from lambent.report.page import escape


def curve(curves: Mapping[str, Sequence[tuple[float, float]]], across: str = "step") -> str:
    """Curves as SVG; values logarithmic; names at their ends. ``across``: what goes to the right.

    Values of 0 and below are left out.
    """
    width, height, left, right, bottom = 640, 260, 72, 132, 30
    points = [p for curve in curves.values() for p in curve if p[1] > 0]
    x1 = max(max(x for x, _ in points), 1)
    ys = [math.log10(y) for _, y in points]
    y0, y1 = min(ys), max(max(ys), min(ys) + 0.05)

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            left + x / x1 * (width - left - right),
            12 + (y1 - y) / (y1 - y0) * (height - bottom - 12),
        )

    marks = []
    for y in _levels(y0, y1):
        _, v = at(0, y)
        marks.append(
            f'<line x1="{left}" x2="{width - right}" y1="{v:.1f}" y2="{v:.1f}" class="grid"/>'
            f'<text x="{left - 8}" y="{v + 4:.1f}" text-anchor="end">{10**y:.3g}</text>'
        )
    marks.append(f'<text x="{left}" y="{height - 8}">0</text>')
    last = f"{escape(across)} {x1:g}"
    marks.append(f'<text x="{width - right}" y="{height - 8}" text-anchor="end">{last}</text>')
    ends: list[tuple[float, str]] = []
    for name, curve in curves.items():
        there = [at(x, math.log10(y)) for x, y in curve if y > 0]
        if not there:
            continue
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in there)
        marks.append(f'<polyline points="{line}"/>')
        ends.append((there[-1][1], name))
    places: list[float] = []
    for y, _ in sorted(ends):  # names do not lie on one another
        places.append(max(y, places[-1] + 14) if places else y)
    lift = max(0.0, places[-1] - (height - 8)) if places else 0.0
    for y, (_, name) in zip(places, sorted(ends), strict=True):
        x, y = width - right + 6, y - lift + 4
        marks.append(f'<text x="{x}" y="{y:.1f}">{escape(name)}</text>')
    return (
        f'<svg class="curve" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{escape(", ".join(curves))} over {escape(across)}">{"".join(marks)}</svg>'
    )


def _levels(low: float, high: float) -> list[float]:
    """Where the lines go, as logarithms: powers of ten, or five even steps within one decade."""
    powers = range(math.ceil(low), math.floor(high) + 1)
    if len(powers) >= 2:
        return [float(y) for y in powers[:: math.ceil(len(powers) / 6)]]
    return [low + (high - low) * k / 4 for k in range(5)]
