"""PNG with 16 bits a channel, which Pillow reads and writes only in grey.

"Portable Network Graphics (PNG) Specification", W3C, third edition, 2025; section 9 has the five
row filters. Undoing them is sequential along both axes: pixels on one anti-diagonal do not depend
on each other, so a whole diagonal is done at once.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.frame.limits import check_declared
from lambent.frame.png_chunks import MAGIC, REMEDY, chunk, chunks

#: Colour type -> channels.
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}


def header(content: bytes, path: object = None) -> tuple[int, int, int, int, int]:
    """Width, height, bits, colour type, interlace. Raises `DamagedFileError`."""
    if content[12:16] != b"IHDR" or len(content) < 33:
        raise DamagedFileError("has no PNG header", file=path, remedy=REMEDY)
    width, height, bits, kind, _, _, interlace = struct.unpack(">IIBBBBB", content[16:29])
    return width, height, bits, kind, interlace


def read_png16(content: bytes, path: object = None) -> NDArray[np.uint16]:
    """``(H, W, C)`` uint16 from the bytes of a 16-bit PNG.

    Raises `FileError` for an interlaced one, `DamagedFileError`.
    """
    width, height, bits, kind, interlace = header(content, path)
    if interlace:
        raise FileError(
            "is an interlaced PNG of 16 bits", file=path, remedy="save it without interlacing"
        )
    if bits != 16 or kind not in _CHANNELS or not width * height:
        raise DamagedFileError("has an impossible PNG header", file=path, remedy=REMEDY)
    channels = _CHANNELS[kind]
    check_declared(width, height, channels, 4, path, stored=len(content))
    step = 2 * channels
    packed = [(name, body) for name, body in chunks(content, path) if name in (b"IDAT", b"tRNS")]
    try:
        unpacker = zlib.decompressobj()
        data = b"".join(body for name, body in packed if name == b"IDAT")
        raw = unpacker.decompress(data, height * (1 + width * step))
    except zlib.error as error:
        raise DamagedFileError(f"cannot be unpacked ({error})", file=path, remedy=REMEDY) from None
    if len(raw) != height * (1 + width * step):
        raise DamagedFileError("ends before its last row", file=path, remedy=REMEDY)
    rows = np.frombuffer(raw, np.uint8).reshape(height, 1 + width * step)
    if rows[:, 0].max() > 4:
        raise DamagedFileError("uses an unknown row filter", file=path, remedy=REMEDY)
    pixels = _unfilter(rows[:, 0], rows[:, 1:].reshape(height, width, step))
    del raw, rows
    values = pixels.view(">u2").astype(np.uint16)
    transparent = next((body for name, body in packed if name == b"tRNS"), b"")
    if channels in (1, 3) and len(transparent) == step:
        clear = (values == np.frombuffer(transparent, ">u2")).all(axis=2, keepdims=True)
        alpha = np.where(clear, 0, 65535).astype(np.uint16)
        values = np.concatenate([values, alpha], axis=2)
    return values


def write_png16(image: NDArray[np.uint16]) -> bytes:
    """The bytes of a PNG from ``(H, W, C)`` uint16, C in 1 to 4."""
    height, width, channels = image.shape
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    step = 2 * channels
    rows = np.ascontiguousarray(image.astype(">u2")).view(np.uint8).reshape(height, width * step)
    left = np.zeros_like(rows)
    left[:, step:] = rows[:, :-step]
    up = np.zeros_like(rows)
    up[1:] = rows[:-1]
    candidates = np.stack([rows, rows - left, rows - up])  # filters 0, 1, 2
    # The usual heuristic: least sum of absolute differences.
    cost = np.abs(candidates.view(np.int8).astype(np.int16)).sum(axis=2, dtype=np.int64)
    best = np.argmin(cost, axis=0)
    filtered = np.empty((height, 1 + width * step), np.uint8)
    filtered[:, 0] = best
    filtered[:, 1:] = candidates[best, np.arange(height)]
    head = struct.pack(">IIBBBBB", width, height, 16, kind, 0, 0, 0)
    return b"".join([
        MAGIC,
        chunk(b"IHDR", head),
        chunk(b"IDAT", zlib.compress(filtered.tobytes(), 6)),
        chunk(b"IEND", b""),
    ])  # fmt: skip


def _unfilter(kinds: NDArray[np.uint8], rows: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Undo the row filters of ``(H, W, bytes)``, one anti-diagonal at a time."""
    height, width, step = rows.shape
    out = np.zeros((height + 1, width + 1, step), np.uint8)
    for diagonal in range(height + width - 1):
        y = np.arange(max(0, diagonal - width + 1), min(height, diagonal + 1))
        x = diagonal - y
        # left, above, above left
        a, b, c = (out[at].astype(np.int16) for at in ((y + 1, x), (y, x + 1), (y, x)))
        k = kinds[y, None]
        pa, pb, pc = np.abs(b - c), np.abs(a - c), np.abs(a + b - 2 * c)
        paeth = np.where((pa <= pb) & (pa <= pc), a, np.where(pb <= pc, b, c))
        guess = np.select([k == 1, k == 2, k == 3, k == 4], [a, b, (a + b) >> 1, paeth], 0)
        out[y + 1, x + 1] = (rows[y, x] + guess) & 255
    return np.ascontiguousarray(out[1:, 1:])
