"""Everything about a file that somebody who wants to denoise it should know.

`inspect_file` reads all of it: parts and channels, what each layer means and why, ranges and counts
of broken values, which layers sum to the beauty, and what looks suspicious. Nothing is printed
here; `Inspection.as_dict` is plain data for JSON and for the report.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.dialects.images import shown
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.luma import to_rgb, weights
from lambent.frame.role import Role, Space, Stat
from lambent.frame.sums import LayerSum, layer_sums
from lambent.frame.suspicion import LOSSY, Suspicion, suspicions

if TYPE_CHECKING:
    from lambent.frame.dialects import Found, Identified
    from lambent.frame.exr import ExrFile, ExrPart

Window = tuple[int, int, int, int]


@dataclass(frozen=True)
class ChannelReport:
    """A channel as the file has it: ``type`` is half, float or uint."""

    name: str
    type: str
    x_sampling: int = 1
    y_sampling: int = 1


@dataclass(frozen=True)
class PartReport:
    """A part. Windows are ``(x0, y0, x1, y1)``, inclusive."""

    index: int
    name: str
    view: str
    type: str
    compression: str
    data_window: Window
    display_window: Window
    channels: tuple[ChannelReport, ...]


@dataclass(frozen=True)
class LayerReport:
    """A layer: what it means and why, and what its values are.

    ``low``, ``high``, ``mean`` over the finite values of all channels (None where there is none);
    ``nan``, ``infinite``, ``negative`` count values. ``misses`` are values that mean "nothing
    hit"; an infinite depth is one.
    """

    name: str
    role: Role
    stat: Stat
    space: Space
    view: str
    why: str
    part: int
    channels: tuple[str, ...]
    width: int
    height: int
    low: float | None
    high: float | None
    mean: float | None
    nan: int
    infinite: int
    negative: int


@dataclass(frozen=True)
class Inspection:
    """What `inspect_file` found. ``format``: "exr", "png", …; ``dialect``: whose names these are.

    ``suspicions`` hold for the main view and, with the view's name in front, for the others.
    """

    path: str
    format: str
    size: int
    width: int
    height: int
    dialect: str
    dialect_why: str
    spp: int | None
    views: tuple[str, ...]
    parts: tuple[PartReport, ...]
    layers: tuple[LayerReport, ...]
    sums: tuple[LayerSum, ...]
    suspicions: tuple[Suspicion, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data that `json.dumps` takes: no NaN, no infinity, no enumerations."""
        plain = _plain(dataclasses.asdict(self))
        for given, one in zip(self.sums, plain["sums"], strict=True):
            one["sums"] = given.sums
        assert isinstance(plain, dict)
        return plain


def inspect_file(
    path: str | os.PathLike[str],
    roles: Mapping[str, str] | None = None,
    spp: int | None = None,
) -> Inspection:
    """Read a whole file and report on it. ``roles``: the user's own ``{role: layer}``, or files.

    ``spp``: samples per pixel, where the file does not tell.
    Raises `FileError`, `DamagedFileError`, `DeepFileError`, `UnknownNameError`, `LayerError`.
    """
    from lambent.frame.files import read_views
    from lambent.frame.guides import is_guide, split

    path = Path(path)
    frames = read_views(path, roles=roles, spp=spp)
    main = next(iter(frames.values()))
    if main.origin is None or main.origin.kind != "exr":
        return _of_image(path, main)
    from lambent.frame.dialects import identify

    exr: ExrFile = main.origin.payload.exr
    identified = identify(exr, split(roles)[0], spp)
    # Measured first: this decodes every part once and keeps it, so that frames only copy.
    layers = tuple(_layer(exr, layer) for layer in identified.layers)
    layers += tuple(_of_layer(layer) for layer in main.all_layers() if is_guide(layer))
    found = _once([s for view, frame in frames.items() for s in _seen(frame, view, main.view)])
    window = exr.parts[_first(identified).part].data_window if identified.layers else None
    return Inspection(
        path=str(path),
        format="exr",
        size=path.stat().st_size,
        width=0 if window is None else window[2] - window[0] + 1,
        height=0 if window is None else window[3] - window[1] + 1,
        dialect=identified.dialect,
        dialect_why=identified.why,
        spp=spp if spp is not None else identified.spp,
        views=identified.views,
        parts=tuple(_part(part) for part in exr.parts),
        layers=layers,
        sums=tuple(layer_sums(main)),
        suspicions=(*found, *_lossy(exr, identified)),
        notes=main.notes,
    )


# ------------------------------------------------------------------------------------------- parts


