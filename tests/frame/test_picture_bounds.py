"""Small files that declare much: refused before anything is decoded; the limit can be raised."""

from __future__ import annotations

import io
import lzma
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image

from lambent.errors import DamagedFileError, FileError
from lambent.frame import limits
from lambent.frame.exif import parse, serialise
from lambent.frame.files import read, write
from lambent.frame.ldr import read_image
from lambent.frame.png_chunks import MAGIC, chunk

SIDE = 40_000


def tiff(changes: dict[int, int], image: np.ndarray | None = None, **options) -> bytes:
    """A small TIFF whose tags (LONG) are then others."""
    buffer = io.BytesIO()
    image = np.zeros((16, 16, 3), np.uint8) if image is None else image
    tifffile.imwrite(buffer, image, photometric="rgb", byteorder="<", **options)
    content = buffer.getvalue()
    tree = parse(content)
    tree.update({tag: (4, 1, struct.pack("<I", value)) for tag, value in changes.items()})
    head = content[:4] + struct.pack("<I", len(content)) + content[8:]
    return head + serialise(tree, "<", len(content))


def png(width: int, height: int, bits: int, kind: int, more: bytes = b"") -> bytes:
    """A PNG of zeros, as well packed as can be: its data are complete. ``more``: chunks."""
    step = {0: 1, 2: 3, 3: 1, 6: 4}[kind] * bits // 8
    packer = zlib.compressobj(9)
    row = bytes(1 + width * step)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)
    return MAGIC + chunk(b"IHDR", head) + more + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def jpeg() -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (16, 16)).save(buffer, "JPEG")
    content = bytearray(buffer.getvalue())
    at = content.find(b"\xff\xc0")
    struct.pack_into(">HH", content, at + 5, SIDE, SIDE)
    return bytes(content)


