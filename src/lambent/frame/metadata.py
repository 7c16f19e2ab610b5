"""What a picture holds beside its pixels: colour profile, EXIF, XMP, resolution.

It is kept as it is for the file that is written, except that the orientation is applied. The colour
profile is kept and not applied: pixels pass through with the transfer of sRGB and back, so under
the same profile the result looks as its input did, in any gamut.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

#: What each kind of file can hold.
_HOLDS = {
    "png": {"icc", "exif", "xmp", "dpi"},
    "jpeg": {"icc", "exif", "xmp", "dpi"},
    "tiff": {"icc", "exif", "xmp", "dpi"},
}
_WORDS = {"icc": "the colour profile", "exif": "EXIF", "xmp": "XMP", "dpi": "the resolution"}


@dataclass(frozen=True)
class Metadata:
    """What stands beside the pixels.

    ``icc``: a colour profile. ``exif``: a TIFF block, its orientation 1. ``xmp``: a packet.
    ``dpi``: pixels an inch, horizontally and vertically. ``native``: chunks (PNG), segments (JPEG)
    by name that only a file of the same ``kind`` can hold.
    """

    icc: bytes | None = None
    exif: bytes | None = None
    xmp: bytes | None = None
    dpi: tuple[float, float] | None = None
    native: tuple[tuple[bytes, bytes], ...] = ()
    kind: str = ""

    def lost_in(self, kind: str) -> str | None:
        """A sentence on what a file of another kind does not hold; None: it holds all."""
        names = [
            words
            for name, words in _WORDS.items()
            if getattr(self, name) is not None and name not in _HOLDS.get(kind, ())
        ]
        if self.native and self.kind != kind:
            names += dict.fromkeys(name.decode("latin-1") for name, _ in self.native)
        if not names:
            return None
        return f"{kind.upper()} does not hold {', '.join(names)} of the input: left out."


def profile_name(icc: bytes) -> str:
    """The description of a colour profile, ``"unreadable"`` for a damaged one."""
    from PIL import ImageCms

    try:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(icc))
        return str(ImageCms.getProfileDescription(profile)).strip()
    except (ImageCms.PyCMSError, OSError):
        return "unreadable"


def profile_note(icc: bytes | None) -> tuple[str, ...]:
    """What a person should know about a profile that is kept: nothing for sRGB."""
    if icc is None:
        return ()
    name = profile_name(icc)
    if "srgb" in name.lower():
        return ()
    return (f"Its colour profile ({name}) is kept; until then values are taken as sRGB.",)
