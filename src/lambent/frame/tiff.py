"""TIFF: what tifffile reads and writes, what it does not check, and the tags beside the pixels.

tifffile fills strips that are not there with zeros and unpacks without a bound; both are looked at
before. Tags that it does not write (EXIF, GPS) are put into the finished file's directory.
"""

from __future__ import annotations

import io
import lzma
import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.frame import exif, limits
from lambent.frame.metadata import Metadata

_REMEDY = "the file is damaged: copy it again"
_ICC, _XMP, _RESOLUTION = 34675, 700, (282, 283, 296)
#: Tags that say how the pixels are stored, or have a place of their own in `Metadata`.
_STRUCTURE = frozenset(
    {254, 255, *range(256, 267), 273, *range(277, 285), 290, 291, 292, 293, 296, 297, 301, 317, 320}
    | {*range(321, 348), 400, *range(512, 522), 529, 530, 531, 532, 559, _XMP, 32997, 32998}
    | {33421, 33422, _ICC, 37724, 50838, 50839}
)


class NeedsPillowError(Exception):
    """A packing or colour space that tifffile cannot read and Pillow can."""


def read_tiff(content: bytes, path: Path) -> tuple[NDArray[Any], Metadata, tuple[str, ...]]:
    """Pixels ``(H, W)`` or ``(H, W, C)`` as stored, what stands beside them, and notes.

    Raises `FileError`, `DamagedFileError`, and, once sizes and strips have been checked,
    `NeedsPillowError`.
    """
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            page = file.pages[0]
            check_segments(page, content, path)
            several = len(file.pages)
            pixels = _pixels(page, path)
    except (FileError, NeedsPillowError, MemoryError):
        raise
    except Exception as error:  # tifffile raises many kinds for damaged files
        raise DamagedFileError(f"cannot be decoded ({error})", file=path, remedy=_REMEDY) from None
    if pixels.dtype not in (np.uint8, np.uint16, np.float16, np.float32):
        raise FileError(
            f"holds values of type {pixels.dtype}",
            file=path,
            remedy="save it with 8 or 16 bits, or as float",
        )
    metadata, notes = metadata_of(content)
    if several > 1:
        notes = (*notes, f"Only the first of {several} pages was read.")
    return pixels, metadata, notes


def metadata_of(content: bytes) -> tuple[Metadata, tuple[str, ...]]:
    """What a TIFF holds beside its pixels, and a note where that cannot be read."""
    try:
        order, tree = exif.order_of(content), exif.parse(content)
    except ValueError as error:
        return Metadata(kind="tiff"), (f"Its tags cannot be read ({error}): left out.",)

    def value(tag: int) -> bytes | None:
        entry = tree.get(tag)
        return entry[2] if isinstance(entry, tuple) else None

    dpi = None
    unit = int.from_bytes(value(296) or b"", "little" if order == "<" else "big")
    factor = {0: 1.0, 2: 1.0, 3: 2.54}.get(unit, 0.0)
    x, y = (value(tag) for tag in _RESOLUTION[:2])
    if x is not None and y is not None and len(x) == len(y) == 8 and factor:
        pair = [struct.unpack(f"{order}II", each) for each in (x, y)]
        if all(above and below for above, below in pair):
            dpi = (pair[0][0] / pair[0][1] * factor, pair[1][0] / pair[1][1] * factor)
    rest = {tag: entry for tag, entry in tree.items() if tag not in _STRUCTURE}
    block = exif.block_of(rest, order) if rest else None
    return Metadata(value(_ICC), block, value(_XMP), dpi, (), "tiff"), ()


def write_tiff(pixels: NDArray[Any], metadata: Metadata) -> tuple[bytes, tuple[str, ...]]:
    """The bytes of a TIFF of ``(H, W, C)``, packed with zlib, and notes."""
    import tifffile

    notes: tuple[str, ...] = ()
    rest: exif.Tree = {}
    order = "<"
    if metadata.exif is not None:
        try:
            order, rest = exif.order_of(metadata.exif), exif.parse(metadata.exif)
        except ValueError as error:
            notes = (f"Its EXIF cannot be read ({error}): left out.",)
    buffer = io.BytesIO()
    grey, alpha = pixels.shape[2] < 3, pixels.shape[2] in (2, 4)
    tifffile.imwrite(
        buffer,
        pixels[:, :, 0] if pixels.shape[2] == 1 else pixels,
        byteorder=order,
        bigtiff=False,
        photometric="minisblack" if grey else "rgb",
        planarconfig=None if pixels.shape[2] == 1 else "contig",
        extrasamples=["unassalpha"] if alpha else None,
        compression="zlib",
        metadata=None,
        software=False,
        iccprofile=metadata.icc,
        resolution=metadata.dpi,
        resolutionunit=None if metadata.dpi is None else 2,
    )
    content = buffer.getvalue()
    more: exif.Tree = {tag: entry for tag, entry in rest.items() if tag not in _STRUCTURE}
    if metadata.xmp is not None:
        more[_XMP] = (1, len(metadata.xmp), metadata.xmp)
    return (_with_tags(content, more) if more else content), notes


