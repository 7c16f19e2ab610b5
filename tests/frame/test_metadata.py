"""What stands beside the pixels of a picture is kept or applied; what cannot be is named."""

from __future__ import annotations

import io
import struct
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms, ImageOps

from lambent.denoise.files import denoise_file
from lambent.frame import exif
from lambent.frame.files import read, write, write_noted
from lambent.frame.png16 import write_png16
from lambent.frame.png_chunks import chunk, chunks

ENDINGS = ("png", "jpg", "tif")
XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description '
    b'tiff:Orientation="6" dc:title="Kitchen"/></x:xmpmeta>'
)


@cache
def profile(name: str = "XYZ") -> bytes:
    """A profile that is not called sRGB. (It holds the time at which it is made.)"""
    return ImageCms.ImageCmsProfile(ImageCms.createProfile(name)).tobytes()


def tags(orientation: int = 1) -> Image.Exif:
    """What a camera writes: its make, its exposure, its place, and how it was held."""
    found = Image.Exif()
    found[271], found[274], found[33432] = "Lambertian", orientation, "A. Nonymous"
    found.get_ifd(34665).update({33434: (1, 60), 37386: 35.0, 36867: "2025:01:02 03:04:05"})
    found.get_ifd(34853).update({1: "N", 2: (48.0, 12.0, 30.0)})
    return found


def pixels(dtype: type = np.uint8) -> np.ndarray:
    """Smooth, without symmetry, and wider than high."""
    y, x = np.mgrid[0:16, 0:24]
    return (
        np.stack([x * 10, y * 15, 255 - x * 5 - y * 5], 2) * (np.iinfo(dtype).max // 255)
    ).astype(dtype)


def make(path: Path, orientation: int = 1, depth: int = 8) -> Path:
    """A picture with everything beside its pixels, made by Pillow or tifffile."""
    block = tags(orientation)
    if depth == 16 and path.suffix == ".png":
        content = write_png16(pixels(np.uint16))
        new = [
            chunk(b"iCCP", b"x\0\0" + zlib.compress(profile())),
            chunk(b"pHYs", struct.pack(">IIB", 11811, 5906, 1)),
            chunk(b"eXIf", block.tobytes()[6:]),
            chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + XMP),
            chunk(b"tEXt", b"Comment\0by hand"),
        ]
        path.write_bytes(content[:33] + b"".join(new) + content[33:])
    elif path.suffix == ".tif":
        raw = block.tobytes()[6:]
        order = exif.order_of(raw)
        tifffile.imwrite(
            path, pixels(np.uint16 if depth == 16 else np.uint8), photometric="rgb",
            byteorder=order, resolution=(300, 150), resolutionunit=2, iccprofile=profile(),
        )  # fmt: skip
        content = path.read_bytes()
        tree = {**exif.parse(content), **exif.parse(raw), 700: (1, len(XMP), XMP)}
        head = content[:4] + struct.pack(f"{order}I", len(content)) + content[8:]
        path.write_bytes(head + exif.serialise(tree, order, len(content)))
    else:
        from PIL import PngImagePlugin

        info = PngImagePlugin.PngInfo()
        info.add_itxt("XML:com.adobe.xmp", XMP.decode())
        info.add_text("Comment", "by hand")
        options = (
            {"pnginfo": info} if path.suffix == ".png" else {"xmp": XMP, "comment": b"by hand"}
        )
        Image.fromarray(pixels()).save(path, exif=block, icc_profile=profile(), dpi=(300, 150),
                                       **options)  # fmt: skip
    return path


def beside(path: Path) -> dict[str, object]:
    """What other readers see in a file."""
    with Image.open(path) if not is_16_bit(path) else Image.open(io.BytesIO(small(path))) as image:
        found = image.getexif()
        xmp = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp")
        if xmp is None and hasattr(image, "tag_v2"):
            xmp = image.tag_v2.get(700)
        return {
            "make": found.get(271),
            "orientation": found.get(274),
            "copyright": found.get(33432),
            "exposure": found.get_ifd(34665).get(36867),
            "place": tuple(map(float, found.get_ifd(34853).get(2, ()))),
            "icc": image.info.get("icc_profile"),
            "xmp": xmp.encode() if isinstance(xmp, str) else xmp,
            "dpi": tuple(round(float(v)) for v in image.info.get("dpi", ())),
        }


def is_16_bit(path: Path) -> bool:
    return path.suffix == ".png" and path.read_bytes()[24] == 16


