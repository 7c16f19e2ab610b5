"""How much memory a file may ask for: its declared sizes are checked before anything is decoded.

A few bytes of a damaged or malicious file can declare a picture of any size. What a file declares
may take 2 GiB, or 100 times the file's own length where that is more (large files that are really
large pass). ``LAMBENT_MAX_DECODED``, a size such as ``500M`` or ``16G``, replaces both.
"""

from __future__ import annotations

import os

from lambent.errors import FileError, OptionError
from lambent.memory import bytes_of, show_size

#: The environment variable with the limit of one's own.
VARIABLE = "LAMBENT_MAX_DECODED"
#: What any file may take decoded, in bytes, however short it is.
DEFAULT = 2 * 1024**3
#: What a file may take decoded for each of its own bytes.
RATIO = 100


def check_declared(
    width: int,
    height: int,
    channels: int,
    bytes_per_sample: int,
    file: object,
    *,
    stored: int = 0,
    limit: int | None = None,
) -> None:
    """Raise `FileError` where a picture of ``width x height`` pixels would take too much memory.

    ``stored``: the length of the file in bytes, ``limit``: bytes; see `check_bytes`.
    """
    check_bytes(
        width * height * channels * bytes_per_sample,
        file,
        what=f"{width}x{height} pixels with {channels} channel{'' if channels == 1 else 's'}",
        stored=stored,
        limit=limit,
    )


def check_bytes(
    declared: int, file: object, *, what: str, stored: int = 0, limit: int | None = None
) -> None:
    """Raise `FileError` where what a file declares would take more than ``limit`` bytes decoded.

    ``what``: the declared thing, for the message. ``stored``: the length of the file in bytes
    (0: not known, and the file gets no credit for it). ``limit`` None: see `allowed`.
    """
    most = allowed(stored) if limit is None else limit
    if declared > most:
        raise FileError(
            f"declares {what}, {show_size(declared)} once decoded, where {show_size(most)} are "
            "allowed",
            file=file,
            remedy="if this is meant, allow more with the environment variable "
            f"{VARIABLE}={_enough(declared)}",
        )


def allowed(stored: int = 0) -> int:
    """How many bytes a file of ``stored`` bytes may take once decoded.

    Raises `OptionError` where ``LAMBENT_MAX_DECODED`` is no size.
    """
    text = os.environ.get(VARIABLE, "").strip()
    if not text:
        return max(DEFAULT, RATIO * stored)
    size = bytes_of(text)
    if size is None:
        raise OptionError(
            f"{VARIABLE}='{text}' is not a size",
            remedy=f"write a number of bytes, or {VARIABLE}=4G",
        )
    return size


# ------------------------------------------------------------------- private


def _enough(count: int) -> str:
    """The least whole number of gibibytes (mebibytes, where that suffices) that allows this."""
    if count <= 1024**3:
        return f"{-(-count // 1024**2)}M"
    return f"{-(-count // 1024**3)}G"
