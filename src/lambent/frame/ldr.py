"""PNG, JPEG, TIFF, Radiance HDR and PFM: one picture, perhaps with alpha.

Display-referred pictures (PNG, JPEG, integer TIFF) carry the sRGB transfer; inside Lambent colour
is linear, so reading undoes it and writing applies it, each with a note. Floating-point TIFF, HDR
and PFM are linear already. Alpha is straight and linear, and stays as it is. What was 16 bits stays
16 bits. The orientation that EXIF tells is applied; the profile, EXIF and XMP are kept
(`lambent.frame.metadata`).
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.frame import exif
from lambent.frame.atomic import atomic
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.limits import check_declared
from lambent.frame.magic import kind_of
from lambent.frame.metadata import Metadata, profile_name, profile_note
from lambent.frame.opening import read_file
from lambent.frame.tonemap import inverse_srgb, srgb

_REMEDY = "the file is damaged: copy it again"
#: Pixels as stored, what stands beside them, notes.
_Read = tuple[NDArray[Any], Metadata, tuple[str, ...]]


@dataclass(frozen=True)
class Facts:
    """What is needed to write a picture as it was: bits a channel (8, 16, 32), float or not.

    ``metadata``: what stands beside the pixels.
    """

    bits: int = 8
    floating: bool = False
    metadata: Metadata = field(default_factory=Metadata)


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture as read: linear ``colour`` ``(H, W, 1 or 3)``, straight ``alpha`` ``(H, W, 1)``."""

    kind: str
    colour: FloatImage
    alpha: FloatImage | None
    facts: Facts
    notes: tuple[str, ...] = ()


def is_display(frame: Frame) -> bool:
    """Whether the frame comes from a picture of display values, of 16 bits at most."""
    facts = frame.origin.payload if frame.origin is not None else None
    return isinstance(facts, Facts) and not facts.floating


def exposure_of(frame: Frame) -> float:
    """The exposure at which a frame is shown: 1 for display values, else the automatic one."""
    return 1.0 if is_display(frame) else auto_exposure(frame.colour)


def read_image(path: str | os.PathLike[str]) -> Picture:
    """Read a PNG, JPEG, TIFF, HDR or PFM. Raises `FileError`, `DamagedFileError`."""
    path = Path(path)
    content = read_file(path)
    found = kind_of(content[:16])
    readers: dict[str, Callable[[bytes, Path], _Read]] = {
        "png": _read_png, "jpeg": _read_jpeg, "tiff": _read_tiff, "hdr": _read_hdr,
        "pfm": _read_pfm,
    }  # fmt: skip
    if found is None or found[0] not in readers:
        raise FileError(f"is {found[1] if found else 'not a picture'}", file=path)
    pixels, metadata, notes = readers[found[0]](content, path)
    pixels, metadata, turns = _upright(pixels, metadata)
    return _picture(found[0], pixels, metadata, (*notes, *turns), path)


def _upright(pixels: NDArray[Any], metadata: Metadata) -> _Read:
    """The picture as it is looked at, and its metadata saying that it is."""
    notes: tuple[str, ...] = ()
    try:
        orientation, block, xmp = exif.upright(metadata.exif, metadata.xmp)
    except ValueError as error:
        notes = (f"Its EXIF is damaged ({error}): left out.",)
        orientation, block, xmp = exif.upright(None, metadata.xmp)
    if orientation != 1:
        pixels = exif.turned(pixels, orientation)
        notes = (*notes, f"It was turned upright, as its EXIF orientation ({orientation}) asks.")
    dpi = metadata.dpi[::-1] if metadata.dpi and orientation >= 5 else metadata.dpi
    return pixels, replace(metadata, exif=block, xmp=xmp, dpi=dpi), notes


