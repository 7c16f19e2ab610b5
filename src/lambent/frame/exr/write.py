"""Writing an EXR file again with some channels replaced.

What is not replaced stays:

- parts without a replaced channel, and every header, are copied as they stand, byte for byte;
- in a part with replaced channels the others keep their decoded values bit for bit. Where the
  part's compression would change them at any level (DWAA, DWAB; at times PXR24, B44, B44A), it is
  packed with ZIP instead;
- lower levels of mip- and rip-maps are made anew for the replaced channels, by averaging;
- a part with sub-sampled channels is packed with ZIP: the OpenEXR module cannot write those.

`encode` returns a sentence for each of the latter three, so that nothing changes silently.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
import struct
from collections.abc import Iterable, Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError
from lambent.frame.atomic import atomic
from lambent.frame.exr.file import ExrFile, ExrPart
from lambent.frame.exr.header import Container, Level, PartHeader
from lambent.frame.exr.pixels import (
    NONE,
    ZIP,
    Arrays,
    Packed,
    bands,
    decode_rows,
    encode_rows,
    survives,
)
from lambent.frame.exr.values import COMPRESSIONS
from lambent.frame.exr.whole import write_whole

#: The largest value of a half.
HALF_MAX = 65504.0
#: Compressions that may change values each time they pack: the result is checked.
_LOSSY = {COMPRESSIONS.index(name) for name in ("pxr24", "b44", "b44a", "dwaa", "dwab", "lj2k")}

Replaced = Mapping[tuple[int, str], NDArray[Any]]


def to_type(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Values in another channel type. Halves are clamped to ±65504, never made infinite.

    NaN stays NaN and infinities stay infinite, since they were there before. Unsigned integers
    are rounded and clamped.
    """
    if array.dtype == dtype:
        return array
    if dtype == np.float16:
        clamped = np.clip(array, -HALF_MAX, HALF_MAX)
        if not np.isfinite(array).all():
            clamped = np.where(np.isinf(array), array, clamped)
        return clamped.astype(np.float16)
    if dtype == np.uint32:
        whole = np.rint(np.nan_to_num(np.asarray(array, np.float64), nan=0.0))
        return np.clip(whole, 0, 2**32 - 1).astype(np.uint32)
    return array.astype(dtype)


def beyond_half(plane: NDArray[Any]) -> int:
    """How many finite values a half cannot hold; a few rows at a time, to save memory."""
    count = 0
    for top in range(0, plane.shape[0], 256):
        size = np.abs(plane[top : top + 256])
        count += int(((size > HALF_MAX) & np.isfinite(size)).sum())
    return count


# ------------------------------------------------------------------- writing


