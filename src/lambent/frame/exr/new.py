"""A new EXR file from the layers of a frame that came from elsewhere.

One scan-line part, packed with ZIP, with the names that Lambent itself and most other programs
find again: ``R G B``, ``A``, ``albedo.R``, ``normal.X``, ``depth.Z``, ``motion.X``; variances as
``variance.R`` and ``albedo_variance.R``, half buffers as ``half_a.R``. Extra layers keep their own
names. Samples per pixel go to the attribute ``spp``.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError
from lambent.frame.atomic import atomic
from lambent.frame.exr.file import KEEP_BYTES
from lambent.frame.exr.header import DTYPES, ChannelInfo, PartHeader
from lambent.frame.exr.pixels import ZIP, bands, encode_rows
from lambent.frame.exr.whole import write_whole
from lambent.frame.exr.write import append, beyond_half, to_type
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.magic import EXR_MAGIC
from lambent.frame.role import Role, Stat
from lambent.frame.windows import Windows

_COLOURS = ("R", "G", "B", "A")
_AXES = ("X", "Y", "Z", "W")
_VECTORS = (Role.NORMAL, Role.POSITION, Role.MOTION)


def channel_names(layer: Layer, count: int) -> list[str]:
    """The names of a layer's channels in a new file.

    The beauty is ``R G B`` (grey: ``Y``), its statistics ``variance.R``, ….
    """
    if layer.role in (Role.COLOUR, Role.ALPHA) and layer.stat is Stat.MEAN:
        if layer.role is Role.ALPHA:
            return ["A"]
        return ["Y"] if count == 1 else list(_COLOURS[:count])
    if layer.role in (Role.LIGHTING, Role.ID, Role.OTHER):
        base = layer.name
    elif layer.stat is Stat.MEAN:
        base = layer.role.value
    elif layer.role is Role.COLOUR:
        base = layer.stat.value
    else:
        base = f"{layer.role.value}_{layer.stat.value}"
    if count == 1:
        return [f"{base}.Z" if layer.role is Role.DEPTH else base]
    letters: tuple[str, ...] = _AXES if layer.role in _VECTORS or count == 2 else _COLOURS
    if count > 4:
        letters = tuple(f"{n:03d}" for n in range(count))
    return [f"{base}.{letter}" for letter in letters[:count]]


def planes_of(frame: Frame, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Every channel ``(H, W)`` of a frame by name; ``prefix`` goes in front (a view's)."""
    planes: dict[str, NDArray[Any]] = {}
    for layer in frame.all_layers():
        image = layer.data
        for n, name in enumerate(channel_names(layer, image.shape[2])):
            if prefix + name in planes:
                raise LayerError(f"two layers would both be '{name}'", layer=layer.name)
            planes[prefix + name] = image[:, :, n]
    return planes


def write_new(
    path: str | os.PathLike[str],
    planes: Mapping[str, NDArray[Any]],
    *,
    half: bool = False,
    attributes: Mapping[str, int | str | list[str]] | None = None,
    overwrite: bool = False,
    windows: Windows | None = None,
) -> tuple[str, ...]:
    """Write channels ``(H, W)`` of one size as a new EXR, float32 or half, atomically.

    ``attributes``: header values beside the required ones. ``windows``: where the pixels lie in the
    picture (None: they are all of it). Returns what was clamped, in sentences.
    Raises `LayerError` for sizes that differ or names the format cannot hold, `OutputError`.
    """
    part = _part(path, planes, DTYPES[1] if half else DTYPES[2], attributes or {}, windows)
    with atomic(path, overwrite) as out:
        long_names = max(len(c.raw) for c in part.channels) > 31
        start = EXR_MAGIC + struct.pack("<I", 2 | (0x400 if long_names else 0)) + part.raw
        if part.unpacked > KEEP_BYTES or not write_whole(
            out, start, part, {c.name: to_type(planes[c.name], c.dtype) for c in part.channels}
        ):
            _in_bands(out, start, part, planes)
    if not half:
        return ()
    beyond = {name: count for name, plane in planes.items() if (count := beyond_half(plane))}
    return tuple(
        f"{n} values of '{name}' exceed a half: clamped to ±65504." for name, n in beyond.items()
    )


def _in_bands(
    out: BinaryIO, start: bytes, part: PartHeader, planes: Mapping[str, NDArray[Any]]
) -> None:
    out.write(start)
    out.seek(8 * part.chunk_count, os.SEEK_CUR)
    offsets = []
    for a, b in bands(part):
        rows = {c.name: to_type(planes[c.name][a:b], c.dtype) for c in part.channels}
        offsets.append(append(out, encode_rows(part, rows, a, part.levels[0], False)))
    out.seek(len(start))
    out.write(np.concatenate(offsets).astype("<u8").tobytes())


def _part(
    path: object,
    planes: Mapping[str, NDArray[Any]],
    dtype: np.dtype[Any],
    attributes: Mapping[str, int | str | list[str]],
    windows: Windows | None,
) -> PartHeader:
    sizes = {plane.shape for plane in planes.values()}
    if len(sizes) != 1:
        raise LayerError(
            f"the layers have different sizes: {sorted(sizes)}" if sizes else "there are no layers",
            file=path,
            remedy="all layers of a frame need the same size",
        )
    height, width = sizes.pop()
    for name in planes:
        if not 0 < len(name.encode()) <= 255 or "\0" in name:
            raise LayerError("an EXR cannot hold this name", file=path, layer=name)
    channels = tuple(
        sorted((ChannelInfo(name.encode(), dtype, 0, 1, 1) for name in planes), key=lambda c: c.raw)
    )
    kind = 1 if dtype == np.float16 else 2
    listed = b"".join(c.raw + struct.pack("<xiB3xii", kind, 0, 1, 1) for c in channels) + b"\0"
    windows = windows or Windows.of_size(width, height)
    if windows.size != (width, height):
        raise LayerError(
            f"the layers are {width}x{height}, the frame's data window is {windows}",
            file=path,
            remedy="give the frame the windows of these pixels: frame.replace(windows=None)",
        )
    entries = [
        (b"channels", b"chlist", listed),
        (b"compression", b"compression", bytes([ZIP])),
        (b"dataWindow", b"box2i", struct.pack("<4i", *windows.data)),
        (b"displayWindow", b"box2i", struct.pack("<4i", *windows.display)),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
        (b"type", b"string", b"scanlineimage"),
        *(_attribute(name, value) for name, value in attributes.items()),
    ]
    raw = b"".join(
        name + b"\0" + kind_name + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind_name, value in entries
    )
    return PartHeader(0, raw + b"\0", (), channels, ZIP, windows.data, windows.display, None)


def _attribute(name: str, value: int | str | list[str]) -> tuple[bytes, bytes, bytes]:
    if isinstance(value, int):
        return name.encode(), b"int", struct.pack("<i", value)
    if isinstance(value, str):
        return name.encode(), b"string", value.encode()
    texts = b"".join(struct.pack("<i", len(v.encode())) + v.encode() for v in value)
    return name.encode(), b"stringvector", texts
