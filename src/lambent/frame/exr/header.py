"""The structure of an EXR file: headers, offset tables, chunks. Pixels stay packed.

An EXR file is: magic number, version, one header a part, one table of chunk offsets a part, then
chunks (rows or tiles, packed). "OpenEXR File Layout", Industrial Light & Magic, 2024.

Lambent walks this structure itself and gives OpenEXR only the packing and unpacking of pixels
(`lambent.frame.exr.pixels`), for three reasons. Whatever is not filtered can be copied bit for bit:
the OpenEXR Python module loses opaque attributes and the levels of mip-maps, cannot write
sub-sampled channels, and re-packs lossy compressions. A damaged file is found before a single
pixel is decoded: the module returns no parts for some. And headers made by chance or malice never
reach C code.
"""

from __future__ import annotations

import os
import struct
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, DeepFileError, FileError
from lambent.frame.exr.values import COMPRESSIONS, text_of, value_of
from lambent.frame.exr.walk import walk
from lambent.frame.limits import check_bytes
from lambent.frame.magic import EXR_MAGIC, kind_of
from lambent.frame.opening import open_file

REMEDY = "the file is damaged: copy or render it again"

#: Rows a chunk holds, by compression number (`COMPRESSIONS`).
LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 1)
#: Channel types by number.
DTYPES = (np.dtype(np.uint32), np.dtype(np.float16), np.dtype(np.float32))
#: Attributes that every part needs: name -> (type, size in bytes or None).
_REQUIRED = {
    "channels": ("chlist", None),
    "compression": ("compression", 1),
    "dataWindow": ("box2i", 16),
    "displayWindow": ("box2i", 16),
    "lineOrder": ("lineOrder", 1),
    "pixelAspectRatio": ("float", 4),
    "screenWindowCenter": ("v2f", 8),
    "screenWindowWidth": ("float", 4),
}
_FLAG_TILED, _FLAG_LONG, _FLAG_DEEP, _FLAG_PARTS = 0x200, 0x400, 0x800, 0x1000
#: Beyond this a window is nonsense, and 32-bit sums could wrap.
_LARGEST = 1 << 30


@dataclass(frozen=True)
class Attribute:
    """One attribute as it stands in the header."""

    name: str
    kind: str
    raw: bytes
    at: int  # where the value starts, counted from the start of the part's header


@dataclass(frozen=True)
class ChannelInfo:
    """One entry of the channel list; ``raw`` is the name's bytes."""

    raw: bytes
    dtype: np.dtype[Any]
    p_linear: int
    x_sampling: int
    y_sampling: int

    @property
    def name(self) -> str:
        """The name; bytes that are no UTF-8 survive as surrogates, so that names stay distinct."""
        return self.raw.decode("utf-8", errors="surrogateescape")


@dataclass(frozen=True)
class Tiles:
    """Tile size, levels (0 one, 1 mip-map, 2 rip-map) and how odd level sizes are rounded."""

    width: int
    height: int
    mode: int
    round_up: bool


@dataclass(frozen=True)
class Level:
    """One resolution level: its number in x and y, its size, and its first chunk."""

    lx: int
    ly: int
    width: int
    height: int
    first: int = 0


