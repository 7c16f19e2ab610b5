"""One file in, one file out: read, denoise every view, write beside, and say what was done.

The three steps `load`, `process` and `save` are apart so that a sequence can overlap them
(`lambent.denoise.sequence`). Results carry a stamp, the attribute ``lambent:settings``, that tells
which settings made them; it is how a repeated command knows what is finished.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lambent import memory
from lambent.denoise.pipeline import (
    Settings,
    choose_layers,
    clean,
    plan_frame,
    view_with_beauty,
    without_beauty,
)
from lambent.errors import FileError, OutputError
from lambent.frame.atomic import check_target, refuse_stdout
from lambent.frame.frame import Frame
from lambent.frame.opening import exists, refuse_special, unreadable
from lambent.frame.role import Role, Stat
from lambent.frame.stamp import CHOSEN, STAMP
from lambent.progress import Progress

#: What the default output's name has more than the input's.
SUFFIX = "_clean"
#: What a preview's name has more than that of the result it stands beside.
PREVIEW_SUFFIX = "_preview.png"


@dataclass(frozen=True)
class Loaded:
    """A file's views, read and not yet touched."""

    source: Path
    views: Mapping[str, Frame]
    seconds: float


@dataclass(frozen=True)
class Processed:
    """Denoised views that wait for being written, and the account so far.

    ``before`` holds the input's views where the caller wanted to keep them.
    """

    source: Path
    views: Mapping[str, Frame]
    before: Mapping[str, Frame]
    result: Result


@dataclass(frozen=True)
class Result:
    """What was done to one file.

    ``layers``: names of the filtered layers. ``notes`` and ``repairs``: one sentence each.
    ``seconds`` by stage (read, repair, filter, blend, write, total). ``peak_memory``: bytes, of
    the whole process so far. ``views``: names of stereo views, or ``("",)``.
    """

    source: Path
    output: Path | None
    model: str
    width: int
    height: int
    spp: int | None
    dialect: str
    views: tuple[str, ...]
    layers: tuple[str, ...]
    notes: tuple[str, ...]
    repairs: tuple[str, ...]
    tiles: str
    seconds: Mapping[str, float] = field(default_factory=dict)
    peak_memory: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        fields["source"] = str(self.source)
        fields["output"] = None if self.output is None else str(self.output)
        fields["seconds"] = {name: round(value, 4) for name, value in self.seconds.items()}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in fields.items()}


def default_output(source: Path) -> Path:
    """``shot.exr`` to ``shot_clean.exr``, beside it."""
    return source.with_name(f"{source.stem}{SUFFIX}{source.suffix}")


def output_for(source: Path, output: str | Path | None) -> Path:
    """Where the result of one file goes: ``output``, or the input's name in it if a directory.

    A name that ends in a slash, or has no ending at all, means a directory. Raises `OutputError`
    for ``-``.
    """
    refuse_stdout(output)
    if output is None:
        return default_output(source)
    target = Path(output)
    if str(output).endswith(("/", os.sep)) or os.path.isdir(target) or not target.suffix:
        return target / source.name
    return target


def make_folder(folder: Path) -> None:
    """Make an output directory of which only the last part is missing."""
    if os.path.exists(folder) or not os.path.isdir(folder.parent):
        return
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"this directory cannot be made: {error.strerror}",
            file=folder,
            remedy="choose another with -o",
        ) from error


