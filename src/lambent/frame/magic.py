"""What kind of file this is, by its first bytes; names lie too often."""

from __future__ import annotations

from pathlib import Path

#: First bytes -> (kind, words for a person). Kinds that `lambent.frame.files` reads come first.
_MAGIC: tuple[tuple[bytes, str, str], ...] = (
    (b"\x76\x2f\x31\x01", "exr", "an OpenEXR image"),
    (b"\x89PNG\r\n\x1a\n", "png", "a PNG image"),
    (b"\xff\xd8\xff", "jpeg", "a JPEG image"),
    (b"II*\0", "tiff", "a TIFF image"),
    (b"MM\0*", "tiff", "a TIFF image"),
    (b"II+\0", "tiff", "a TIFF image"),
    (b"MM\0+", "tiff", "a TIFF image"),
    (b"#?RADIANCE", "hdr", "a Radiance HDR image"),
    (b"#?RGBE", "hdr", "a Radiance HDR image"),
    *((b"P%c%c" % (f, end), "pfm", "a PFM image") for f in b"Ff" for end in b"\n\r "),
    (b"GIF8", "gif", "a GIF image"),
    (b"BM", "bmp", "a BMP image"),
    (b"8BPS", "psd", "a Photoshop document"),
    (b"SDPX", "dpx", "a DPX image"),
    (b"XPDS", "dpx", "a DPX image"),
    (b"BLENDER", "blend", "a Blender scene"),
    (b"PK\x03\x04", "zip", "a ZIP archive"),
    (b"\x1f\x8b", "gzip", "a gzip archive"),
    (b"\x28\xb5\x2f\xfd", "zstd", "a zstd archive"),
    (b"%PDF", "pdf", "a PDF document"),
    (b"\x93NUMPY", "npy", "a NumPy array"),
)

EXR_MAGIC = _MAGIC[0][0]


def begins_as(path: Path, kind: str) -> bool:
    """Whether a file can be opened and begins as one of a kind does: cut off, perhaps, but one."""
    try:
        with path.open("rb") as handle:
            found = kind_of(handle.read(16))
    except OSError:
        return False
    return found is not None and found[0] == kind


def kind_at(path: Path) -> str:
    """What a file is, in words ("a PNG image"); "" where it cannot be told."""
    try:
        with path.open("rb") as handle:
            found = kind_of(handle.read(64))
    except OSError:
        return ""
    return found[1] if found is not None else ""


def kind_of(start: bytes) -> tuple[str, str] | None:
    """``("png", "a PNG image")`` from a file's first bytes (16 suffice, 39 for
    Lambent's own archives), or None."""
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return "webp", "a WebP image"
    if start[4:8] == b"ftyp":
        return "mp4", "a video or HEIF image"
    if start.startswith(b"PK\x03\x04") and start[30:39] == b"card.json":  # the first member's name
        return "lambent", "a solution or a model of Lambent"
    for magic, kind, words in _MAGIC:
        if start.startswith(magic):
            return kind, words
    if start and all(32 <= b < 127 or b in b"\t\r\n" for b in start):
        return "text", "a text file"
    return None
