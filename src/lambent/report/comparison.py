"""The page of a comparison: pictures side by side, error maps, the table of metrics.

The same page shows one denoising without a reference: then there is no table of metrics, but
statistics, and maps of the change.
"""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError
from lambent.metrics.compare import Comparison, Picture, compare, number
from lambent.metrics.metric import METRICS, Metric
from lambent.metrics.pair import FloatArray
from lambent.report.codec import pack_map, pack_radiance
from lambent.report.colourmap import error_colours
from lambent.report.histogram import Axis, histograms
from lambent.report.page import build, escape, save, table

#: Pictures of more pixels are shown reduced (a full HD frame just passes).
MAX_PIXELS = 2_100_000

#: Maps of more pixels are kept at half size.
MAX_MAP_PIXELS = 250_000

#: More pixels that are not finite than this are not marked one by one.
MAX_MARKED = 20_000

#: What is mapped unless asked otherwise, where the comparison has it.
MAPS = ("relmse", "flip-ldr")


@dataclass(frozen=True)
class _Window:
    """Which part of the frame the page shows, and by how much it is reduced."""

    x: int
    y: int
    width: int
    height: int
    factor: int

    def cut(self, image: NDArray[Any]) -> NDArray[Any]:
        part = image[self.y : self.y + self.height, self.x : self.x + self.width]
        return reduced(part, self.factor)


def write_report(
    path: str | os.PathLike[str],
    results: Comparison | Mapping[str, Any],
    *,
    title: str = "Comparison",
    notes: Iterable[str] = (),
    maps: Iterable[str] | None = None,
    max_pixels: int = MAX_PIXELS,
    crop: tuple[int, int, int, int] | None = None,
) -> Path:
    """Write one self-contained HTML page; returns its path.

    ``results``: a `Comparison`, or images by name (paths, frames or arrays ``(H, W, 3)`` of linear
    radiance) that are shown without a reference. ``title``, ``notes``: plain text. ``maps``: names
    of metrics to show as maps (default: relMSE and FLIP where measured; the change, SMAPE, without
    a reference). ``max_pixels``: larger pictures are shown reduced by a whole factor; the metrics
    are always those of the whole frames. ``crop``: x, y, width, height of a part to show.
    Raises `OptionError` for a crop outside the picture or a metric without maps, `OutputError`
    where the file cannot be written.
    """
    if not isinstance(results, Comparison):
        results = compare(None, results)
    return save(path, comparison_page(results, title, notes, maps, max_pixels, crop))


def comparison_page(
    results: Comparison,
    title: str = "Comparison",
    notes: Iterable[str] = (),
    maps: Iterable[str] | None = None,
    max_pixels: int = MAX_PIXELS,
    crop: tuple[int, int, int, int] | None = None,
) -> str:
    """The text of the page; arguments as in `write_report`."""
    window = _window(results, max_pixels, crop)
    kinds = _maps(results, maps)
    pictures = _pictures(results)
    names = _names(pictures)
    shown = [p for p in results.pictures if results.reference is not None or p is not pictures[0]]
    layers = {
        kind.name: {names[id(p)]: results.map(p.name, kind.name) for p in shown} for kind in kinds
    }
    data = {
        "size": window.cut(pictures[0].image).shape[1::-1],
        "offset": [window.x, window.y] if window.factor == 1 else [0, 0],
        "exposure": results.exposure,
        "images": [_image(names[id(p)], p, results.exposure, window) for p in pictures],
        "maps": [_layers(kind, layers[kind.name], window) for kind in kinds],
        "colours": base64.b64encode(error_colours().tobytes()).decode("ascii"),
        **_first_pair(results),
    }
    remarks = [*notes, *results.notes(), *_window_notes(results, window, bool(kinds))]
    body = "".join(
        [
            _viewer(results, kinds),
            _metrics(results),
            _histograms(results, kinds, layers),
            _facts(pictures, names),
            _notes(remarks),
            _about(results, kinds),
        ]
    )
    return build(
        title,
        body,
        subtitle=_subtitle(results),
        scripts=("codec.js", "page.js", "viewer.js"),
        data=data,
    )


