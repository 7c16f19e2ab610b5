"""PNG, JPEG, TIFF and HDR: values against other readers, depth and alpha kept, damage refused."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lambent.errors import DamagedFileError, FileError, OutputError
from lambent.frame.files import read, write, write_noted
from lambent.frame.frame import Frame
from lambent.frame.png16 import read_png16, write_png16
from lambent.frame.radiance import from_rgbe, read_hdr, to_rgbe, write_hdr
from lambent.frame.role import Role


def ramp(dtype: type, channels: int = 3) -> np.ndarray:
    """Every value of an integer type somewhere, in smooth and in random rows."""
    rng = np.random.default_rng(0)
    top = np.iinfo(dtype).max
    smooth = np.linspace(0, top, 24 * 40 * channels).reshape(24, 40, channels)
    return np.concatenate([smooth, rng.integers(0, top + 1, smooth.shape)]).astype(dtype)


def linear(pixels: np.ndarray) -> np.ndarray:
    """The sRGB transfer undone in double precision: the definition."""
    x = pixels.astype(np.float64) / np.iinfo(pixels.dtype).max
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("ending", ["png", "tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_integers_come_back_exactly(dtype: type, ending: str, alpha: bool, tmp_path: Path) -> None:
    """Read is linear by definition; written again, each integer is the one it was."""
    import tifffile

    pixels = ramp(dtype, 4 if alpha else 3)
    path = tmp_path / f"in.{ending}"
    if ending == "tif":
        tifffile.imwrite(path, pixels, photometric="rgb",
                         extrasamples=["unassalpha"] if alpha else None)  # fmt: skip
    elif dtype == np.uint16:
        path.write_bytes(write_png16(pixels))
    else:
        Image.fromarray(pixels).save(path)
    frame = read(path)
    np.testing.assert_allclose(frame.colour, linear(pixels[..., :3]), atol=3e-7)
    assert frame.has(Role.ALPHA) == alpha
    if alpha:
        expected = pixels[..., 3:] / np.float32(np.iinfo(dtype).max)
        np.testing.assert_allclose(frame[Role.ALPHA], expected, atol=1e-7)
    assert any("linear" in note for note in frame.notes)
    for out_ending in ("png", "tif"):
        out = write(tmp_path / f"out.{out_ending}", frame)
        if out_ending == "tif":
            again = tifffile.imread(out)
        else:
            raw = out.read_bytes()
            again = read_png16(raw) if dtype == np.uint16 else np.asarray(Image.open(out))
        assert again.dtype == dtype
        np.testing.assert_array_equal(again, pixels)


@pytest.mark.heavy
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png16_agrees_with_opencv(channels: int, tmp_path: Path) -> None:
    """The twin reads ours and we read the twin's, which uses other row filters."""
    import cv2

    pixels = ramp(np.uint16, channels)
    np.testing.assert_array_equal(read_png16(write_png16(pixels)), pixels)
    if channels == 2:
        return  # OpenCV has no grey with alpha
    order = {1: [0], 3: [2, 1, 0], 4: [2, 1, 0, 3]}[channels]
    (tmp_path / "ours.png").write_bytes(write_png16(pixels))
    twin = cv2.imread(str(tmp_path / "ours.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(twin.reshape(pixels.shape), pixels[..., order])
    cv2.imwrite(str(tmp_path / "twin.png"), pixels[..., order])
    np.testing.assert_array_equal(read_png16((tmp_path / "twin.png").read_bytes()), pixels)


def paeth_rows(kind: int, pixels: np.ndarray) -> bytes:
    """One PNG row filter applied by the book, pixel by pixel: the slow twin."""
    height, width, step = pixels.shape
    out = bytearray()
    for y in range(height):
        out.append(kind)
        for x in range(width):
            for c in range(step):
                a = int(pixels[y, x - 1, c]) if x else 0
                b = int(pixels[y - 1, x, c]) if y else 0
                d = int(pixels[y - 1, x - 1, c]) if x and y else 0
                p = a + b - d
                near = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - d), 2, d))[2]
                guess = (0, a, b, (a + b) // 2, near)[kind]
                out.append((int(pixels[y, x, c]) - guess) & 255)
    return bytes(out)


@pytest.mark.parametrize("kind", range(5))
def test_png_row_filters(kind: int) -> None:
    from lambent.frame.png16 import _unfilter

    pixels = np.random.default_rng(kind).integers(0, 256, (7, 9, 6), dtype=np.uint8)
    rows = np.frombuffer(paeth_rows(kind, pixels), np.uint8).reshape(7, -1)
    found = _unfilter(rows[:, 0], rows[:, 1:].reshape(7, 9, 6))
    np.testing.assert_array_equal(found, pixels)


def test_float_tiff_is_linear_and_exact(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pixels = (rng.normal(size=(9, 11, 4)) * 1e3).astype(np.float32)
    import tifffile

    tifffile.imwrite(tmp_path / "in.tif", pixels, photometric="rgb", extrasamples=["unassalpha"])
    frame = read(tmp_path / "in.tif")
    np.testing.assert_array_equal(frame.colour, pixels[..., :3])
    assert frame.notes == ()
    out = write(tmp_path / "out.tiff", frame)
    np.testing.assert_array_equal(tifffile.imread(out), pixels)


def test_grey_palette_and_one_pixel(tmp_path: Path) -> None:
    Image.fromarray(ramp(np.uint8)[..., 0]).save(tmp_path / "grey.png")
    frame = read(tmp_path / "grey.png")
    assert frame[Role.COLOUR].shape == (48, 40, 1)
    assert Image.open(write(tmp_path / "grey2.png", frame)).mode == "L"
    Image.fromarray(ramp(np.uint8)).quantize(16).save(tmp_path / "palette.png")
    assert read(tmp_path / "palette.png").colour.shape == (48, 40, 3)
    one = Frame.from_arrays(colour=np.full((1, 1, 3), 0.5, np.float32))
    for ending in ("png", "jpg", "tif", "hdr", "exr"):
        assert read(write(tmp_path / f"one.{ending}", one)).colour.shape == (1, 1, 3)


def test_clipping_is_counted(tmp_path: Path) -> None:
    """Nothing is tone-mapped or clipped silently."""
    colour = np.full((4, 4, 3), 0.5, np.float32)
    colour[0, 0] = (2, -1, np.nan)
    alpha = np.ones((4, 4, 1), np.float32)
    notes = write_noted(tmp_path / "a.jpg", Frame.from_arrays(colour=colour, alpha=alpha)).notes
    assert any("3 of 48 values" in note for note in notes)
    assert any("no alpha" in note for note in notes)
    notes = write_noted(
        tmp_path / "a.hdr", Frame.from_arrays(colour=colour, albedo=colour.clip(0, 1))
    ).notes
    assert any("2 negative" in note for note in notes)
    assert any("albedo left out" in note for note in notes)


# ----------------------------------------------------------------------- HDR


def radiance(width: int = 40) -> np.ndarray:
    rng = np.random.default_rng(1)
    image = (rng.random((12, width, 3)) ** 6 * 5e3).astype(np.float32)
    image[3:5] = image[3, 0]
    image[6] = 0
    image[7, :, 1:] = 0
    return image


@pytest.mark.heavy
@pytest.mark.parametrize("width", [1, 5, 8, 40, 300])
def test_hdr_agrees_with_opencv(width: int, tmp_path: Path) -> None:
    """The twin reads ours to the same values, and we read the twin's."""
    import cv2

    image = radiance(width)
    (tmp_path / "ours.hdr").write_bytes(write_hdr(image))
    ours = read(tmp_path / "ours.hdr").colour
    twin = cv2.imread(str(tmp_path / "ours.hdr"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(ours, twin[..., ::-1])
    cv2.imwrite(str(tmp_path / "twin.hdr"), image[..., ::-1])
    twin = cv2.imread(str(tmp_path / "twin.hdr"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read(tmp_path / "twin.hdr").colour, twin[..., ::-1])


def test_hdr_keeps_eight_bits() -> None:
    """The error is half a step of the brightest channel's mantissa, 1/256 at most."""
    image = radiance()
    found = read_hdr(write_hdr(image))
    assert (np.abs(found - image) <= image.max(-1, keepdims=True) / 256 + 1e-30).all()
    assert write_hdr(found) == write_hdr(read_hdr(write_hdr(found)))


def test_hdr_known_values() -> None:
    """By the definition: mantissa/256 times 2 to the exponent less 128."""
    bytes_ = np.array([[128, 64, 0, 129], [0, 0, 0, 0], [255, 255, 255, 128]], np.uint8)
    expected = [[1, 0.5, 0], [0, 0, 0], [255 / 256] * 3]
    np.testing.assert_array_equal(from_rgbe(bytes_), np.array(expected, np.float32))
    np.testing.assert_array_equal(to_rgbe(from_rgbe(bytes_)), bytes_)
    # Rounding may carry into the exponent.
    assert to_rgbe(np.array([0.9999, 0, 0], np.float32)).tolist() == [128, 0, 0, 129]


def test_hdr_orientations_and_old_runs() -> None:
    pixels = b"".join(bytes([n, n, n, 129]) for n in (10, 20, 30, 40, 50, 60))
    head = b"#?RADIANCE\nEXPOSURE=2\nFORMAT=32-bit_rle_rgbe\n\n"
    step = np.float32(1 / 128 / 2)
    first = [[10, 20, 30], [40, 50, 60]]
    for size, expected in (
        (b"-Y 2 +X 3\n", first),
        (b"+Y 2 +X 3\n", first[::-1]),
        (b"-Y 2 -X 3\n", [[30, 20, 10], [60, 50, 40]]),
        (b"+X 2 -Y 3\n", [[10, 40], [20, 50], [30, 60]]),
    ):
        found = read_hdr(head + size + pixels)
        np.testing.assert_allclose(found[..., 0], np.array(expected) * step)
    old = head + b"-Y 1 +X 300\n" + bytes([9, 9, 9, 129, 1, 1, 1, 43, 1, 1, 1, 1])
    assert (read_hdr(old) == 9 * step).all()


# -------------------------------------------------------------------- damage


@pytest.mark.parametrize(
    ("ending", "bits"), [("png", 8), ("png", 16), ("jpg", 8), ("tif", 8), ("tif", 16), ("hdr", 8)]
)
def test_damaged_pictures(ending: str, bits: int, tmp_path: Path) -> None:
    """Cut off anywhere, or with bytes changed: our error or a picture, nothing else."""
    colour = np.random.default_rng(0).random((20, 21, 3), np.float32)
    path = tmp_path / f"a.{ending}"
    if bits == 16 and ending == "png":
        path.write_bytes(write_png16((colour * 65535).astype(np.uint16)))
    elif bits == 16:
        import tifffile

        tifffile.imwrite(path, (colour * 65535).astype(np.uint16), photometric="rgb")
    else:
        write(path, Frame.from_arrays(colour=colour))
    content = path.read_bytes()
    for end in range(12, len(content) - 40, max(1, len(content) // 40)):
        path.write_bytes(content[:end])
        with pytest.raises(FileError):
            read(path)
    rng = np.random.default_rng(1)
    for _ in range(40):
        broken = bytearray(content)
        for at in rng.integers(4, len(content), 3):
            broken[at] = rng.integers(256)
        path.write_bytes(broken)
        with contextlib.suppress(FileError):
            assert read(path).colour.size > 0


def test_wrong_names_and_kinds(tmp_path: Path) -> None:
    """The content decides, not the ending; what cannot be read is named."""
    Image.fromarray(ramp(np.uint8)).save(tmp_path / "a.exr", "PNG")
    assert read(tmp_path / "a.exr").origin.kind == "png"
    for content, words in ((b"GIF89a" + bytes(20), "GIF"), (b"text file", "text"), (b"", "empty")):
        (tmp_path / "b.png").write_bytes(content)
        with pytest.raises(FileError, match=words):
            read(tmp_path / "b.png")
    frame = read(tmp_path / "a.exr")
    with pytest.raises(OutputError, match=r"\.exr, \.png"):
        write(tmp_path / "a.webp", frame)
    buffer = io.BytesIO()
    Image.fromarray(ramp(np.uint8)).save(buffer, "PNG")
    (tmp_path / "c.png").write_bytes(buffer.getvalue()[:60])
    with pytest.raises(DamagedFileError):
        read(tmp_path / "c.png")


@pytest.mark.parametrize("text", ["1v", "nan", "inf", "0", "-2", "1e-99", "1e400", "2 x"])
def test_an_exposure_that_is_no_factor_is_damage(text: str, tmp_path: Path) -> None:
    head = f"#?RADIANCE\nEXPOSURE={text}\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n".encode()
    (tmp_path / "a.hdr").write_bytes(head + bytes([9, 9, 9, 130]))
    with pytest.raises(DamagedFileError, match="has the exposure"):
        read(tmp_path / "a.hdr")


def test_the_smallest_values_of_an_hdr_come_back() -> None:
    """Every exponent, and mantissas that do not fill their byte where it is the least one."""
    exponents = np.arange(1, 256)[:, None]
    mantissas = np.array([[255, 128, 1], [128, 0, 3]])
    pixels = np.concatenate(
        [np.concatenate([np.tile(m, (255, 1)), exponents], 1) for m in mantissas]
        + [[[n, 0, n // 2, 1] for n in range(1, 256)]]
    ).astype(np.uint8)
    np.testing.assert_array_equal(to_rgbe(from_rgbe(pixels)), pixels)
    assert not to_rgbe(np.zeros((2, 3), np.float32)).any()
