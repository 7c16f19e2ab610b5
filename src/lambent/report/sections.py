"""The parts of a comparison's page as markup: viewer, tables, histograms, notes.

All text that comes from files or callers goes through `escape`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lambent.metrics.compare import Comparison, number
from lambent.metrics.metric import METRICS, Metric
from lambent.metrics.pair import FloatArray
from lambent.metrics.picture import Picture
from lambent.report.histogram import Axis, histograms
from lambent.report.page import escape, table


def subtitle(results: Comparison) -> str:
    """What is compared, in one line."""
    width, height = results.size
    parts = [f"{width} × {height} pixels"]
    if results.reference is not None:
        reference = results.reference
        source = f"reference {Path(reference.path).name}" if reference.path else "with a reference"
        parts.append(source + (f", {reference.spp} spp" if reference.spp else ""))
    parts.append(f"display exposure × {number(results.exposure)}")
    return " <span>·</span> ".join(escape(p) for p in parts)


def viewer(results: Comparison, kinds: list[Metric]) -> str:
    """The picture viewer with its controls; empty until the script fills it."""
    change = results.reference is None
    shows = [("picture", "Picture")] + [(k.name, "Change" if change else k.title) for k in kinds]
    show = _segment("show", "Show", shows) if kinds else ""
    legends = "".join(_legend(kind, change) for kind in kinds)
    return f"""
<noscript><p class="note">The pictures need JavaScript. The tables below do not.</p></noscript>
<section class="viewer" aria-label="Pictures" hidden>
<div class="bar" role="toolbar" aria-label="View">
{_segment("view", "View", [("slider", "Slider"), ("single", "Single"), ("grid", "Grid")])}
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
<button type="button" id="one" title="One to one (o)">1:1</button>
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
(<kbd>Shift</kbd>: one pixel), <kbd>0</kbd> fit, <kbd>o</kbd> one to one, <kbd>[</kbd> <kbd>]</kbd>
exposure. <kbd>1</kbd> to <kbd>9</kbd> show one picture, with <kbd>Shift</kbd> they choose B;
<kbd>b</kbd> blinks between A and B, <kbd>x</kbd> swaps them, <kbd>s</kbd> slider, <kbd>g</kbd>
grid. The divider takes arrow keys too.</p>
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


def metric_table(results: Comparison) -> str:
    """The metrics, one row an image, best values marked; empty without a reference."""
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


def error_histograms(
    results: Comparison, kinds: list[Metric], layers: Mapping[str, Mapping[str, FloatArray]]
) -> str:
    """One panel for each metric that has a map."""
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


def image_table(pictures: list[Picture], names: Mapping[int, str]) -> str:
    """What is known of each picture: file, spp, model, time, statistics."""
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
            path = escape(picture.path or "–").replace("/", "/<wbr>")
            cells.append(f'<td class="text file">{path}</td>')
        if with_spp:
            cells.append(escape(spp[id(picture)] or "–"))
        cells += [_detail(picture.details.get(key), key in texts) for key in keys]
        cells += [number(facts[k]) for k in ("mean", "median", "max", "noise")]
        for key in ("nonfinite", "negative"):
            count = f"{int(facts[key]):,}".replace(",", "\u2009")
            cells.append(f'<td class="warn">{count}</td>' if facts[key] else count)
        rows.append(cells)
    inner = table(headings, rows, caption="Images", kind="sortable", first="images")
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


def note_list(notes: list[str]) -> str:
    """Remarks and warnings."""
    if not notes:
        return ""
    items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return f'<section><h2>Notes</h2><ul class="notes">{items}</ul></section>'


def explanation(results: Comparison, kinds: list[Metric]) -> str:
    """What each number means, folded away."""
    shown: list[Metric] = [METRICS[name] for name in results.metrics] or kinds
    terms = "".join(f"<dt>{escape(k.title)}</dt><dd>{escape(k.about)}</dd>" for k in shown)
    return f"""<section><details><summary>How this was measured</summary><dl>{terms}
<dt>Display</dt><dd>sRGB transfer of values clipped to [0, 1], at one exposure for all pictures.
Pixels that are not finite are magenta; negative values are shown as black.</dd>
<dt>Pictures</dt><dd>Packed for this page (log-coded wavelet, about 0.1 stop in fine grain and 0.01
in smooth areas); values in the loupes are rounded by that. Tables and histograms are computed from
the originals.</dd></dl></details></section>"""