BOMBS = {
    "tiff-size": lambda: tiff({256: SIDE, 257: SIDE, 278: SIDE}, compression="zlib"),
    "tiff-tile": lambda: tiff({322: 1 << 20, 323: 1 << 20}, tile=(16, 16), compression="zlib"),
    "tiff-samples": lambda: tiff({277: 65535, 256: 4096, 257: 4096}),
    "tiff-lzw": lambda: tiff({256: SIDE, 257: SIDE, 278: SIDE, 259: 5}),
    "png-8": lambda: png(25_000, 25_000, 8, 0),
    "png-palette": lambda: png(16_000, 16_000, 8, 3, chunk(b"PLTE", bytes(3))),
    "png-transparent": lambda: png(
        13_000, 13_000, 8, 3, chunk(b"PLTE", bytes(3)) + chunk(b"tRNS", b"\0")
    ),
    "png-16": lambda: png(25_000, 25_000, 16, 0),
    "jpeg": jpeg,
    "hdr": lambda: b"#?RADIANCE\n\n-Y 40000 +X 40000\n" + bytes(100_000),
    "pfm": lambda: b"PF\n40000 40000\n-1.0\n" + bytes(100),
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_within_little_memory(name, tmp_path):
    """In a process of its own, by its peak; what `import` takes is taken off."""
    path = tmp_path / f"bomb.{name.partition('-')[0]}"
    path.write_bytes(BOMBS[name]())
    assert path.stat().st_size < 2_000_000
    code = (
        "import sys, lambent\nfrom lambent.memory import peak\n"
        "import PIL.Image, tifffile\nfrom lambent.errors import FileError\n"
        "before = peak()\n"
        f"try:\n    lambent.read({str(path)!r})\n"
        "except FileError as error:\n    print(error)\n"
        "else:\n    sys.exit('it was accepted')\n"
        "print(peak() - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    *message, grown = done.stdout.splitlines()
    assert str(path) in message[0]
    assert "declares" in message[0]
    assert limits.VARIABLE in done.stdout
    assert int(grown) < 50_000_000


def test_the_limit_can_be_raised_and_lowered(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(png(300, 200, 16, 2))
    monkeypatch.setenv(limits.VARIABLE, "700k")
    with pytest.raises(FileError, match="300x200 pixels with 3 channels") as caught:
        read(path)
    monkeypatch.setenv(limits.VARIABLE, str(caught.value).rpartition("=")[2])
    assert read(path).colour.shape == (200, 300, 3)


def test_larger_than_another_library_allows(tmp_path):
    """Pillow alone would refuse 180 megapixels; here it is the one limit that counts."""
    path = tmp_path / "a.png"
    path.write_bytes(png(15_000, 12_500, 8, 0))
    assert read_image(path).colour.shape == (12_500, 15_000, 1)


def test_sixteen_bits_take_little_more_than_the_picture(tmp_path):
    """A true picture: decoded, it is 72 MB of float32; the way there costs a few times as much."""
    path = tmp_path / "a.png"
    path.write_bytes(png(3000, 2000, 16, 2))
    code = (
        "import lambent, lambent.frame.ldr, lambent.frame.png16, lambent.frame.layer\n"
        "from lambent.memory import peak\n"
        f"before = peak()\nlambent.read({str(path)!r})\nprint(peak() - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 4 * 72_000_000


# --------------------------------------------------------------- incomplete TIFFs


@pytest.mark.parametrize("compression", [None, "zlib", "lzma"])
@pytest.mark.parametrize("tile", [None, (16, 16)])
@pytest.mark.parametrize("how", ["no offset", "no length", "beyond the end", "too few"])
def test_a_tiff_with_missing_pieces_is_refused(compression, tile, how, tmp_path):
    """Other readers show them black."""
    image = np.random.default_rng(0).integers(1, 256, (64, 64, 3)).astype(np.uint8)
    options = {"tile": tile} if tile else {"rowsperstrip": 16}
    path = tmp_path / "a.tif"
    tifffile.imwrite(
        path, image, photometric="rgb", byteorder="<", compression=compression, **options
    )
    assert read(path).colour.min() > 0
    content = path.read_bytes()
    tree = parse(content)
    offsets, counts = (324, 325) if tile else (273, 279)
    tag = offsets if how in ("no offset", "beyond the end", "too few") else counts
    kind, count, values = tree[tag]
    size = {3: 2, 4: 4}[kind]
    if how == "too few":
        tree[tag] = (kind, count - 1, values[:-size])
    else:
        new = 1 << 30 if how == "beyond the end" else 0
        tree[tag] = (
            kind,
            count,
            values[: 2 * size] + struct.pack("<I", new)[:size] + values[3 * size :],
        )
    head = content[:4] + struct.pack("<I", len(content)) + content[8:]
    path.write_bytes(head + serialise(tree, "<", len(content)))
    with pytest.raises(
        DamagedFileError, match=rf"1 of {16 if tile else 4} (strips|tiles) are missing"
    ):
        read(path)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_strip_that_unpacks_to_less_is_refused(bits, tmp_path):
    image = np.full((64, 64, 3), 7, np.uint16 if bits == 16 else np.uint8)
    path = tmp_path / "a.tif"
    tifffile.imwrite(
        path, image, photometric="rgb", byteorder="<", compression="zlib", rowsperstrip=64
    )
    content = path.read_bytes()
    tree = parse(content)
    short = zlib.compress(image[:32].tobytes())
    tree[273] = (4, 1, struct.pack("<I", len(content)))
    tree[279] = (4, 1, struct.pack("<I", len(short)))
    at = len(content) + len(short) + len(short) % 2
    body = (content[:4] + struct.pack("<I", at) + content[8:] + short).ljust(at, b"\0")
    path.write_bytes(body + serialise(tree, "<", at))
    with pytest.raises(DamagedFileError):
        read(path)


@pytest.mark.parametrize("packing", ["zlib", "lzma"])
def test_a_strip_that_unpacks_to_more_is_refused_in_time(packing, tmp_path):
    """The declared size is small; the strip is not."""
    image = np.zeros((16, 16, 3), np.uint8)
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, image, photometric="rgb", byteorder="<", compression=packing)
    content = path.read_bytes()
    tree = parse(content)
    if packing == "zlib":
        packer = zlib.compressobj(9)
        bomb = b"".join(packer.compress(bytes(1 << 24)) for _ in range(140)) + packer.flush()
    else:
        packer = lzma.LZMACompressor()
        bomb = b"".join(packer.compress(bytes(1 << 24)) for _ in range(8)) + packer.flush()
    tree[273] = (4, 1, struct.pack("<I", len(content)))
    tree[279] = (4, 1, struct.pack("<I", len(bomb)))
    at = len(content) + len(bomb) + len(bomb) % 2
    body = (content[:4] + struct.pack("<I", at) + content[8:] + bomb).ljust(at, b"\0")
    path.write_bytes(body + serialise(tree, "<", at))
    with pytest.raises(DamagedFileError, match="unpacks to more than the 768 bytes"):
        read(path)


def test_whole_tiffs_of_other_writers_are_read(tmp_path):
    """Packed, planar, tiled, with a last strip of fewer rows: nothing sound is refused."""
    image = np.random.default_rng(0).integers(0, 256, (50, 70, 3)).astype(np.uint8)
    for n, options in enumerate(
        (
            {"compression": "tiff_lzw"},
            {"compression": "tiff_deflate"},
            {"compression": "packbits"},
            {},
        )
    ):
        Image.fromarray(image).save(tmp_path / f"p{n}.tif", **options)
    tifffile.imwrite(tmp_path / "planar.tif", image.transpose(2, 0, 1), photometric="rgb",
                     planarconfig="separate", rowsperstrip=16)  # fmt: skip
    tifffile.imwrite(tmp_path / "tiled.tif", image, photometric="rgb", tile=(32, 32),
                     compression="zlib")  # fmt: skip
    tifffile.imwrite(tmp_path / "big.tif", image, photometric="rgb", bigtiff=True)
    expected = read(write(tmp_path / "e.png", read(tmp_path / "p3.tif"))).colour
    for path in sorted(tmp_path.glob("*.tif")):
        np.testing.assert_array_equal(read(path).colour, expected, err_msg=path.name)
