"""Reading and writing frames: the one door to every file format.

`read` tells formats by their first bytes, never by the name; `write` by the ending of the name.
A frame that came from an EXR is written back into that EXR: its changed layers get their new
pixels, everything else stays bit for bit (`lambent.frame.exr.write`). Writes are atomic.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lambent.errors import FileError, LayerError, OptionError, OutputError
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.magic import kind_of
from lambent.frame.opening import open_file
from lambent.frame.origin import Origin
from lambent.frame.role import Role, Space

if TYPE_CHECKING:
    from lambent.frame.guides import Reader

#: Ending -> kind of file that `write` makes.
ENDINGS = {
    ".exr": "exr",
    ".png": "png",
    ".jpg": "jpeg",
    ".jpeg": "jpeg",
    ".tif": "tiff",
    ".tiff": "tiff",
    ".hdr": "hdr",
    ".rgbe": "hdr",
    ".pic": "hdr",
    ".pfm": "pfm",
}
READABLE = ("exr", "png", "jpeg", "tiff", "hdr", "pfm")


@dataclass(frozen=True)
class Written:
    """A file that was written, and what a person should know about how."""

    path: Path
    notes: tuple[str, ...] = ()


def read(
    path: str | os.PathLike[str],
    *,
    view: str | None = None,
    roles: Mapping[str, str] | None = None,
    spp: int | None = None,
) -> Frame:
    """The frame in a file: EXR, PNG, JPEG, TIFF, Radiance HDR or PFM.

    ``view``: of a stereo EXR, by name; None is the main one. ``roles``: the user's own
    ``{role: layer}``; channels with commas, and guides in files of their own
    (`lambent.frame.guides`). ``spp``: samples per pixel, where the file does not tell.
    Display-referred images become linear, with a note. Layers of an EXR are decoded when they are
    looked at. Raises `FileError`, `DamagedFileError`, `DeepFileError`, `UnknownNameError`,
    `LayerError`, `OptionError`.
    """
    from lambent.frame.guides import attach, split

    path = Path(path)
    own, guides = split(roles)
    _check_spp(spp)
    if _kind(path) != "exr":
        frame = _read_image(path, view, own, spp)
    else:
        from lambent.frame.dialects import identify
        from lambent.frame.exr import decode
        from lambent.frame.exr.frame import frame_of

        exr = decode(path)
        frame = frame_of(exr, identify(exr, own, spp), view, spp, own)
    return attach({frame.view: frame}, guides, _reader(spp))[frame.view]


def read_views(
    path: str | os.PathLike[str],
    *,
    roles: Mapping[str, str] | None = None,
    spp: int | None = None,
) -> dict[str, Frame]:
    """Every stereo view of a file as a frame, the main one first; ``{"": frame}`` if only one."""
    from lambent.frame.guides import attach, split

    path = Path(path)
    own, guides = split(roles)
    _check_spp(spp)
    if _kind(path) != "exr":
        frames = {"": _read_image(path, None, own, spp)}
    else:
        from lambent.frame.dialects import identify
        from lambent.frame.exr import decode
        from lambent.frame.exr.frame import frame_of

        exr = decode(path)
        identified = identify(exr, own, spp)
        views = identified.views or ("",)
        frames = {view: frame_of(exr, identified, view, spp, own) for view in views}
    return attach(frames, guides, _reader(spp))


def _reader(spp: int | None) -> Reader:
    return lambda path, roles: read_views(path, roles=roles, spp=spp)


def _check_spp(spp: int | None) -> None:
    if spp is not None and (isinstance(spp, bool) or not 1 <= spp < 10**9):
        raise OptionError(f"samples per pixel must be 1 or more, not {spp}")


def write(
    path: str | os.PathLike[str],
    frame: Frame,
    *,
    overwrite: bool = False,
    half: bool = False,
    attributes: Mapping[str, str] | None = None,
) -> Path:
    """Write a frame; the ending of the name tells the format. Returns the path.

    EXR: back into the frame's own EXR if it has one, else a new file (``half``: 16-bit channels).
    Other pictures: the beauty (and alpha), with 16 bits where the frame was read from 16.
    ``attributes``: texts for the header of an EXR. Use `write_noted` to learn what was clamped,
    clipped or left out. Raises `OutputError`; nothing is left behind then.
    """
    return write_noted(path, frame, overwrite=overwrite, half=half, attributes=attributes).path


def write_noted(
    path: str | os.PathLike[str],
    frame: Frame,
    *,
    overwrite: bool = False,
    half: bool = False,
    attributes: Mapping[str, str] | None = None,
) -> Written:
    """Like `write`, and says in sentences what a person should know."""
    if not isinstance(frame, Frame) or not isinstance(path, (str, os.PathLike)):
        raise OptionError(
            f"write takes a path and then a frame, not {type(path).__name__} and "
            f"{type(frame).__name__}",
            remedy="call write(path, frame)",
        )
    kind = _target_kind(path)
    if kind != "exr":
        return Written(Path(path), _write_image(path, kind, frame, overwrite))
    return write_views_noted(
        path, {frame.view: frame}, overwrite=overwrite, half=half, attributes=attributes
    )


def write_views(
    path: str | os.PathLike[str],
    frames: Mapping[str, Frame],
    *,
    overwrite: bool = False,
    half: bool = False,
    attributes: Mapping[str, str] | None = None,
) -> Path:
    """Write the stereo views of one picture into one EXR (see `write`), the main one first."""
    return write_views_noted(
        path, frames, overwrite=overwrite, half=half, attributes=attributes
    ).path


def write_views_noted(
    path: str | os.PathLike[str],
    frames: Mapping[str, Frame],
    *,
    overwrite: bool = False,
    half: bool = False,
    attributes: Mapping[str, str] | None = None,
) -> Written:
    """Like `write_views`, and says in sentences what a person should know."""
    if _target_kind(path) != "exr":
        raise OutputError(
            "only an EXR holds stereo views", file=path, remedy="give it the ending .exr"
        )
    if not frames:
        raise LayerError("there are no views to write", file=path)
    from lambent.frame.exr.frame import ExrOrigin, replaced_channels
    from lambent.frame.exr.write import encode

    origins = [f.origin.payload if f.origin else None for f in frames.values()]
    files = {id(o.exr) for o in origins if isinstance(o, ExrOrigin)}
    if not files:
        return Written(Path(path), _write_new(path, frames, overwrite, half, attributes))
    first = origins[0]
    if len(files) > 1 or not isinstance(first, ExrOrigin) or None in origins:
        raise LayerError(
            "the views come from different files",
            file=path,
            remedy="read them with read_views, or write each to a file of its own",
        )
    replaced, notes = {}, []
    for frame in frames.values():
        assert frame.origin is not None
        channels, remarks = replaced_channels(frame, frame.origin.payload)
        replaced.update(channels)
        notes += remarks
    notes += encode(path, first.exr, replaced, overwrite, attributes)
    return Written(Path(path), tuple(notes))


def _write_new(
    path: str | os.PathLike[str],
    frames: Mapping[str, Frame],
    overwrite: bool,
    half: bool,
    texts: Mapping[str, str] | None,
) -> tuple[str, ...]:
    from lambent.frame.exr.new import planes_of, write_new
    from lambent.frame.ldr import Facts

    views = [view for view in frames if view]
    planes = {}
    for n, (view, frame) in enumerate(frames.items()):
        planes.update(planes_of(frame, f"{view}." if n and view else ""))
    first = next(iter(frames.values()))
    attributes: dict[str, int | str | list[str]] = dict(texts or {})
    if first.spp is not None:
        attributes["spp"] = first.spp
    if len(views) > 1:
        attributes["multiView"] = views
    notes = write_new(
        path,
        planes,
        half=half,
        attributes=attributes,
        overwrite=overwrite,
        windows=first.windows,
    )
    facts = first.origin.payload if first.origin else None
    lost = facts.metadata.lost_in("exr") if isinstance(facts, Facts) else None
    return notes if lost is None else (*notes, lost)


# -------------------------------------------------------------------- images


def _read_image(
    path: Path, view: str | None, roles: Mapping[str, str] | None, spp: int | None
) -> Frame:
    from lambent.frame.ldr import read_image

    if view:
        raise FileError(f"there is no view '{view}': only EXR files have views", file=path)
    if roles:
        raise LayerError(
            f"a {_kind(path).upper()} has no layers to map to {', '.join(roles)}", file=path
        )
    image = read_image(path)
    layers = [
        Layer(Role.COLOUR, image.colour, name="RGB", space=Space.LINEAR, why="the only picture")
    ]
    if image.alpha is not None:
        layers.append(Layer(Role.ALPHA, image.alpha, name="A", why="the picture's alpha"))
    return Frame.from_layers(
        layers,
        spp=spp,
        origin=Origin(path, image.kind, image.facts),
        notes=image.notes,
    )


def _write_image(
    path: str | os.PathLike[str], kind: str, frame: Frame, overwrite: bool
) -> tuple[str, ...]:
    from lambent.frame.ldr import Facts, write_image

    facts = frame.origin.payload if frame.origin else None
    left_out = [f.name for f in frame.all_layers() if f.role not in (Role.COLOUR, Role.ALPHA)]
    notes = write_image(
        path,
        kind,
        frame[Role.COLOUR],
        frame.get(Role.ALPHA),
        facts if isinstance(facts, Facts) else Facts(),
        overwrite,
    )
    if left_out:
        notes = (*notes, f"A {kind.upper()} holds one picture: {', '.join(left_out)} left out.")
    return notes


def _kind(path: Path) -> str:
    """The kind of a file by its first bytes. Raises `FileError` for what Lambent cannot read."""
    descriptor = open_file(path)
    try:
        start = os.pread(descriptor, 64, 0)
    finally:
        os.close(descriptor)
    if not start:
        raise FileError("is empty", file=path, remedy="copy or render it again")
    found = kind_of(start)
    if found is not None and found[0] == "lambent":
        raise FileError(
            f"is {found[1]}, not a picture",
            file=path,
            remedy="look at a solution with 'lambent view', take a model with --model",
        )
    if found is None and path.suffix.lower() == ".exr":
        return "exr"  # its reader says what is wrong with it
    if found is None or found[0] not in READABLE:
        words = found[1] if found else "of a kind that Lambent does not know"
        raise FileError(
            f"is {words}",
            file=path,
            remedy="Lambent reads EXR, PNG, JPEG, TIFF, Radiance HDR and PFM",
        )
    return found[0]


def check_source(path: Path) -> None:
    """Raise `FileError` for a file that neither its name nor its first bytes call a picture."""
    if path.suffix.lower() not in ENDINGS:
        _kind(path)


def check_ending(path: str | os.PathLike[str]) -> None:
    """Raise `OutputError` for an output whose ending says no format that can be written."""
    _target_kind(path)


def _target_kind(path: str | os.PathLike[str]) -> str:
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise OutputError(
            f"cannot tell the format from the ending '{ending}'",
            file=path,
            remedy=f"end the name in {', '.join(ENDINGS)}",
        )
    return ENDINGS[ending]