def check_segments(page: Any, content: bytes, path: Path) -> None:
    """Raise `FileError` where a page declares too much, lacks strips or tiles, or unpacks to more.

    ``page``: a tifffile page.
    """
    samples = int(page.samplesperpixel)
    depth = int(page.imagedepth) * (int(page.tiledepth) if page.is_tiled else 1)
    stored = len(content)
    limits.check_declared(
        int(page.imagewidth), int(page.imagelength) * depth, samples, 4, path, stored=stored
    )
    width, rows = int(page.imagewidth), int(page.rowsperstrip or page.imagelength)
    if page.is_tiled:
        width, rows = int(page.tilewidth), int(page.tilelength)
        limits.check_declared(width, rows * depth, samples, 4, path, stored=stored)
    offsets, counts = page.dataoffsets, page.databytecounts
    rows = rows if page.is_tiled else min(rows, int(page.imagelength))
    planes = samples if int(page.planarconfig or 1) == 2 else 1
    across = math.ceil(page.imagewidth / width) if page.is_tiled else 1
    expected = planes * across * math.ceil(page.imagelength / rows) if rows and width else 0
    there = [
        (offset, count)
        for offset, count in zip(offsets, counts, strict=False)
        if offset and count and offset + count <= stored
    ]
    if not expected or len(there) < expected:
        kind = "tiles" if page.is_tiled else "strips"
        raise DamagedFileError(
            f"{max(expected, 1) - len(there)} of {max(expected, 1)} {kind} are missing",
            file=path,
            remedy="the file was not written to its end: copy or render it again",
        )
    # What one strip or tile holds, whole bytes for each value.
    most = width * rows * depth * (samples // planes) * math.ceil(int(page.bitspersample) / 8)
    for offset, count in there[:expected]:
        _check_packed(int(page.compression), content[offset : offset + count], most, path)


# ------------------------------------------------------------------- private


def _pixels(page: Any, path: Path) -> NDArray[Any]:
    if int(page.photometric) not in (0, 1, 2):  # white or black is zero, RGB
        raise NeedsPillowError
    try:
        pixels = np.asarray(page.asarray())
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
        if page.bitspersample != 8:
            raise FileError(
                f"is packed with {page.compression.name}",
                file=path,
                remedy="save it without compression, or pip install imagecodecs",
            ) from None
        raise NeedsPillowError from None
    if page.axes.startswith("S") and pixels.ndim == 3:
        pixels = np.moveaxis(pixels, 0, 2)
    if int(page.photometric) == 0:
        pixels = np.iinfo(pixels.dtype).max - pixels
    return pixels


def _check_packed(compression: int, packed: bytes, most: int, path: Path) -> None:
    """Refuse a strip or tile that unpacks to more than it declares; a part of it is enough."""
    unpacker: Any
    if compression in (8, 32946):
        if len(packed) * 1032 <= limits.DEFAULT:  # the most that zlib packs
            return
        unpacker = zlib.decompressobj()
    elif compression == 34925:
        unpacker = lzma.LZMADecompressor()
    else:
        return
    size, step = 0, 1 << 20
    while size <= most:
        piece = unpacker.decompress(packed, step)
        packed = unpacker.unconsumed_tail if compression != 34925 else b""
        size += len(piece)
        if not piece or unpacker.eof:
            break
    if size > most:
        raise DamagedFileError(
            f"unpacks to more than the {most} bytes that it declares", file=path, remedy=_REMEDY
        )


def _with_tags(content: bytes, more: exif.Tree) -> bytes:
    """A TIFF with more tags: its directory is written anew, at the end."""
    order = exif.order_of(content)
    tree = {**exif.parse(content), **more}
    at = len(content) + len(content) % 2
    head = content[:4] + struct.pack(f"{order}I", at) + content[8:]
    return head.ljust(at, b"\0") + exif.serialise(tree, order, at)
