"""What is needed to write a file back with all else bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, eq=False)
class Origin:
    """Where a frame comes from.

    ``path``: the file. ``kind``: ``"exr"``, ``"png"``, …. ``payload``: what the reader of that
    kind keeps to write the file back (for EXR: the decoded file with all parts, headers and
    channels in their own types).
    """

    path: Path
    kind: str
    payload: Any = None
