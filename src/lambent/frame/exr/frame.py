"""An EXR file as a frame, and a frame back into its EXR file.

`frame_of` finds the layers' meaning (`lambent.frame.dialects`) and makes a `Frame` whose layers
are decoded when they are looked at: all layers with a role in one pass over the file, band by band
straight into their final arrays, so that memory beside them is one band; ids and unknown layers in
another pass, if ever. `replaced_channels` is the way back.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError, OptionError
from lambent.frame.cie import rgb_from_xyz, xyz_from_rgb
from lambent.frame.exr.file import ExrFile, ExrPart
from lambent.frame.exr.module import enough_memory
from lambent.frame.exr.write import beyond_half, to_type
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer, Source
from lambent.frame.luma import enlarge, from_rgb, to_rgb, weights
from lambent.frame.origin import Origin
from lambent.frame.role import Role, Stat, parse_role
from lambent.frame.windows import Window, Windows

if TYPE_CHECKING:
    from lambent.frame.dialects import Found, Identified

#: Roles that hardly anybody looks at: decoded in a pass of their own.
_SELDOM = (Role.ID, Role.OTHER)
_LUMA = ("Y", "RY", "BY")


@dataclass(frozen=True, eq=False)
class ExrOrigin:
    """What a frame keeps of its EXR: the file, the window of its layers, and where each is."""

    exr: ExrFile
    window: Window
    found: Mapping[Source, Found]


class LayerPixels:
    """A layer's pixels, not decoded yet."""

    def __init__(self, loader: _Loader, found: Found) -> None:
        self.loader, self.found = loader, found

    def __call__(self) -> FloatImage:
        """Decode (with the layers that are usually wanted together)."""
        return self.loader.load(self.found)


def source_of(found: Found) -> Source:
    """Where a found layer lies, as layers carry it."""
    return Source(found.part, tuple(name for _, name in found.channels))


def frame_of(
    exr: ExrFile,
    identified: Identified,
    view: str | None,
    spp: int | None,
    roles: Mapping[str, str] | None = None,
) -> Frame:
    """The frame of one view (None: the main one). Raises `OptionError` for an unknown view.

    Layers are cut to the data window of the colour. One that does not cover it is left out with a
    note; if the user mapped it by hand that is a `LayerError`.
    """
    views = identified.views
    if view is None:
        view = views[0] if views else ""
    elif view and view not in views:
        raise OptionError(
            f"there is no view '{view}'",
            file=exr.path,
            remedy=f"the file has {', '.join(views)}" if views else "the file has no stereo views",
        )
    chosen = [f for f in identified.layers if f.view in ("", view)]
    window = _frame_window(exr, chosen)
    notes = [*(exr.container.notes if exr.container else ()), *identified.notes]
    covering = [f for f in chosen if _covers(exr, f, window)]
    for found in chosen:
        if not _covers(exr, found, window):
            notes.append(_leave_out(exr, found, window, roles))
    loader = _Loader(exr, covering, window)
    layers = [
        Layer(
            f.role,
            LayerPixels(loader, f),
            stat=f.stat,
            name=f.name,
            space=f.space,
            source=source_of(f),
            why=f.why,
        )
        for f in covering
    ]
    origin = Origin(exr.path, "exr", ExrOrigin(exr, window, {source_of(f): f for f in covering}))
    return Frame.from_layers(
        layers,
        spp=spp if spp is not None else identified.spp,
        view=view,
        dialect=identified.dialect,
        origin=origin,
        notes=tuple(notes),
        windows=Windows(window, exr.parts[0].display_window),
    )


def _frame_window(exr: ExrFile, found: Iterable[Found]) -> Window:
    """The data window of the colour; without a colour, of the first layer there is."""
    found = list(found)
    for layer in found:
        if (layer.role, layer.stat) == (Role.COLOUR, Stat.MEAN):
            return exr.parts[layer.part].data_window
    return exr.parts[found[0].part if found else 0].data_window


def _covers(exr: ExrFile, found: Found, window: Window) -> bool:
    for index, _ in found.channels:
        x0, y0, x1, y1 = exr.parts[index].data_window
        if x0 > window[0] or y0 > window[1] or x1 < window[2] or y1 < window[3]:
            return False
    return True


