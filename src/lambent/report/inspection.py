"""The page of an inspection: what a file holds, which layers were found and why, what is odd."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.exposure import auto_exposure
from lambent.frame.role import INFO, Role
from lambent.frame.tonemap import to_uint8
from lambent.metrics.compare import number
from lambent.metrics.pair import FloatArray
from lambent.report.page import build, escape, picture, save, table

if TYPE_CHECKING:
    from pathlib import Path

#: Longer side of a thumbnail made here, in pixels (shown at half, for fine screens).
THUMBNAIL = 264

#: What a reader wants first: what is odd, then the layers, then the parts.
ORDER = ("suspicion", "warning", "note", "layer", "sum", "part")

Record = Mapping[str, Any]


def write_inspection(
    path: str | os.PathLike[str],
    inspection: Record,
    thumbnails: Mapping[str, Any] | None = None,
    *,
    title: str | None = None,
) -> Path:
    """Write one self-contained HTML page; returns its path.

    ``inspection``: `lambent.frame.inspection.Inspection.as_dict()`. Plain values at its top become
    a list of facts, lists of records become tables, lists of text become lists; nothing is left
    out. ``thumbnails``: by name of layer, the bytes of a PNG or an array ``(H, W)`` or
    ``(H, W, 1 or 3)`` of linear values; shown in the table whose rows have that name.
    Raises `OutputError` where the file cannot be written.
    """
    return save(path, inspection_page(inspection, thumbnails, title))


def inspection_page(
    inspection: Record,
    thumbnails: Mapping[str, Any] | None = None,
    title: str | None = None,
) -> str:
    """The text of the page; arguments as in `write_inspection`."""
    roles = {
        str(r.get("name")): str(r.get("role"))
        for r in (inspection.get("layers") or ())
        if isinstance(r, Mapping)
    }
    images = {
        name: _thumbnail(name, thing, roles.get(name, ""))
        for name, thing in (thumbnails or {}).items()
    }
    facts: list[tuple[str, str]] = []
    sections: list[tuple[int, str, str]] = []
    used: set[str] = set()
    for key, value in _tidy(inspection).items():
        if _is_records(value):
            inner, names = _records(key, list(value), images)
            used |= names
            sections.append((_rank(key), _words(key), inner))
        elif isinstance(value, Mapping) and value:
            rows = [[escape(k), f'<td class="text">{_text(v)}</td>'] for k, v in value.items()]
            inner = table(["Name", "Value"], rows, caption=_words(key), kind="plain")
            sections.append((_rank(key), _words(key), inner))
        elif isinstance(value, (list, tuple)) and value and _rank(key) < len(ORDER):
            items = "".join(f"<li>{_text(v)}</li>" for v in value)
            sections.append((_rank(key), _words(key), f'<ul class="notes">{items}</ul>'))
        elif not _empty(value):
            facts.append((_words(key), _text(value)))
    left = [name for name in images if name not in used]
    if left:
        rows = [[escape(n), f'<td class="thumb">{images[n]}</td>'] for n in left]
        inner = table(["Layer", "Picture"], rows, caption="Pictures", kind="plain")
        sections.append((len(ORDER), "Pictures", inner))
    terms = "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in facts)
    body = f'<section><dl class="facts">{terms}</dl></section>' if terms else ""
    for _, heading, inner in sorted(sections, key=lambda s: s[0]):
        body += f"<section><h2>{heading}</h2>{inner}</section>"
    source = str(inspection.get("path") or "")
    name = title or (f"Inspection of {os.path.basename(source)}" if source else "Inspection")
    return build(name, body, subtitle=escape(source))


# ------------------------------------------------------- in a reader's words


def _tidy(inspection: Record) -> dict[str, Any]:
    """The same facts, grouped as a person reads them. Keys that are not known stay as they are."""
    facts = {k: v for k, v in inspection.items() if k != "path"}
    if isinstance(facts.get("size"), int):
        facts["size"] = f"{facts['size'] / 1e6:.2f} MB"
    if {"width", "height"} <= facts.keys():
        picture_size = f"{facts.pop('width')} × {facts.pop('height')} pixels"
        facts = {"picture": picture_size, **facts}
    if facts.get("dialect") and facts.get("dialect_why"):
        facts["dialect"] = f"{facts['dialect']} ({facts.pop('dialect_why')})"
    several = len(facts.get("parts") or ()) > 1
    if _is_records(facts.get("layers")):
        facts["layers"] = [_layer(r, facts.get("picture"), several) for r in facts["layers"]]
    if _is_records(facts.get("parts")):
        facts["parts"] = [_part(r) for r in facts["parts"]]
    return facts


def _layer(record: Record, picture_size: Any, several: bool) -> dict[str, Any]:
    """``several``: whether the file has several parts, so that their numbers say something."""
    r = dict(record)
    tidy: dict[str, Any] = {"name": r.pop("name", "")}
    stat = r.pop("stat", "mean")
    role = r.pop("role", None)
    if role is not None:
        tidy["role"] = role if stat in ("mean", None, "") else f"{role}, {stat}"
    space = r.pop("space", None)
    tidy["space"] = None if space in ("none", None) else space
    tidy["why"] = r.pop("why", None)
    tidy["view"] = r.pop("view", None)
    part = r.pop("part", None)
    tidy["part"] = part if several else None
    channels = r.pop("channels", None)
    if isinstance(channels, (list, tuple)):
        tidy["channels"] = "  ".join(str(c).rsplit(".", 1)[-1] for c in channels)
    if {"width", "height"} <= r.keys():
        size = f"{r.pop('width')} × {r.pop('height')} pixels"
        tidy["size"] = None if size == picture_size else size
    return {**tidy, **r}


def _part(record: Record) -> dict[str, Any]:
    r = dict(record)
    channels = r.pop("channels", None)
    for key in ("data_window", "display_window"):
        window = r.get(key)
        if isinstance(window, (list, tuple)) and len(window) == 4:
            r[key] = f"{window[0]}, {window[1]} to {window[2]}, {window[3]}"
    if _is_records(channels):
        of_type: dict[str, list[str]] = {}
        for c in channels:
            x, y = c.get("x_sampling", 1), c.get("y_sampling", 1)
            sampling = "" if (x, y) == (1, 1) else f" (every {x} × {y})"
            of_type.setdefault(f"{c.get('type', '')}{sampling}", []).append(str(c.get("name", "")))
        r["channels"] = {kind: "  ".join(names) for kind, names in of_type.items()}
    elif channels is not None:
        r["channels"] = channels
    return r


def _rank(key: str) -> int:
    return next((i for i, word in enumerate(ORDER) if word in key.lower()), len(ORDER))


def _words(key: object) -> str:
    text = str(key).replace("_", " ")
    special = {"spp": "spp", "nan": "NaN", "why": "Found by", "low": "Lowest", "high": "Highest"}
    return escape(special.get(text) or text[:1].upper() + text[1:])


# ------------------------------------------------------------------- markup


def _is_records(value: Any) -> bool:
    return (
        isinstance(value, (list, tuple))
        and bool(value)
        and all(isinstance(v, Mapping) for v in value)
    )


def _empty(value: Any) -> bool:
    return value is None or (isinstance(value, (str, list, tuple, Mapping)) and not value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _records(key: str, records: list[Record], images: Mapping[str, str]) -> tuple[str, set[str]]:
    """A table of records, and the names whose thumbnails it shows."""
    columns = [
        c
        for c in dict.fromkeys(c for r in records for c in r)
        if any(not _empty(r.get(c)) for r in records)
    ]
    columns.sort(key=lambda c: c != "name")  # the name heads the row; else order is kept
    shown = {str(r["name"]) for r in records if "name" in r and str(r["name"]) in images}
    with_pictures = bool(shown) and "part" not in key.lower()
    numeric = {c for c in columns[1:] if any(_is_number(r.get(c)) for r in records)}
    rows = []
    for record in records:
        cells = [_text(record.get(columns[0])) if columns else ""]
        if with_pictures:
            cells.append(f'<td class="thumb">{images.get(str(record.get("name")), "")}</td>')
        for column in columns[1:]:
            value = record.get(column)
            kind = "number" if column in numeric else "text"
            if (column, value) == ("level", "warning"):
                kind += " warn"
            # A negative value is no surprise but in light.
            odd = column in ("nan", "infinite")
            odd |= column == "negative" and record.get("space") in (None, "linear")
            if odd and value and record.get("role") not in ("id", "other"):
                kind += " warn"
            cells.append(f'<td class="{kind}">{_text(value)}</td>')
        rows.append(cells)
    headings = [
        f'<span class="right">{_words(c)}</span>' if c in numeric else _words(c) for c in columns
    ]
    if with_pictures:
        headings.insert(1, '<span class="hidden">Picture</span>')
    inner = table(headings, rows, caption=_words(key), kind="plain sortable")
    return inner, shown if with_pictures else set()


def _text(value: Any) -> str:
    """A value as markup."""
    if _empty(value):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return number(float(value))
    if isinstance(value, Mapping):
        return "<br>".join(f"<i>{escape(k)}</i> {_text(v)}" for k, v in value.items())
    if isinstance(value, (list, tuple)):
        return (", " if not all(map(_is_number, value)) else "  ").join(_text(v) for v in value)
    return escape(value)


def _thumbnail(name: str, thing: Any, role: str) -> str:
    from PIL import Image

    if isinstance(thing, (bytes, bytearray)):
        with Image.open(io.BytesIO(bytes(thing))) as image:
            size = image.size
        return picture(bytes(thing), f"Layer {name}", *size)
    array = np.asarray(thing, np.float32)
    if array.ndim == 2:
        array = array[:, :, None]
    if array.shape[2] != 3:
        array = np.repeat(array[:, :, :1], 3, axis=2)
    step = max(1, -(-max(array.shape[:2]) // THUMBNAIL))
    shown = Image.fromarray(_visible(array[::step, ::step], role))
    buffer = io.BytesIO()
    shown.save(buffer, "PNG", optimize=True)
    return picture(buffer.getvalue(), f"Layer {name}", *shown.size)


def _visible(image: FloatArray, role: str) -> NDArray[np.uint8]:
    """Bytes for the eye: light at its automatic exposure, vectors around grey, the rest to 1."""
    light = role in ("", "None") or any(role == r.value and INFO[r].radiance for r in Role)
    if light:
        return to_uint8(image, auto_exposure(image))
    finite = image[np.isfinite(image)]
    # 95 %: a few misses (1e10) shall not darken a depth.
    top = float(np.percentile(np.abs(finite), 95)) if finite.size else 1.0
    top = 1.0 if 0 < top <= 1 else top or 1.0
    if finite.size and finite.min() < 0:
        centred = np.nan_to_num(image / top, posinf=1, neginf=-1) * 0.5 + 0.5
        return np.asarray(np.clip(centred, 0, 1) * 255 + 0.5, np.uint8)
    return to_uint8(image, 1 / top)
