"""PNG, JPEG, TIFF and Radiance HDR: one picture, perhaps with alpha.

Display-referred pictures (PNG, JPEG, integer TIFF) carry the sRGB transfer; inside Lambent colour
is linear, so reading undoes it and writing applies it, each with a note. Floating-point TIFF and
HDR are linear already. Alpha is straight and linear, and stays as it is. What was 16 bits stays
16 bits.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.frame.atomic import atomic
from lambent.frame.layer import FloatImage
from lambent.frame.magic import kind_of
from lambent.frame.tonemap import inverse_srgb, srgb

_REMEDY = "the file is damaged: copy it again"


@dataclass(frozen=True)
class Facts:
    """What is needed to write a picture as it was: bits a channel (8, 16, 32), float or not."""

    bits: int = 8
    floating: bool = False


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture as read: linear ``colour`` ``(H, W, 1 or 3)``, straight ``alpha`` ``(H, W, 1)``."""

    kind: str
    colour: FloatImage
    alpha: FloatImage | None
    facts: Facts
    notes: tuple[str, ...] = ()


def read_image(path: str | os.PathLike[str]) -> Picture:
    """Read a PNG, JPEG, TIFF or HDR. Raises `FileError`, `DamagedFileError`."""
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror}", file=path) from error
    found = kind_of(content[:16])
    readers: dict[str, Callable[[bytes, Path], tuple[NDArray[Any], tuple[str, ...]]]] = {
        "png": _read_png, "jpeg": _read_pillow, "tiff": _read_tiff, "hdr": _read_hdr,
    }  # fmt: skip
    if found is None or found[0] not in readers:
        raise FileError(f"is {found[1] if found else 'no picture'}", file=path)
    pixels, notes = readers[found[0]](content, path)
    return _picture(found[0], pixels, notes, path)


def _picture(kind: str, pixels: NDArray[Any], notes: tuple[str, ...], path: Path) -> Picture:
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or not 1 <= pixels.shape[2] <= 4 or 0 in pixels.shape:
        raise FileError(f"has the shape {pixels.shape}, which is no picture", file=path)
    floating = pixels.dtype.kind == "f"
    bits = pixels.dtype.itemsize * 8
    values = pixels.astype(np.float32)
    if not floating:
        values /= np.float32(2**bits - 1)
    grey = pixels.shape[2] in (1, 2)
    colour, alpha = values[:, :, : 1 if grey else 3], None
    if pixels.shape[2] in (2, 4):
        alpha = np.ascontiguousarray(values[:, :, -1:])
    if not floating:
        colour = inverse_srgb(colour)
        notes = (*notes, f"{bits}-bit sRGB values were made linear.")
    return Picture(
        kind, np.ascontiguousarray(colour, np.float32), alpha, Facts(bits, floating), notes
    )


def _read_png(content: bytes, path: Path) -> tuple[NDArray[Any], tuple[str, ...]]:
    from lambent.frame.png16 import header, read_png16

    if header(content, path)[2] == 16:
        return read_png16(content, path), ()
    return _read_pillow(content, path)


def _read_pillow(content: bytes, path: Path) -> tuple[NDArray[Any], tuple[str, ...]]:
    from PIL import Image, ImageCms

    notes: tuple[str, ...] = ()
    try:
        with Image.open(io.BytesIO(content)) as image:
            image.load()
            if (profile := image.info.get("icc_profile")) is not None:
                try:
                    name = ImageCms.getProfileDescription(
                        ImageCms.ImageCmsProfile(io.BytesIO(profile))
                    ).strip()
                except ImageCms.PyCMSError:
                    name = "unreadable"
                if "srgb" not in name.lower():
                    notes = (f"Its colour profile ({name}) is not used: taken as sRGB.",)
            has_alpha = "A" in image.getbands() or "transparency" in image.info
            grey = image.mode in ("1", "L", "LA", "I;16", "I;16B")
            if not image.mode.startswith("I;16"):
                mode = ("L" if grey else "RGB") + ("A" if has_alpha else "")
                if image.mode == "CMYK":
                    notes = (*notes, "CMYK values were made sRGB without a profile.")
                image = image.convert(mode)
            return np.asarray(image), notes
    except Image.DecompressionBombError as error:
        raise FileError(f"is larger than Pillow allows ({error})", file=path) from None
    except (OSError, SyntaxError, ValueError, EOFError, IndexError) as error:
        raise DamagedFileError(f"cannot be decoded ({error})", file=path, remedy=_REMEDY) from None


