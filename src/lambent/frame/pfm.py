"""Portable float map (.pfm): a header of three lines, then float32 from the bottom row up.

``PF`` has three channels, ``Pf`` one. The sign of the third line tells the byte order (negative:
little-endian); its size is the scale by which values are multiplied (P. Debevec, HDR Shop, 2001).
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError
from lambent.frame.limits import check_declared

_HEADER = re.compile(rb"(PF|Pf)\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(\d{1,9})\s+(\S{1,32})(?:\r\n|\s)")
_REMEDY = "the file is damaged: copy or render it again"


def read_pfm(content: bytes, path: object = None) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """``(H, W, 1 or 3)`` float32, top row first, and notes. Raises `DamagedFileError`."""
    match = _HEADER.match(content)
    try:
        scale = float(match[4]) if match is not None else 0.0
    except ValueError:
        scale = 0.0
    if match is None or not (math.isfinite(scale) and scale):
        raise DamagedFileError("has no valid header", file=path, remedy=_REMEDY)
    width, height, channels = int(match[2]), int(match[3]), 3 if match[1] == b"PF" else 1
    if not width or not height:
        raise DamagedFileError("has an impossible size", file=path, remedy=_REMEDY)
    check_declared(width, height, channels, 4, path, stored=len(content))
    count = width * height * channels
    if len(content) - match.end() < 4 * count:
        raise DamagedFileError("ends before its last row", file=path, remedy=_REMEDY)
    kind = "<f4" if scale < 0 else ">f4"
    pixels = np.frombuffer(content, kind, count, match.end()).reshape(height, width, channels)
    image = np.array(pixels[::-1], np.float32)
    if abs(scale) == 1:
        return image, ()
    image *= np.float32(abs(scale))
    return image, (f"Values were multiplied by the file's scale, {abs(scale):g}.",)


def write_pfm(image: NDArray[np.float32]) -> bytes:
    """``(H, W, 1 or 3)`` to the bytes of a little-endian PFM of scale 1."""
    height, width, channels = image.shape
    head = f"{'PF' if channels == 3 else 'Pf'}\n{width} {height}\n-1.0\n".encode()
    return head + np.ascontiguousarray(image[::-1], "<f4").tobytes()
