"""The page of a comparison: pictures side by side, error maps, the table of metrics.

The same page shows one denoising without a reference: then there is no table of metrics, but
statistics, and maps of the change.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError
from lambent.metrics.compare import Comparison, compare
from lambent.metrics.metric import METRICS, Metric
from lambent.metrics.pair import FloatArray
from lambent.metrics.picture import Picture
from lambent.report.codec import pack_map, pack_radiance
from lambent.report.colourmap import error_colours
from lambent.report.histogram import Axis
from lambent.report.page import build, save
from lambent.report.sections import (
    error_histograms,
    explanation,
    image_table,
    metric_table,
    note_list,
    subtitle,
    viewer,
)

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
            viewer(results, kinds),
            metric_table(results),
            error_histograms(results, kinds, layers),
            image_table(pictures, names),
            note_list(remarks),
            explanation(results, kinds),
        ]
    )
    return build(
        title,
        body,
        subtitle=subtitle(results),
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
