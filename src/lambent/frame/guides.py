"""Guides in files of their own: an albedo, normals or a variance beside the beauty.

Where a choice ``role=NAME`` has the ending of a picture, NAME is a file: ``albedo=albedo.exr``, or
``albedo=passes.exr:base`` for one layer of several. Of the file is taken the layer that has the
role there, or its only picture. It must have the pixels of the colour, by its data window; an
overscan beyond them, in the same display window, is cut off. Such a layer is looked at and never
written.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lambent.errors import FileError, LayerError, OptionError
from lambent.frame.files import ENDINGS
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Stat, parse_role
from lambent.frame.sequence import has_place, put_number
from lambent.frame.tonemap import srgb
from lambent.frame.windows import Window, Windows, size_of

#: Reads all views of a file: path and choices of layers to frames.
Reader = Callable[[Path, Mapping[str, str]], Mapping[str, Frame]]


@dataclass(frozen=True, eq=False)
class GuidePixels:
    """Pixels of a layer of another file, cut to the colour's window when they are looked at."""

    layer: Layer
    rows: slice
    columns: slice
    channels: int
    stored: bool

    def __call__(self) -> FloatImage:
        """Decode; ``stored``: values as in the file, not made linear."""
        image = self.layer.data[self.rows, self.columns, : self.channels]
        return np.asarray(srgb(image) if self.stored else image, np.float32)


def file_of(name: object) -> tuple[Path, str] | None:
    """The file and layer that a choice names (layer ``""``: not told), or None for a layer."""
    text = os.fspath(name) if isinstance(name, (str, os.PathLike)) else ""
    if Path(text).suffix.lower() in ENDINGS:
        return Path(text), ""
    path, sign, layer = text.rpartition(":")
    if sign and layer and Path(path).suffix.lower() in ENDINGS:
        return Path(path), layer
    return None


def split(roles: Mapping[str, str] | None) -> tuple[dict[str, str], dict[str, str]]:
    """Choices of layers, and those of files. Raises `OptionError` for a file that is no guide."""
    own: dict[str, str] = {}
    guides: dict[str, str] = {}
    for name, text in (roles or {}).items():
        if file_of(text) is None:
            own[name] = text
            continue
        role, stat = parse_role(name)
        if not (INFO[role].guide or role is Role.MOTION or stat is not Stat.MEAN):
            raise OptionError(
                f"--map {name}={text}: {INFO[role].title} cannot come from another file",
                remedy="a file of its own may hold a guide, such as albedo, normal or depth",
            )
        guides[name] = text
    return own, guides


def numbered(
    roles: Mapping[str, str], number: int | None, source: str | os.PathLike[str]
) -> dict[str, str]:
    """The choices with the frame's number in files such as ``albedo.####.exr``.

    Raises `OptionError` where the frame has no number.
    """
    found = {}
    for role, text in roles.items():
        named = file_of(text)
        if named is not None and has_place(named[0].name):
            if number is None:
                raise OptionError(
                    f"--map {role}={text} has a place for a frame number, and "
                    f"{Path(source).name} has none",
                    remedy="name the file itself",
                )
            path = named[0].with_name(put_number(named[0].name, number))
            text = f"{path}:{named[1]}" if named[1] else str(path)
        found[role] = text
    return found


def paths(roles: Mapping[str, str]) -> list[Path]:
    """The files that choices name."""
    return [named[0] for text in roles.values() if (named := file_of(text)) is not None]


def attach(
    frames: Mapping[str, Frame], guides: Mapping[str, str], read: Reader
) -> dict[str, Frame]:
    """Frames by view, with the guides in place of their own layers of those roles.

    ``read`` reads a guide's file. Raises `FileError` and its kinds, `LayerError` for a layer that
    is not there, has the wrong channels, or does not cover the colour.
    """
    result = dict(frames)
    for name, text in guides.items():
        named = file_of(text)
        assert named is not None
        path, layer = named
        role, stat = parse_role(name)
        if not path.is_file():
            raise FileError(
                "there is no such file",
                file=path,
                remedy=f"check the guide's name ({name}={text})",
            )
        others = read(path, {name: layer} if layer else {})
        for view, frame in result.items():
            other = _of_view(others, view, path)
            result[view] = _with_guide(frame, other, role, stat, path)
    return result


def is_guide(layer: Layer) -> bool:
    """Whether a layer comes from a file of its own."""
    return isinstance(layer.pixels, GuidePixels)


# ------------------------------------------------------------------- private