def _picture(
    kind: str, pixels: NDArray[Any], metadata: Metadata, notes: tuple[str, ...], path: Path
) -> Picture:
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or not 1 <= pixels.shape[2] <= 4 or 0 in pixels.shape:
        raise FileError(f"has the shape {pixels.shape}, which is not that of a picture", file=path)
    floating = pixels.dtype.kind == "f"
    bits = pixels.dtype.itemsize * 8
    colours = 1 if pixels.shape[2] in (1, 2) else 3
    if floating:
        values = pixels.astype(np.float32)
        colour, alpha = values[:, :, :colours], values[:, :, colours:]
    else:
        steps = np.arange(2**bits, dtype=np.float32) / np.float32(2**bits - 1)
        colour = inverse_srgb(steps)[pixels[:, :, :colours]]
        alpha = steps[pixels[:, :, colours:]]
        notes = (*notes, f"{bits}-bit sRGB values were made linear.")
    return Picture(
        kind,
        np.ascontiguousarray(colour, np.float32),
        np.ascontiguousarray(alpha) if alpha.shape[2] else None,
        Facts(bits, floating, metadata),
        (*notes, *profile_note(metadata.icc)),
    )


def _read_png(content: bytes, path: Path) -> _Read:
    from lambent.frame.png16 import header, read_png16
    from lambent.frame.png_chunks import metadata_of

    bits = header(content, path)[2]
    metadata, notes = metadata_of(content, path)  # checksums too, before anything is decoded
    if bits == 16:
        pixels: NDArray[Any] = read_png16(content, path)
    else:
        pixels = _decoded(content, path, "PNG")[0]
    return pixels, metadata, notes


def _read_jpeg(content: bytes, path: Path) -> _Read:
    from lambent.frame.jpeg import metadata_of

    metadata = metadata_of(content)
    pixels, used, notes = _decoded(content, path, "JPEG", metadata.icc)
    return pixels, replace(metadata, icc=None) if used else metadata, notes


def _read_tiff(content: bytes, path: Path) -> _Read:
    from lambent.frame.tiff import NeedsPillowError, metadata_of, read_tiff

    try:
        return read_tiff(content, path)
    except NeedsPillowError:
        metadata, notes = metadata_of(content)
        pixels, used, more = _decoded(content, path, "TIFF", metadata.icc)
        metadata = replace(metadata, icc=None) if used else metadata
        return pixels, metadata, (*notes, *more)


def _read_hdr(content: bytes, path: Path) -> _Read:
    from lambent.frame.radiance import notes_of, read_hdr

    return read_hdr(content, path), Metadata(), notes_of(content)


def _read_pfm(content: bytes, path: Path) -> _Read:
    from lambent.frame.pfm import read_pfm

    pixels, notes = read_pfm(content, path)
    return pixels, Metadata(), notes


def _decoded(
    content: bytes, path: Path, kind: str, icc: bytes | None = None
) -> tuple[NDArray[Any], bool, tuple[str, ...]]:
    """What Pillow makes of the pixels, whether ``icc`` was applied to them, and notes."""
    from PIL import JpegImagePlugin, PngImagePlugin, TiffImagePlugin

    # Not `Image.open`: its own limit is one for the whole process.
    plugin: Any = {
        "PNG": PngImagePlugin.PngImageFile,
        "JPEG": JpegImagePlugin.JpegImageFile,
        "TIFF": TiffImagePlugin.TiffImageFile,
    }[kind]
    try:
        with plugin(io.BytesIO(content)) as image:
            # a palette has one band here, and three colours (perhaps alpha) once decoded
            bands = len(image.getbands()) if image.mode != "P" else 3
            bands += "transparency" in image.info
            check_declared(image.width, image.height, bands, 4, path, stored=len(content))
            image.load()
            has_alpha = "A" in image.getbands() or "transparency" in image.info
            grey = image.mode in ("1", "L", "LA", "I;16", "I;16B")
            if image.mode.startswith("I;16"):
                return np.asarray(image), False, ()
            if image.mode == "CMYK":
                return _from_cmyk(image, icc)
            mode = ("L" if grey else "RGB") + ("A" if has_alpha else "")
            return np.asarray(image.convert(mode)), False, ()
    except (OSError, SyntaxError, ValueError, EOFError, IndexError, KeyError, TypeError) as error:
        raise DamagedFileError(f"cannot be decoded ({error})", file=path, remedy=_REMEDY) from None