def _part(part: ExrPart) -> PartReport:
    names = {"float16": "half", "float32": "float", "uint32": "uint"}
    channels = tuple(
        ChannelReport(
            shown(c.name), names.get(c.dtype.name, c.dtype.name), c.x_sampling, c.y_sampling
        )
        for c in part.channels.values()
    )
    return PartReport(
        part.index,
        shown(part.name),
        shown(part.view),
        part.type,
        part.compression,
        part.data_window,
        part.display_window,
        channels,
    )


def _layer(exr: ExrFile, found: Found) -> LayerReport:
    from lambent.frame.exr.frame import is_luma

    part = exr.parts[found.part]
    planes = [exr.parts[index].channels[name].data for index, name in found.channels]
    if is_luma(found):  # chroma is negative as a rule; the colour that it stands for counts
        planes = [to_rgb(planes[0], planes[1], planes[2], weights(part.header))]
    return LayerReport(
        name=found.name,
        role=found.role,
        stat=found.stat,
        space=found.space,
        view=found.view,
        why=found.why,
        part=found.part,
        channels=tuple(shown(name) for _, name in found.channels),
        width=part.width,
        height=part.height,
        **_measured(planes),
    )


def _measured(planes: list[NDArray[Any]]) -> dict[str, Any]:
    """Range, mean and counts over planes of any type and size."""
    low, high, total, count = math.inf, -math.inf, 0.0, 0
    nan = infinite = negative = 0
    for plane in planes:
        values = plane.astype(np.float32) if plane.dtype == np.float16 else plane
        finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
        if values.dtype.kind == "f":
            missing = int(np.count_nonzero(np.isnan(values)))
            nan += missing
            infinite += values.size - finite.size - missing
        if finite.size:
            low, high = min(low, float(finite.min())), max(high, float(finite.max()))
            total += float(finite.sum(dtype=np.float64))
            count += finite.size
            negative += int(np.count_nonzero(finite < 0))
    known = count > 0
    return {
        "low": low if known else None,
        "high": high if known else None,
        "mean": total / count if known else None,
        "nan": nan,
        "infinite": infinite,
        "negative": negative,
    }


def _first(identified: Identified) -> Found:
    """The colour, or what there is."""
    view = identified.views[0] if identified.views else ""
    return identified.of(Role.COLOUR, view=view) or identified.layers[0]


def _seen(frame: Frame, view: str, main: str) -> list[Suspicion]:
    found = suspicions(frame)
    if view == main:
        return found
    return [
        dataclasses.replace(one, explanation=f"View '{view}': {one.explanation}") for one in found
    ]


def _once(found: list[Suspicion]) -> list[Suspicion]:
    """All of them, but the want of guides of the first view only: its advice is for the file."""
    first = next((one for one in found if one.name == "no guides"), None)
    return [one for one in found if one.name != "no guides" or one is first]


def _lossy(exr: ExrFile, identified: Identified) -> list[Suspicion]:
    """Compressions that change the noise of layers which take part in denoising."""
    used = {f.part for f in identified.layers if f.role not in (Role.ID, Role.OTHER)}
    found = []
    for part in exr.parts:
        method = part.compression
        if part.index not in used or method not in LOSSY:
            continue
        if method == "pxr24" and all(c.dtype != np.float32 for c in part.channels.values()):
            continue  # loses bits of 32-bit floats only
        found.append(
            Suspicion(
                "lossy compression",
                "hint" if method == "pxr24" else "warning",
                part.name,
                f"The pixels are packed with {method.upper()}, which changes values"
                + (
                    "." if method == "pxr24" else " in blocks: noise is smoothed before the filter."
                ),
                "Save with ZIP, PIZ or ZSTD, and pack the clean picture as small as you like.",
            )
        )
    return found


def _of_layer(layer: Layer) -> LayerReport:
    """A layer that is no EXR's of this file: of a picture, or of a guide's file."""
    return LayerReport(
        layer.name,
        layer.role,
        layer.stat,
        layer.space or Space.NONE,
        "",
        layer.why,
        0,
        tuple(("XYZ" if layer.role is Role.NORMAL else "RGBA")[: layer.data.shape[2]]),
        layer.data.shape[1],
        layer.data.shape[0],
        **_measured([layer.data]),
    )


def _of_image(path: Path, frame: Frame) -> Inspection:
    """PNG, JPEG, TIFF, HDR, PFM: one picture."""
    layers = tuple(_of_layer(layer) for layer in frame.all_layers())
    return Inspection(
        path=str(path),
        format=frame.origin.kind if frame.origin is not None else "",
        size=path.stat().st_size,
        width=frame.width,
        height=frame.height,
        dialect=frame.dialect or "generic",
        dialect_why="a picture without named layers",
        spp=frame.spp,
        views=(),
        parts=(),
        layers=layers,
        sums=(),
        suspicions=tuple(suspicions(frame)),
        notes=frame.notes,
    )


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