def _of_view(others: Mapping[str, Frame], view: str, path: Path) -> Frame:
    if view in others:
        return others[view]
    if len(others) == 1:
        return next(iter(others.values()))
    raise LayerError(
        f"there is no view '{view}'", file=path, remedy=f"the file has {', '.join(others)}"
    )


def _with_guide(frame: Frame, other: Frame, role: Role, stat: Stat, path: Path) -> Frame:
    source = _layer_of(frame, other, role, stat, path)
    rows, columns = _cut(frame, other, source, path)
    facts = other.origin.payload if other.origin else None
    encoded = getattr(facts, "floating", True) is False  # a display-referred picture, made linear
    colours = role in (Role.COLOUR, Role.ALBEDO, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
    pixels = GuidePixels(
        source, rows, columns, _channels(source, role, path), encoded and not colours
    )
    layer = Layer(
        role,
        pixels,
        stat=stat,
        name=f"{path.name}:{source.name}",
        space=source.space if source.role is role else None,
        why=f"layer '{source.name}' of the file {path}",
    )
    if encoded and colours:
        frame = frame.noted(*(f"{path.name}: {note}" for note in other.notes))
    held = frame.layer(role, stat)
    if held is not None and not is_guide(held):
        kept = Layer(
            Role.OTHER, held.pixels, name=held.name, source=held.source, why="not used: see --map"
        )
        frame = frame.replace(extras={**frame.extras, held.name: kept})
    return frame.replace(layers={**frame.layers, (role, stat): layer})


def _layer_of(frame: Frame, other: Frame, role: Role, stat: Stat, path: Path) -> Layer:
    """The layer of that role, or the file's only picture."""
    found = other.layer(role, stat)
    if found is not None and (role, stat) != (Role.COLOUR, Stat.MEAN):
        return found
    pictures = [layer for layer in other.all_layers() if layer.role is not Role.ALPHA]
    same = frame.path is not None and os.path.exists(frame.path) and path.samefile(frame.path)
    if len(pictures) == 1 and not same:
        return pictures[0]
    name = role.value if stat is Stat.MEAN else f"{role.value}.{stat.value}"
    listed = ", ".join(sorted(layer.name for layer in pictures)) or "no layer"
    raise LayerError(
        f"no layer for '{name}' ({INFO[role].title}) was found",
        file=path,
        remedy=f"name one: --map {name}={path}:LAYER. The file has: {listed}.",
    )


def _channels(layer: Layer, role: Role, path: Path) -> int:
    """How many of a layer's channels are taken."""
    have = layer.data.shape[2]
    allowed = [count for count in INFO[role].channels if count <= have]
    if have in INFO[role].channels:
        return have
    # Depth three times over, as single pictures have it, or motion in two channels of three.
    if allowed and role in (Role.DEPTH, Role.ROUGHNESS, Role.MOTION):
        return max(allowed)
    raise LayerError(
        f"{INFO[role].title} has {' or '.join(map(str, INFO[role].channels))} channels, "
        f"this has {have}",
        file=path,
        layer=layer.name,
        remedy=f"name another layer: --map {role.value}={path}:LAYER",
    )


def _cut(frame: Frame, other: Frame, layer: Layer, path: Path) -> tuple[slice, slice]:
    """Rows and columns of the guide that lie on the colour's pixels."""
    ours, display = _windows(frame)
    theirs, other_display = _windows(other, layer)
    covers = (
        theirs[0] <= ours[0]
        and theirs[1] <= ours[1]
        and theirs[2] >= ours[2]
        and theirs[3] >= ours[3]
    )
    if theirs != ours and not (covers and display == other_display):
        raise LayerError(
            f"its pixels, {_shown(theirs)}, are not those of the frame, {_shown(ours)}",
            file=path,
            layer=layer.name,
            remedy="render the guide with the size and the crop of the frame",
        )
    top, left = ours[1] - theirs[1], ours[0] - theirs[0]
    return (
        slice(top, top + ours[3] - ours[1] + 1),
        slice(left, left + ours[2] - ours[0] + 1),
    )


def _windows(frame: Frame, layer: Layer | None = None) -> tuple[Window, Window]:
    """Data and display window; of a picture without, its size twice."""
    if frame.windows is not None:
        return frame.windows.data, frame.windows.display
    height, width = (frame.height, frame.width) if layer is None else layer.data.shape[:2]
    whole = Windows.of_size(width, height)
    return whole.data, whole.display


def _shown(window: Window) -> str:
    width, height = size_of(window)
    return f"{width}x{height} at ({window[0]}, {window[1]})"