def small(path: Path) -> bytes:
    """The same chunks beside a PNG of 8 bits, which Pillow reads."""
    buffer = io.BytesIO()
    Image.fromarray(pixels()).save(buffer, "PNG")
    content = buffer.getvalue()
    own = b"".join(
        chunk(name, body)
        for name, body in chunks(path.read_bytes())
        if name not in (b"IHDR", b"IDAT")
    )
    return content[:33] + own + content[33:]


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("result", ENDINGS)
def test_everything_comes_through_a_denoised_picture(ending, result, depth, tmp_path):
    """From every format to every other: profile, EXIF with place and exposure, XMP, resolution."""
    source = make(tmp_path / f"in.{ending}", orientation=6, depth=depth if ending != "jpg" else 8)
    output = tmp_path / f"out.{result}"
    denoise_file(source, output, model="box")
    found = beside(output)
    assert found["make"] == "Lambertian"
    assert found["copyright"] == "A. Nonymous"
    assert found["exposure"] == "2025:01:02 03:04:05"
    assert found["place"] == (48.0, 12.0, 30.0)
    assert found["icc"] == profile()
    assert found["orientation"] in (None, 1)
    assert found["xmp"] == XMP.replace(b'Orientation="6"', b'Orientation="1"')
    assert found["dpi"] == (150, 300), "it was turned by a quarter"
    # What was made can be read, and is not turned again.
    assert read(output).colour.shape == read(source).colour.shape == (24, 16, 3)


