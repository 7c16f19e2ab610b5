"""Values of EXR header attributes as plain Python objects.

Vectors and matrices become tuples of floats, boxes ``(x0, y0, x1, y1)``, strings ``str`` (bytes
that are no UTF-8 are shown as U+FFFD); types that are not known stay ``bytes``. The values are for
reading only: a file is written back from the header's own bytes (`lambent.frame.exr.header`).
The layout of each type is that of "OpenEXR File Layout", Industrial Light & Magic, 2024.
"""

from __future__ import annotations

import struct
from typing import Any

#: Types that are a row of numbers: name -> struct format.
_PLAIN = {
    "int": "<i", "float": "<f", "double": "<d",
    "v2i": "<2i", "v2f": "<2f", "v2d": "<2d", "v3i": "<3i", "v3f": "<3f", "v3d": "<3d",
    "v4i": "<4i", "v4f": "<4f", "v4d": "<4d",
    "m33f": "<9f", "m33d": "<9d", "m44f": "<16f", "m44d": "<16d",
    "box2i": "<4i", "box2f": "<4f", "chromaticities": "<8f", "rational": "<iI",
    "timecode": "<2I", "keycode": "<7i",
    "compression": "<B", "lineOrder": "<B", "envmap": "<B", "deepImageState": "<B",
}  # fmt: skip

COMPRESSIONS = (
    "none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab",
    "htj2k256", "htj2k32", "lj2k", "zstd",
)  # fmt: skip
LINE_ORDERS = ("increasing", "decreasing", "random")


def value_of(kind: str, raw: bytes) -> Any:
    """The Python value of an attribute of type ``kind``; ``raw`` itself if it makes no sense."""
    try:
        return _value(kind, raw)
    except (struct.error, ValueError, IndexError):
        return raw


def well_formed(kind: str, raw: bytes) -> bool:
    """Whether an attribute is of a known type and its bytes make sense."""
    if kind == "chlist":
        return True  # read and checked with the header
    try:
        if kind == "string":
            raw.decode("utf-8")
        if kind == "preview":
            width, height = struct.unpack_from("<II", raw)
            return len(raw) == 8 + 4 * width * height
        if kind == "tiledesc" and len(raw) != 9:
            return False
        if kind == "floatvector" and len(raw) % 4:
            return False
        return not isinstance(_value(kind, raw), bytes)
    except (struct.error, ValueError, IndexError):
        return False


def text_of(raw: bytes) -> str:
    """UTF-8 text; other bytes are shown as U+FFFD."""
    return raw.decode("utf-8", errors="replace")


def _value(kind: str, raw: bytes) -> Any:
    if kind == "string":
        return text_of(raw)
    if kind in _PLAIN:
        numbers = struct.unpack(_PLAIN[kind], raw)
        if kind == "compression":
            return COMPRESSIONS[numbers[0]]
        if kind == "lineOrder":
            return LINE_ORDERS[numbers[0]]
        return numbers[0] if len(numbers) == 1 else numbers
    if kind == "stringvector":
        return _strings(raw)
    if kind == "floatvector":
        return struct.unpack(f"<{len(raw) // 4}f", raw)
    if kind == "tiledesc":
        x, y, mode = struct.unpack("<IIB", raw)
        return {"width": x, "height": y, "level": mode & 15, "round_up": bool(mode >> 4)}
    if kind == "preview":
        width, height = struct.unpack_from("<II", raw)
        return {"width": width, "height": height, "rgba": raw[8:]}
    return raw


def _strings(raw: bytes) -> list[str]:
    found, at = [], 0
    while at < len(raw):
        (length,) = struct.unpack_from("<i", raw, at)
        if not 0 <= length <= len(raw) - at - 4:
            raise ValueError(length)
        found.append(text_of(raw[at + 4 : at + 4 + length]))
        at += 4 + length
    return found
