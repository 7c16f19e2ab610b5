"""One file in, one file out: read, denoise every view, write beside, and say what was done.

The three steps `load`, `process` and `save` are apart so that a sequence can overlap them
(`lambent.denoise.sequence`). Results carry a stamp, the attribute ``lambent:settings``, that tells
which settings made them; it is how a repeated command knows what is finished.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lambent.denoise import memory
from lambent.denoise.pipeline import Settings, choose_layers, clean, plan_frame
from lambent.denoise.tiles import Progress
from lambent.errors import FileError, OutputError
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat

#: The EXR attribute that holds the settings a file was made with.
STAMP = "lambent:settings"

#: What the default output's name has more than the input's.
SUFFIX = "_clean"


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

    A name that ends in a slash, or has no ending at all, means a directory.
    """
    if output is None:
        return default_output(source)
    target = Path(output)
    if str(output).endswith(("/", os.sep)) or target.is_dir() or not target.suffix:
        return target / source.name
    return target


def make_folder(folder: Path) -> None:
    """Make an output directory of which only the last part is missing."""
    if folder.exists() or not folder.parent.is_dir():
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
    check_output(source, target, overwrite, folder=output)
    if progress is not None:
        progress(0, 1, "reading")
    return save(process(load(source, settings), settings, progress), target, settings, overwrite)


def load(source: Path, settings: Settings) -> Loaded:
    """Read all views of a file. Raises `FileError` and its kinds."""
    from lambent.frame.files import read_views

    start = time.perf_counter()
    views = read_views(source, roles=settings.roles or None)
    return Loaded(source, views, time.perf_counter() - start)


def process(
    loaded: Loaded, settings: Settings, progress: Progress | None = None, keep: bool = False
) -> Processed:
    """Denoise every view. ``keep``: hold on to the input for a preview or a report."""
    cleaned = {name: clean(view, settings, progress) for name, view in loaded.views.items()}
    seconds = {"read": loaded.seconds}
    for one in cleaned.values():
        for stage, value in one.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + value
    first = next(iter(cleaned.values()))
    beauty = first.frame[Role.COLOUR]
    result = Result(
        source=loaded.source,
        output=None,
        model=settings.model,
        width=beauty.shape[1],
        height=beauty.shape[0],
        spp=first.frame.spp,
        dialect=first.frame.dialect,
        views=tuple(cleaned),
        layers=_unique(name for one in cleaned.values() for name in one.layers),
        notes=_unique(
            note
            for one in cleaned.values()
            for note in one.frame.notes
            if note not in one.repairs.notes()  # `repairs` has them
        ),
        repairs=_unique(
            f"view {name}: {line}" if len(cleaned) > 1 else line
            for name, one in cleaned.items()
            for line in one.repairs.sentences()
        ),
        tiles=first.plan.describe() if first.plan else "",
        seconds=seconds,
    )
    frames = {name: _released(one.frame) for name, one in cleaned.items()}
    return Processed(loaded.source, frames, loaded.views if keep else {}, result)


def save(processed: Processed, output: Path, settings: Settings, overwrite: bool) -> Result:
    """Write the denoised views, atomically; complete the account."""
    from lambent.frame.files import write_noted, write_views_noted

    start = time.perf_counter()
    make_folder(output.parent)
    attributes = {STAMP: stamp(settings)}
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


def stamp(settings: Settings) -> str:
    """The settings as the text that the attribute `STAMP` holds."""
    return json.dumps(settings.key(), sort_keys=True)


def check_output(
    source: Path, output: Path, overwrite: bool, folder: str | Path | None = None
) -> None:
    """Refuse an output that cannot or must not be written, before any work is done.

    ``folder``: what the user gave; where that names a directory (see `output_for`), `save` will
    make it.
    """
    from lambent.frame.files import check_ending

    if not source.exists():
        raise FileError(
            "there is no such file", file=source, remedy="check the path; quote names with spaces"
        )
    if output.is_dir():
        raise OutputError(
            "the output is a directory",
            file=output,
            remedy=f"name a file in it: -o {output / default_output(source).name}",
        )
    check_ending(output)
    if overwrite and output.exists():
        return
    if output.exists():
        same = output.samefile(source)
        raise OutputError(
            "the output is the input itself" if same else "this file exists already",
            file=output,
            remedy="write elsewhere with -o NAME, or allow it with --overwrite",
        )
    parent = output.parent
    if folder is not None and Path(folder) == parent and not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise OutputError(
            "is no directory" if parent.exists() else "this directory does not exist",
            file=parent,
            remedy=f"mkdir -p '{parent}'" if not parent.exists() else "choose another with -o",
        )


def outline(source: Path, output: Path, settings: Settings) -> dict[str, Any]:
    """What `denoise_file` would do, for ``--dry-run``: roles, layers, output, tiles."""
    loaded = load(source, settings)
    views = {}
    for name, frame in loaded.views.items():
        denoiser = settings.denoiser()
        if not frame.has(Role.COLOUR):
            raise frame.missing(Role.COLOUR)
        denoiser.check(frame)
        chosen = choose_layers(frame, settings)
        plan = plan_frame(frame, denoiser, chosen, settings)
        views[name] = {
            "roles": {
                role.value if stat is Stat.MEAN else f"{role.value}.{stat.value}": layer.name
                for (role, stat), layer in frame.layers.items()
            },
            "why": {layer.name: layer.why for layer in frame.layers.values()},
            "filtered": [layer.name for layer in chosen],
            "untouched": sorted(
                layer.name
                for layer in frame.all_layers()
                if layer.name not in {c.name for c in chosen}
            ),
            "width": frame.width,
            "height": frame.height,
            "tiles": plan.describe(),
            "notes": list(frame.notes),
        }
    return {
        "source": str(source),
        "output": str(output),
        "model": settings.model,
        "dialect": next(iter(loaded.views.values())).dialect,
        "strength": settings.strength,
        "views": views,
    }


def write_preview(path: Path, before: Frame, after: Frame) -> Path:
    """A PNG with the input on the left and the result on the right, at one exposure."""
    from lambent.frame.atomic import atomic
    from lambent.frame.tonemap import auto_exposure, to_png

    exposure = auto_exposure(after.colour)
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


def _unique(items: Any) -> tuple[str, ...]:
    return tuple(dict.fromkeys(items))