def denoise_file(
    source: str | Path,
    output: str | Path | None = None,
    *,
    settings: Settings | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Result:
    """Denoise a file into a file; the default output is ``NAME_clean.exr`` beside it.

    ``options`` are those of `Settings.checked` where ``settings`` is not given. Everything that is
    not filtered is written back bit for bit. Raises `lambent.LambentError` and its kinds; nothing
    is left behind on failure.
    """
    settings = settings or Settings.checked(**options)
    source = Path(source)
    target = output_for(source, output)
    check_output(source, target, overwrite)
    check_guides(source, target, settings)
    if progress is not None:
        progress(0, 1, "reading")
    return save(process(load(source, settings), settings, progress), target, settings, overwrite)


def load(source: Path, settings: Settings, number: int | None = None) -> Loaded:
    """Read all views of a file, and guides that have files of their own.

    ``number``: of the frame, for guides named by a pattern; None: the last number in its name.
    Raises `FileError` and its kinds.
    """
    from lambent.frame.files import read_views

    start = time.perf_counter()
    roles = roles_of(source, settings, number)
    views = read_views(source, roles=roles or None, spp=settings.spp)
    return Loaded(source, views, time.perf_counter() - start)


def roles_of(source: Path, settings: Settings, number: int | None = None) -> dict[str, str]:
    """The choices of layers and guide files for one frame. Raises `OptionError`."""
    from lambent.frame.guides import numbered

    return numbered(settings.roles, number if number is not None else number_of(source), source)


def number_of(path: Path) -> int | None:
    """The last number in a file's name."""
    found = re.findall(r"\d+", path.stem)
    return int(found[-1]) if found else None


def guides_of(source: Path, settings: Settings, number: int | None = None) -> list[Path]:
    """The files of a frame's guides. Raises `OptionError`."""
    from lambent.frame.guides import paths

    return paths(roles_of(source, settings, number))


def check_guides(source: Path, output: Path, settings: Settings, number: int | None = None) -> None:
    """Refuse guide files that are not there, or that the output would replace."""
    for path in guides_of(source, settings, number):
        refuse_special(path)
        if not exists(path):
            raise FileError("there is no such file", file=path, remedy="check the guide's name")
        if os.path.exists(output) and output.samefile(path):
            raise OutputError(
                "the output is the file of a guide", file=output, remedy="write elsewhere with -o"
            )


def process(
    loaded: Loaded, settings: Settings, progress: Progress | None = None, keep: bool = False
) -> Processed:
    """Denoise every view that has a beauty; others stay as they are, with a note.

    ``keep``: hold on to the input for a preview or a report. Raises `LayerError` if no view has a
    beauty.
    """
    main = view_with_beauty(loaded.views)  # raises if there is nothing to filter at all
    settings = settings.suited(loaded.views[main])
    cleaned = {
        name: clean(view, settings, progress)
        for name, view in loaded.views.items()
        if view.has(Role.COLOUR)
    }
    kept = [name for name in loaded.views if name not in cleaned]
    seconds = {"read": loaded.seconds}
    for one in cleaned.values():
        for stage, value in one.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + value
    first = next(iter(cleaned.values()))
    beauty = first.frame[Role.COLOUR]
    result = Result(
        source=loaded.source,
        output=None,
        model=settings.label,
        width=beauty.shape[1],
        height=beauty.shape[0],
        spp=first.frame.spp,
        dialect=first.frame.dialect,
        views=tuple(loaded.views),
        layers=_unique(name for one in cleaned.values() for name in one.layers),
        notes=_unique(
            [f"{without_beauty(name)} and stays as it is" for name in kept]
            + [
                note
                for one in cleaned.values()
                for note in one.frame.notes
                if note not in one.repairs.notes()  # `repairs` has them
            ]
        ),
        repairs=_unique(
            f"view {name}: {line}" if len(cleaned) > 1 else line
            for name, one in cleaned.items()
            for line in one.repairs.sentences()
        ),
        tiles=first.plan.describe() if first.plan else "",
        seconds=seconds,
    )
    frames = {
        name: _released(_without_guides(cleaned[name].frame if name in cleaned else view))
        for name, view in loaded.views.items()
    }
    return Processed(loaded.source, frames, loaded.views if keep else {}, result)


def save(processed: Processed, output: Path, settings: Settings, overwrite: bool) -> Result:
    """Write the denoised views, atomically; complete the account."""
    from lambent.frame.files import write_noted, write_views_noted

    start = time.perf_counter()
    make_folder(output.parent)
    attributes = {STAMP: stamp(settings, processed.result.model)}
    if len(processed.views) == 1:
        frame = next(iter(processed.views.values()))
        written = write_noted(output, frame, overwrite=overwrite, attributes=attributes)
    else:
        written = write_views_noted(
            output, processed.views, overwrite=overwrite, attributes=attributes
        )
    seconds = {**processed.result.seconds, "write": time.perf_counter() - start}
    seconds["total"] = sum(seconds.values())
    return dataclasses.replace(
        processed.result,
        output=written.path,
        notes=_unique((*processed.result.notes, *written.notes)),
        seconds=seconds,
        peak_memory=memory.peak(),
    )


def stamp(settings: Settings, model: str) -> str:
    """The settings, and the model that was chosen, as the text that the attribute `STAMP` holds."""
    chosen = {} if model == settings.model else {CHOSEN: model}
    return json.dumps({**settings.key(), **chosen}, sort_keys=True)


def check_output(source: Path, output: Path, overwrite: bool) -> None:
    """Refuse an output that cannot or must not be written, before any work is done.

    A directory of which only the last part is missing is no fault: `save` will make it.
    """
    from lambent.frame.files import check_ending, check_source

    if not exists(source):
        raise unreadable(source, FileNotFoundError())
    refuse_special(source)
    check_source(source)
    if os.path.isdir(output):
        raise OutputError(
            "the output is a directory",
            file=output,
            remedy=f"name a file in it: -o {output / default_output(source).name}",
        )
    check_ending(output)
    parent = output.parent
    if not os.path.lexists(parent) and os.path.isdir(parent.parent):
        check_target(parent)  # whether the directory can be made
        return
    if not overwrite and os.path.exists(output):
        if output.samefile(source):
            raise OutputError(
                "the output is the input itself",
                file=output,
                remedy="write elsewhere with -o NAME, and keep the noisy original",
            )
        raise OutputError(
            "exists already",
            file=output,
            remedy="write elsewhere with -o NAME, or allow it with --overwrite",
        )
    check_target(output, overwrite)


def outline(
    source: Path, output: Path, settings: Settings, number: int | None = None
) -> dict[str, Any]:
    """What `denoise_file` would do, for ``--dry-run``: roles, layers, output, tiles."""
    loaded = load(source, settings, number)
    first = loaded.views[view_with_beauty(loaded.views)]
    settings = settings.suited(first)
    return {
        "source": str(source),
        "output": str(output),
        "model": settings.label,
        "dialect": first.dialect,
        "strength": settings.strength,
        "views": {name: _outlined(frame, settings) for name, frame in loaded.views.items()},
    }


def _outlined(frame: Frame, settings: Settings) -> dict[str, Any]:
    """What would be done to one view."""
    from lambent.frame.guides import is_guide

    chosen, tiles, notes = [], "", [f"{without_beauty(frame.view)} and stays as it is"]
    if frame.has(Role.COLOUR):
        denoiser = settings.denoiser()
        denoiser.check(frame)
        chosen = choose_layers(frame, settings)
        tiles, notes = plan_frame(frame, denoiser, chosen, settings).describe(), []
        notes += filter(None, [settings.remark])
    names = [layer.name for layer in chosen]
    return {
        "roles": {
            role.value if stat is Stat.MEAN else f"{role.value}.{stat.value}": layer.name
            for (role, stat), layer in frame.layers.items()
        },
        "why": {layer.name: layer.why for layer in frame.layers.values()},
        "filtered": names,
        "untouched": sorted(
            layer.name
            for layer in frame.all_layers()
            if layer.name not in names and not is_guide(layer)
        ),
        "width": frame.width,
        "height": frame.height,
        "tiles": tiles,
        "notes": [*notes, *frame.notes],
    }


def write_preview(path: Path, before: Frame, after: Frame) -> Path:
    """A PNG with the input on the left and the result on the right, at one exposure."""
    from lambent.frame.atomic import atomic
    from lambent.frame.ldr import exposure_of
    from lambent.frame.tonemap import to_png

    exposure = exposure_of(after)
    white = np.full((after.height, max(2, after.width // 200), 3), 1 / exposure, np.float32)
    pair = np.concatenate([before.colour, white, after.colour], axis=1)
    with atomic(path, overwrite=True) as file:
        file.write(to_png(pair, exposure))
    return path


# ------------------------------------------------------------------- private


def _released(frame: Frame) -> Frame:
    """The frame without pixels that can be decoded again: writing needs the memory."""

    def fresh(layer: Any) -> Any:
        return dataclasses.replace(layer, _decoded=[]) if callable(layer.pixels) else layer

    return frame.replace(
        layers={key: fresh(layer) for key, layer in frame.layers.items()},
        extras={name: fresh(layer) for name, layer in frame.extras.items()},
    )


def _without_guides(frame: Frame) -> Frame:
    """The frame without layers of other files: they were looked at and are not written."""
    from lambent.frame.guides import is_guide

    return frame.replace(layers={k: v for k, v in frame.layers.items() if not is_guide(v)})


def _unique(items: Any) -> tuple[str, ...]:
    return tuple(dict.fromkeys(items))
