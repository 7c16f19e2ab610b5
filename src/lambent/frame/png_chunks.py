"""The chunks of a PNG: walked, checked, and what they hold beside the picture.

"Portable Network Graphics (PNG) Specification", W3C, third edition, 2025, sections 5 and 11.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from lambent.errors import DamagedFileError
from lambent.frame.metadata import Metadata

MAGIC = b"\x89PNG\r\n\x1a\n"
REMEDY = "the file is damaged: copy it again"
_XMP = b"XML:com.adobe.xmp\0"
#: Chunks that `with_metadata` makes anew, or that belong to the pixels as they were stored.
_OWN = (b"iCCP", b"eXIf", b"pHYs", b"sRGB", b"tRNS", b"bKGD", b"hIST", b"sBIT", b"tIME", b"oFFs")
#: Chunks that say what the values mean where there is no profile.
_COLOUR = (b"gAMA", b"cHRM", b"cICP", b"mDCV", b"cLLI")
#: Longest that a packed profile or text may be.
_MOST = 1 << 26


def chunks(content: bytes, path: object = None) -> Iterator[tuple[bytes, bytes]]:
    """Name and body of each chunk before the end. Raises `DamagedFileError`."""
    at = len(MAGIC)
    while at + 12 <= len(content):
        (size,) = struct.unpack_from(">I", content, at)
        name, body = content[at + 4 : at + 8], content[at + 8 : at + 8 + size]
        check = content[at + 8 + size : at + 12 + size]
        if check != struct.pack(">I", zlib.crc32(name + body)):
            raise DamagedFileError("has a wrong checksum", file=path, remedy=REMEDY)
        if name == b"IEND":
            return
        yield name, body
        at += 12 + size
    raise DamagedFileError("ends too early", file=path, remedy=REMEDY)


def chunk(name: bytes, body: bytes) -> bytes:
    """A chunk with its length and checksum."""
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def metadata_of(content: bytes, path: object = None) -> tuple[Metadata, tuple[str, ...]]:
    """What a PNG holds beside its pixels, and notes. Raises `DamagedFileError`."""
    icc = exif = xmp = dpi = None
    native: list[tuple[bytes, bytes]] = []
    notes: list[str] = []
    is_srgb = False
    for name, body in chunks(content, path):
        if name == b"iCCP":
            icc = _unpacked(body.partition(b"\0")[2][1:], path)
        elif name == b"eXIf":
            exif = body.removeprefix(b"Exif\0\0")
        elif name == b"iTXt" and body.startswith(_XMP):
            xmp = _text(body[len(_XMP) :], path)
        elif name == b"pHYs" and len(body) == 9:
            x, y, unit = struct.unpack(">IIB", body)
            dpi = (x * 0.0254, y * 0.0254) if unit == 1 and x and y else None
        elif name == b"sRGB":
            is_srgb = True
        elif name == b"acTL":
            notes.append("Only the first picture of an animation was read.")
        # Ancillary (first letter small) and safe to copy (last letter small), or known.
        elif ((name[0] & 32 and name[3] & 32) or name in _COLOUR) and name not in _OWN:
            native.append((name, body))
    if is_srgb or icc is not None:
        native = [(name, body) for name, body in native if name not in _COLOUR]
    for name, body in native:
        if name == b"gAMA" and len(body) == 4 and abs(struct.unpack(">I", body)[0] - 45455) > 500:
            gamma = struct.unpack(">I", body)[0] / 100000
            notes.append(f"Its gamma ({gamma:g}) is kept; until then values are taken as sRGB.")
        elif name == b"cICP":
            notes.append("Its colour space (cICP) is kept; until then values are taken as sRGB.")
    return Metadata(icc, exif, xmp, dpi, tuple(native), "png"), tuple(notes)


def with_metadata(content: bytes, metadata: Metadata) -> bytes:
    """A PNG with this beside its pixels; without a profile its values are called sRGB."""
    new = []
    own_colour = metadata.kind == "png" and any(name in _COLOUR for name, _ in metadata.native)
    if metadata.icc is not None:
        new.append(chunk(b"iCCP", b"ICC profile\0\0" + zlib.compress(metadata.icc)))
    elif not own_colour:
        new.append(chunk(b"sRGB", b"\0"))
    if metadata.dpi is not None:
        x, y = (round(value / 0.0254) for value in metadata.dpi)
        new.append(chunk(b"pHYs", struct.pack(">IIB", x, y, 1)))
    if metadata.exif is not None:
        new.append(chunk(b"eXIf", metadata.exif))
    if metadata.xmp is not None:
        new.append(chunk(b"iTXt", _XMP + b"\0\0\0\0" + metadata.xmp))
    if metadata.kind == "png":
        new += [chunk(name, body) for name, body in metadata.native]
    after_header = len(MAGIC) + 25
    return content[:after_header] + b"".join(new) + content[after_header:]


# ------------------------------------------------------------------- private


def _text(body: bytes, path: object) -> bytes:
    """The text of an iTXt chunk behind its keyword."""
    packed, rest = body[:1] == b"\1", body[2:]
    text = rest.partition(b"\0")[2].partition(b"\0")[2]
    return _unpacked(text, path) if packed else text


def _unpacked(body: bytes, path: object) -> bytes:
    try:
        unpacker = zlib.decompressobj()
        text = unpacker.decompress(body, _MOST)
    except zlib.error as error:
        raise DamagedFileError(f"cannot be unpacked ({error})", file=path, remedy=REMEDY) from None
    if unpacker.unconsumed_tail:
        raise DamagedFileError(
            f"holds a profile or text of more than {_MOST} bytes", file=path, remedy=REMEDY
        )
    return text
