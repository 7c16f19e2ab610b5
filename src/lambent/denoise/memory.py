"""How much memory this process uses, may use, and has used at most."""

from __future__ import annotations

import os
import sys
from pathlib import Path


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
