"""How much memory this process uses, may use, and has used at most; sizes as people write them."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from lambent.errors import OptionError

#: A bare number below this is a forgotten unit.
_LEAST = 1 << 20
_SIZE = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(?:i?b)?\s*", re.IGNORECASE)
_UNITS = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40}


def used() -> int:
    """Bytes of this process now resident (the peak, where the system does not tell)."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return peak()


def peak() -> int:
    """The most bytes of this process that were ever resident; 0 where unknown (Windows)."""
    try:  # getrusage would count the parent's memory too, up to the moment of the exec
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass
    try:
        import resource
    except ImportError:
        return 0
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(most) if sys.platform == "darwin" else int(most) * 1024


def available() -> int | None:
    """Bytes that may still be used: the machine's, or the container's where that is less."""
    free = None
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                free = int(line.split()[1]) * 1024
    except (OSError, ValueError):
        return None
    limit = _container_room()
    return limit if free is None else free if limit is None else min(free, limit)


def bytes_of(text: str) -> int | None:
    """``"4G"``, ``"512 MB"``, ``"1.5GiB"``, ``"4096"`` to bytes (binary units); None: no size."""
    match = _SIZE.fullmatch(text)
    return int(float(match[1]) * _UNITS[match[2].lower()]) if match else None


def parse_size(text: str | int) -> int:
    """A size to work within, as in `bytes_of` or a number of bytes, to bytes.

    Raises `OptionError` for anything else, for sizes that are not positive, and for small numbers
    in text that lack a unit.
    """
    size = text if isinstance(text, int) else bytes_of(text) or 0
    if isinstance(text, str) and text.strip().isdigit() and 0 < size < _LEAST:
        raise OptionError(
            f"'{text}' without a unit is {size} bytes of memory, which is too little to work in",
            remedy=f"write it with a unit: {text.strip()}G, or {text.strip()}M",
        )
    if size <= 0:
        raise OptionError(
            f"'{text}' is not an amount of memory", remedy="write it like 4G, 512M or 1.5GiB"
        )
    return size


def show_size(size: float) -> str:
    """Bytes as people write them: ``"3.7 GiB"``."""
    for unit in ("B", "KiB", "MiB"):
        if size < 1000:
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.3g} {unit}"
        size /= 1024
    return f"{size:.2f} GiB" if size < 10 else f"{size:.1f} GiB"


# ------------------------------------------------------------------- private


def _container_room() -> int | None:
    root = Path("/sys/fs/cgroup")
    pairs = (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    )
    for limit, usage in pairs:
        try:
            most = (root / limit).read_text().strip()
            if most == "max":
                return None
            room = int(most) - int((root / usage).read_text())
            return max(room, 0) if int(most) < 2**60 else None
        except (OSError, ValueError):
            continue
    return None
