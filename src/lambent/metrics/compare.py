"""Several images against one reference: a table of metrics, and maps for those who ask.

All images of a comparison are shown and measured at one exposure, the reference's automatic one
unless another is given. Without a reference (one noisy and one cleaned image, say) there are no
metrics, but everything else is there: statistics, and maps of the *change* from the first image.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from lambent.errors import LayerError, OptionError
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.ldr import is_display
from lambent.frame.stamp import DENOISED
from lambent.metrics.align import Cut, aligned
from lambent.metrics.metric import METRICS, Metric, chosen
from lambent.metrics.pair import FloatArray, Pair, as_rgb
from lambent.metrics.picture import Picture
from lambent.progress import Progress

Thing = Any  # a path, a Frame, or an array

#: Called before each metric of each image with (what comes, how many are done, how many in all).


_ARROWS = {"lower": "↓", "higher": "↑"}


@dataclass(frozen=True)
class Row:
    """The metrics of one image. ``bad``: its pixels that are NaN or infinite."""

    name: str
    values: Mapping[str, float]
    bad: int = 0


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """What `compare` found. ``rows`` are in the order of ``pictures``.

    ``reference`` is None where there was none; then ``rows`` hold no values. ``exposure`` is the
    factor from radiance to display. ``uncounted``: pixels of the reference that are not finite,
    left out of every mean. ``where``: the note on which part was compared, where images have pixels
    at other places; ``pictures`` are cut to it.
    """

    pictures: tuple[Picture, ...]
    reference: Picture | None
    rows: tuple[Row, ...]
    metrics: tuple[str, ...]
    exposure: float
    uncounted: int = 0
    where: str = ""
    _pairs: Mapping[str, Pair] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        width, height = self.size
        against = "" if self.reference is None else f" against {self.reference.name}"
        names = ", ".join(row.name for row in self.rows)
        return f"<Comparison {width}x{height}{against}: {names}>"

    def __str__(self) -> str:
        return self.markdown()

    def _repr_html_(self) -> str:
        """The table, for Jupyter."""
        kinds: list[Metric] = [METRICS[name] for name in self.metrics]
        head = "".join(f"<th>{escape(k.title)} {_ARROWS[k.better]}</th>" for k in kinds)
        body = []
        for row in self.rows:
            cells = []
            for kind in kinds:
                text = number(row.values[kind.name])
                bold = row.name in self.best(kind.name)
                cells.append(f"<td>{f'<b>{text}</b>' if bold else text}</td>")
            body.append(f"<tr><th>{escape(row.name)}</th>{''.join(cells)}</tr>")
        return (
            f"<table><thead><tr><th>image</th>{head}</tr></thead>"
            f"<tbody>{''.join(body)}</tbody></table>"
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.pictures[0].image.shape[:2]
        return width, height

    def __getitem__(self, name: str) -> Row:
        """The row of an image; `OptionError` for a name that is not there."""
        for row in self.rows:
            if row.name == name:
                return row
        known = ", ".join(row.name for row in self.rows)
        raise OptionError(f"there is no image '{name}' in this comparison", remedy=f"take {known}")

    def map(self, name: str, metric: str) -> FloatArray:
        """The error of an image in each pixel ``(H, W)`` by a metric, made when first asked for.

        Without a reference this is the change from the first image. Raises `OptionError` for an
        unknown image or a metric that has no map.
        """
        self[name]
        kind: Metric = METRICS[metric]
        if kind.error_map is None:
            raise OptionError(f"the metric '{metric}' has no map")
        return kind.error_map(self._pairs[name])

    def best(self, metric: str) -> frozenset[str]:
        """Names of the images with the best value."""
        kind: Metric = METRICS[metric]
        return kind.best({r.name: r.values[metric] for r in self.rows if metric in r.values})

    def notes(self) -> tuple[str, ...]:
        """Everything a reader should know: notes of the files, pixels that were not finite."""
        found = [self.where] if self.where else []
        pictures = self.pictures if self.reference is None else (self.reference, *self.pictures)
        for picture in pictures:
            found += [f"{picture.name}: {note}" for note in picture.notes]
        if self.uncounted:
            found.append(
                f"The reference has {self.uncounted} pixels that are NaN or infinite; "
                "they are left out of every metric."
            )
        for row in self.rows:
            if row.bad and self.reference is not None:
                found.append(
                    f"{row.name}: {row.bad} pixels are NaN or infinite; every metric counts them "
                    "as the worst there is."
                )
            elif row.bad:
                found.append(f"{row.name}: {row.bad} pixels are NaN or infinite.")
        return tuple(found)

    def as_dict(self) -> dict[str, Any]:
        """Everything but pixels, of plain types that JSON knows (∞ as "inf", NaN as None)."""
        width, height = self.size
        return {
            "reference": None if self.reference is None else _described(self.reference),
            "images": [
                {
                    **_described(picture),
                    "metrics": {k: _plain(v) for k, v in row.values.items()},
                    "bad_pixels": row.bad,
                }
                for picture, row in zip(self.pictures, self.rows, strict=True)
            ],
            "metrics": list(self.metrics),
            "width": width,
            "height": height,
            "exposure": self.exposure,
            "uncounted_pixels": self.uncounted,
            "notes": list(self.notes()),
        }

    def markdown(self) -> str:
        """The table in Markdown; the best value of each metric in bold."""
        kinds: list[Metric] = [METRICS[name] for name in self.metrics]
        lines = [
            "| image | " + " | ".join(f"{k.title} {_ARROWS[k.better]}" for k in kinds) + " |",
            "|---|" + "---:|" * len(kinds),
        ]
        for row in self.rows:
            cells = []
            for kind in kinds:
                text = number(row.values[kind.name])
                cells.append(f"**{text}**" if row.name in self.best(kind.name) else text)
            name = row.name.replace("|", "\\|").replace("\n", " ")
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        return "\n".join(lines)


def compare(
    reference: Thing | None,
    images: Mapping[str, Thing] | Iterable[Any] | Thing,
    metrics: str | Iterable[str] | None = None,
    exposure: float | None = None,
    *,
    reference_variance: Any = None,
    details: Mapping[str, Mapping[str, Any]] | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Measure images against a reference.

    ``reference``: a path, a `Frame` or an array ``(H, W, 3)`` of linear radiance; or None, then
    nothing is measured and maps show the change from the first image. ``images``: the same by
    name, one image alone, or an iterable of paths (named by their stems). ``metrics``: names from
    `METRICS` or of families of them, ``"relmse,flip"`` say (default: all). ``exposure``: the factor
    before the tone map (default: the reference's automatic one; 1 where it holds display values).
    ``reference_variance``: see `lambent.metrics.relmse`. ``details``: by name of image (or
    "reference"), facts to show beside it, such as ``{"model": "oidn", "seconds": 0.9}``.
    Images are compared where all have pixels, by their data windows (`lambent.metrics.align`).
    Raises `LayerError` naming both images where sizes or places differ, `UnknownNameError` for an
    unknown metric, and what `lambent.frame.files.read` raises.

    >>> table = compare("reference.exr", {"noisy": "noisy.exr", "clean": clean})  # doctest: +SKIP
    >>> print(table.markdown())  # doctest: +SKIP
    """
    named = _named(images)
    if not named:
        raise OptionError("there is nothing to compare", remedy="give at least one image")
    more = details or {}
    kinds = chosen(metrics)
    truth = None
    if reference is not None:
        truth = _picture("reference", reference, more.get("reference", {}))
    pictures = tuple(_picture(name, thing, more.get(name, {})) for name, thing in named.items())
    every, cuts, where = aligned(pictures if truth is None else (truth, *pictures))
    if truth is not None:
        truth = every[0]
        reference_variance = _cut(reference_variance, cuts[0], truth)
    pictures = tuple(every if truth is None else every[1:])
    base = pictures[0] if truth is None else truth
    if exposure is None:
        factor = 1.0 if base.display else auto_exposure(base.image)
    else:
        factor = float(exposure)
    if not (math.isfinite(factor) and factor > 0):
        raise OptionError(f"the exposure is {factor}", remedy="give a factor above 0")
    pairs = {
        picture.name: Pair.of(
            picture.image, base.image, factor, reference_variance, (picture.label, base.label)
        )
        for picture in pictures
    }
    if truth is None:
        kinds = []
    rows, done, steps = [], 0, len(kinds) * len(pictures)
    for picture in pictures:
        pair, values = pairs[picture.name], {}
        for kind in kinds:
            if progress is not None:
                progress(done, steps, f"{kind.title} of {picture.name}")
            values[kind.name] = kind.score(pair)
            done += 1
        bad = int((~np.isfinite(picture.image).all(axis=2)).sum())
        rows.append(Row(picture.name, MappingProxyType(values), bad))
    uncounted = 0 if truth is None else int((~pairs[pictures[0].name].counted).sum())
    return Comparison(
        pictures=pictures,
        reference=truth,
        rows=tuple(rows),
        metrics=tuple(kind.name for kind in kinds),
        exposure=factor,
        uncounted=uncounted,
        where=where,
        _pairs=pairs,
    )


