"""The files of `attack.py`: small sound ones of every kind, and what damage makes of them.

Each function takes a random generator and nothing else that varies: the same seed, the same bytes.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import re
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Rng = np.random.Generator

COMPRESSIONS = [n for n in OpenEXR.Compression.__members__ if not n.startswith("NUM")]
#: Name -> tiled, number of parts, level mode (1 mip, 2 rip), rounding up.
STORAGES = {
    "scanline": (False, 1, 0, False),
    "scanline parts": (False, 2, 0, False),
    "tiled": (True, 1, 0, False),
    "tiled parts": (True, 2, 0, False),
    "mip down": (True, 1, 1, False),
    "mip up": (True, 1, 1, True),
    "rip down": (True, 1, 2, False),
    "rip up": (True, 1, 2, True),
}
ORDERS = ("INCREASING_Y", "DECREASING_Y")
EXTREMES = (0, 1, -1, 2, 255, 65535, 65536, 2**20, 2**28, 2**30, 2**31 - 1, -(2**31), -(2**20))

# ------------------------------------------------------------------- sound EXRs


def planes(rng: Rng, height: int, width: int) -> dict[str, np.ndarray]:
    """Colour with noise, guides, and data that nothing may touch, in all three types."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    wave = np.sin(x / 5) * np.cos(y / 7) + 1.5
    arrays = {n: wave * rng.exponential(1, wave.shape) for n in "RGB"}
    arrays |= {f"albedo.{n}": wave / 3 for n in "RGB"}
    arrays |= {"A": rng.random(wave.shape), "mask.V": rng.random(wave.shape)}
    found = {n: np.ascontiguousarray(a, np.float16) for n, a in arrays.items()}
    depth = (9 * wave + rng.random(wave.shape)).astype(np.float32)
    depth[rng.random(wave.shape) < 0.05] = np.inf
    found["depth.Z"] = depth
    found["id.V"] = rng.integers(0, 2**32, wave.shape, dtype=np.uint32)
    return found


def exr(rng: Rng, compression: str, storage: str, order: str = "INCREASING_Y") -> bytes:
    """A sound EXR of some 20x30 pixels."""
    tiled, parts, mode, up = STORAGES[storage]
    height, width = (int(n) for n in rng.integers(9, 34, 2))
    if mode:
        return _with_levels(rng, compression, order, mode, up, height, width)
    stream = io.BytesIO()
    x, y = (int(n) for n in rng.integers(-20, 20, 2))
    made = [
        OpenEXR.Part(
            {
                **_header(compression, order, tiled),
                "dataWindow": ((x, y), (x + width - 1, y + height - 1)),
                "displayWindow": ((0, 0), (39, 29)),
                "comment": "kept",
            },
            planes(rng, height, width),
            ("beauty", "other")[n] if parts > 1 else "",
        )
        for n in range(parts)
    ]
    OpenEXR.File(made).write(stream)
    return stream.getvalue()


def _header(compression: str, order: str, tiled: bool) -> dict[str, Any]:
    header = {
        "compression": OpenEXR.Compression.__members__[compression],
        "lineOrder": OpenEXR.LineOrder.__members__[order],
        "type": OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage,
    }
    if tiled:
        header["tiles"] = OpenEXR.TileDescription()
        header["tiles"].xSize, header["tiles"].ySize = 8, 8
    return header


