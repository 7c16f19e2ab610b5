"""The page of an inspection: what a file holds, which layers were found and why, what is odd."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lambent.frame.tonemap import auto_exposure, to_uint8
from lambent.report.page import build, escape, picture, save, table

#: Longer side of a thumbnail made here, in pixels (shown at half, for fine screens).
THUMBNAIL = 264


def write_inspection(
    path: str | os.PathLike[str],
    inspection: Mapping[str, Any],
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
    inspection: Mapping[str, Any],
    thumbnails: Mapping[str, Any] | None = None,
    title: str | None = None,
) -> str:
    """The text of the page; arguments as in `write_inspection`."""
    images = {name: _thumbnail(name, thing) for name, thing in (thumbnails or {}).items()}
    facts: list[tuple[str, str]] = []
    sections: list[tuple[int, str]] = []
    used: set[str] = set()
    for key, value in inspection.items():
        if _is_records(value):
            inner, names = _records(key, list(value), images)
            used |= names
            sections.append((_rank(key), f"<section><h2>{_words(key)}</h2>{inner}</section>"))
        elif isinstance(value, Mapping) and value:
            rows = [[escape(k), f'<td class="text">{_text(v)}</td>'] for k, v in value.items()]
            inner = table(["Name", "Value"], rows, caption=_words(key), kind="plain")
            sections.append((_rank(key), f"<section><h2>{_words(key)}</h2>{inner}</section>"))
        elif isinstance(value, (list, tuple)) and value:
            items = "".join(f"<li>{_text(v)}</li>" for v in value)
            sections.append(
                (
                    _rank(key),
                    f'<section><h2>{_words(key)}</h2><ul class="notes">{items}</ul></section>',
                )
            )
        elif value not in (None, "", [], (), {}):
            facts.append((_words(key), _text(value)))
    left = [name for name in images if name not in used]
    if left:
        rows = [[escape(n), f'<td class="thumb">{images[n]}</td>'] for n in left]
        inner = table(["Layer", "Picture"], rows, caption="Pictures", kind="plain")
        sections.append((5, f"<section><h2>Pictures</h2>{inner}</section>"))
    terms = "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in facts)
    head = f"<section><dl>{terms}</dl></section>" if terms else ""
    sections.sort(key=lambda s: s[0])
    source = str(inspection.get("path") or inspection.get("file") or "")
    name = title or (f"Inspection of {os.path.basename(source)}" if source else "Inspection")
    return build(name, head + "".join(s for _, s in sections), subtitle=escape(source))


# ------------------------------------------------------------------ private


def _rank(key: str) -> int:
    """What a reader wants first: what is odd, then the layers, then the parts."""
    order = ("suspicion", "warning", "note", "layer", "role", "part", "channel")
    return next((i for i, word in enumerate(order) if word in key.lower()), len(order))


def _is_records(value: Any) -> bool:
    return (
        isinstance(value, (list, tuple))
        and bool(value)
        and all(isinstance(v, Mapping) for v in value)
    )


def _records(
    key: str, records: list[Mapping[str, Any]], images: Mapping[str, str]
) -> tuple[str, set[str]]:
    """A table of records, and the names whose thumbnails it shows."""
    columns = [
        c
        for c in dict.fromkeys(c for r in records for c in r)
        if any(r.get(c) not in (None, "", [], (), {}) for r in records)
    ]
    columns.sort(key=lambda c: c != "name")  # the name heads the row; else order is kept
    shown = {str(r["name"]) for r in records if str(r.get("name")) in images}
    with_pictures = bool(shown) and "part" not in key.lower()
    rows = []
    for record in records:
        cells = [_text(record.get(columns[0], ""))] if columns else [""]
        if with_pictures:
            cells.append(f'<td class="thumb">{images.get(str(record.get("name")), "")}</td>')
        for column in columns[1:]:
            value = record.get(column)
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            kind = "number" if number else "text"
            cells.append(f'<td class="{kind}">{_text(value)}</td>')
        rows.append(cells)
    headings = [_words(c) for c in columns]
    if with_pictures:
        headings.insert(1, '<span class="hidden">Picture</span>')
    inner = table(headings, rows, caption=_words(key), kind="plain")
    return inner, shown if with_pictures else set()


def _words(key: object) -> str:
    text = str(key).replace("_", " ")
    return escape(text[:1].upper() + text[1:])


def _text(value: Any) -> str:
    """A value as markup."""
    if value is None or value == "":
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return escape(f"{float(value):.6g}")
    if isinstance(value, Mapping):
        pairs = (f"{escape(k)}: {_text(v)}" for k, v in value.items())
        return "<br>".join(pairs) or "–"
    if isinstance(value, (list, tuple)):
        plain = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value)
        return ("  " if plain else ", ").join(_text(v) for v in value) or "–"
    return escape(value)


def _thumbnail(name: str, thing: Any) -> str:
    from PIL import Image

    if isinstance(thing, (bytes, bytearray)):
        with Image.open(io.BytesIO(bytes(thing))) as image:
            width, height = image.size
        return picture(bytes(thing), f"Layer {name}", width, height)
    array = np.asarray(thing, np.float32)
    if array.ndim == 2:
        array = array[:, :, None]
    if array.shape[2] != 3:
        array = np.repeat(array[:, :, :1], 3, axis=2)
    step = max(1, -(-max(array.shape[:2]) // THUMBNAIL))
    small = array[::step, ::step]
    image = Image.fromarray(to_uint8(small, auto_exposure(small)))
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return picture(buffer.getvalue(), f"Layer {name}", *image.size)
