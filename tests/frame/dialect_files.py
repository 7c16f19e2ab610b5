"""Decoded EXR files made by hand, for tests that need names and not pixels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lambent.frame.exr import ExrChannel, ExrFile, ExrPart

SIZE = (6, 8)


def part(
    index: int,
    channels: Iterable[str] | Mapping[str, Any],
    name: str = "",
    view: str = "",
    header: Mapping[str, Any] | None = None,
) -> ExrPart:
    """A part of float32 channels; given as names only they hold zeros."""
    arrays = channels if isinstance(channels, Mapping) else dict.fromkeys(channels)
    made = {}
    height, width = SIZE
    for channel, pixels in arrays.items():
        data = np.zeros(SIZE, np.float32) if pixels is None else np.asarray(pixels)
        height, width = data.shape
        made[channel] = ExrChannel(channel, data)
    window = (0, 0, width - 1, height - 1)
    return ExrPart(index, name, view, dict(header or {}), made, window, window)


def exr(*channels: str, header: Mapping[str, Any] | None = None, path: str = "x.exr") -> ExrFile:
    """A file of one part."""
    return ExrFile(Path(path), (part(0, channels, header=header),))


def parts(*named: tuple[str, str] | tuple[str, str, str], header: Any = None) -> ExrFile:
    """A file of parts: ``(name, "R G B")`` or ``(name, "R G B", view)``."""
    made = []
    for index, (name, channels, *view) in enumerate(named):
        made.append(part(index, channels.split(), name, view[0] if view else "", header))
    return ExrFile(Path("x.exr"), tuple(made))


def rgb(layer: str) -> list[str]:
    return [f"{layer}.{c}" for c in "RGB"]


def xyz(layer: str) -> list[str]:
    return [f"{layer}.{c}" for c in "XYZ"]


def roles(found: Any, view: str = "") -> dict[str, str]:
    """``{"albedo": layer name, "colour.variance": …}`` of one view; ids, others, light left out."""
    result = {}
    for layer in found.layers:
        if layer.view == view and layer.role.value not in ("id", "other", "lighting"):
            key = layer.role.value
            result[key if layer.stat.value == "mean" else f"{key}.{layer.stat.value}"] = layer.name
    return result


def named(found: Any, role: str, view: str = "") -> set[str]:
    """Names of all layers of a role in a view."""
    return {layer.name for layer in found.layers if (layer.role.value, layer.view) == (role, view)}