def _leave_out(exr: ExrFile, found: Found, window: Window, roles: Mapping[str, str] | None) -> str:
    """The note about a layer that does not cover the window; an error if it was asked for."""
    x0, y0, x1, y1 = exr.parts[found.part].data_window
    what = (
        f"its data window ({x0}, {y0}) - ({x1}, {y1}) does not cover that of the colour, "
        f"({window[0]}, {window[1]}) - ({window[2]}, {window[3]})"
    )
    if (found.role, found.stat) in [parse_role(role) for role in roles or ()]:
        raise LayerError(
            what, file=exr.path, layer=found.name, remedy="map a layer that covers the colour"
        )
    return f"'{found.name}' is left out: {what}."


class _Loader:
    """Decodes the layers of one frame, several at a time."""

    def __init__(self, exr: ExrFile, layers: Iterable[Found], window: Window) -> None:
        self.exr, self.window = exr, window
        self.waiting = list(layers)
        self.done: dict[int, FloatImage] = {}
        self.lock = threading.Lock()

    def load(self, found: Found) -> FloatImage:
        """The pixels of one layer. What was decoded along with it is kept until asked for."""
        with self.lock:
            if id(found) not in self.done:
                seldom = found.role in _SELDOM
                group = [f for f in self.waiting if (f.role in _SELDOM) == seldom]
                if all(f is not found for f in group):
                    group = [found]  # asked for a second time
                else:
                    self.waiting = [f for f in self.waiting if (f.role in _SELDOM) != seldom]
                with enough_memory(self.exr.path):
                    self._decode(group)
            return self.done.pop(id(found))

    def _decode(self, group: list[Found]) -> None:
        """All layers of a group; each part that they need is decoded once."""
        height, width = size_of(self.window)
        self.exr.gather({index for found in group for index, _ in found.channels})
        targets: dict[int, dict[str, list[tuple[NDArray[Any], int, int]]]] = {}
        for found in group:
            if self._sampled(found):
                self.done[id(found)] = self._from_sampled(found)
                continue
            if (plane := self._single(found)) is not None:
                self.done[id(found)] = plane
                continue
            image = np.empty((height, width, len(found.channels)), np.float32)
            self.done[id(found)] = image
            for n, (index, name) in enumerate(found.channels):
                part = self.exr.parts[index]
                place = (image[:, :, n], *offset(part, self.window))
                targets.setdefault(index, {}).setdefault(name, []).append(place)
        for index, wanted in targets.items():
            self.exr.parts[index].fill(wanted)
        for found in group:
            if found.scale != 1.0:
                self.done[id(found)] *= np.float32(found.scale)
            if found.factors:
                self.done[id(found)] *= np.asarray(found.factors, np.float32)
            if found.cie:
                self.done[id(found)] = rgb_from_xyz(self.done[id(found)])

    def _single(self, found: Found) -> FloatImage | None:
        """A layer that is one kept channel as it stands: no copy."""
        if len(found.channels) != 1 or found.scale != 1.0:
            return None
        index, name = found.channels[0]
        part = self.exr.parts[index]
        if part.pixels is None or not part.pixels.small or part.data_window != self.window:
            return None
        if part.channels[name].dtype != np.float32:
            return None
        return part.channels[name].data[:, :, None]

    def _sampled(self, found: Found) -> bool:
        channels = [self.exr.parts[index].channels[name] for index, name in found.channels]
        return any(c.x_sampling > 1 or c.y_sampling > 1 for c in channels)

    def _from_sampled(self, found: Found) -> FloatImage:
        """A layer with channels at less than full resolution, brought to it."""
        part = self.exr.parts[found.part]
        planes = [self.exr.parts[index].channels[name].data for index, name in found.channels]
        if is_luma(found):
            image = to_rgb(planes[0], planes[1], planes[2], weights(part.header))
        else:
            image = np.stack([enlarge(p, part.height, part.width) for p in planes], axis=2)
        row, column = offset(part, self.window)
        height, width = size_of(self.window)
        return np.ascontiguousarray(image[row : row + height, column : column + width])


def is_luma(found: Found) -> bool:
    """Whether a layer is stored as luminance and chroma."""
    return tuple(name.rsplit(".", 1)[-1] for _, name in found.channels) == _LUMA


def size_of(window: Window) -> tuple[int, int]:
    """Height and width of a window."""
    return window[3] - window[1] + 1, window[2] - window[0] + 1


def offset(part: ExrPart, window: Window) -> tuple[int, int]:
    """Row and column of the window's first pixel in the part."""
    return window[1] - part.data_window[1], window[0] - part.data_window[0]