@dataclass(frozen=True, eq=False)
class PartHeader:
    """The header of one part. Windows are ``(x0, y0, x1, y1)``, inclusive."""

    index: int
    raw: bytes = field(repr=False)
    attributes: tuple[Attribute, ...] = field(repr=False)
    channels: tuple[ChannelInfo, ...]
    compression: int
    data_window: tuple[int, int, int, int]
    display_window: tuple[int, int, int, int]
    tiles: Tiles | None

    @property
    def width(self) -> int:
        """Columns of the data window."""
        return self.data_window[2] - self.data_window[0] + 1

    @property
    def height(self) -> int:
        """Rows of the data window."""
        return self.data_window[3] - self.data_window[1] + 1

    @property
    def lines(self) -> int:
        """Rows in a chunk (of scan lines, or of tiles)."""
        return self.tiles.height if self.tiles else LINES[self.compression]

    @property
    def sampled(self) -> bool:
        """Whether a channel is stored at less than full resolution."""
        return any(c.x_sampling > 1 or c.y_sampling > 1 for c in self.channels)

    @property
    def upwards(self) -> bool:
        """Whether the last rows come first in the file (the line order "decreasing")."""
        return self.values.get("lineOrder") == "decreasing"

    def find(self, name: str) -> Attribute | None:
        """An attribute by name, or None."""
        return next((a for a in self.attributes if a.name == name), None)

    @cached_property
    def unpacked(self) -> int:
        """Bytes of the finest level's pixels."""
        return sum(
            c.dtype.itemsize * (self.width // c.x_sampling) * (self.height // c.y_sampling)
            for c in self.channels
        )

    @cached_property
    def values(self) -> dict[str, Any]:
        """All attributes but the channel list as Python values."""
        return {a.name: value_of(a.kind, a.raw) for a in self.attributes if a.kind != "chlist"}

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """Every resolution level in the order of the offset table."""
        if self.tiles is None:
            return (Level(0, 0, self.width, self.height),)
        tiles, found, first = self.tiles, [], 0
        for lx, ly in _level_numbers(self.width, self.height, tiles):
            level = Level(
                lx,
                ly,
                _level_size(self.width, lx, tiles),
                _level_size(self.height, ly, tiles),
                first,
            )
            found.append(level)
            first += -(-level.width // tiles.width) * -(-level.height // tiles.height)
        return tuple(found)

    @cached_property
    def chunk_count(self) -> int:
        """How many chunks the part consists of."""
        if self.tiles is None:
            return -(-self.height // self.lines)
        last = self.levels[-1]
        columns, rows = -(-last.width // self.tiles.width), -(-last.height // self.tiles.height)
        return last.first + columns * rows


def _level_numbers(width: int, height: int, tiles: Tiles) -> Iterator[tuple[int, int]]:
    def count(size: int) -> int:
        return (size - 1).bit_length() + 1 if tiles.round_up else size.bit_length()

    if tiles.mode == 0:
        yield 0, 0
    elif tiles.mode == 1:
        yield from ((n, n) for n in range(count(max(width, height))))
    else:
        yield from ((x, y) for y in range(count(height)) for x in range(count(width)))


def _level_size(size: int, level: int, tiles: Tiles) -> int:
    return max(1, -((-size) >> level) if tiles.round_up else size >> level)


@dataclass(frozen=True, eq=False)
class Chunks:
    """Where a part's chunks lie: ``start`` of the leader, ``size`` of the packed pixels (int64).

    ``lead`` is the leader's length: part number (multi-part only), coordinates, size.
    """

    start: NDArray[np.int64]
    size: NDArray[np.int64]
    lead: int


class Container:
    """An EXR file opened for reading: its headers and where its chunks are.

    The file stays open as long as this object lives, so that what is decoded later comes from the
    file that was read, even when its name has been given to another one since.
    Raises `FileError`, `DamagedFileError`, `DeepFileError`.
    """

    def __init__(self, path: str | os.PathLike[str] | None, content: bytes | None = None) -> None:
        self.path = Path("(memory)") if path is None else Path(path)
        self._content = content
        if content is None:
            self._fd = open_file(self.path)
            weakref.finalize(self, os.close, self._fd)
            self.size = os.fstat(self._fd).st_size
        else:
            self.size = len(content)
        cursor = _Cursor(self)
        self.version = _version(cursor)
        self.multipart = bool(self.version & _FLAG_PARTS)
        self.parts: tuple[PartHeader, ...] = _headers(cursor, self.version)
        self.header_size = cursor.at
        if content is None:
            self._check_size()
        self.rebuilt = False  # whether `chunks` is not what the file's own table says
        self.chunks: tuple[Chunks, ...] = self._tables(cursor)

    def read(self, at: int, count: int) -> bytes:
        """``count`` bytes from ``at``. Raises `DamagedFileError` if the file ends before."""
        if self._content is not None:
            piece = self._content[at : at + count]
        else:
            try:
                piece = os.pread(self._fd, count, at)
                while len(piece) < count:
                    more = os.pread(self._fd, count - len(piece), at + len(piece))
                    if not more:
                        break
                    piece += more
            except OSError as error:
                raise FileError(f"cannot be read: {error.strerror}", file=self.path) from error
        if len(piece) != count:
            self.damaged(f"the file ends at byte {at + len(piece)} in the middle of its contents")
        return piece

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about the file's structure, one sentence each."""
        if not self.rebuilt:
            return ()
        return (
            "The table of where its pixels lie is empty or wrong; it was made anew from the "
            f"{sum(len(c.start) for c in self.chunks)} pieces of the picture, which are all there.",
        )

    @property
    def open_name(self) -> str | None:
        """A name by which C code can open this very file again, if there is one."""
        if self._content is not None:
            return None
        if os.path.isdir("/proc/self/fd"):
            return f"/proc/self/fd/{self._fd}"
        try:
            same = os.path.samestat(os.stat(self.path), os.fstat(self._fd))
        except OSError:
            return None
        return str(self.path) if same else None

    def damaged(self, what: str, layer: str | None = None) -> NoReturn:
        """Raise `DamagedFileError` with the file's name."""
        raise DamagedFileError(what, file=self.path, layer=layer, remedy=REMEDY)

    def _check_size(self) -> None:
        """Refuse a picture that would take far more memory than its file lets expect."""
        count = len(self.parts)
        what = f"{self.parts[0].width}x{self.parts[0].height} pixels"
        what += f" and {count - 1} more parts" if count > 1 else ""
        declared = sum(part.unpacked for part in self.parts)
        check_bytes(declared, self.path, what=what, stored=self.size)

    def _tables(self, cursor: _Cursor) -> tuple[Chunks, ...]:
        tables = []
        for part in self.parts:
            if part.chunk_count * 8 > self.size - cursor.at:
                self.damaged(f"the file ends in the table of its {part.chunk_count} chunks")
            tables.append(np.frombuffer(cursor.take(part.chunk_count * 8), "<u8"))
        try:
            return self._checked(tables, cursor.at)
        except DamagedFileError:
            return self._rebuilt(tables, cursor.at)

    def _checked(self, tables: list[NDArray[np.uint64]], first: int) -> tuple[Chunks, ...]:
        """The chunks by these tables. Raises `DamagedFileError` unless all are where they say."""
        found = []
        for part, offsets in zip(self.parts, tables, strict=True):
            missing = int((~self._inside(part, offsets, first)).sum())
            if missing:
                self.damaged(
                    f"{missing} of {len(offsets)} pieces of the picture are missing "
                    "(the file ends too early, or its renderer was stopped)"
                )
            start, lead = offsets.astype(np.int64), self._lead(part)
            found.append(Chunks(start, self._leaders(part, start, lead), lead))
        return tuple(found)

    def _rebuilt(self, tables: list[NDArray[np.uint64]], first: int) -> tuple[Chunks, ...]:
        """The chunks where a table is empty or wrong: looked for one after the other."""
        places = [coordinates(part) for part in self.parts]
        walked = walk(self.read, first, self.size, places, self.multipart)
        if all(table.all() for table in walked):
            chunks = self._checked(walked, first)
        else:  # gaps end the walk; what the table itself has may be right
            mended = [
                np.where(self._inside(part, table, first), table, met)
                for part, table, met in zip(self.parts, tables, walked, strict=True)
            ]
            chunks = self._checked(mended, first)
        self.rebuilt = True
        return chunks

    def _lead(self, part: PartHeader) -> int:
        """Length of the leader of the part's chunks."""
        return (4 if self.multipart else 0) + (20 if part.tiles else 8)

    def _inside(
        self, part: PartHeader, offsets: NDArray[np.uint64], first: int
    ) -> NDArray[np.bool_]:
        """Which offsets lie between the tables and the end of the file."""
        return (offsets >= first) & (offsets <= max(self.size - self._lead(part), 0))

    def _leaders(self, part: PartHeader, start: NDArray[np.int64], lead: int) -> NDArray[np.int64]:
        """The packed sizes, after checking that each chunk is the one it should be."""
        blob = b"".join([self.read(at, lead) for at in start.tolist()])
        fields = np.frombuffer(blob, "<i4").reshape(len(start), lead // 4)
        if self.multipart:
            if (fields[:, 0] != part.index).any():
                self.damaged("a piece of the picture belongs to another part than it should")
            fields = fields[:, 1:]
        if not np.array_equal(fields[:, :-1], coordinates(part)):
            self.damaged("a piece of the picture is not where the file says")
        size = fields[:, -1].astype(np.int64)
        if (size < 0).any() or (start + lead + size > self.size).any():
            self.damaged("the file ends in the middle of the picture")
        return size


def coordinates(part: PartHeader) -> NDArray[np.int32]:
    """What the chunks' leaders must say: ``(n, 1)`` first rows, or ``(n, 4)`` tile and level."""
    if part.tiles is None:
        first = part.data_window[1] + np.arange(part.chunk_count, dtype=np.int64) * part.lines
        return first.astype(np.int32)[:, None]
    rows = []
    for level in part.levels:
        columns = -(-level.width // part.tiles.width)
        count = columns * -(-level.height // part.tiles.height)
        n = np.arange(count, dtype=np.int32)
        fixed = np.full((2, count), [[level.lx], [level.ly]], np.int32)
        rows.append(np.stack([n % columns, n // columns, *fixed], axis=1))
    return np.concatenate(rows)


# ------------------------------------------------------------------- opening


class _Cursor:
    """Reads a container from its start, growing its buffer as needed."""

    def __init__(self, container: Container) -> None:
        self.container = container
        self.at = 0
        self.buffer = b""

    def take(self, count: int) -> bytes:
        """The next ``count`` bytes."""
        self._have(self.at + count)
        piece = self.buffer[self.at : self.at + count]
        self.at += count
        return piece

    def text(self, longest: int = 255) -> bytes:
        """The next bytes up to a zero, which is skipped."""
        while True:
            end = self.buffer.find(b"\0", self.at, self.at + longest + 1)
            if end >= 0:
                piece = self.buffer[self.at : end]
                self.at = end + 1
                return piece
            if len(self.buffer) > self.at + longest:
                self.container.damaged(f"a name in the header is longer than {longest} letters")
            self._have(min(len(self.buffer) + 1, self.container.size + 1))

    def _have(self, count: int) -> None:
        if count <= len(self.buffer):
            return
        if count > self.container.size:
            self.container.damaged("the file ends in the middle of its header")
        wanted = min(max(count, 4 * len(self.buffer), 65536), self.container.size)
        self.buffer += self.container.read(len(self.buffer), wanted - len(self.buffer))


def _version(cursor: _Cursor) -> int:
    container = cursor.container
    if container.size == 0:
        raise FileError("is empty", file=container.path, remedy="copy or render it again")
    start = container.read(0, min(16, container.size))
    if not start.startswith(EXR_MAGIC):
        if EXR_MAGIC.startswith(start):
            container.damaged("the file ends in the middle of its header")
        kind = kind_of(start)
        raise FileError(
            f"is not an EXR but {kind[1]}" if kind else "is not an EXR",
            file=container.path,
            remedy="give it the ending of what it is" if kind else "name an EXR file",
        )
    cursor.take(4)
    version = int(struct.unpack("<I", cursor.take(4))[0])
    if version & 0xFF != 2:
        raise FileError(
            f"is an EXR of version {version & 0xFF}; Lambent knows version 2", file=container.path
        )
    if version & ~0x1EFF:
        container.damaged("the header has unknown flags")
    return version


# ------------------------------------------------------------------- headers


def _headers(cursor: _Cursor, version: int) -> tuple[PartHeader, ...]:
    parts: list[PartHeader] = []
    while True:
        parts.append(_header(cursor, version, len(parts)))
        if not version & _FLAG_PARTS:
            return tuple(parts)
        cursor._have(cursor.at + 1)
        if cursor.buffer[cursor.at] == 0:
            cursor.take(1)
            return tuple(parts)


def _header(cursor: _Cursor, version: int, index: int) -> PartHeader:
    container, begin = cursor.container, cursor.at
    attributes: dict[str, Attribute] = {}
    while raw_name := cursor.text():
        kind = text_of(cursor.text())
        (size,) = struct.unpack("<i", cursor.take(4))
        if not 0 <= size <= container.size:
            early = "the file ends in the middle of its header: " if size > 0 else ""
            container.damaged(
                f"{early}the attribute '{text_of(raw_name)}' has a size of {size} bytes"
            )
        at = cursor.at - begin
        name = text_of(raw_name)
        if name in attributes:
            container.damaged(f"the header has the attribute '{name}' twice")
        attributes[name] = Attribute(name, kind, cursor.take(size), at)
    _refuse_deep(container, version, attributes)
    for name, (kind, length) in _REQUIRED.items():
        found = attributes.get(name)
        if found is None:
            container.damaged(f"the header of part {index} lacks '{name}'")
        if found.kind != kind or (length is not None and len(found.raw) != length):
            container.damaged(f"the attribute '{name}' is not of type {kind}")
    compression = attributes["compression"].raw[0]
    if compression >= len(COMPRESSIONS):
        raise FileError(
            f"is packed with a compression unknown to Lambent (number {compression})",
            file=container.path,
            remedy="write it with ZIP compression",
        )
    window = _window(container, attributes["dataWindow"])
    part = PartHeader(
        index=index,
        raw=cursor.buffer[begin : cursor.at],
        attributes=tuple(attributes.values()),
        channels=_channels(container, attributes["channels"].raw),
        compression=compression,
        data_window=window,
        display_window=_window(container, attributes["displayWindow"]),
        tiles=_tiles(container, version, attributes),
    )
    _check(container, part)
    return part


def _refuse_deep(container: Container, version: int, attributes: dict[str, Attribute]) -> None:
    kind = attributes["type"].raw if "type" in attributes else b""
    if kind.startswith(b"deep") or (version & _FLAG_DEEP and not version & _FLAG_PARTS):
        raise DeepFileError(
            "is a deep image: its pixels hold lists of samples, which cannot be filtered",
            file=container.path,
            remedy="flatten it first (Nuke: DeepToImage; OpenImageIO: oiiotool --flatten)",
        )


def _window(container: Container, attribute: Attribute) -> tuple[int, int, int, int]:
    x0, y0, x1, y1 = struct.unpack("<4i", attribute.raw)
    if x1 < x0 or y1 < y0 or max(map(abs, (x0, y0, x1, y1))) >= _LARGEST:
        container.damaged(f"the {attribute.name} ({x0}, {y0}) - ({x1}, {y1}) makes no sense")
    return x0, y0, x1, y1


def _channels(container: Container, raw: bytes) -> tuple[ChannelInfo, ...]:
    found: list[ChannelInfo] = []
    at = 0
    while at < len(raw) and raw[at] != 0:
        end = raw.find(b"\0", at)
        if end < 0 or end + 17 > len(raw) or end - at > 255:
            container.damaged("the list of channels is cut off")
        kind, linear, x, y = struct.unpack_from("<iB3xii", raw, end + 1)
        if not 0 <= kind <= 2 or not 1 <= x < _LARGEST or not 1 <= y < _LARGEST:
            container.damaged(f"the channel '{text_of(raw[at:end])}' has an impossible type")
        found.append(ChannelInfo(raw[at:end], DTYPES[kind], linear, x, y))
        at = end + 17
    names = [c.raw for c in found]
    if not found or at != len(raw) - 1:
        container.damaged("the list of channels is empty or cut off")
    if names != sorted(set(names)):
        container.damaged("the channels are not in alphabetical order, as the format demands")
    return tuple(found)


def _tiles(container: Container, version: int, attributes: dict[str, Attribute]) -> Tiles | None:
    kind = attributes["type"].raw if "type" in attributes else b""
    if version & _FLAG_PARTS and kind not in (b"scanlineimage", b"tiledimage"):
        container.damaged(f"a part is of the unknown type '{text_of(kind)}'")
    tiled = kind == b"tiledimage" if version & _FLAG_PARTS else bool(version & _FLAG_TILED)
    if not tiled:
        return None
    found = attributes.get("tiles")
    if found is None or found.kind != "tiledesc" or len(found.raw) != 9:
        container.damaged("a tiled picture lacks the description of its tiles")
    width, height, mode = struct.unpack("<IIB", found.raw)
    if not 0 < width < _LARGEST or not 0 < height < _LARGEST or mode & 15 > 2 or mode >> 4 > 1:
        container.damaged(f"tiles of {width}x{height}, mode {mode}, make no sense")
    return Tiles(width, height, mode & 15, bool(mode >> 4))


def _check(container: Container, part: PartHeader) -> None:
    x0, y0, _, _ = part.data_window
    for channel in part.channels:
        x, y = channel.x_sampling, channel.y_sampling
        if (x, y) == (1, 1):
            continue
        if part.tiles or x0 % x or y0 % y or part.width % x or part.height % y:
            container.damaged(f"the channel '{channel.name}' cannot be sub-sampled {x}x{y} here")
    # The format counts bytes of a chunk in 31 bits.
    rows = min(part.lines, part.height)
    columns = min(part.tiles.width, part.width) if part.tiles else part.width
    if rows * columns * sum(c.dtype.itemsize for c in part.channels) >= 1 << 31:
        container.damaged(f"pieces of {columns}x{rows} pixels are larger than the format allows")
    if part.tiles is None and part.chunk_count * 8 > container.size:
        container.damaged(f"the file is too short for {part.height} rows")
    if part.tiles:
        across = -(-part.width // part.tiles.width) * -(-part.height // part.tiles.height)
        if across * 8 > container.size:
            container.damaged(f"the file is too short for {across} tiles")
    count = part.find("chunkCount")
    if container.version & _FLAG_PARTS and count is not None and len(count.raw) == 4:
        stated = struct.unpack("<i", count.raw)[0]
        if stated != part.chunk_count:
            container.damaged(f"the header counts {stated} chunks, not {part.chunk_count}")