def _read_tiff(content: bytes, path: Path) -> tuple[NDArray[Any], tuple[str, ...]]:
    import tifffile

    notes: tuple[str, ...] = ()
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            page = file.pages[0]
            if len(file.pages) > 1:
                notes = (f"Only the first of {len(file.pages)} pages was read.",)
            if int(page.photometric) not in (0, 1, 2):  # white or black is zero, RGB
                return _read_pillow(content, path)
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
                return _read_pillow(content, path)
            if page.axes.startswith("S") and pixels.ndim == 3:
                pixels = np.moveaxis(pixels, 0, 2)
            if int(page.photometric) == 0:
                pixels = np.iinfo(pixels.dtype).max - pixels
    except FileError:
        raise
    except Exception as error:  # tifffile raises many kinds for damaged files
        raise DamagedFileError(f"cannot be decoded ({error})", file=path, remedy=_REMEDY) from None
    if pixels.dtype not in (np.uint8, np.uint16, np.float16, np.float32):
        raise FileError(
            f"holds values of type {pixels.dtype}",
            file=path,
            remedy="save it with 8 or 16 bits, or as float",
        )
    return pixels, notes


def _read_hdr(content: bytes, path: Path) -> tuple[NDArray[Any], tuple[str, ...]]:
    from lambent.frame.radiance import read_hdr

    return read_hdr(content, path), ()


# ------------------------------------------------------------------- writing


def write_image(
    path: str | os.PathLike[str],
    kind: str,
    colour: FloatImage,
    alpha: FloatImage | None,
    facts: Facts | None = None,
    overwrite: bool = False,
) -> tuple[str, ...]:
    """Write linear ``colour`` ``(H, W, 1 or 3)`` and straight ``alpha``; returns notes.

    ``kind``: ``"png"``, ``"jpeg"``, ``"tiff"`` or ``"hdr"``. PNG and TIFF take 16 bits, TIFF
    float, where ``facts`` say so. Nothing is tone-mapped: values beyond [0, 1] are clipped in
    integer formats, and counted in the notes. Raises `OutputError`.
    """
    facts = facts or Facts()
    notes: list[str] = []
    if alpha is not None and kind in ("jpeg", "hdr"):
        notes.append(f"A {kind.upper()} holds no alpha: it was left out.")
        alpha = None
    if kind == "hdr":
        content = _hdr(colour, notes)
    elif kind == "tiff" and facts.floating:
        content = _tiff(_joined(np.asarray(colour), alpha))
    else:
        bits = 16 if facts.bits >= 16 and kind != "jpeg" else 8
        pixels = _display(colour, alpha, bits, notes)
        content = _pack(kind, pixels, bits)
    with atomic(path, overwrite) as out:
        out.write(content)
    return tuple(notes)


def _display(
    colour: FloatImage, alpha: FloatImage | None, bits: int, notes: list[str]
) -> NDArray[Any]:
    """Integers with the sRGB transfer; notes what was clipped."""
    outside = int((~((colour >= 0) & (colour <= 1))).sum())
    notes.append(f"Linear values were written as {bits}-bit sRGB.")
    if outside:
        notes.append(f"{outside} of {colour.size} values lie outside [0, 1] and were clipped.")
    top = np.float32(2**bits - 1)
    parts = srgb(colour)
    if alpha is not None:
        parts = _joined(parts, np.clip(np.nan_to_num(alpha), 0, 1))
    return np.floor(parts * top + np.float32(0.5)).astype(np.uint16 if bits == 16 else np.uint8)


def _joined(colour: NDArray[Any], alpha: FloatImage | None) -> NDArray[Any]:
    return colour if alpha is None else np.concatenate([colour, alpha], axis=2)


def _pack(kind: str, pixels: NDArray[Any], bits: int) -> bytes:
    if kind == "tiff":
        return _tiff(pixels)
    if bits == 16:
        from lambent.frame.png16 import write_png16

        return write_png16(pixels)
    from PIL import Image

    buffer = io.BytesIO()
    image = Image.fromarray(pixels[:, :, 0] if pixels.shape[2] == 1 else pixels)
    if kind == "jpeg":
        image.save(buffer, "JPEG", quality=95, subsampling=0)
    else:
        image.save(buffer, "PNG")
    return buffer.getvalue()


def _tiff(pixels: NDArray[Any]) -> bytes:
    import tifffile

    buffer = io.BytesIO()
    grey, alpha = pixels.shape[2] < 3, pixels.shape[2] in (2, 4)
    tifffile.imwrite(
        buffer,
        pixels[:, :, 0] if pixels.shape[2] == 1 else pixels,
        photometric="minisblack" if grey else "rgb",
        planarconfig=None if pixels.shape[2] == 1 else "contig",
        extrasamples=["unassalpha"] if alpha else None,
        compression="zlib",
        metadata=None,
    )
    return buffer.getvalue()


def _hdr(colour: FloatImage, notes: list[str]) -> bytes:
    from lambent.frame.radiance import write_hdr

    bad = int((~(np.isfinite(colour) & (colour >= 0))).sum())
    if bad:
        notes.append(f"{bad} negative, infinite or NaN values cannot be held by HDR.")
    rgb = colour if colour.shape[2] == 3 else np.repeat(colour, 3, axis=2)
    return write_hdr(np.asarray(rgb, np.float32))
