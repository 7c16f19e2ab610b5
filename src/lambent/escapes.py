"""How names from files are shown: nothing in them can give orders to a terminal.

A name in a file may hold anything: escape sequences that set the title, the clipboard or colours,
line breaks, letters that turn the direction of what follows, bytes that are no text at all.
"""

from __future__ import annotations


def escaped(text: str) -> str:
    """Text on one line, in which whatever is not printable stands as an escape of Python's.

    ESC is shown as ``\\x1b``, a line break as ``\\n``, a bidi override as ``\\u202e``, a byte that
    was no UTF-8 (a lone surrogate) as ``\\xe9``. Printable text stays as it is; so to escape again
    changes nothing.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escape(c) for c in text)


def _escape(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:
        return f"\\x{code - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")