def _from_cmyk(image: Any, icc: bytes | None) -> tuple[NDArray[Any], bool, tuple[str, ...]]:
    """Four inks to RGB, by the profile where there is one: no RGB file can keep it."""
    from PIL import ImageCms

    if icc is not None:
        try:
            made = ImageCms.profileToProfile(
                image,
                ImageCms.ImageCmsProfile(io.BytesIO(icc)),
                ImageCms.createProfile("sRGB"),
                outputMode="RGB",
            )
            note = f"CMYK values were made sRGB by the colour profile ({profile_name(icc)})."
            return np.asarray(made), True, (note,)
        except (ImageCms.PyCMSError, OSError):
            note = "CMYK values were made sRGB without their colour profile, which is unreadable."
            return np.asarray(image.convert("RGB")), True, (note,)
    note = "CMYK values were made sRGB without a profile."
    return np.asarray(image.convert("RGB")), False, (note,)


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

    ``kind``: ``"png"``, ``"jpeg"``, ``"tiff"``, ``"hdr"`` or ``"pfm"``. PNG and TIFF take 16
    bits, TIFF float, where ``facts`` say so, and hold the metadata that they can. Nothing is
    tone-mapped: values beyond [0, 1] are clipped in integer formats, and counted in the notes.
    Raises `OutputError`.
    """
    facts = facts or Facts()
    notes: list[str] = []
    if alpha is not None and kind in ("jpeg", "hdr", "pfm"):
        notes.append(f"A {kind.upper()} holds no alpha: it was left out.")
        alpha = None
    metadata = facts.metadata
    more: tuple[str, ...] = ()
    if kind == "hdr":
        content = _hdr(colour, notes)
    elif kind == "pfm":
        from lambent.frame.pfm import write_pfm

        content = write_pfm(np.asarray(colour, np.float32))
    elif kind == "tiff" and facts.floating:
        from lambent.frame.tiff import write_tiff

        content, more = write_tiff(_joined(np.asarray(colour), alpha), metadata)
    else:
        bits = 16 if facts.bits >= 16 and kind != "jpeg" else 8
        pixels = _display(colour, alpha, bits, notes)
        content, more = _pack(kind, pixels, bits, metadata)
    if (lost := metadata.lost_in(kind)) is not None:
        notes.append(lost)
    with atomic(path, overwrite) as out:
        out.write(content)
    return (*notes, *more)


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


def _pack(
    kind: str, pixels: NDArray[Any], bits: int, metadata: Metadata
) -> tuple[bytes, tuple[str, ...]]:
    if kind == "tiff":
        from lambent.frame.tiff import write_tiff

        return write_tiff(pixels, metadata)
    if bits == 16:
        from lambent.frame import png_chunks
        from lambent.frame.png16 import write_png16

        return png_chunks.with_metadata(write_png16(pixels), metadata), ()
    from PIL import Image

    buffer = io.BytesIO()
    image = Image.fromarray(pixels[:, :, 0] if pixels.shape[2] == 1 else pixels)
    if kind == "jpeg":
        from lambent.frame import jpeg

        dpi = metadata.dpi or (0, 0)
        image.save(buffer, "JPEG", quality=95, subsampling=0, dpi=[round(v) for v in dpi])
        return jpeg.with_metadata(buffer.getvalue(), metadata)
    from lambent.frame import png_chunks

    image.save(buffer, "PNG")
    return png_chunks.with_metadata(buffer.getvalue(), metadata), ()


def _hdr(colour: FloatImage, notes: list[str]) -> bytes:
    from lambent.frame.radiance import write_hdr

    bad = int((~(np.isfinite(colour) & (colour >= 0))).sum())
    if bad:
        notes.append(f"{bad} negative, infinite or NaN values cannot be held by HDR.")
    rgb = colour if colour.shape[2] == 3 else np.repeat(colour, 3, axis=2)
    return write_hdr(np.asarray(rgb, np.float32))