def reduced(image: NDArray[Any], factor: int) -> NDArray[Any]:
    """The means of ``factor`` x ``factor`` blocks; rows and columns left over are cut off.

    A block with a pixel that is not finite is not finite: nothing is hidden by an average.
    """
    if factor == 1:
        return image
    height, width = (n // factor * factor for n in image.shape[:2])
    blocks = image[:height, :width].reshape(
        height // factor, factor, width // factor, factor, *image.shape[2:]
    )
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


# ------------------------------------------------------- what the page shows


def _window(
    results: Comparison, max_pixels: int, crop: tuple[int, int, int, int] | None
) -> _Window:
    width, height = results.size
    x, y, w, h = crop or (0, 0, width, height)
    if x < 0 or y < 0 or w < 1 or h < 1 or x + w > width or y + h > height:
        raise OptionError(
            f"the part {w}x{h} at {x},{y} is not inside the picture of {width}x{height}",
            remedy="give x, y, width, height in pixels",
        )
    factor = 1
    while (w // factor) * (h // factor) > max_pixels and min(w, h) >= 2 * (factor + 1):
        factor += 1
    return _Window(x, y, w, h, factor)


def _maps(results: Comparison, maps: Iterable[str] | None) -> list[Metric]:
    if maps is not None:
        wanted = list(dict.fromkeys(maps))
    elif results.reference is None:
        wanted = ["smape"] if len(results.pictures) > 1 else []
    else:
        wanted = [name for name in MAPS if name in results.metrics]
    kinds: list[Metric] = [METRICS[name] for name in wanted]
    for kind in kinds:
        if kind.error_map is None:
            raise OptionError(f"the metric '{kind.name}' has no map")
    return kinds


def _pictures(results: Comparison) -> list[Picture]:
    first = [] if results.reference is None else [results.reference]
    return [*first, *results.pictures]


def _names(pictures: list[Picture]) -> dict[int, str]:
    """What the page calls each picture: an image may itself be named "reference"."""
    names: dict[int, str] = {}
    for picture in pictures:
        name, count = picture.name, 2
        while name in names.values():
            name, count = f"{picture.name} ({count})", count + 1
        names[id(picture)] = name
    return names


def _first_pair(results: Comparison) -> dict[str, int]:
    """Which two pictures the slider shows first: two images, or the one and its reference."""
    offset = 0 if results.reference is None else 1
    if len(results.pictures) >= 2:
        return {"a": offset, "b": offset + len(results.pictures) - 1}
    return {"a": offset, "b": 0}


def _image(name: str, picture: Picture, exposure: float, window: _Window) -> dict[str, Any]:
    part = window.cut(picture.image)
    bad = np.flatnonzero(~np.isfinite(part).all(axis=2))
    return {
        "name": name,
        "packed": pack_radiance(part, exposure).as_dict(),
        "bad": [int(i) for i in bad[:MAX_MARKED]],
    }


def _layers(kind: Metric, layers: Mapping[str, FloatArray], window: _Window) -> dict[str, Any]:
    axis = Axis(*kind.limits, kind.scale)
    packed = {}
    for name, values in layers.items():
        part = window.cut(values)
        if part.shape[0] * part.shape[1] > MAX_MAP_PIXELS:
            part = reduced(part, 2)
        packed[name] = pack_map(axis.place(part)).as_dict()
    return {
        "id": kind.name,
        "title": kind.title,
        "scale": kind.scale,
        "limits": kind.limits,
        "layers": packed,
    }


def _window_notes(results: Comparison, window: _Window, mapped: bool) -> list[str]:
    width, height = results.size
    notes = []
    if (window.width, window.height) != (width, height):
        notes.append(
            f"Shown is the part of {window.width} × {window.height} pixels at x {window.x}, "
            f"y {window.y}; the numbers are those of the whole frame."
        )
    if window.factor > 1:
        notes.append(
            f"Shown at 1/{window.factor} of the size, each pixel the mean of {window.factor} × "
            f"{window.factor}; the numbers are those of the full size. A part can be shown at full "
            "size (crop)."
        )
    shown = (window.width // window.factor) * (window.height // window.factor)
    if mapped and shown > MAX_MAP_PIXELS:
        notes.append("Maps are kept at half the size of the pictures.")
    return notes


# ------------------------------------------------------------------- markup


def _subtitle(results: Comparison) -> str:
    width, height = results.size
    parts = [f"{width} × {height} pixels"]
    if results.reference is not None:
        reference = results.reference
        source = f"reference {Path(reference.path).name}" if reference.path else "with a reference"
        parts.append(source + (f", {reference.spp} spp" if reference.spp else ""))
    parts.append(f"display exposure × {number(results.exposure)}")
    return " <span>·</span> ".join(escape(p) for p in parts)


def _viewer(results: Comparison, kinds: list[Metric]) -> str:
    change = results.reference is None
    shows = [("picture", "Picture")] + [(k.name, "Change" if change else k.title) for k in kinds]
    show = _segment("show", "Show", shows) if kinds else ""
    legends = "".join(_legend(kind, change) for kind in kinds)
    return f"""
<noscript><p class="note">The pictures need JavaScript. The tables below do not.</p></noscript>
<section class="viewer" aria-label="Pictures" hidden>
<div class="bar" role="toolbar" aria-label="View">
{_segment("view", "View", [("slider", "Slider"), ("grid", "Grid")])}
{show}
<div class="group" id="pair">
<label>A <select id="a" aria-label="Picture A, on the left"></select></label>
<button type="button" id="swap" aria-label="Swap A and B" title="Swap A and B (x)">⇄</button>
<label>B <select id="b" aria-label="Picture B, on the right"></select></label>
</div>
<div class="group exposure">
<label for="exposure">Exposure</label>
<input type="range" id="exposure" min="-6" max="6" step="0.1" value="0">
<output id="stops" for="exposure">0.0</output>
<button type="button" id="reset" title="Exposure back to 0">Reset</button>
</div>
<div class="group zoom">
<button type="button" id="out" aria-label="Zoom out" title="Zoom out (−)">−</button>
<output id="zoom" aria-label="Zoom">100 %</output>
<button type="button" id="in" aria-label="Zoom in" title="Zoom in (+)">+</button>
<button type="button" id="fit" title="Whole picture (0)">Fit</button>
<button type="button" id="one" title="One to one (1)">1:1</button>
</div>
</div>
<div class="work">
<div class="stage" id="stage" tabindex="0" role="group" aria-label="Picture viewer"
 aria-describedby="keys">
<div class="divider" id="divider" role="slider" tabindex="0" aria-label="Divider between A and B"
 aria-orientation="horizontal" aria-valuemin="0" aria-valuemax="100" aria-valuenow="50"
><i></i></div>
</div>
<div class="detail">
<div class="loupes" id="loupes" role="group" aria-label="Detail under the pointer"></div>
<p id="where" class="where"></p>
</div>
</div>
{legends}
<p id="status" role="status"></p>
<p class="keys" id="keys">Wheel or <kbd>+</kbd> <kbd>−</kbd> zoom, drag or arrow keys move
(<kbd>Shift</kbd>: one pixel), <kbd>0</kbd> fit, <kbd>1</kbd> one to one, <kbd>[</kbd> <kbd>]</kbd>
exposure, <kbd>x</kbd> swap A and B, <kbd>g</kbd> grid. The divider takes arrow keys too.</p>
</section>"""


def _segment(name: str, legend: str, choices: list[tuple[str, str]]) -> str:
    inputs = "".join(
        f'<label><input type="radio" name="{name}" value="{escape(value)}"'
        f"{' checked' if i == 0 else ''}><span>{escape(text)}</span></label>"
        for i, (value, text) in enumerate(choices)
    )
    return f'<fieldset class="seg"><legend class="hidden">{legend}</legend>{inputs}</fieldset>'


def _legend(kind: Metric, change: bool) -> str:
    axis = Axis(*kind.limits, kind.scale)
    ticks = "".join(f"<span>{label}</span>" for _, label in axis.ticks())
    title = f"Change from the first picture ({kind.title})" if change else kind.title
    return (
        f'<div class="legend" data-map="{escape(kind.name)}" hidden><b>{escape(title)}</b>'
        f'<div><canvas aria-hidden="true"></canvas><div class="ticks">{ticks}</div></div></div>'
    )


def _metrics(results: Comparison) -> str:
    if not results.metrics:
        return ""
    kinds: list[Metric] = [METRICS[name] for name in results.metrics]
    timed = any("seconds" in p.details for p in results.pictures)
    best = {kind.name: results.best(kind.name) for kind in kinds}
    arrows = {"lower": ("↓", "lower is better"), "higher": ("↑", "higher is better")}
    headings = ["Image"]
    for kind in kinds:
        sign, words = arrows[kind.better]
        headings.append(
            f'<span title="{escape(kind.about)}">{escape(kind.title)}</span> '
            f'<span class="way" title="{words}" aria-label="{words}">{sign}</span>'
        )
    if timed:
        headings.append('Seconds <span class="way" aria-label="lower is better">↓</span>')
    rows = []
    for picture, row in zip(results.pictures, results.rows, strict=True):
        cells = [escape(row.name)]
        for kind in kinds:
            value = row.values[kind.name]
            win = row.name in best[kind.name]
            cells.append(_cell(value, number(value), win, kind.name))
        if timed:
            seconds = float(picture.details.get("seconds", math.nan))
            cells.append(_cell(seconds, number(seconds), False, "seconds"))
        rows.append(cells)
    inner = table(
        headings, rows, caption="Metrics against the reference", kind="sortable", first="metrics"
    )
    for kind in kinds:
        if kind.better == "higher":  # the first click sorts the best to the top
            inner = inner.replace(
                f'<th scope="col"><span title="{escape(kind.about)}">',
                f'<th scope="col" data-first="descending"><span title="{escape(kind.about)}">',
            )
    note = '<p class="small"><i class="dot"></i> best of its column</p>' if len(rows) > 1 else ""
    return f"<section><h2>Metrics</h2>{inner}{note}</section>"


def _cell(value: float, text: str, best: bool, metric: str) -> str:
    exact = "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")
    if math.isfinite(value):
        exact = repr(float(value))
    mark = '<i class="dot"></i><span class="hidden">best </span>' if best else ""
    return (
        f'<td data-value="{exact}" data-metric="{escape(metric)}"'
        f"{' class=best' if best else ''}>{mark}{text}</td>"
    )


def _histograms(
    results: Comparison, kinds: list[Metric], layers: Mapping[str, Mapping[str, FloatArray]]
) -> str:
    panels = []
    for kind in kinds:
        if not layers[kind.name]:
            continue
        title = "Change in each pixel" if results.reference is None else f"{kind.title} per pixel"
        inner = histograms(layers[kind.name], Axis(*kind.limits, kind.scale), title)
        panels.append(f'<div class="panel"><h3>{escape(title)}</h3>{inner}</div>')
    if not panels:
        return ""
    return (
        '<section><h2>Distribution of the error</h2><div class="panels">'
        f'{"".join(panels)}</div><p class="small">Bars: number of pixels, square root scale, the '
        "same for all images. Lines: median and 99 %.</p></section>"
    ).replace("of the error", "of the error" if results.reference is not None else "of the change")


def _facts(pictures: list[Picture], names: Mapping[int, str]) -> str:
    keys = dict.fromkeys(k for p in pictures for k in p.details if k != "spp")
    texts = {k for k in keys if any(isinstance(p.details.get(k), str) for p in pictures)}
    spp = {id(p): p.details.get("spp", p.spp) for p in pictures}
    with_files = any(p.path for p in pictures)
    with_spp = any(value is not None for value in spp.values())
    headings = ["Image", *(["File"] if with_files else []), *(["spp"] if with_spp else [])]
    headings += [escape(k.replace("_", " ").capitalize()) for k in keys]
    headings += ["Mean", "Median", "Maximum", "Grain", "Not finite", "Negative"]
    rows = []
    for picture in pictures:
        facts = picture.statistics()
        cells = [escape(names[id(picture)])]
        if with_files:
            cells.append(f'<td class="text">{escape(picture.path or "–")}</td>')
        if with_spp:
            cells.append(escape(spp[id(picture)] or "–"))
        cells += [_detail(picture.details.get(key), key in texts) for key in keys]
        cells += [number(facts[k]) for k in ("mean", "median", "max", "noise")]
        for key in ("nonfinite", "negative"):
            count = f"{int(facts[key]):,}".replace(",", "\u2009")
            cells.append(f'<td class="warn">{count}</td>' if facts[key] else count)
        rows.append(cells)
    inner = table(headings, rows, caption="Images", first="images")
    return (
        f"<section><h2>Images</h2>{inner}"
        '<p class="small">Mean, median, maximum: luminance, radiance units. Grain: median absolute '
        "second difference along rows over the mean; texture counts too. Not finite, negative: "
        "pixels.</p></section>"
    )


def _detail(value: Any, text: bool) -> str:
    shown = "–" if value is None else value
    if isinstance(value, (float, np.floating)):
        shown = number(float(value))
    return f'<td class="text">{escape(shown)}</td>' if text else escape(shown)


def _notes(notes: list[str]) -> str:
    if not notes:
        return ""
    items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return f'<section><h2>Notes</h2><ul class="notes">{items}</ul></section>'


def _about(results: Comparison, kinds: list[Metric]) -> str:
    shown: list[Metric] = [METRICS[name] for name in results.metrics] or kinds
    terms = "".join(f"<dt>{escape(k.title)}</dt><dd>{escape(k.about)}</dd>" for k in shown)
    return f"""<section><details><summary>How this was measured</summary><dl>{terms}
<dt>Display</dt><dd>sRGB transfer of values clipped to [0, 1], at one exposure for all pictures.
Pixels that are not finite are magenta; negative values are shown as black.</dd>
<dt>Pictures</dt><dd>Packed for this page (log-coded wavelet, about 0.1 stop in fine grain and 0.01
in smooth areas); values in the loupes are rounded by that. Tables and histograms are computed from
the originals.</dd></dl></details></section>"""