@pytest.mark.parametrize("ending", ["png", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied(ending, orientation, tmp_path):
    """As Pillow applies it; and once: the file that is written is upright."""
    source = make(tmp_path / f"in.{ending}", orientation)
    with Image.open(source) as image:
        expected = np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    frame = read(source)
    assert any(f"({orientation})" in note for note in frame.notes) == (orientation != 1)
    for name in ("png", "tif"):
        with Image.open(write(tmp_path / f"out{orientation}.{name}", frame)) as image:
            np.testing.assert_array_equal(
                np.asarray(ImageOps.exif_transpose(image).convert("RGB")), expected
            )
            np.testing.assert_array_equal(np.asarray(image.convert("RGB")), expected)


def test_an_orientation_of_xmp_alone(tmp_path):
    """Where there is no EXIF, XMP tells: as `exif_transpose` has it."""
    content = write_png16(pixels(np.uint16))
    path = tmp_path / "a.png"
    new = chunk(b"iTXt", b"XML:com.adobe.xmp\0\1\0\0\0" + zlib.compress(XMP))
    path.write_bytes(content[:33] + new + content[33:])
    frame = read(path)
    assert frame.colour.shape == (24, 16, 3)
    assert b'Orientation="1"' in frame.origin.payload.metadata.xmp


def test_pixels_pass_through_under_a_profile(tmp_path):
    """The profile is kept, so the integers must be those that it was made for."""
    source = make(tmp_path / "in.png")
    frame = read(source)
    assert any("is kept" in note for note in frame.notes)
    with Image.open(write(tmp_path / "out.png", frame)) as image:
        np.testing.assert_array_equal(np.asarray(image), pixels())
        assert image.info["icc_profile"] == profile()
    srgb = tmp_path / "srgb.png"
    Image.fromarray(pixels()).save(srgb, icc_profile=profile("sRGB"))
    assert not any("profile" in note for note in read(srgb).notes)


def test_the_same_format_keeps_what_no_other_holds(tmp_path):
    """Texts of a PNG, the comment of a JPEG; into another format they are named as left out."""
    for ending in ("png", "jpg"):
        frame = read(make(tmp_path / f"in.{ending}"))
        same = write_noted(tmp_path / f"same.{ending}", frame)
        assert not any("left out" in note for note in same.notes)
        with Image.open(same.path) as image:
            kept = image.info.get("Comment") or image.info.get("comment")
            assert kept in ("by hand", b"by hand")
        other = write_noted(tmp_path / f"other-{ending}.tif", frame)
        assert any("left out" in note for note in other.notes)


@pytest.mark.parametrize("ending", ["exr", "hdr", "pfm"])
def test_formats_that_hold_none_of_it_say_so(ending, tmp_path):
    frame = read(make(tmp_path / "in.jpg"))
    notes = write_noted(tmp_path / f"out.{ending}", frame).notes
    lost = next(note for note in notes if "does not hold" in note)
    for word in ("colour profile", "EXIF", "XMP", "resolution", "comment"):
        assert word in lost


def test_gamma_of_a_png_is_kept_and_told(tmp_path):
    content = write_png16(pixels(np.uint16))
    path = tmp_path / "a.png"
    path.write_bytes(content[:33] + chunk(b"gAMA", struct.pack(">I", 100000)) + content[33:])
    frame = read(path)
    assert any("gamma (1)" in note for note in frame.notes)
    names = [name for name, _ in chunks(write(tmp_path / "b.png", frame).read_bytes())]
    assert b"gAMA" in names
    assert b"sRGB" not in names


def test_the_transparent_colour_of_sixteen_bits(tmp_path):
    from lambent.frame.role import Role

    content = write_png16(pixels(np.uint16))
    key = pixels(np.uint16)[3, 4].astype(">u2").tobytes()
    (tmp_path / "a.png").write_bytes(content[:33] + chunk(b"tRNS", key) + content[33:])
    alpha = read(tmp_path / "a.png")[Role.ALPHA]
    assert alpha[3, 4, 0] == 0
    assert alpha.sum() == alpha.size - 1


def test_a_cmyk_profile_is_applied(tmp_path):
    """No RGB file could keep it. (An RGB profile in its place is one that cannot be applied.)"""
    Image.new("CMYK", (8, 8), (10, 200, 30, 5)).save(tmp_path / "a.jpg", icc_profile=profile())
    frame = read(tmp_path / "a.jpg")
    assert any("CMYK" in note and "unreadable" in note for note in frame.notes)
    assert frame.origin.payload.metadata.icc is None


def test_too_much_for_a_jpeg_is_told(tmp_path):
    long = XMP + b" " * 70000
    content = write_png16(pixels(np.uint16))
    new = chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + long)
    (tmp_path / "a.png").write_bytes(content[:33] + new + content[33:])
    notes = write_noted(tmp_path / "a.jpg", read(tmp_path / "a.png")).notes
    assert any("XMP of 7" in note and "left out" in note for note in notes)


@pytest.mark.parametrize("ending", ENDINGS)
def test_damaged_metadata_is_a_note_or_an_error(ending, tmp_path):
    """Bytes changed in the tags: never anything but our errors; the picture may well be whole."""
    from lambent.errors import FileError

    content = make(tmp_path / f"in.{ending}", 3).read_bytes()
    start = content.find(b"Lambertian") - 120
    rng = np.random.default_rng(0)
    accepted = 0
    for turn in range(120):
        broken = bytearray(content)
        for at in rng.integers(max(start, 33), start + 400, 3):
            broken[at % len(broken)] = rng.integers(256)
        path = tmp_path / f"b.{ending}"
        path.write_bytes(broken)
        try:
            frame = read(path)
        except FileError:
            continue
        accepted += 1
        write(tmp_path / f"c{turn}.{'tif' if turn % 2 else 'jpg'}", frame)
    assert accepted or ending == "png", "PNG has checksums, the others must mostly be readable"


@pytest.mark.parametrize("order", ["<", ">"])
def test_directories_come_back(order):
    """A tree, its block, and what Pillow reads in it."""
    tree: exif.Tree = {
        271: (2, 11, b"Lambertian\0"),
        274: (3, 1, struct.pack(f"{order}H", 6)),
        34665: {36867: (2, 20, b"2025:01:02 03:04:05\0"), 40965: {1: (2, 4, b"R98\0")}},
        34853: {1: (2, 2, b"N\0")},
    }
    block = exif.block_of(tree, order)
    assert exif.parse(block) == tree
    loaded = Image.Exif()
    loaded.load(b"Exif\0\0" + block)
    assert loaded[271] == "Lambertian"
    assert loaded.get_ifd(34665)[36867] == "2025:01:02 03:04:05"
    orientation, straight, _ = exif.upright(block, None)
    assert orientation == 6
    assert exif.upright(straight, None)[0] == 1
    assert len(straight) == len(block)


def test_header_lines_of_an_hdr_are_told(tmp_path):
    from lambent.frame.radiance import write_hdr

    content = write_hdr(np.ones((4, 9, 3), np.float32))
    assert content.count(b"FORMAT=") == 1
    content = content.replace(b"FORMAT=", b"PRIMARIES=0.7 0.3 0.2 0.7 0.1 0.1 0.3 0.3\nFORMAT=")
    (tmp_path / "a.hdr").write_bytes(content)
    assert read(tmp_path / "a.hdr").notes == ("Not used and not kept: PRIMARIES of its header.",)
