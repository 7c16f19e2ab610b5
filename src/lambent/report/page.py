"""A self-contained HTML page: one file, no network, nothing in it that data could turn into code.

Text from files (names of layers, notes) is not trusted. Three things hold it: `escape` for what
goes into markup, `json_block` for what scripts read, and a content security policy with hashes that
lets the page's own script and style run and nothing else, and forbids every request.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

import lambent
from lambent.frame.atomic import atomic

#: Which way is better, in a heading.
_ARROWS = re.compile('<span class="way".*?</span>')


def escape(text: object) -> str:
    """Text for markup and for quoted attributes; control characters become visible."""
    shown = "".join(c if c.isprintable() or c in "\n\t" else "\ufffd" for c in str(text))
    return html.escape(shown, quote=True)


def json_block(name: str, value: Any) -> str:
    """A block of data that scripts read with ``JSON.parse``. It can hold any text.

    Raises `ValueError` for NaN and infinities: they are no JSON.
    """
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    # No tag, comment or entity can begin in here.
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return f'<script type="application/json" id="{escape(name)}">{text}</script>'


def asset(name: str) -> str:
    """The text of a file in the folder ``page``."""
    return resources.files("lambent.report").joinpath("page").joinpath(name).read_text("utf-8")


def build(
    title: str,
    body: str,
    *,
    subtitle: str = "",
    scripts: Iterable[str] = ("page.js",),
    data: Any = None,
) -> str:
    """A whole page.

    ``title``: plain text. ``body``, ``subtitle``: markup, already escaped. ``scripts``: files of
    the folder ``page``, joined in this order. ``data``: what they read, or None.
    """
    style = asset("page.css")
    script = "\n".join(asset(name) for name in scripts)
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    parts = {
        "title": escape(title),
        "subtitle": subtitle,
        "policy": policy,
        "style": style,
        "script": script,
        "body": body,
        "data": "" if data is None else json_block("data", data),
        "version": escape(lambent.__version__),
    }
    pieces = asset("page.html").split("%%")
    # Odd pieces are names of parts; what is put in is never looked through again.
    return "".join(parts[p] if i % 2 else p for i, p in enumerate(pieces))


def save(path: str | os.PathLike[str], text: str) -> Path:
    """Write a page; an old one of that name is replaced in one step, never half.

    Raises `OutputError` where that fails.
    """
    with atomic(path, overwrite=True) as file:
        file.write(text.encode("utf-8"))
    return Path(path)


def table(
    headings: list[str], rows: list[list[str]], *, caption: str, kind: str = "", first: str = ""
) -> str:
    """A table from markup cells; the first cell of a row is its heading.

    Every cell knows its column's heading, for narrow windows in which rows become lists.
    """
    texts = [any(r[i].startswith('<td class="text"') for r in rows) for i in range(len(headings))]
    head = "".join(
        f'<th scope="col" class="text">{h}</th>' if text else f'<th scope="col">{h}</th>'
        for h, text in zip(headings, texts, strict=True)
    )
    labels = [html.unescape(re.sub("<[^>]*>", "", _ARROWS.sub("", h))).strip() for h in headings]
    body = "".join(
        "<tr>"
        + f'<th scope="row">{row[0]}</th>'
        + "".join(
            f'<td data-label="{escape(label)}"'
            + (cell[3:] if cell.startswith("<td") else f">{cell}</td>")
            for label, cell in zip(labels[1:], row[1:], strict=True)
        )
        + "</tr>"
        for row in rows
    )
    identity = f' id="{first}"' if first else ""
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{caption}">'
        f'<table class="{kind}"{identity}><caption class="hidden">{caption}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def picture(png: bytes, alternative: str, width: int, height: int) -> str:
    """An image element that holds its PNG."""
    code = base64.b64encode(png).decode("ascii")
    return (
        f'<img src="data:image/png;base64,{code}" alt="{escape(alternative)}" '
        f'width="{width}" height="{height}">'
    )


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return "sha256-" + base64.b64encode(digest).decode("ascii")
