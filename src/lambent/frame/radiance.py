"""Radiance HDR (.hdr): three mantissas and a shared exponent a pixel, run-length coded.

G. Ward, "Real Pixels", Graphics Gems II, 1991, and the Radiance file format description. A value
is ``mantissa/256 · 2^(exponent − 128)``; rows of 8 to 32767 pixels are coded plane by plane: a
count above 128 repeats the next byte, another count copies as many. We read also old run-length
coding and all orientations, and write the new coding, top row first.
"""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.frame.limits import check_declared

_SIZE = re.compile(rb"^([+-][XY]) (\d{1,7}) ([+-][XY]) (\d{1,7})$")
#: Header lines that are applied, or that only say who wrote the file.
_USED = (b"FORMAT", b"EXPOSURE", b"SOFTWARE")
_REMEDY = "the file is damaged: copy or render it again"


def read_hdr(content: bytes, path: object = None) -> NDArray[np.float32]:
    """The bytes of an HDR file to linear ``(H, W, 3)`` float32. Raises `DamagedFileError`."""
    header, match, at = _header(content, path)
    if header.get(b"FORMAT", b"32-bit_rle_rgbe") != b"32-bit_rle_rgbe":
        raise FileError(
            "is an HDR image in XYZ, not RGB", file=path, remedy="convert it to 32-bit_rle_rgbe"
        )
    first, second = match[1], match[3]
    count, length = int(match[2]), int(match[4])  # rows as stored, pixels in one
    if first[1:] == second[1:] or not count or not length:
        raise DamagedFileError("has an impossible size", file=path, remedy=_REMEDY)
    check_declared(length, count, 3, 4, path, stored=len(content))
    if count * 2 > len(content) - at:
        raise DamagedFileError("ends before its last row", file=path, remedy=_REMEDY)
    pixels = np.empty((count, length, 4), np.uint8)
    for row in range(count):
        at = _row(content, at, pixels[row], path)
    image = from_rgbe(pixels) / _exposure(header.get(b"EXPOSURE", b"1"), path)
    if first[:1] == b"+" if first[1:] == b"Y" else first[:1] == b"-":
        image = image[::-1]
    if second[:1] == b"-" if second[1:] == b"X" else second[:1] == b"+":
        image = image[:, ::-1]
    if first[1:] == b"X":  # stored column by column
        image = image.transpose(1, 0, 2)
    return np.ascontiguousarray(image, np.float32)


def notes_of(content: bytes) -> tuple[str, ...]:
    """What the header of an HDR file says that is neither used nor kept."""
    header, _, _ = _header(content, None)
    names = sorted(key.decode("latin-1") for key in header if key not in _USED)
    return (f"Not used and not kept: {', '.join(names)} of its header.",) if names else ()


def write_hdr(image: NDArray[np.float32]) -> bytes:
    """Linear ``(H, W, 3)``, finite and not negative, to the bytes of an HDR file.

    Negative values and NaN become 0, infinities the largest value; callers count them before.
    """
    height, width = image.shape[:2]
    pixels = to_rgbe(image)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    if not 8 <= width < 32768:
        return head + pixels.tobytes()
    leader = bytes([2, 2, width >> 8, width & 255])
    rows = [head]
    for row in pixels:
        rows.append(leader)
        rows += [_pack(np.ascontiguousarray(row[:, plane])) for plane in range(4)]
    return b"".join(rows)


