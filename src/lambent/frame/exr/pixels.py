"""Packed chunks of an EXR part to arrays and back, with OpenEXR's own module as the codec.

Whole files are read and written by the module itself (`lambent.frame.exr.whole`). Everything else
goes in runs of chunks: a band of rows, a part of several, one level of a mip-map. A run is handed
to the module as a little single-part EXR of its own, with a header made here that holds nothing
but what the codec needs. Bands bound the memory; levels, and parts beside damaged ones, become
reachable at all. Uncompressed rows are plain memory and need no codec; sub-sampled channels, which
the module cannot write, are packed with zlib here.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import FileError, OutputError
from lambent.frame.exr.apart import decode_apart
from lambent.frame.exr.header import Container, Level, PartHeader
from lambent.frame.exr.module import enough_memory, memory_file, module, name_of, parts_of, threads
from lambent.frame.exr.values import COMPRESSIONS
from lambent.frame.magic import EXR_MAGIC

Arrays = dict[str, NDArray[Any]]

#: Unpacked bytes of a band: large enough that a band costs little, small against a picture.
BAND_BYTES = 32 << 20
NONE, ZIP = 0, 3
#: Bytes copied at once.
_COPY = 4 << 20
#: Bytes of the longest name that the format allows.
LONGEST_NAME = 255
#: Compressions whose library prints remarks to standard output.
_TALKATIVE = ("htj2k256", "htj2k32", "lj2k")
#: Compressions that unpack at the speed of memory.
_QUICK = ("none", "rle", "zstd")
_CHANNEL_NUMBER = {np.dtype(np.uint32): 0, np.dtype(np.float16): 1, np.dtype(np.float32): 2}


def bands(part: PartHeader, level: Level | None = None) -> Iterator[tuple[int, int]]:
    """Row ranges ``[a, b)`` of a level that start at chunks and are about `BAND_BYTES` large."""
    level = level or part.levels[0]
    row = max(1, level.width * sum(c.dtype.itemsize for c in part.channels))
    step = part.lines
    if part.sampled and part.lines < 2:
        step = int(np.lcm.reduce([c.y_sampling for c in part.channels]))
    elif part.sampled:
        step *= int(np.lcm.reduce([c.y_sampling for c in part.channels]))
    count = max(1, BAND_BYTES // (row * step))
    for a in range(0, level.height, count * step):
        yield a, min(a + count * step, level.height)


# ------------------------------------------------------------------ decoding


def decode_rows(
    container: Container,
    part: PartHeader,
    rows: tuple[int, int] | None = None,
    level: Level | None = None,
    apart: bool = False,
) -> Arrays:
    """All channels of the rows ``[a, b)`` of a level, in their own types and sampled sizes.

    ``rows`` count from the top of the data window and start at a chunk (see `bands`); None means
    all. ``apart``: in a process of its own, as is done anyhow where decoding here fails, for the
    reason (`lambent.frame.exr.apart`). Raises `DamagedFileError` with what OpenEXR said.
    """
    level = level or part.levels[0]
    a, b = rows or (0, level.height)
    chosen = _chunk_range(part, level, a, b)
    if part.compression == NONE and part.tiles is None and not part.sampled:
        return _plain_rows(container, part, chosen, a, b)
    exr = module()
    if COMPRESSIONS[part.compression] != "none" and not _known(exr, part.compression):
        raise FileError(
            f"is packed with {COMPRESSIONS[part.compression].upper()}, which the OpenEXR "
            f"{exr.__version__} installed here does not know",
            file=container.path,
            remedy="pip install --upgrade OpenEXR",
        )
    reason = ""
    if not apart and COMPRESSIONS[part.compression] not in _TALKATIVE:
        with _codec_file(container, part, level, chosen, a, b) as (place, threads):
            found, reason = parts_of(place, threads, container.path)
        if found:
            channels = found[0].channels
            return {
                info.name: channels[safe].pixels
                for info, safe in zip(part.channels, safe_names(part), strict=True)
            }
    head, pieces = _codec_pieces(container, part, level, chosen, a, b)
    packed, more = decode_apart(b"".join([head, *pieces]), container.path)
    if packed is not None:
        return _taken_apart(part, level, b - a, packed)
    reason = more or reason
    if not reason or "MEMORY" in reason:  # which B44 says of damage, too
        with enough_memory(container.path):
            np.empty(2 * part.unpacked, np.uint8)
    reason = reason or "OpenEXR gave no reason"
    container.damaged(f"the pixels cannot be decoded ({reason})", layer=_name(part))


def _taken_apart(part: PartHeader, level: Level, height: int, raw: bytes) -> Arrays:
    """Channels from their bytes, one after the other."""
    found, at = {}, 0
    for channel in part.channels:
        size = (height // channel.y_sampling, level.width // channel.x_sampling)
        count = size[0] * size[1]
        found[channel.name] = np.frombuffer(raw, channel.dtype, count, at).reshape(size)
        at += count * channel.dtype.itemsize
    return found


def _name(part: PartHeader) -> str | None:
    return str(part.values.get("name", "")) or None


def _known(exr: Any, number: int) -> bool:
    return any(int(c) == number for c in exr.Compression.__members__.values())


def _chunk_range(part: PartHeader, level: Level, a: int, b: int) -> slice:
    if part.tiles is None:
        return slice(a // part.lines, -(-b // part.lines))
    columns = -(-level.width // part.tiles.width)
    first, last = a // part.tiles.height, -(-b // part.tiles.height)
    return slice(level.first + first * columns, level.first + last * columns)


def _plain_rows(container: Container, part: PartHeader, chosen: slice, a: int, b: int) -> Arrays:
    """Uncompressed rows: each is its channels one after the other."""
    chunks = container.chunks[part.index]
    start, size = chunks.start[chosen], chunks.size[chosen]
    row = part.width * sum(c.dtype.itemsize for c in part.channels)
    if (size != row).any():
        container.damaged("a row does not have the size that its channels need", layer=_name(part))
    stride = chunks.lead + row
    in_order = bool((np.diff(start) == stride).all())
    found = {c.name: np.empty((len(start), part.width), c.dtype) for c in part.channels}
    step = max(1, _COPY // stride)
    for top in range(0, len(start), step):
        some = start[top : top + step]
        if in_order:
            raw = container.read(int(some[0]), stride * len(some))
        else:
            raw = b"".join([container.read(int(s), stride) for s in some])
        block = np.frombuffer(raw, np.uint8).reshape(len(some), stride)
        at = chunks.lead
        for channel in part.channels:
            end = at + part.width * channel.dtype.itemsize
            found[channel.name][top : top + step].view(np.uint8)[...] = block[:, at:end]
            at = end
    return found


@contextmanager
def _codec_file(
    container: Container, part: PartHeader, level: Level, chosen: slice, a: int, b: int
) -> Iterator[tuple[Any, int]]:
    """The chunks of a band or level as an EXR of their own: what to open, with how many threads.

    On Linux a file in memory, which C code reads by itself; elsewhere, and where unpacking costs
    no more than such a file, a stream, on which threads would only wait for Python's lock.
    """
    quick = COMPRESSIONS[part.compression] in _QUICK
    descriptor = None if quick else memory_file()
    if descriptor is not None:
        with os.fdopen(descriptor, "w+b", buffering=1 << 16) as out:
            written = False
            with suppress(OSError):  # no room, or a limit on the size of files: then as a stream
                head, pieces = _codec_pieces(container, part, level, chosen, a, b)
                out.write(head)
                for piece in pieces:
                    out.write(piece)
                out.flush()
                written = True
            if written:
                yield name_of(descriptor), threads()
                return
            with suppress(OSError):
                out.truncate(0)
    head, pieces = _codec_pieces(container, part, level, chosen, a, b)
    yield io.BytesIO(b"".join([head, *pieces])), 0


def _codec_pieces(
    container: Container, part: PartHeader, level: Level, chosen: slice, a: int, b: int
) -> tuple[bytes, Iterator[bytes]]:
    """Header with offset table, and the chunks; tiles are counted from the band's own corner."""
    chunks = container.chunks[part.index]
    start, size = chunks.start[chosen], chunks.size[chosen]
    skip = 4 if container.multipart else 0
    lead = chunks.lead - skip
    moved = part.tiles is not None and chosen.start > 0
    head = _codec_header(part, level, a, b)
    first = len(head) + 8 * len(start)
    length = size + lead
    span = int(start[-1] + chunks.lead + size[-1] - start[0])
    gap = span - int(size.sum()) - chunks.lead * len(start)
    if not moved and gap == 0 and (np.diff(start) > 0).all():
        # All in one piece, in order: copied as it lies, part numbers included.
        table = first + (start - start[0]) + skip
        whole = (container.read(int(start[0]) + n, min(_COPY, span - n))
                 for n in range(0, span, _COPY))  # fmt: skip
        return head + table.astype("<u8").tobytes(), whole
    table = first + np.concatenate([[0], np.cumsum(length)[:-1]])
    columns = -(-level.width // part.tiles.width) if part.tiles else 1

    def each() -> Iterator[bytes]:
        for n, (at, count) in enumerate(zip(start.tolist(), size.tolist(), strict=True)):
            if moved:
                yield struct.pack("<5i", n % columns, n // columns, 0, 0, count)
                yield container.read(at + chunks.lead, count)
            else:
                yield container.read(at + skip, lead + count)

    return head + table.astype("<u8").tobytes(), each()


def tile_size(part: PartHeader, level: Level) -> tuple[int, int]:
    """Width and height of a level's tiles, none larger than the level: the module takes memory for
    what a header states, though what lies outside the picture is not stored.
    """
    assert part.tiles is not None
    return min(part.tiles.width, level.width), min(part.tiles.height, level.height)


def safe_names(part: PartHeader) -> list[str]:
    """Channel names for the module, which cannot show bytes that are no UTF-8 as text.

    Such bytes are read as Latin-1, in all names alike: that keeps their order, and with it that of
    the pixels in a chunk, and whatever ASCII there is. DWA finds colours by it: ``.R``, ``.G`` and
    ``.B`` behind the same beginning.
    """
    try:
        return [c.raw.decode("utf-8") for c in part.channels]
    except UnicodeDecodeError:
        names = [c.raw.decode("latin-1") for c in part.channels]
    if max(len(name.encode()) for name in names) <= LONGEST_NAME:
        return names
    return [f"c{n:06d}" for n in range(len(names))]


def _codec_header(part: PartHeader, level: Level, a: int, b: int) -> bytes:
    """The header of a single-part EXR that holds rows ``[a, b)`` of a level of the part."""
    names = [name.encode() for name in safe_names(part)]
    channels = b"".join(
        name
        + struct.pack("<xiB3xii", _CHANNEL_NUMBER[c.dtype], c.p_linear, c.x_sampling, c.y_sampling)
        for name, c in zip(names, part.channels, strict=True)
    )
    x, y = part.data_window[0], part.data_window[1] + a
    box = struct.pack("<4i", x, y, x + level.width - 1, y + b - a - 1)
    attributes = [
        (b"channels", b"chlist", channels + b"\0"),
        (b"compression", b"compression", bytes([part.compression])),
        (b"dataWindow", b"box2i", box),
        (b"displayWindow", b"box2i", box),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    ]
    flags = 0x400 if max(map(len, names)) > 31 else 0
    if part.tiles:
        flags |= 0x200
        tiles = struct.pack("<IIB", *tile_size(part, level), 0)
        attributes.append((b"tiles", b"tiledesc", tiles))
    body = b"".join(
        name + b"\0" + kind + b"\0" + struct.pack("<i", len(raw)) + raw
        for name, kind, raw in attributes
    )
    return EXR_MAGIC + struct.pack("<I", 2 | flags) + body + b"\0"


# ------------------------------------------------------------------ encoding


@dataclass(frozen=True)
class Packed:
    """Chunks ready for a file: their bytes in pieces, and the size of each with its leader."""

    pieces: list[Any]
    sizes: NDArray[np.int64]


def encode_rows(
    part: PartHeader, arrays: Mapping[str, NDArray[Any]], first: int, level: Level, multipart: bool
) -> Packed:
    """The chunks (leader and packed pixels, in table order) of rows from ``first`` on.

    ``arrays``: every channel of the part by name, in its own type and sampled size.
    """
    prefix = struct.pack("<i", part.index) if multipart else b""
    if part.tiles is None and not part.sampled and part.compression == NONE:
        return _pack_plain(part, arrays, first, prefix)
    if part.sampled:
        return _pack_sampled(part, arrays, first, prefix)
    content = _little_file(part, arrays, first)
    packed = Container(None, content)
    chunks = packed.chunks[0]
    sizes = chunks.size + chunks.lead
    view = memoryview(content)
    if not multipart and not part.tiles and (np.diff(chunks.start) == sizes[:-1]).all():
        start = int(chunks.start[0])
        return Packed([view[start : start + int(sizes.sum())]], sizes)
    width = next(iter(arrays.values())).shape[1]
    columns = -(-width // part.tiles.width) if part.tiles else 1
    row = first // part.lines
    pieces: list[Any] = []
    for n, (start, size) in enumerate(
        zip(chunks.start.tolist(), chunks.size.tolist(), strict=True)
    ):
        if part.tiles:
            place = (n % columns, row + n // columns, level.lx, level.ly)
            pieces.append(prefix + struct.pack("<5i", *place, size))
        else:
            y = part.data_window[1] + first + n * part.lines
            pieces.append(prefix + struct.pack("<2i", y, size))
        pieces.append(view[start + chunks.lead : start + chunks.lead + size])
    return Packed(pieces, sizes + len(prefix))


def survives(
    part: PartHeader, arrays: Mapping[str, NDArray[Any]], first: int, names: list[str]
) -> bool:
    """Whether these channels come back bit for bit when packed with the part's compression."""
    stream = io.BytesIO(_little_file(part, arrays, first))
    found, _ = parts_of(stream, 0, "(memory)")
    if not found:
        return False
    back = found[0].channels
    safe = dict(zip((c.name for c in part.channels), safe_names(part), strict=True))
    return all(same_bits(arrays[n], back[safe[n]].pixels) for n in names)


def same_bits(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays hold the same bits (NaN and the sign of zero included)."""
    kind = np.dtype(f"u{one.dtype.itemsize}")
    one, other = np.ascontiguousarray(one), np.ascontiguousarray(other)
    return one.dtype == other.dtype and np.array_equal(one.view(kind), other.view(kind))


def module_part(part: PartHeader, arrays: Mapping[str, NDArray[Any]], first: int) -> Any:
    """These rows as a part that the module can write."""
    exr = module()
    height, width = next(iter(arrays.values())).shape
    x, y = part.data_window[0], part.data_window[1] + first
    window = ((x, y), (x + width - 1, y + height - 1))
    header: dict[str, Any] = {
        "compression": exr.Compression(part.compression),
        "type": exr.tiledimage if part.tiles else exr.scanlineimage,
        "dataWindow": window,
        "displayWindow": window,
    }
    level_of_dwa = part.values.get("dwaCompressionLevel")
    if isinstance(level_of_dwa, float):
        header["dwaCompressionLevel"] = level_of_dwa
    if part.tiles:
        tiles = exr.TileDescription()
        tiles.xSize, tiles.ySize = min(part.tiles.width, width), min(part.tiles.height, height)
        header["tiles"] = tiles
    channels = {
        safe: exr.Channel(safe, np.ascontiguousarray(arrays[c.name]), 1, 1, bool(c.p_linear))
        for c, safe in zip(part.channels, safe_names(part), strict=True)
    }
    return exr.Part(header, channels, "")


def _little_file(part: PartHeader, arrays: Mapping[str, NDArray[Any]], first: int) -> bytes:
    """A single-part EXR of these rows, packed by OpenEXR."""
    exr = module()
    parts = [module_part(part, arrays, first)]
    descriptor = memory_file()
    if descriptor is not None:
        # No room, or a limit on the size of files, and the module's many exceptions: as a stream.
        with os.fdopen(descriptor, "rb") as made, suppress(Exception):
            exr.File(parts, num_threads=threads()).write(name_of(descriptor))
            content = made.read()
            Container(None, content)  # raises for a file that was cut off
            return content
    stream = io.BytesIO()
    try:
        exr.File(parts, num_threads=0).write(stream)
    except MemoryError:
        raise
    except Exception as error:  # the module raises many kinds; all mean the same here
        raise OutputError(
            f"OpenEXR cannot pack it with {COMPRESSIONS[part.compression].upper()} ({error})",
            layer=_name(part),
            remedy="render it with another compression (ZIP takes everything)",
        ) from error
    return stream.getvalue()


def _pack_plain(
    part: PartHeader, arrays: Mapping[str, NDArray[Any]], first: int, prefix: bytes
) -> Packed:
    height, width = next(iter(arrays.values())).shape
    row = width * sum(c.dtype.itemsize for c in part.channels)
    lead = len(prefix) + 8
    block = np.empty((height, lead + row), np.uint8)
    leader = np.empty((height, 2), "<i4")
    leader[:, 0] = part.data_window[1] + first + np.arange(height)
    leader[:, 1] = row
    block[:, : len(prefix)] = np.frombuffer(prefix, np.uint8)
    block[:, len(prefix) : lead] = leader.view(np.uint8)
    at = lead
    for channel in part.channels:
        end = at + width * channel.dtype.itemsize
        pixels = np.ascontiguousarray(arrays[channel.name], channel.dtype)
        block[:, at:end] = pixels.view(np.uint8)
        at = end
    return Packed([block.data], np.full(height, lead + row, np.int64))


def _pack_sampled(
    part: PartHeader, arrays: Mapping[str, NDArray[Any]], first: int, prefix: bytes
) -> Packed:
    """Chunks of scan lines whose channels may be sub-sampled, uncompressed or packed with ZIP."""
    assert part.compression in (NONE, ZIP)
    height = max(a.shape[0] * c.y_sampling for c, a in _with_arrays(part, arrays))
    found = []
    for top in range(0, height, part.lines):
        pieces = [
            np.ascontiguousarray(array[line // channel.y_sampling]).tobytes()
            for line in range(top, min(top + part.lines, height))
            for channel, array in _with_arrays(part, arrays)
            if line % channel.y_sampling == 0
        ]
        raw = b"".join(pieces)
        pixels = zip_pack(raw) if part.compression == ZIP else raw
        place = part.data_window[1] + first + top
        found.append(prefix + struct.pack("<2i", place, len(pixels)) + pixels)
    return Packed(list(found), np.array([len(chunk) for chunk in found], np.int64))


def _with_arrays(
    part: PartHeader, arrays: Mapping[str, NDArray[Any]]
) -> list[tuple[Any, NDArray[Any]]]:
    return [(c, arrays[c.name]) for c in part.channels]


def zip_pack(raw: bytes) -> bytes:
    """EXR's ZIP: low and high bytes apart, differences of neighbours, deflate; raw if not smaller.

    The half of the bytes at even places comes first; each difference is stored plus 128.
    """
    source = np.frombuffer(raw, np.uint8)
    split = np.concatenate([source[0::2], source[1::2]])
    split[1:] = split[1:] - split[:-1] + np.uint8(128)
    packed = zlib.compress(split.tobytes(), 4)
    return packed if len(packed) < len(raw) else raw
