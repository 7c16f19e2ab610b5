"""Small EXR files of every kind, made with OpenEXR's own module at test time."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

COMPRESSIONS = [
    name for name, c in OpenEXR.Compression.__members__.items() if not name.startswith("NUM")
]
HEIGHT, WIDTH = 37, 29


def arrays(seed: int = 0, height: int = HEIGHT, width: int = WIDTH) -> dict[str, np.ndarray]:
    """Channels of all three types; smooth, so that lossy compressions really compress."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    wave = np.sin(x / 5) * np.cos(y / 7) + 1.5
    noise = rng.random((height, width), np.float32)
    return {
        "A": (noise * 0 + 1).astype(np.float16),
        "B": (wave + 0.1 * noise).astype(np.float16),
        "G": (2 * wave + 0.3 * noise).astype(np.float16),
        "R": (3 * wave + 0.2 * noise).astype(np.float16),
        "depth.Z": (wave * 10 + noise).astype(np.float32),
        "id": rng.integers(0, 2**32, (height, width), dtype=np.uint32),
    }


def content(
    compression: str = "ZIP_COMPRESSION",
    *,
    tiled: bool = False,
    parts: int = 1,
    channels: dict[str, np.ndarray] | None = None,
    origin: tuple[int, int] = (0, 0),
    extra: dict[str, Any] | None = None,
) -> bytes:
    """The bytes of a file; with several parts they are named ``part0``, ``part1``, …"""
    made = []
    for n in range(parts):
        pixels = dict(channels or arrays(n))  # the module puts its own objects into it
        height, width = next(iter(pixels.values())).shape
        x, y = origin
        header: dict[str, Any] = {
            "compression": OpenEXR.Compression.__members__[compression],
            "type": OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage,
            "dataWindow": ((x, y), (x + width - 1, y + height - 1)),
            "displayWindow": ((0, 0), (99, 79)),
            **(extra or {}),
        }
        if tiled:
            tiles = OpenEXR.TileDescription()
            tiles.xSize, tiles.ySize = 16, 8
            header["tiles"] = tiles
        made.append(OpenEXR.Part(header, pixels, f"part{n}" if parts > 1 else ""))
    stream = io.BytesIO()
    OpenEXR.File(made).write(stream)
    return stream.getvalue()


def bare(path: Path) -> list[dict[str, np.ndarray]]:
    """What OpenEXR's own module reads: a dictionary of channels for each part."""
    file = OpenEXR.File(str(path), separate_channels=True)
    return [{n: c.pixels for n, c in p.channels.items()} for p in file.parts]


def opaque_attribute(raw: bytes) -> bytes:
    """A single-part file with an attribute of a type that nobody knows, put in front.

    Offsets move along, so this also makes a file that the OpenEXR module did not write.
    """
    entry = b"secret\0unheardOf\0" + struct.pack("<i", 5) + b"\0\1\2\3\4"
    end = raw.index(b"screenWindowWidth\0float\0") + len(b"screenWindowWidth\0float\0") + 8
    while raw[end] != 0:  # attributes that follow in the alphabet
        name_end = raw.index(b"\0", raw.index(b"\0", end) + 1)
        end = name_end + 5 + struct.unpack_from("<i", raw, name_end + 1)[0]
    table = end + 1
    (first,) = struct.unpack_from("<Q", raw, table)
    count = (first - table) // 8
    offsets = [o + len(entry) for o in struct.unpack_from(f"<{count}Q", raw, table)]
    moved = struct.pack(f"<{count}Q", *offsets)
    return raw[:8] + entry + raw[8:table] + moved + raw[first:]