def number(value: float) -> str:
    """A metric's value for a table: four significant digits, no exponent where it can be helped."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    size = abs(value)
    if size >= 1e5 or size < 1e-5:
        text = f"{value:.2e}"
    else:
        text = f"{value:.{max(0, min(7, 3 - math.floor(math.log10(size))))}f}"
    return text.replace("-", "−") if value < 0 else text


# ------------------------------------------------------------------ private


def _named(images: Mapping[str, Thing] | Iterable[Any]) -> dict[str, Thing]:
    if isinstance(images, Mapping):
        return {str(name): thing for name, thing in images.items()}
    if isinstance(images, (str, Path, Frame, Picture, np.ndarray)):  # one image
        images = [images]
    named: dict[str, Thing] = {}
    for index, thing in enumerate(images, 1):
        path = thing.path if isinstance(thing, Frame) else thing
        name = Path(path).stem if isinstance(path, (str, Path)) else f"image {index}"
        unique, count = name, 2
        while unique in named:
            unique, count = f"{name} ({count})", count + 1
        named[unique] = thing
    return named


def _picture(name: str, thing: Thing, details: Mapping[str, Any]) -> Picture:
    if isinstance(thing, Picture):
        return replace(thing, name=name, details={**thing.details, **details})
    path = None
    if isinstance(thing, (str, Path)):
        from lambent.frame.files import read

        path = str(thing)
        thing = read(thing)
    if isinstance(thing, Frame):
        image = as_rgb(thing.colour, thing.path or f"image '{name}'")
        path = thing.path or path
        return Picture(
            name,
            image,
            path,
            thing.spp,
            dict(details),
            tuple(note for note in thing.notes if DENOISED not in note),  # as one would expect
            thing.windows,
            is_display(thing),
        )
    try:
        image = as_rgb(thing, f"image '{name}'")
    except (TypeError, ValueError) as error:
        raise LayerError(f"cannot be taken as an image: {error}", file=f"image '{name}'") from error
    return Picture(name, image, path, None, dict(details))


def _cut(variance: Any, cut: Cut, truth: Picture) -> Any:
    """The variance of the whole reference, cut as it was; another is left for `Pair` to check."""
    if variance is None or np.shape(variance)[:2] == truth.image.shape[:2]:
        return variance
    return np.asarray(variance)[cut]


def _described(picture: Picture) -> dict[str, Any]:
    return {
        "name": picture.name,
        "path": picture.path,
        "spp": picture.spp,
        "details": {k: _plain(v) for k, v in picture.details.items()},
        "statistics": {k: _plain(v) for k, v in picture.statistics().items()},
    }


def _plain(value: Any) -> Any:
    if isinstance(value, (bool, int, str)) or value is None:
        return value
    if isinstance(value, (float, np.floating, np.integer)):
        plain = float(value)
        if math.isnan(plain):
            return None
        return plain if math.isfinite(plain) else ("inf" if plain > 0 else "-inf")
    return str(value)
