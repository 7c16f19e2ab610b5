"""Directories of tags as TIFF has them, which EXIF is made of: read, turned upright, written.

TIFF 6.0, Adobe, 1992, section 2; EXIF 2.32, CIPA, 2019. A *block* is what a JPEG or PNG holds as
EXIF: a TIFF header and directories. Values stay the bytes they are; only offsets are made anew.
"""

from __future__ import annotations

import re
import struct

from numpy.typing import NDArray

#: Type, count, and the bytes of the values.
Entry = tuple[int, int, bytes]
#: A directory: tag to entry, or to the directory that it points to.
Tree = dict[int, "Entry | Tree"]

ORIENTATION = 274
#: Tags that point to another directory: EXIF, GPS, interoperability.
_POINTERS = (34665, 34853, 40965)
#: Bytes of one value, by type.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_XMP = re.compile(rb"(tiff:Orientation\s*(?:=\s*[\"']|>)\s*)([1-8])")


def order_of(block: bytes) -> str:
    """``"<"`` or ``">"``. Raises `ValueError` for what is no (classic) TIFF block."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(block[:4])
    if order is None:
        raise ValueError("no TIFF header")
    return order


def parse(block: bytes) -> Tree:
    """The first directory of a block and those below. Raises `ValueError` for a damaged one."""
    try:
        (at,) = struct.unpack_from(f"{order_of(block)}I", block, 4)
        return _directory(block, order_of(block), at, 0, [len(block)])
    except struct.error as error:
        raise ValueError(str(error)) from None


def serialise(tree: Tree, order: str, base: int = 0) -> bytes:
    """The bytes of a directory and those below, to stand at the (even) offset ``base``."""
    head = bytearray(struct.pack(f"{order}H", len(tree)))
    at = base + 2 + 12 * len(tree) + 4
    tail = bytearray()
    for tag, entry in sorted(tree.items()):
        if isinstance(entry, dict):
            head += struct.pack(f"{order}HHII", tag, 4, 1, at + len(tail))
            tail += serialise(entry, order, at + len(tail))
        else:
            kind, count, value = entry
            head += struct.pack(f"{order}HHI", tag, kind, count)
            if len(value) <= 4:
                head += value.ljust(4, b"\0")
            else:
                head += struct.pack(f"{order}I", at + len(tail))
                tail += value
        tail += b"\0" * (len(tail) % 2)
    return bytes(head + b"\0\0\0\0" + tail)


def block_of(tree: Tree, order: str) -> bytes:
    """A block of one directory and those below."""
    magic = b"II*\0" if order == "<" else b"MM\0*"
    return magic + struct.pack(f"{order}I", 8) + serialise(tree, order, 8)


def upright(block: bytes | None, xmp: bytes | None) -> tuple[int, bytes | None, bytes | None]:
    """The orientation (1 to 8) that EXIF, or else XMP, tells; and both with 1 in its place.

    Nothing else in them changes: makers' notes bear no move. Raises `ValueError` for a damaged
    block.
    """
    found = 0
    if block is not None:
        order = order_of(block)
        try:
            (at,) = struct.unpack_from(f"{order}I", block, 4)
            (count,) = struct.unpack_from(f"{order}H", block, at)
            for entry in range(at + 2, at + 2 + 12 * count, 12):
                tag, kind, _ = struct.unpack_from(f"{order}HHI", block, entry)
                if tag == ORIENTATION and kind in (3, 4):
                    form = f"{order}{'H' if kind == 3 else 'I'}"
                    (found,) = struct.unpack_from(form, block, entry + 8)
                    changed = bytearray(block)
                    struct.pack_into(form, changed, entry + 8, 1)
                    block = bytes(changed)
        except struct.error as error:
            raise ValueError(str(error)) from None
    if xmp is not None and (match := _XMP.search(xmp)) is not None:
        found = found or int(match[2])
        xmp = _XMP.sub(rb"\g<1>1", xmp)
    return (found if 1 <= found <= 8 else 1), block, xmp


def turned(pixels: NDArray, orientation: int) -> NDArray:
    """``(H, W, …)`` as it is looked at, from how it is stored with an orientation of 1 to 8."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


# ------------------------------------------------------------------- private


def _directory(block: bytes, order: str, at: int, depth: int, room: list[int]) -> Tree:
    """One directory. ``room``: how many bytes of values may still come; damage repeats them."""
    tree: Tree = {}
    (count,) = struct.unpack_from(f"{order}H", block, at)
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, number = struct.unpack_from(f"{order}HHI", block, entry)
        (offset,) = struct.unpack_from(f"{order}I", block, entry + 8)
        if tag in _POINTERS and kind in (4, 13) and number == 1:
            if depth < 3:
                tree[tag] = _directory(block, order, offset, depth + 1, room)
            continue
        size = _SIZES.get(kind, 0) * number
        if not size:
            continue  # a type that is not known has no known length
        start = entry + 8 if size <= 4 else offset
        room[0] -= size
        if start + size > len(block) or room[0] < 0:
            raise ValueError(f"the values of tag {tag} lie beyond the end")
        tree[tag] = (kind, number, block[start : start + size])
    return tree
