"""The stamp of a denoised file: the attribute ``lambent:settings``, with what it was made with.

Denoising replaces the pictures and leaves their variances and half buffers as they were: those are
statistics of the noisy pictures and tell nothing about the clean ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

#: The EXR attribute that holds the settings a file was made with.
STAMP = "lambent:settings"
#: Its entry for the model that was chosen for the file; the other entries are what was asked for.
CHOSEN = "chosen"
#: What a note on a file with a stamp says of it.
DENOISED = "was denoised by Lambent before"


def stamp_in(header: Mapping[str, Any]) -> dict[str, Any] | None:
    """The stamp in a header; None where there is none that can be read."""
    from lambent.settings import parse_json

    text = header.get(STAMP)
    try:
        stamp = parse_json(text) if isinstance(text, str) else None
    except ValueError:
        return None
    return stamp if isinstance(stamp, dict) else None


def model_of(stamp: Mapping[str, Any]) -> str:
    """The model that made the file, "" where the stamp does not tell or nothing was filtered."""
    if stamp.get("strength") == 0:
        return ""
    return str(stamp.get(CHOSEN) or stamp.get("model") or "")