# ---------------------------------------------------------------------- back


def replaced_channels(
    frame: Frame, origin: ExrOrigin
) -> tuple[dict[tuple[int, str], NDArray[Any]], list[str]]:
    """Which channels of the frame's file get which pixels, and notes.

    A layer counts as changed when its pixels are not the ones that were read (`Layer.with_data`).
    Layers that are not from the file have no place in it: a note says so.
    Raises `LayerError` where a size or channel count differs from the file's.
    """
    replaced: dict[tuple[int, str], NDArray[Any]] = {}
    notes: list[str] = []
    for layer in frame.all_layers():
        if isinstance(layer.pixels, LayerPixels) and layer.pixels.loader.exr is origin.exr:
            continue
        found = None if layer.source is None else origin.found.get(layer.source)
        if found is None:
            notes.append(f"'{layer.name}' is not a layer of the file and was not written.")
            continue
        _check_size(layer, found, origin, frame)
        notes += _place(layer, found, origin, replaced)
    _paste(origin.exr, origin.window, replaced)
    return replaced, notes


def _check_size(layer: Layer, found: Found, origin: ExrOrigin, frame: Frame) -> None:
    expected = (*size_of(origin.window), 3 if is_luma(found) else len(found.channels))
    if layer.data.shape != expected:
        raise LayerError(
            f"has the shape {layer.data.shape}, its place in the file {expected}",
            file=frame.path,
            layer=layer.name,
            remedy="write a new file: frame.replace(origin=None)",
        )


def _place(
    layer: Layer, found: Found, origin: ExrOrigin, replaced: dict[tuple[int, str], NDArray[Any]]
) -> list[str]:
    """Put one layer's planes where its channels are."""
    exr, image, notes = origin.exr, layer.data, []
    if is_luma(found):
        planes = list(from_rgb(image, weights(exr.parts[found.part].header)))
        notes.append(f"'{layer.name}' was converted back to luminance and chroma.")
    else:
        image = xyz_from_rgb(image) if found.cie else image
        planes = [image[:, :, n] for n in range(image.shape[2])]
    if found.scale != 1.0:
        planes = [plane / np.float32(found.scale) for plane in planes]
    if found.factors:
        planes = [p / np.float32(f) for p, f in zip(planes, found.factors, strict=True)]
    for (index, name), plane in zip(found.channels, planes, strict=True):
        part = exr.parts[index]
        if part.channels[name].dtype == np.float16 and (beyond := beyond_half(plane)):
            notes.append(f"{beyond} values of '{name}' exceed a half: clamped to ±65504.")
        replaced[index, name] = _as_stored(part, name, plane, origin.window)
    return notes


def _as_stored(part: ExrPart, name: str, plane: NDArray[Any], window: Window) -> NDArray[Any]:
    """The plane of a channel, sub-sampled as the channel is."""
    channel = part.channels[name]
    x, y = channel.x_sampling, channel.y_sampling
    row, column = offset(part, window)
    if (x, y) != (1, 1):
        if row % y or column % x or plane.shape[0] % y or plane.shape[1] % x:
            raise LayerError(f"is sub-sampled {x}x{y}, the colour's window is not", layer=name)
        plane = plane[::y, ::x]  # a sub-sampled channel holds the samples at even pixels
    return plane


def _paste(exr: ExrFile, window: Window, replaced: dict[tuple[int, str], NDArray[Any]]) -> None:
    """Make planes of the window whole channels, whose other pixels stay as they were.

    A part is decoded once for all its channels.
    """
    wholes: dict[int, dict[str, NDArray[Any]]] = {}
    for (index, name), plane in replaced.items():
        part, channel = exr.parts[index], exr.parts[index].channels[name]
        size = (part.height // channel.y_sampling, part.width // channel.x_sampling)
        if plane.shape != size:
            wholes.setdefault(index, {})[name] = np.empty(size, channel.dtype)
    for index, made in wholes.items():
        part = exr.parts[index]
        part.fill({name: [(whole, 0, 0)] for name, whole in made.items()})
        top, left = offset(part, window)
        for name, whole in made.items():
            channel, plane = part.channels[name], replaced[index, name]
            row, column = top // channel.y_sampling, left // channel.x_sampling
            place = whole[row : row + plane.shape[0], column : column + plane.shape[1]]
            place[...] = to_type(plane, whole.dtype)
            replaced[index, name] = whole