def encode(
    path: str | os.PathLike[str],
    exr: ExrFile,
    replaced: Replaced | None = None,
    overwrite: bool = False,
    attributes: Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """Write the file again with some channels replaced, atomically; see the module's docstring.

    ``replaced``: ``(part index, channel name)`` to pixels ``(h, w)`` of the channel's sampled
    size; they are converted to the channel's type (`to_type`). ``attributes``: texts to add to the
    first part's header (one of that name is replaced). Returns what a person should know,
    one sentence each. Raises `LayerError` for a wrong size or an unknown channel, `OutputError`.
    """
    container = exr.container
    assert container is not None, "a file that was not decoded has nothing to be copied from"
    by_part = _by_part(exr, replaced or {})
    notes: list[str] = []
    with atomic(path, overwrite) as out:
        if not by_part and not attributes and not container.rebuilt:
            _copy(container, out, [(0, container.size)])
            return ()
        packs = [_Repack(container, part, by_part.get(part.index, {}), notes) for part in exr.parts]
        packs[0].add(attributes or {})
        magic = _magic(container, attributes or {})
        if len(packs) == 1 and packs[0].write_whole(out, magic):
            return tuple(notes)
        out.write(magic)
        for pack in packs:
            out.write(pack.header)
        if container.multipart:
            out.write(b"\0")
        tables = out.tell()
        out.seek(sum(pack.target.chunk_count for pack in packs) * 8, os.SEEK_CUR)
        offsets = [pack.write(out) for pack in packs]
        out.seek(tables)
        for offset in offsets:
            out.write(offset.astype("<u8").tobytes())
    return tuple(notes)


def _magic(container: Container, attributes: Mapping[str, str]) -> bytes:
    """Magic number and version, with the flag that names longer than 31 bytes need."""
    long_names = any(len(name.encode()) > 31 for name in attributes)
    version = container.version | (0x400 if long_names else 0)
    return container.read(0, 4) + struct.pack("<I", version)


def _by_part(exr: ExrFile, replaced: Replaced) -> dict[int, dict[str, NDArray[Any]]]:
    found: dict[int, dict[str, NDArray[Any]]] = {}
    for (index, name), array in replaced.items():
        if not 0 <= index < len(exr.parts) or name not in exr.parts[index].channels:
            raise LayerError(f"part {index} has no channel '{name}'", file=exr.path, layer=name)
        part = exr.parts[index]
        channel = part.channels[name]
        size = (part.height // channel.y_sampling, part.width // channel.x_sampling)
        if array.shape != size:
            raise LayerError(
                f"has {size[1]}x{size[0]} pixels, the new ones are {array.shape}",
                file=exr.path,
                layer=name,
            )
        found.setdefault(index, {})[name] = array
    return found


def _copy(container: Container, out: BinaryIO, ranges: Iterable[tuple[int, int]]) -> None:
    """Copy byte ranges ``[a, b)`` of the file."""
    for a, b in ranges:
        while a < b:
            count = min(b - a, 8 << 20)
            out.write(container.read(a, count))
            a += count


class _Repack:
    """One part on its way into the new file: copied as it is, or packed anew."""

    def __init__(
        self,
        container: Container,
        of: ExrPart,
        replaced: Mapping[str, NDArray[Any]],
        notes: list[str],
    ) -> None:
        assert of.pixels is not None
        self.container, self.pixels, self.replaced = container, of.pixels, replaced
        part = self.part = of.pixels.packed
        self.target = part
        self.changed: dict[str, bytes] = {}
        if not replaced:
            return
        title = f"part '{part.values.get('name')}'" if "name" in part.values else "the picture"
        kind = COMPRESSIONS[part.compression].upper()
        if part.sampled and part.compression not in (NONE, ZIP):
            self._take(ZIP)
            notes.append(f"{title}: packed with ZIP in place of {kind} (sub-sampled channels)")
        elif part.compression in _LOSSY and not self._keeps_others():
            self._take(ZIP)
            notes.append(
                f"{title}: packed with ZIP in place of {kind}, which would have changed the "
                "channels that were not denoised"
            )
        if len(part.levels) > 1:
            notes.append(
                f"{title}: the smaller levels of {', '.join(replaced)} were made anew by averaging"
            )

    def _take(self, compression: int) -> None:
        """Use another compression, and say so in the header."""
        self.target = dataclasses.replace(self.part, compression=compression)
        self.changed["compression"] = _entry("compression", "compression", bytes([compression]))
        if self.part.find("chunkCount") is not None:
            count = struct.pack("<i", self.target.chunk_count)
            self.changed["chunkCount"] = _entry("chunkCount", "int", count)

    def add(self, attributes: Mapping[str, str]) -> None:
        """Put texts into the header; one of the same name is replaced in its place."""
        for name, text in attributes.items():
            self.changed[name] = _entry(name, "string", text.encode())

    @property
    def header(self) -> bytes:
        """The part's header: every attribute's bytes in their place, changed or not; new ones last.

        Attributes are told apart by where they stand, never by what they hold: one may quote
        another.
        """
        pieces, end = [], 0
        for attribute in self.part.attributes:
            begin, end = end, attribute.at + len(attribute.raw)
            pieces.append(self.changed.get(attribute.name, self.part.raw[begin:end]))
        known = {attribute.name for attribute in self.part.attributes}
        pieces += [entry for name, entry in self.changed.items() if name not in known]
        return b"".join(pieces) + b"\0"

    def _arrays(self, a: int, b: int, level: Level, shrunk: Mapping[str, Any]) -> Arrays:
        """Rows ``[a, b)`` of a level: the others decoded, the replaced ones as given."""
        others = {c.name for c in self.part.channels} - set(shrunk)
        found = {}
        if others and (level.lx, level.ly) == (0, 0) and (self.pixels.kept or self.pixels.small):
            for channel in self.part.channels:
                if channel.name in others:
                    step = channel.y_sampling
                    whole = self.pixels.arrays[channel.name]
                    found[channel.name] = whole[a // step : -(-b // step)]
        elif others:
            decoded = decode_rows(self.container, self.part, (a, b), level)
            found = {name: decoded[name] for name in others}
        for channel in self.part.channels:
            if channel.name in shrunk:
                step = channel.y_sampling
                rows = shrunk[channel.name][a // step : -(-b // step)]
                found[channel.name] = to_type(rows, channel.dtype)
        return found

    def _keeps_others(self) -> bool:
        """Whether packing with the part's own, lossy compression keeps the other channels."""
        others = [c.name for c in self.part.channels if c.name not in self.replaced]
        if not others:
            return True
        check = self._keeps_24_bits
        if COMPRESSIONS[self.part.compression] != "pxr24":
            check = self._keeps_packed
        shrunk: dict[tuple[int, int], dict[str, NDArray[Any]]] = {}
        for level in self.part.levels:
            here = _level_arrays(self.part, level, self.replaced, shrunk)
            if not check(others, level, here):
                return False
        return True

    def _keeps_packed(self, others: list[str], level: Level, replaced: Mapping[str, Any]) -> bool:
        """Whether the others at a level come back from being packed: tried out."""
        # Mostly the first rows tell already.
        first = [(0, min(self.part.lines, level.height))]
        return all(
            survives(self.part, self._arrays(a, b, level, replaced), a, others)
            for a, b in itertools.chain(first, bands(self.part, level))
        )

    def _keeps_24_bits(self, others: list[str], level: Level, replaced: Mapping[str, Any]) -> bool:
        """PXR24 drops the last 8 bits of floats: nothing is lost where they are zero already.

        They are, but for chunks that the file holds unpacked since packing made them no smaller.
        """
        for a, b in bands(self.part, level):
            for name, rows in self._arrays(a, b, level, replaced).items():
                if name not in others or rows.dtype != np.float32:
                    continue
                if (np.ascontiguousarray(rows).view(np.uint32) & 0xFF).any():
                    return False
        return True

    def write_whole(self, out: BinaryIO, magic: bytes) -> bool:
        """Let the module write the whole file at once, where it can and the part is not large."""
        if not self.replaced or self.container.multipart or not self.pixels.small:
            return False
        level = self.part.levels[0]
        arrays = self._arrays(0, level.height, level, self.replaced)
        return write_whole(out, magic + self.header, self.target, arrays)

    def write(self, out: BinaryIO) -> NDArray[np.int64]:
        """Append the part's chunks; returns where each one starts."""
        return self._write_packed(out) if self.replaced else self._write_copy(out)

    def _write_copy(self, out: BinaryIO) -> NDArray[np.int64]:
        """The chunks as they stand, in their order in the file (line order is that order)."""
        chunks = self.container.chunks[self.part.index]
        order = np.argsort(chunks.start, kind="stable")
        start = chunks.start[order]
        length = chunks.size[order] + chunks.lead
        placed = out.tell() + np.concatenate([[0], np.cumsum(length)[:-1]])
        cuts = np.flatnonzero(start[1:] != start[:-1] + length[:-1]) + 1
        edges = [0, *cuts.tolist(), len(start)]
        _copy(
            self.container,
            out,
            [
                (int(start[i]), int(start[j - 1] + length[j - 1]))
                for i, j in itertools.pairwise(edges)
            ],
        )
        offsets = np.empty(len(start), np.int64)
        offsets[order] = placed
        return offsets

    def _write_packed(self, out: BinaryIO) -> NDArray[np.int64]:
        """All chunks anew, in the line order that the header states."""
        part, target = self.part, self.target
        offsets: list[NDArray[np.int64]] = []
        shrunk: dict[tuple[int, int], dict[str, NDArray[Any]]] = {}
        for level in part.levels:
            here = _level_arrays(part, level, self.replaced, shrunk)
            runs = list(bands(target if target.lines > part.lines else part, level))
            columns = -(-level.width // part.tiles.width) if part.tiles else 1
            places = []
            for a, b in reversed(runs) if part.upwards else runs:
                arrays = self._arrays(a, b, level, here)
                packed = encode_rows(target, arrays, a, level, self.container.multipart)
                places.append(append(out, packed, columns if part.upwards else None))
            offsets += reversed(places) if part.upwards else places
        return np.concatenate(offsets)


def _entry(name: str, kind: str, value: bytes) -> bytes:
    """An attribute as it stands in a header."""
    return b"\0".join([name.encode(), kind.encode(), struct.pack("<i", len(value)) + value])


def append(out: BinaryIO, packed: Packed, upwards: int | None = None) -> NDArray[np.int64]:
    """Write chunks at the end; returns where each one starts, in the order of ``packed``.

    ``upwards``: write the last row of chunks first; a row has so many chunks.
    """
    at = out.tell()
    if upwards is None:
        out.writelines(packed.pieces)
        return at + np.cumsum(packed.sizes) - packed.sizes
    whole = memoryview(b"".join(packed.pieces))
    begin = np.cumsum(packed.sizes) - packed.sizes
    order = np.arange(len(begin)).reshape(-1, upwards)[::-1].ravel()
    for start, size in zip(begin[order].tolist(), packed.sizes[order].tolist(), strict=True):
        out.write(whole[start : start + size])
    places = np.empty_like(begin)
    places[order] = at + np.cumsum(packed.sizes[order]) - packed.sizes[order]
    return places


# -------------------------------------------------------------------- levels


def _level_arrays(
    part: PartHeader,
    level: Level,
    replaced: Mapping[str, NDArray[Any]],
    made: dict[tuple[int, int], dict[str, NDArray[Any]]],
) -> Mapping[str, NDArray[Any]]:
    """The replaced channels at a level, averaged from the next finer one."""
    if (level.lx, level.ly) == (0, 0):
        made[0, 0] = dict(replaced)
        return replaced
    assert part.tiles is not None
    if part.tiles.mode == 1:
        finer = made[level.lx - 1, level.ly - 1]
    else:
        finer = made[level.lx - 1, level.ly] if level.lx else made[level.lx, level.ly - 1]
    here = {name: shrink(a, level.height, level.width) for name, a in finer.items()}
    made[level.lx, level.ly] = here
    return here


def shrink(image: NDArray[Any], height: int, width: int) -> NDArray[Any]:
    """``(H, W)`` to a size of about half or all of it, by the mean of the pixels covered.

    Integers (ids) are not averaged: the nearest pixel is taken.
    """
    rows = np.arange(height + 1) * image.shape[0] // height
    columns = np.arange(width + 1) * image.shape[1] // width
    if image.dtype == np.uint32:
        return image[np.ix_(rows[:-1], columns[:-1])]
    wide = np.asarray(image, np.float32)
    wide = np.add.reduceat(wide, rows[:-1], axis=0) / np.diff(rows)[:, None].astype(np.float32)
    wide = np.add.reduceat(wide, columns[:-1], axis=1) / np.diff(columns).astype(np.float32)
    return wide
