"""The page of a render: the picture as it grows, its estimated error, in the end every layer."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role, Stat
from lambent.frame.tonemap import to_uint8
from lambent.metrics.compare import number
from lambent.report.page import build, escape, picture, save

#: Seconds after which a page of a running render loads itself again.
RELOAD = 5
#: Longer side of a layer's picture, in pixels.
THUMBNAIL = 360

#: A point of the curve: seconds, samples a pixel, estimated relMSE.
Point = tuple[float, int, float]


def write_rendering(
    path: str | os.PathLike[str],
    frame: Frame,
    points: Sequence[Point],
    *,
    left: float | None,
    running: bool,
) -> Path:
    """Write the page; ``left``: seconds to go. Raises `OutputError`."""
    return save(path, rendering_page(Path(path).stem, frame, points, left, running))


def rendering_page(
    name: str, frame: Frame, points: Sequence[Point], left: float | None, running: bool
) -> str:
    """The text of the page."""
    exposure = auto_exposure(frame.colour)
    facts = [("Picture", f"{frame.width} × {frame.height} pixels"), ("Samples", f"{frame.spp} spp")]
    if points:
        seconds, spp, error = points[-1]
        pace = spp and (spp - _before(frame, points)) * frame.width * frame.height
        facts.append(("Estimated relMSE", number(error)))
        facts.append(("Time", f"{seconds:.0f} s"))
        if pace and seconds > 0:
            facts.append(("Pace", f"{pace / seconds / 1e6:.2f} million paths/s"))
    if running and left is not None:
        facts.append(("To go", f"about {left:.0f} s"))
    reload = f'<meta http-equiv="refresh" content="{RELOAD}">' if running else ""
    terms = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts)
    shown = picture(_png(frame.colour, exposure, None), "the picture", frame.width, frame.height)
    body = f'{reload}<section><dl class="facts">{terms}</dl></section>'
    body += f'<section class="growing">{shown}</section>'
    if len(points) > 1:
        body += f"<section><h2>Estimated error</h2>{_curve(points)}</section>"
    if not running:
        body += f"<section><h2>Layers</h2>{_layers(frame, exposure)}</section>"
        body += "".join(f'<p class="note">{escape(n)}</p>' for n in frame.notes)
    state = "rendering" if running else "rendered"
    return build(f"{name}, {state}", body, subtitle=escape(f"{frame.spp} samples a pixel"))


def _before(frame: Frame, points: Sequence[Point]) -> int:
    """Samples that were there before this run began: the first pass is short, so by its pace."""
    if len(points) < 2:
        return 0
    (t0, n0, _), (t1, n1, _) = points[0], points[-1]
    pace = (n1 - n0) / max(t1 - t0, 1e-6)
    return max(0, round(n0 - pace * t0))


def _layers(frame: Frame, exposure: float) -> str:
    """A gallery of the means, each with its range."""
    figures = []
    for layer in frame.all_layers():
        if layer.stat is not Stat.MEAN or layer.name.endswith("_variance"):
            continue
        image = layer.data
        low, high = (number(float(v)) for v in (image.min(), image.max()))
        width, height = _fitted(frame)
        made = picture(_shown(layer, exposure, (width, height)), layer.name, width, height)
        name = escape(layer.name.replace("_", " "))
        words = f"<b>{name}</b> <span>{low} … {high}</span>"
        figures.append(f"<figure>{made}<figcaption>{words}</figcaption></figure>")
    return f'<div class="gallery">{"".join(figures)}</div>'


def _shown(layer: Layer, exposure: float, size: tuple[int, int]) -> bytes:
    """A layer as a person reads it: light at the picture's exposure, vectors as colours."""
    image = layer.data
    light = layer.role in (
        Role.COLOUR, Role.DIFFUSE, Role.SPECULAR, Role.DIRECT, Role.INDIRECT, Role.EMISSION,
        Role.LIGHTING,
    )  # fmt: skip
    if light:
        return _png(image, exposure, size)
    if "normal" in layer.name:
        return _png(image * 0.5 + 0.5, 1.0, size)
    if "albedo" in layer.name or layer.role in (Role.ALPHA, Role.ROUGHNESS, Role.ID):
        return _png(image, 1.0, size)
    if layer.role is Role.MOTION:
        most = float(np.abs(image).max()) or 1.0
        three = np.concatenate([image[:, :, :2] / (2 * most), np.zeros_like(image[:, :, :1])], 2)
        return _png(three + 0.5, 1.0, size)
    low, high = np.percentile(image, [1, 99])
    return _png((image - low) / max(float(high - low), 1e-12), 1.0, size)


def _fitted(frame: Frame) -> tuple[int, int]:
    scale = min(1.0, THUMBNAIL / max(frame.width, frame.height))
    return max(1, round(frame.width * scale)), max(1, round(frame.height * scale))


def _png(image: Any, exposure: float, size: tuple[int, int] | None) -> bytes:
    import io

    from PIL import Image

    pixels = to_uint8(np.asarray(image, np.float32), exposure)
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    made = Image.fromarray(pixels[:, :, :3])
    if size is not None and size != made.size:
        made = made.resize(size, Image.Resampling.BOX)
    buffer = io.BytesIO()
    made.save(buffer, "PNG", compress_level=4)
    return buffer.getvalue()


def _curve(points: Sequence[Point]) -> str:
    """Estimated relMSE over samples, both logarithmic, as SVG; 1/spp is a straight line."""
    width, height, left, bottom = 560, 220, 64, 34
    xs = [math.log10(max(n, 1)) for _, n, _ in points]
    ys = [math.log10(max(e, 1e-9)) for _, _, e in points]
    x0, x1 = min(xs), max(max(xs), min(xs) + 0.1)
    y0, y1 = math.floor(min(ys)), max(math.ceil(max(ys)), math.floor(min(ys)) + 1)

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            left + (x - x0) / (x1 - x0) * (width - left - 12),
            12 + (y1 - y) / (y1 - y0) * (height - bottom - 12),
        )

    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in (at(x, y) for x, y in zip(xs, ys, strict=True)))
    marks = []
    for exponent in range(y0, y1 + 1):
        _, y = at(x0, exponent)
        marks.append(
            f'<line x1="{left}" x2="{width - 12}" y1="{y:.1f}" y2="{y:.1f}" class="grid"/>'
            f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{10.0**exponent:g}</text>'
        )
    for k, anchor in ((points[0][1], "start"), (points[-1][1], "end")):
        x, _ = at(math.log10(max(k, 1)), y0)
        marks.append(f'<text x="{x:.1f}" y="{height - 12}" text-anchor="{anchor}">{k} spp</text>')
    return (
        f'<svg class="curve" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="Estimated relMSE over samples a pixel">{"".join(marks)}'
        f'<polyline points="{line}"/></svg>'
    )
