"""What can be asked of a render, in four records: what, how long, where to, and who listens.

`lambent.render` takes their fields as keywords.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from lambent.errors import OptionError
from lambent.render.accumulate import CHECKPOINT_SECONDS, Goal, State
from lambent.render.animation import Animation
from lambent.render.moments import Moments

T = TypeVar("T")
#: Samples a pixel where nothing says when to end; of Cycles, where time alone does.
SPP, CYCLES_SPP = 64, 4096


@dataclass(frozen=True)
class Shot:
    """What is rendered.

    ``size``: in pixels, and ``camera``: name or number, None for the scene's. ``features``: layers
    beside the colour (`lambent.render.channels.chosen`). ``depth``: most vertices of a path, None
    for the scene's. ``integrator``: "path" (ours), "scene" (the scene's own), a plug-in's name, or
    an integrator. ``light_groups``: name -> patterns of emitter ids. ``parameters``: values of the
    scene's ``$names``. ``device``: auto, cpu or cuda. ``frames``: numbers, None for one picture.
    ``animation``: a TOML file of keyframes or a function ``frame -> Pose``; None for the ``.toml``
    beside a scene file.
    """

    size: tuple[int, int] | None = None
    camera: str | int | None = None
    features: str | Iterable[str] = "all"
    depth: int | None = None
    seed: int = 0
    integrator: str | Any = "path"
    light_groups: Mapping[str, Iterable[str]] | None = None
    parameters: Mapping[str, Any] | None = None
    device: str = "auto"
    frames: Iterable[int] | None = None
    animation: str | os.PathLike[str] | Animation | None = None


@dataclass(frozen=True)
class Effort:
    """When a picture is done.

    ``spp``: samples a pixel in all (64 unless something else ends the render); ``"+64"``: so many
    more than there are. ``time``: seconds. ``target_error``: estimated relMSE.
    """

    spp: int | str | None = None
    time: float | None = None
    target_error: float | None = None

    @property
    def more(self) -> bool:
        """Whether ``spp`` is added to what is there."""
        return isinstance(self.spp, str) and self.spp.startswith("+")

    def goal(self, began: int = 0) -> Goal:
        """For a picture that has ``began`` samples a pixel. Raises `OptionError`."""
        spp = self.spp
        if isinstance(spp, str):
            text = spp.removeprefix("+")
            if not text.isdigit():
                raise OptionError(
                    f"'{spp}' is not a number of samples per pixel",
                    remedy="take --spp 64, or --spp +64",
                )
            spp = int(text) + (began if self.more else 0)
        if spp is None and self.time is None and self.target_error is None:
            spp = SPP
        return Goal(spp, self.time, self.target_error)


@dataclass(frozen=True)
class Output:
    """Where pictures go: ``path``, a pattern for frames, or None to keep them in memory.

    ``resume``: go on with what is there. ``checkpoint``: seconds after which it is written again.
    """

    path: str | os.PathLike[str] | None = None
    resume: bool = False
    overwrite: bool = False
    checkpoint: float = CHECKPOINT_SECONDS


@dataclass(frozen=True)
class Listeners:
    """Whom to tell: ``report`` after every pass, with the frame's number; ``report_cycles`` as
    Cycles goes on; ``note`` of remarks; ``written`` after every checkpoint.
    """

    report: Callable[[int | None, State], None] | None = None
    report_cycles: Callable[..., None] | None = None
    note: Callable[[str], None] | None = None
    written: Callable[[Path, Moments], None] | None = None


def tell(listener: Callable[..., None] | None, *what: Any) -> None:
    """Call a listener, if there is one."""
    if listener is not None:
        listener(*what)


#: Every field by name.
OPTIONS = {f.name: f for kind in (Shot, Effort, Output, Listeners) for f in fields(kind)}


def records_of(options: Mapping[str, Any]) -> tuple[Shot, Effort, Output, Listeners]:
    """The four records from their fields by name. Raises `TypeError` for another name."""
    for name in options:
        if name not in OPTIONS:
            raise TypeError(f"render() got an unexpected keyword argument '{name}'")

    def made(kind: type[T]) -> T:
        names = [f.name for f in fields(kind) if f.name in options]  # type: ignore[arg-type]
        return kind(**{name: options[name] for name in names})

    return made(Shot), made(Effort), made(Output), made(Listeners)
