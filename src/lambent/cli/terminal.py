"""The one way by which lines reach a terminal, whatever the names in them hold.

Commands print with `say` (results, on stdout) and `remark` (what is said beside them, on stderr);
nothing else here prints. A line is one line: control characters in it, which can only have come
from a file or a file's name, are shown as escapes (`lambent.escapes`). What the terminal's encoding
does not know is replaced by what it does.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import textwrap
from typing import TextIO

from lambent.escapes import escaped

#: What stands for signs of our own where the encoding lacks them.
_PLAIN = str.maketrans(
    {
        "→": "->",
        "…": "...",
        "↑": "^",
        "↓": "v",
        "·": "*",
        "×": "x",
        "±": "+-",
        "∞": "inf",
        "−": "-",
        "–": "-",
    }
)


def say(*lines: object) -> None:
    """Print results on stdout: each argument is a line; none at all an empty one."""
    _print(sys.stdout, lines or ("",))


def remark(*lines: object) -> None:
    """Print on stderr what is no result: notes, errors, how far it is."""
    _print(sys.stderr, lines or ("",))


def say_labelled(label: str, text: str, left: int, width: int) -> None:
    """A label, and its text in a column beside it that begins at ``left``, wrapped to ``width``.

    A label that is too long for its column gets a line of its own.
    """
    label = escaped(label)
    lines = textwrap.wrap(
        escaped(text), max(20, width - left), break_on_hyphens=False, break_long_words=False
    ) or [""]  # fmt: skip
    if len(label) >= left:
        say(label)
        label = ""
    say(f"{label:<{left}}{lines[0]}".rstrip(), *(" " * left + line for line in lines[1:]))


def columns() -> int:
    """How wide lines may be: the terminal's width, or that for a log, never more than 120."""
    return min(shutil.get_terminal_size((100, 24)).columns, 120)


def _print(stream: TextIO, lines: tuple[object, ...]) -> None:
    text = "".join(escaped(str(line)) + "\n" for line in lines)
    with contextlib.suppress(BrokenPipeError):  # whoever read it has gone; the work matters
        stream.write(encodable(text, getattr(stream, "encoding", None)))
        stream.flush()


def encodable(text: str, encoding: str | None) -> str:
    """Text in which everything can be encoded: other signs are spelled out, or shown as escapes."""
    encoding = encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return text.translate(_PLAIN).encode(encoding, "backslashreplace").decode(encoding)
    return text
