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
import tempfile
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

import lambent
from lambent.errors import OutputError


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
    return resources.files("lambent.report").joinpath("page", name).read_text("utf-8")


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
    """Write a page beside its target and move it there, so that no half page is ever seen.

    Raises `OutputError` where that fails.
    """
    target = Path(path)
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(
            prefix=f".{target.name}.", suffix=".part", dir=target.parent
        )
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, target)
        temporary = None
    except OSError as error:
        raise OutputError(
            f"the report cannot be written: {error.strerror or error}",
            file=target,
            remedy="choose a folder that exists and can be written to",
        ) from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
    return target


def table(
    headings: list[str], rows: list[list[str]], *, caption: str, kind: str = "", first: str = ""
) -> str:
    """A table from markup cells; the first cell of a row is its heading."""
    head = "".join(f'<th scope="col">{h}</th>' for h in headings)
    body = "".join(
        "<tr>"
        + f'<th scope="row">{row[0]}</th>'
        + "".join(cell if cell.startswith("<td") else f"<td>{cell}</td>" for cell in row[1:])
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
