"""Small renders for the system tests, written with the bare OpenEXR module."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR


def heed_ctrl_c() -> None:
    """For a child: a shell's background jobs ignore SIGINT, and children inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def channels(height: int = 48, width: int = 64, seed: int = 0) -> dict[str, np.ndarray]:
    """R G B with exponential noise, albedo, normal and depth: what a path tracer writes."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    ramp = 0.2 + 0.6 * x / max(width, 2)
    found = {n: ramp * rng.exponential(1.0, ramp.shape) for n in "RGB"}
    found |= {f"albedo.{n}": ramp for n in "RGB"}
    found |= {
        "normal.X": np.zeros_like(x),
        "normal.Y": np.zeros_like(x),
        "normal.Z": np.ones_like(x),
        "depth.Z": 1 + y,
    }
    return {n: np.array(a, np.float32, order="C") for n, a in found.items()}


def write(path: Path, arrays: dict[str, np.ndarray] | None = None, **header: Any) -> Path:
    """An EXR of these channels (default: `channels`)."""
    arrays = channels() if arrays is None else arrays
    full = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(full, dict(arrays)) as file:  # the module replaces the arrays in the dict
        file.write(str(path))
    return path


def read(path: Path) -> dict[str, np.ndarray]:
    """Every channel of a one-part file, by its full name."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(c.pixels) for name, c in file.parts[0].channels.items()}
