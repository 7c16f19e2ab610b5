"""Whole EXR files, read and written by OpenEXR's own module: nothing is copied on the way.

Reading: the module opens the file that `Container` holds open and has checked (headers, tables and
leaders of all chunks), by a name that means the open file, so that it cannot be another one by now.
Only headers whose attributes are all of known types and sound get that far.

Writing: the module packs straight into the file that is being written. Its own header is stretched
with an attribute to the length of ours, which then takes its place; so the offsets are right.

Both return nothing where that is not possible or fails; then `lambent.frame.exr.pixels` does the
work in runs of chunks, and says what is wrong.
"""

from __future__ import annotations

import dataclasses
import io
import os
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lambent.frame.exr.header import Container, PartHeader
from lambent.frame.exr.module import module, name_of, parts_of, threads
from lambent.frame.exr.pixels import Arrays, module_part, safe_names, tile_size
from lambent.frame.exr.values import COMPRESSIONS, well_formed

#: Compressions that the module can neither read nor write by itself without printing remarks.
_NOT_HERE = ("htj2k256", "htj2k32", "lj2k")
#: A text attribute of one letter takes as many bytes, and then those of its text.
_SHORTEST = len(b"~\0string\0") + 4


def readable(container: Container) -> bool:
    """Whether the module can read this file by itself, if its pixels are sound."""
    if container.rebuilt:
        return False  # the module would go by the file's own offset table
    return container.open_name is not None and all(_plain(part) for part in container.parts)


def read_whole(container: Container) -> list[Arrays] | None:
    """Every channel of every part in its own type and sampled size, or None."""
    if not readable(container):
        return None
    found, _ = parts_of(container.open_name, threads(), container.path)
    if len(found) != len(container.parts):
        return None
    whole = []
    for part, made in zip(container.parts, found, strict=True):
        channels, arrays = made.channels, {}
        for info in part.channels:
            channel = channels.get(info.name)
            size = (part.height // info.y_sampling, part.width // info.x_sampling)
            if (
                channel is None
                or channel.pixels.dtype != info.dtype
                or channel.pixels.shape != size
            ):
                return None
            arrays[info.name] = channel.pixels
        whole.append(arrays)
    return whole


def _plain(part: PartHeader) -> bool:
    """Whether the module may see this header."""
    if len(part.levels) > 1 or COMPRESSIONS[part.compression] in _NOT_HERE:
        return False
    if part.tiles and tile_size(part, part.levels[0]) != (part.tiles.width, part.tiles.height):
        return False  # the module would take memory for the whole tile
    if not all(well_formed(a.kind, a.raw) for a in part.attributes):
        return False
    return safe_names(part) == [info.name for info in part.channels]


def write_whole(
    out: BinaryIO, start: bytes, part: PartHeader, arrays: Mapping[str, NDArray[Any]]
) -> bool:
    """Write a file of one part, whose bytes up to the offset table are ``start``; whether it went.

    ``out`` is empty, open for reading and writing. ``arrays``: every channel, in its own type.
    """
    place = name_of(out.fileno())
    if place is None or part.sampled or len(part.levels) > 1:
        return False
    if COMPRESSIONS[part.compression] in _NOT_HERE:
        return False
    made = module_part(part, arrays, 0)
    if part.upwards:
        made.header["lineOrder"] = module().LineOrder.DECREASING_Y
    missing = len(start) - _header_length(part)
    if missing and missing < _SHORTEST:
        return False
    if missing:
        made.header["~"] = "." * (missing - _SHORTEST)
    with suppress(Exception):  # the module raises many kinds; the way in chunks tells the reason
        module().File([made]).write(place)
        if _is_sound(out.fileno(), len(start), part):
            os.pwrite(out.fileno(), start, 0)
            out.seek(0, os.SEEK_END)
            return True
    out.truncate(0)
    out.seek(0)
    return False


def _header_length(part: PartHeader) -> int:
    """Bytes up to the offset table in what the module writes: tried with a picture of one pixel."""
    x, y = part.data_window[:2]
    dot = {c.name: np.zeros((1, 1), c.dtype) for c in part.channels}
    small = dataclasses.replace(part, data_window=(x, y, x, y))
    stream = io.BytesIO()
    module().File([module_part(small, dot, 0)], num_threads=0).write(stream)
    return Container(None, stream.getvalue()).header_size


def _is_sound(descriptor: int, table: int, part: PartHeader) -> bool:
    """Whether the offset table lies where it should, and the chunks fill the file to its end."""
    offsets = np.frombuffer(os.pread(descriptor, 8 * part.chunk_count, table), "<u8")
    if len(offsets) != part.chunk_count or int(offsets.min()) != table + offsets.nbytes:
        return False
    last, lead = int(offsets.max()), 20 if part.tiles else 8
    (packed,) = np.frombuffer(os.pread(descriptor, 4, last + lead - 4).ljust(4, b"\0"), "<i4")
    return last + lead + int(packed) == os.fstat(descriptor).st_size