def _with_levels(
    rng: Rng, compression: str, order: str, mode: int, up: bool, height: int, width: int
) -> bytes:
    """Mip- and rip-maps, which the module does not write: its single levels put together."""

    def count(n: int) -> int:
        return ((n - 1).bit_length() if up else n.bit_length() - 1) + 1

    def at(n: int, level: int) -> int:
        return max(1, -(-n // 2**level) if up else n // 2**level)

    if mode == 1:
        numbers = [(n, n) for n in range(count(max(height, width)))]
    else:
        numbers = [(x, y) for y in range(count(height)) for x in range(count(width))]
    head, chunks = bytearray(), []
    for lx, ly in numbers:
        stream = io.BytesIO()
        shape = at(height, ly), at(width, lx)
        pixels = planes(rng, *shape)
        OpenEXR.File(_header(compression, order, True), pixels).write(stream)
        raw = stream.getvalue()
        found = {a[0]: a for a in attributes(raw)}
        table = table_start(raw)
        if not head:
            head += raw[:table]
            head[found[b"tiles"][2] + 8] = mode | (16 if up else 0)
        for n in range(-(-shape[0] // 8) * -(-shape[1] // 8)):
            (start,) = struct.unpack_from("<Q", raw, table + 8 * n)
            (size,) = struct.unpack_from("<i", raw, start + 16)
            chunk = bytearray(raw[start : start + 20 + size])
            struct.pack_into("<2i", chunk, 8, lx, ly)
            chunks.append(bytes(chunk))
    places, place = [], len(head) + 8 * len(chunks)
    for chunk in chunks:
        places.append(place)
        place += len(chunk)
    return bytes(head) + struct.pack(f"<{len(places)}Q", *places) + b"".join(chunks)


def attributes(raw: bytes) -> Iterator[tuple[bytes, bytes, int, int]]:
    """Name, type, place and size of each attribute of all headers of a sound file."""
    at, many = 8, bool(raw[5] & 0x10)
    while True:
        if raw[at] == 0:
            at += 1
            if not many or raw[at] == 0:
                return
        end = raw.index(b"\0", at)
        kind = raw.index(b"\0", end + 1)
        (size,) = struct.unpack_from("<i", raw, kind + 1)
        yield raw[at:end], raw[end + 1 : kind], kind + 5, size
        at = kind + 5 + size


def table_start(raw: bytes) -> int:
    """Where the offset tables of a sound file begin."""
    *_, (_, _, at, size) = attributes(raw)
    return at + size + (2 if raw[5] & 0x10 else 1)


# ------------------------------------------------------------------- damaged EXRs


@functools.cache
def seed_exr(compression: str, storage: str) -> bytes:
    """The sound file that mutants come from."""
    return exr(np.random.default_rng(7), compression, storage)


def exr_mutant(rng: Rng) -> bytes:
    raw = seed_exr(pick(rng, COMPRESSIONS), pick(rng, list(STORAGES)))
    content = bytearray(raw)
    for _ in range(rng.integers(1, 4)):
        pick(rng, (_flip, _flip_early, _cut, _slip, _field, _field, _tiles, _table, _chunk))(
            rng, content, raw
        )
    return bytes(content)


def pick(rng: Rng, things: Any) -> Any:
    return things[int(rng.integers(len(things)))]


def _flip(rng: Rng, content: bytearray, raw: bytes) -> None:
    for _ in range(rng.integers(1, 6)):
        if content:
            content[rng.integers(len(content))] = rng.integers(256)


def _flip_early(rng: Rng, content: bytearray, raw: bytes) -> None:
    for _ in range(rng.integers(1, 4)):
        if content:
            content[rng.integers(min(len(content), 900))] ^= 1 << rng.integers(8)


def _cut(rng: Rng, content: bytearray, raw: bytes) -> None:
    del content[rng.integers(len(content) + 1) :]


def _slip(rng: Rng, content: bytearray, raw: bytes) -> None:
    """Some bytes too many or too few, so that all that follows has slipped."""
    at = rng.integers(len(content) + 1)
    if rng.random() < 0.5:
        del content[at : at + rng.integers(1, 9)]
    else:
        content[at:at] = rng.bytes(rng.integers(1, 9))


def _put(content: bytearray, at: int, word: bytes) -> None:
    if at + len(word) <= len(content):
        content[at : at + len(word)] = word


def _number(rng: Rng) -> bytes:
    if rng.random() < 0.15:
        return struct.pack("<f", pick(rng, (np.nan, np.inf, -1.0, 0.0, 1e38)))
    value = pick(rng, EXTREMES) if rng.random() < 0.8 else int(rng.integers(-(2**31), 2**31))
    return struct.pack("<i", value)


def _field(rng: Rng, content: bytearray, raw: bytes) -> None:
    """A number in the header is another: a window, a size, a sampling, a length."""
    _, _, at, size = pick(rng, list(attributes(raw)))
    place = at - 4 if rng.random() < 0.2 or size < 4 else at + 4 * int(rng.integers(size // 4))
    if rng.random() < 0.2 and size:
        content[min(at + int(rng.integers(size)), len(content) - 1) :][:1] = b"\xff"
    _put(content, place, _number(rng))


def _tiles(rng: Rng, content: bytearray, raw: bytes) -> None:
    found = [a for a in attributes(raw) if a[0] == b"tiles"]
    if found:
        at = found[0][2]
        what = rng.integers(3)
        _put(content, at + 4 * int(what), _number(rng) if what < 2 else rng.bytes(1))
    else:
        _field(rng, content, raw)


def _table(rng: Rng, content: bytearray, raw: bytes) -> None:
    table = table_start(raw)
    (first,) = struct.unpack_from("<Q", raw, table)
    count = max(1, (first - table) // 8)
    for _ in range(rng.integers(1, 4)):
        value = pick(
            rng,
            (0, table, first, len(raw), len(raw) - 1, 2**63, 2**64 - 1, int(rng.integers(2**40)),
             int(rng.integers(len(raw))), struct.unpack_from("<Q", raw, table + 8 * int(
                 rng.integers(count)))[0]),
        )  # fmt: skip
        _put(content, table + 8 * int(rng.integers(count)), struct.pack("<Q", value))


def _chunk(rng: Rng, content: bytearray, raw: bytes) -> None:
    """The place or the length that a chunk begins with, or the first bytes of its data."""
    table = table_start(raw)
    (first,) = struct.unpack_from("<Q", raw, table)
    row = int(rng.integers(max(1, (first - table) // 8)))
    (start,) = struct.unpack_from("<Q", raw, table + 8 * row)
    _put(content, start + 4 * int(rng.integers(7)), _number(rng))


# ------------------------------------------------------------------- pictures


@functools.cache
def sound_pictures() -> Mapping[str, bytes]:
    """Name with ending -> a sound picture."""
    import tifffile
    from PIL import Image

    from lambent.frame.png16 import write_png16

    rng = np.random.default_rng(3)
    y, x = np.mgrid[:24, :31]
    smooth = (np.stack([x * 7, y * 9, x + y], 2) % 256).astype(np.uint8)
    rgba = np.concatenate([smooth, rng.integers(0, 256, (24, 31, 1), dtype=np.uint8)], 2)
    wide = rng.integers(0, 65536, (24, 31, 3), dtype=np.uint16)
    real = rng.exponential(2, (24, 31, 3)).astype(np.float32)
    exif = Image.Exif()
    exif[0x0112] = 6  # turned
    exif[0x010F] = "a camera"
    made = {}

    def pillow(name: str, image: Any, kind: str, **options: Any) -> None:
        stream = io.BytesIO()
        image.save(stream, kind, **options)
        made[name] = stream.getvalue()

    def tiff(name: str, array: np.ndarray, **options: Any) -> None:
        stream = io.BytesIO()
        tifffile.imwrite(stream, array, photometric="rgb", **options)
        made[name] = stream.getvalue()

    image = Image.fromarray(smooth)
    pillow("rgb.png", image, "PNG", exif=exif)
    pillow("rgba.png", Image.fromarray(rgba), "PNG", icc_profile=bytes(200))
    pillow("grey.png", image.convert("L"), "PNG")
    pillow("palette.png", image.quantize(16), "PNG")
    made["wide.png"] = write_png16(wide)
    made["wide_rgba.png"] = write_png16(np.concatenate([wide, wide[..., :1]], 2))
    pillow("base.jpg", image, "JPEG", exif=exif, icc_profile=bytes(200))
    pillow("progressive.jpg", image, "JPEG", progressive=True, comment=b"a comment")
    pillow("grey.jpg", image.convert("L"), "JPEG")
    pillow("cmyk.jpg", image.convert("CMYK"), "JPEG")
    tiff("plain.tif", smooth, rowsperstrip=8)
    tiff("zlib.tif", wide, compression="zlib", rowsperstrip=8)
    tiff("tiled.tif", smooth, tile=(16, 16), compression="zlib")
    tiff("float.tif", real, rowsperstrip=8)
    tiff("planar.tif", smooth.transpose(2, 0, 1), planarconfig="separate")
    tiff("big.tif", wide, bigtiff=True)
    tiff("motorola.tif", wide, byteorder=">")
    pillow("lzw.tif", image, "TIFF", compression="tiff_lzw")
    pillow("packbits.tif", image, "TIFF", compression="packbits")
    scale = np.frexp(real.max(2))[1]
    mantissa = np.ldexp(real, 8 - scale[..., None]).clip(0, 255)
    rgbe = np.concatenate([mantissa, scale[..., None] + 128], 2).astype(np.uint8)
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.0\n\n-Y 24 +X 31\n"
    made["flat.hdr"] = head + rgbe.tobytes()
    rows = b"".join(
        b"\2\2\0\37" + b"".join(b"\37" + row[:, c].tobytes() for c in range(4)) for row in rgbe
    )
    made["packed.hdr"] = head + rows
    made["colour.pfm"] = b"PF\n31 24\n-1.0\n" + real[::-1].astype("<f4").tobytes()
    made["grey.pfm"] = b"Pf\n31 24\n2.5\n" + real[::-1, :, 0].astype(">f4").tobytes()
    return made


def picture_mutant(rng: Rng) -> tuple[str, bytes]:
    """Name, content."""
    sound = sound_pictures()
    ending = pick(rng, ("png", "jpg", "tif", "hdr", "pfm"))
    name = pick(rng, [n for n in sound if n.endswith(ending)])
    raw = sound[name]
    content = bytearray(raw)
    for _ in range(rng.integers(1, 4)):
        pick(rng, (_flip, _flip_early, _cut, _slip, _word, _word, _word, _digits))(
            rng, content, raw
        )
    if ending == "png" and rng.random() < 0.6:
        content = _with_sums(content)
    return name, bytes(content)


def _word(rng: Rng, content: bytearray, raw: bytes) -> None:
    """A number near the begin or, for a TIFF, anywhere that a directory may be."""
    reach = len(content) if raw[:2] in (b"II", b"MM") else min(len(content), 300)
    number = struct.unpack("<I", _number(rng))[0]
    big = raw[:2] != b"II"
    size = pick(rng, (2, 4))
    word = (number & (256**size - 1)).to_bytes(size, "big" if big else "little")
    if reach:
        _put(content, int(rng.integers(reach)), word)


def _digits(rng: Rng, content: bytearray, raw: bytes) -> None:
    """A number that is written in digits; where there is none, a byte."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", bytes(content[:120])))
    if raw[:1] not in (b"P", b"#") or not found:
        _flip(rng, content, raw)
        return
    match = pick(rng, found)
    content[match.start() : match.end()] = pick(
        rng,
        (b"0", b"-1", b"1", b"65536", b"2147483647", b"99999999999999999999", b"nan", b"inf",
         b"1e400", b"-0", b"", b"x", b"9" * 5000, b"1_0", "٣".encode()),
    )  # fmt: skip


def _with_sums(content: bytearray) -> bytearray:
    """A PNG whose checksums fit what is in it: damage gets past the first gate."""
    at = 8
    while at + 12 <= len(content):
        (size,) = struct.unpack_from(">I", content, at)
        end = at + 8 + size
        if end + 4 > len(content):
            break
        struct.pack_into(">I", content, end, zlib.crc32(content[at + 4 : end]))
        at = end + 4
    return content


# ------------------------------------------------------------------- archives

VALUES = (
    None, True, 0, -1, 5, 10**9, 2**63, 10**400, 0.5, -1e30, float("nan"), float("inf"), "", "x",
    "../../etc/passwd", "é\x1b[2J", [], [1], ["x"], {}, {"a": 1}, [[[]]], {"a": {"b": []}},
    "9" * 9999,
)  # fmt: skip


def packed_archive(card: Mapping[str, Any], members: Mapping[str, bytes]) -> bytes:
    """An archive whose checksums fit."""
    sums = {n: hashlib.sha256(d).hexdigest() for n, d in members.items()}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("card.json", json.dumps({**card, "sha256": sums}))
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def unpacked_archive(content: bytes) -> tuple[dict[str, Any], dict[str, bytes]]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    return json.loads(members.pop("card.json")), members


@functools.cache
def photo_model() -> bytes:
    """A sound model of a few operations, for photographs."""
    import openvino
    from openvino import opset13 as op

    rng = np.random.default_rng(1)
    pixels = op.parameter(openvino.PartialShape([1, 3, -1, -1]), np.float32)
    weights = (rng.normal(size=(3, 3, 3, 3)) / 9).astype(np.float32)
    layer = op.convolution(pixels, weights, [1, 1], [1, 1], [1, 1], [1, 1])
    graph = openvino.Model([op.add(op.relu(layer), pixels)], [pixels], "x")
    with tempfile.TemporaryDirectory() as folder:
        openvino.save_model(graph, f"{folder}/x.xml", compress_to_fp16=False)
        members = {
            "network.xml": Path(folder, "x.xml").read_bytes(),
            "network.bin": Path(folder, "x.bin").read_bytes(),
        }
    card = {"kind": "model", "format": 1, "reads": "pixels", "inputs": 1, "channels": 3,
            "margin": 4, "name": "x", "options": {"kernel": 5}, "hours": 1.0,
            "score": {"error": 1.0}, "data": [{"name": "x"}], "curve": [[1.0, 2.0]]}  # fmt: skip
    return packed_archive(card, members)


def crafted_model(rng: Rng) -> bytes:
    """Its checksums fit; a value of its card, of its graph or its weights does not."""
    card, members = unpacked_archive(photo_model())
    for _ in range(rng.integers(1, 3)):
        what = rng.integers(4)
        if what == 0:
            _wrong_card(rng, card)
        elif what == 3:
            size = int(rng.integers(len(members["network.bin"]) + 1))
            members["network.bin"] = pick(
                rng, (members["network.bin"][:size], b"\xff" * 324, rng.bytes(324), b"")
            )
        else:
            members["network.xml"] = _wrong_graph(rng, members["network.xml"])
    return packed_archive(card, members)


def _wrong_card(rng: Rng, card: dict[str, Any]) -> None:
    key = pick(rng, [*card, "margin", "channels"])
    if rng.random() < 0.15:
        card.pop(key, None)
    elif isinstance(card.get(key), dict) and card[key] and rng.random() < 0.5:
        card[key] = {**card[key], pick(rng, list(card[key])): pick(rng, VALUES)}
    else:
        card[key] = pick(rng, VALUES)


def _wrong_graph(rng: Rng, xml: bytes) -> bytes:
    """A number, a name of an operation or a line of the network's description is another."""
    what = rng.integers(4)
    if what == 0:
        lines = xml.splitlines(keepends=True)
        del lines[rng.integers(len(lines))]
        return b"".join(lines)
    if what == 1:
        kinds = (b"Tile", b"Loop", b"ReadValue", b"Interpolate", b"NonMaxSuppression", b"Range")
        found = list(re.finditer(rb'type="([A-Z][A-Za-z]+)"', xml))
        word = pick(rng, kinds)
    else:
        found = list(re.finditer(rb'[">](-?\d+)[,"<]', xml))
        word = str(pick(rng, (*EXTREMES, 2**62, -(2**63)))).encode()
    match = pick(rng, found)
    return xml[: match.start(1)] + word + xml[match.end(1) :]


def crafted_solution(rng: Rng, sound: bytes) -> bytes:
    """Its checksums fit; the numbers of an array, its header or the card do not."""
    card, members = unpacked_archive(sound)
    for _ in range(rng.integers(1, 3)):
        if rng.random() < 0.3:
            _wrong_card(rng, card)
            continue
        name = pick(rng, [n for n in members if n.endswith(".npy")])
        members[name] = _wrong_array(rng, members[name])
    return packed_archive(card, members)


def _wrong_array(rng: Rng, content: bytes) -> bytes:
    if rng.random() < 0.25:
        start = 10 + struct.unpack_from("<H", content, 8)[0] if len(content) > 10 else 0
        data = bytearray(content)
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(max(1, start))] = rng.integers(256)
        return bytes(data)
    try:
        array = np.load(io.BytesIO(content))
    except Exception:  # its header was made wrong before: NumPy's parser raises all kinds
        return content
    what = rng.integers(6)
    if what == 0:
        array = array[: len(array) // 2]
    elif what == 1:
        array = array.astype(pick(rng, (np.float64, np.int64, np.uint8, np.bool_)))
    elif what == 2:
        array = array[None]
    elif what == 3:
        array = np.zeros((0, *array.shape[1:]), array.dtype)
    elif array.size:
        array = array.copy()
        flat = array.reshape(-1)
        numbers = (np.nan, np.inf, -1.0, 1e38, 0.0) if array.dtype.kind == "f" else EXTREMES
        for _ in range(rng.integers(1, 4)):
            value = np.asarray(pick(rng, numbers))
            flat[rng.integers(flat.size)] = value.astype(array.dtype)
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()
