"""The segments of a JPEG before its pixels: what they hold beside the picture, read and written.

ISO/IEC 10918-1 (JPEG), 10918-5 (JFIF); EXIF 2.32; the XMP specification part 3; ICC.1 annex B.4.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from lambent.frame.metadata import Metadata

_EXIF = b"Exif\0\0"
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_ICC = b"ICC_PROFILE\0"
_MOST = 65533
#: Segments that are kept for another JPEG as they are: a marker, how its body begins, its name.
_NATIVE = (
    (0xE1, b"http://ns.adobe.com/xmp/extension/\0", b"extended XMP"),
    (0xED, b"", b"IPTC"),
    (0xFE, b"", b"the comment"),
)


@dataclass
class _Parts:
    exif: bytes | None = None
    xmp: bytes | None = None
    icc: dict[int, bytes] = field(default_factory=dict)
    dpi: tuple[float, float] | None = None
    native: list[tuple[bytes, bytes]] = field(default_factory=list)


def metadata_of(content: bytes) -> Metadata:
    """What a JPEG holds beside its pixels. What is damaged ends the list: the pixels tell."""
    found = _Parts()
    for marker, body, whole in _segments(content):
        if marker == 0xE0 and body[:5] == b"JFIF\0" and len(body) >= 12:
            unit, x, y = struct.unpack_from(">BHH", body, 7)
            if unit in (1, 2) and x and y:
                factor = 1.0 if unit == 1 else 2.54
                found.dpi = x * factor, y * factor
        elif marker == 0xE1 and body.startswith(_EXIF) and found.exif is None:
            found.exif = body[len(_EXIF) :]
        elif marker == 0xE1 and body.startswith(_XMP) and found.xmp is None:
            found.xmp = body[len(_XMP) :]
        elif marker == 0xE2 and body.startswith(_ICC) and len(body) > len(_ICC) + 2:
            found.icc.setdefault(body[len(_ICC)], body[len(_ICC) + 2 :])
        else:
            for other, start, name in _NATIVE:
                if marker == other and body.startswith(start):
                    found.native.append((name, whole))
    icc = b"".join(found.icc[n] for n in sorted(found.icc)) or None
    return Metadata(icc, found.exif, found.xmp, found.dpi, tuple(found.native), "jpeg")


def with_metadata(content: bytes, metadata: Metadata) -> tuple[bytes, tuple[str, ...]]:
    """A JPEG with this beside its pixels, and notes on what is too large for it."""
    segments, notes = [], []
    for name, start, body in (
        ("EXIF", _EXIF, metadata.exif),
        ("XMP", _XMP, metadata.xmp),
    ):
        if body is None:
            continue
        if len(start) + len(body) > _MOST:
            notes.append(f"{name} of {len(body)} bytes is too large for a JPEG: left out.")
            continue
        segments.append(_segment(0xE1, start + body))
    if metadata.icc is not None:
        room = _MOST - len(_ICC) - 2
        pieces = [metadata.icc[at : at + room] for at in range(0, len(metadata.icc), room)]
        if len(pieces) < 256:
            segments += [
                _segment(0xE2, _ICC + bytes([n, len(pieces)]) + piece)
                for n, piece in enumerate(pieces, 1)
            ]
        else:
            notes.append("The colour profile is too large for a JPEG: left out.")
    if metadata.kind == "jpeg":
        segments += [whole for _, whole in metadata.native]
    at = 2
    if content[2:4] == b"\xff\xe0":  # JFIF stands first
        at = 4 + struct.unpack_from(">H", content, 4)[0]
    return content[:at] + b"".join(segments) + content[at:], tuple(notes)


# ------------------------------------------------------------------- private


def _segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def _segments(content: bytes) -> list[tuple[int, bytes, bytes]]:
    """(marker, body, the segment as it stands) up to the pixels."""
    found, at = [], 2
    while at + 4 <= len(content) and content[at] == 0xFF:
        marker = content[at + 1]
        if marker == 0xFF:  # a filling byte
            at += 1
            continue
        if marker in (0xD9, 0xDA):  # the end, the pixels
            break
        size = struct.unpack_from(">H", content, at + 2)[0]
        body = content[at + 4 : at + 2 + size]
        if size < 2 or len(body) != size - 2:
            break
        found.append((marker, body, content[at : at + 2 + size]))
        at += 2 + size
    return found