def from_rgbe(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """``(..., 4)`` bytes to ``(..., 3)`` radiance."""
    exponent = pixels[..., 3:].astype(np.int32) - (128 + 8)
    scale = np.where(pixels[..., 3:] > 0, np.ldexp(np.float32(1), exponent), np.float32(0))
    # The middle of the step a mantissa stands for would be +0.5; writers differ, most read without.
    return pixels[..., :3].astype(np.float32) * scale


def to_rgbe(image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """``(..., 3)`` radiance to ``(..., 4)`` bytes; mantissas are rounded to nearest."""
    clean = np.nan_to_num(np.asarray(image, np.float32), nan=0.0, posinf=1e38, neginf=0.0)
    clean = np.clip(clean, 0.0, np.ldexp(np.float32(255), 127 - 8))
    largest = clean.max(axis=-1, keepdims=True)
    _, exponent = np.frexp(largest)
    exponent = np.maximum(exponent, -127)  # the least a file holds; mantissas shrink below it
    rounded = np.rint(np.ldexp(largest, 8 - exponent))
    exponent = exponent + (rounded > 255)
    mantissa = np.rint(np.ldexp(clean, 8 - exponent))
    out = np.empty((*image.shape[:-1], 4), np.uint8)
    visible = mantissa.max(axis=-1, keepdims=True) > 0
    out[..., :3] = np.where(visible, mantissa, 0)
    out[..., 3:] = np.where(visible, exponent + 128, 0)
    return out


def _exposure(text: bytes, path: object) -> np.float32:
    """The product of all exposures in the header, by which values were multiplied."""
    try:
        factor = math.prod(float(word) for word in text.split())
    except ValueError:
        factor = math.nan
    with np.errstate(over="ignore", under="ignore"):
        exposure = np.float32(factor)
    if not (np.isfinite(exposure) and exposure > 0):
        shown = text[:40].decode("latin-1")
        raise DamagedFileError(f"has the exposure '{shown}'", file=path, remedy=_REMEDY)
    return exposure


def _header(content: bytes, path: object) -> tuple[dict[bytes, bytes], re.Match[bytes], int]:
    end = content.find(b"\n\n")
    size_end = content.find(b"\n", end + 2)
    match = _SIZE.match(content[end + 2 : size_end]) if 0 <= end < size_end else None
    if match is None:
        raise DamagedFileError("has no valid header", file=path, remedy=_REMEDY)
    found: dict[bytes, bytes] = {}
    for line in content[:end].splitlines()[1:]:
        key, equals, value = line.partition(b"=")
        if equals:
            again = found.get(key)
            found[key] = value.strip() if again is None else again + b" " + value.strip()
    return found, match, size_end + 1


def _row(content: bytes, at: int, row: NDArray[np.uint8], path: object) -> int:
    """Decode one row into ``(W, 4)``; returns where the next one starts."""
    width = len(row)
    leader = content[at : at + 4]
    if leader[:2] == b"\x02\x02" and len(leader) == 4 and leader[2] < 128:
        if leader[2] << 8 | leader[3] != width:
            raise DamagedFileError("has rows of different widths", file=path, remedy=_REMEDY)
        at += 4
        for plane in range(4):
            line, at = _unpack(content, at, width, path)
            row[:, plane] = np.frombuffer(line, np.uint8)
        return at
    return _old_row(content, at, row, path)


def _unpack(content: bytes, at: int, width: int, path: object) -> tuple[bytes, int]:
    line = bytearray()
    while len(line) < width:
        if at + 1 >= len(content):
            raise DamagedFileError("ends before its last row", file=path, remedy=_REMEDY)
        count = content[at]
        if count > 128:
            line += content[at + 1 : at + 2] * (count - 128)
            at += 2
        else:
            line += content[at + 1 : at + 1 + count]
            at += 1 + count
            if count == 0 or at > len(content):
                raise DamagedFileError("has an impossible run", file=path, remedy=_REMEDY)
    if len(line) != width:
        raise DamagedFileError("has a run beyond its row", file=path, remedy=_REMEDY)
    return bytes(line), at


def _old_row(content: bytes, at: int, row: NDArray[np.uint8], path: object) -> int:
    """Plain pixels, where (1, 1, 1, n) repeats the last one; n of several such in a row shift."""
    filled, shift = 0, 0
    while filled < len(row):
        pixel = content[at : at + 4]
        if len(pixel) < 4:
            raise DamagedFileError("ends before its last row", file=path, remedy=_REMEDY)
        at += 4
        if pixel[:3] == b"\x01\x01\x01" and filled:
            count = min(pixel[3] << shift, len(row) - filled)
            row[filled : filled + count] = row[filled - 1]
            filled += count
            shift = min(shift + 8, 24)
        else:
            row[filled] = np.frombuffer(pixel, np.uint8)
            filled += 1
            shift = 0
    return at


def _pack(line: NDArray[np.uint8]) -> bytes:
    """One plane of a row, run-length coded: runs of four or more, the rest copied."""
    edges = np.flatnonzero(np.diff(line)) + 1
    starts = np.concatenate([[0], edges])
    lengths = np.diff(np.concatenate([starts, [len(line)]]))
    out = bytearray()
    plain = 0  # first byte not written yet
    for start, length in zip(starts[lengths >= 4].tolist(), lengths[lengths >= 4].tolist(),
                             strict=True):  # fmt: skip
        _copy_out(out, line, plain, start)
        plain = start + length
        while length:
            count = min(length, 127)
            out += bytes([128 + count, int(line[start])])
            length -= count
    _copy_out(out, line, plain, len(line))
    return bytes(out)


def _copy_out(out: bytearray, line: NDArray[np.uint8], start: int, end: int) -> None:
    for at in range(start, end, 128):
        piece = line[at : min(at + 128, end)].tobytes()
        out.append(len(piece))
        out += piece
