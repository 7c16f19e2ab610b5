"""The verb `render`: a scene file in, frames out.

``.xml`` and Mitsuba dictionaries are rendered by our own sampler (`lambent.render.sampling`),
``.blend`` files by Cycles (`lambent.render.cycles`). With an output the picture is kept there while
it grows.
"""

from __future__ import annotations

import inspect
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lambent.errors import OptionError, OutputError, stop_by_interrupt
from lambent.frame.atomic import check_target
from lambent.frame.files import read, write
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role
from lambent.frame.sequence import has_place, put_number
from lambent.render import plugins
from lambent.render.accumulate import (
    ATTRIBUTE,
    Goal,
    Stamp,
    accumulate,
    resume,
    save,
    stamp_of,
)
from lambent.render.animation import Animation, Keyframes, Stage, disoccluded, read_keyframes
from lambent.render.complaint import complaint
from lambent.render.moments import Moments
from lambent.render.options import (
    CYCLES_SPP,
    OPTIONS,
    Effort,
    Listeners,
    Output,
    Shot,
    records_of,
    tell,
)
from lambent.render.scene import LoadedScene, film_size, film_windows, integrator_name, load

if TYPE_CHECKING:
    from lambent.render.sampling import FrameSampler

#: Bounces where neither the user nor the scene says how many.
DEFAULT_DEPTH = 12


@dataclass(frozen=True)
class Rendered:
    """A finished picture: its number in the animation, its file if one was written, its frame."""

    frame: Frame
    path: Path | None = None
    number: int | None = None
    #: Samples that were there already, and whether nothing had to be done.
    began_with: int = 0
    skipped: bool = False


def render(scene: Any, output: str | os.PathLike[str] | None = None, **options: Any) -> Any:
    """Render a scene; the options are the fields of the records in `lambent.render.options`.

    Returns the `Frame`, or the list of frames of an animation.

    ``lambent.render("scene.xml", spp=64)`` is a frame with colour, its variance, two half buffers,
    light split in several ways, and every feature (`lambent.render.channels`).
    """
    shot, effort, place, listeners = records_of({**options, "path": output})
    done = [r.frame for r in render_all(scene, shot, effort, place, listeners)]
    return done if shot.frames is not None else done[0]


def render_all(
    source: Any,
    shot: Shot = Shot(),
    effort: Effort = Effort(),
    output: Output = Output(),
    listeners: Listeners = Listeners(),
) -> list[Rendered]:
    """Render a scene, one picture or the frames of an animation.

    A .blend is rendered by Cycles, whole pictures with all features and the light groups and
    animation of the file: there a time alone means at most 4,096 spp, and what is not Cycles' to
    do is refused.
    Raises `FileError`, `OptionError`, `UnknownNameError`, `OutputError`, `EngineError`.
    """
    goal = effort.goal()
    numbers = None if shot.frames is None else tuple(shot.frames)
    shot = replace(shot, frames=numbers)
    if isinstance(source, (str, os.PathLike)) and str(source).endswith(".blend"):
        _refuse_for_cycles(shot, effort, output)
        return _cycles(source, shot, goal, output, listeners)
    loaded = load(
        source, size=shot.size, camera=shot.camera, device=shot.device, parameters=shot.parameters
    )
    for text in loaded.notes:
        if shot.integrator == "path" or "integrator" not in text:
            tell(listeners.note, text)
    moving = _animation(shot.animation, loaded, numbers)
    job = _Job(
        loaded,
        replace(
            shot,
            depth=_depth(shot.depth, loaded),
            integrator=_integrator(shot.integrator, loaded),
        ),
        effort,
        output,
        listeners,
    )
    if numbers is None:
        if moving is not None:
            raise OptionError("an animation needs frames", remedy="give --frames 1-24")
        return [job.picture(None, None if output.path is None else Path(output.path))]
    if output.path is not None and not has_place(str(output.path)):
        raise OutputError(
            "has no place for a frame number", file=output.path, remedy="take -o shot.####.exr"
        )
    return _frames(job, moving, numbers)


def _signature_of_render() -> inspect.Signature:
    """For ``help``: `render`'s own parameters, and the fields of the records."""
    scene, output, _ = inspect.signature(render).parameters.values()
    options = [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=field.type
        )
        for name, field in OPTIONS.items() if name != "path"
    ]  # fmt: skip
    returned = inspect.signature(render).return_annotation
    return inspect.Signature([scene, output, *options], return_annotation=returned)


render.__signature__ = _signature_of_render()  # type: ignore[attr-defined]


# ------------------------------------------------------------------- private


@dataclass(frozen=True)
class _Job:
    """A scene and what is asked of it; ``shot``: its depth and integrator found out."""

    loaded: LoadedScene
    shot: Shot
    effort: Effort
    output: Output
    listeners: Listeners

    def picture(
        self, number: int | None, path: Path | None, motion: Any = None, before: Frame | None = None
    ) -> Rendered:
        """One picture, begun or gone on with, written if it has a path."""
        from lambent.render.sampling import FrameSampler

        shot, listeners = self.shot, self.listeners
        assert shot.depth is not None
        sampler = FrameSampler(
            self.loaded.scene,
            self.loaded.sensor,
            features=shot.features,
            depth=shot.depth,
            rr_depth=self.loaded.rr_depth or 5,
            integrator=shot.integrator,
            light_groups=shot.light_groups,
            motion=motion,
            file=self.loaded.path,
        )
        if sampler.left_out and number in (None, 0):
            tell(
                listeners.note,
                "Light is not split, since only the sum is known of an integrator of Mitsuba's: "
                f"{', '.join(sampler.left_out)} left out.",
            )
        stamp = self._stamp(sampler, number)
        windows = film_windows(self.loaded.sensor)
        start = self._start(path, stamp, sampler)
        began = start.spp if start else 0
        goal = self.effort.goal(began)
        if start is not None and goal.spp is not None and began >= goal.spp:
            tell(listeners.note, f"{path}: has {began} spp already; give more with --spp, or +N.")
            frame = read(path) if path is not None else start.frame(windows=windows)
            return Rendered(frame, path, number, began, skipped=True)

        def keep(moments: Moments) -> None:
            if path is not None:
                save(path, moments, stamp, windows)
                tell(listeners.written, path, moments)

        moments = accumulate(
            sampler,
            goal,
            # different frames have different noise, as in every renderer
            seed=shot.seed * 1_000_003 + (number or 0),
            start=start,
            report=lambda state: tell(listeners.report, number, state),
            checkpoint=keep if path else None,
            every=self.output.checkpoint,
        )
        if moments.dropped:
            tell(
                listeners.note,
                f"{moments.dropped} samples had a radiance that is not finite (a BSDF or texture "
                "returns NaN); they were left out.",
            )
        if path is None:
            return Rendered(_flagged(moments.frame(windows=windows), before), None, number, began)
        frame = _flagged(save(path, moments, stamp, windows), before)
        if before is not None:
            write(path, frame, overwrite=True, attributes={ATTRIBUTE: stamp.text()})
        tell(listeners.written, path, moments)
        return Rendered(frame, path, number, began)

    def _stamp(self, sampler: FrameSampler, number: int | None) -> Stamp:
        width, height = film_size(self.loaded.sensor)
        groups = {k: sorted(v) for k, v in (self.shot.light_groups or {}).items()}
        assert self.shot.depth is not None
        return Stamp(
            self.loaded.digest,
            width,
            height,
            self.shot.depth,
            self.shot.seed,
            _camera_text(self.loaded.sensor),
            tuple(g.name for g in sampler.groups) + ((str(groups),) if groups else ()),
            integrator_name(self.shot.integrator) or "path",
            number or 0,
        )

    def _start(self, path: Path | None, stamp: Stamp, sampler: FrameSampler) -> Moments | None:
        if path is None:
            return None
        if path.suffix.lower() != ".exr":
            raise OutputError(
                "a render has many layers, which only an EXR holds",
                file=path,
                remedy="end the name in .exr",
            )
        check_target(path, self.output.overwrite or self.output.resume or self.effort.more)
        if path.exists() and not self.output.overwrite:
            return resume(path, stamp, sampler.groups)
        return None


def _frames(job: _Job, moving: Animation | None, numbers: tuple[int, ...]) -> list[Rendered]:
    """The frames of an animation, each with motion from the one before."""
    from lambent.render.variant import mitsuba

    if moving is None:
        raise OptionError(
            "frames were asked for, but nothing says what moves",
            remedy="write the keyframes to a .toml beside the scene, or name one with --animation",
        )
    stage = Stage(mitsuba(), job.loaded.scene, job.loaded.sensor, moving)

    def place(number: int) -> Path | None:
        path = job.output.path
        return None if path is None else Path(put_number(str(path), number))

    done: list[Rendered] = []
    before: Frame | None = None
    for number in numbers:
        # The first frame of all has no previous one: its motion is nought. A file of keyframes
        # says which that is; of a function it is the first that is asked for.
        first = moving.frames[0] if isinstance(moving, Keyframes) else numbers[0]
        previous = number - 1 if number > first else number
        motion = stage.motion(number, previous)
        if not done or done[-1].number != previous:  # the first of this call, or one was left out
            before = _earlier(place(previous))
        result = job.picture(number, place(number), motion, before if previous != number else None)
        done.append(result)
        before = result.frame
    return done


def _earlier(path: Path | None) -> Frame | None:
    """The frame before, where an earlier call left it."""
    return read(path) if path is not None and path.exists() else None


def _refuse_for_cycles(shot: Shot, effort: Effort, output: Output) -> None:
    """Raises `OptionError` for an option that only Mitsuba scenes know."""
    asked = {
        "target-error": effort.target_error is not None,
        "resume": output.resume,
        "spp=+N": effort.more,
        "features": shot.features != "all",
        "integrator": shot.integrator != "path",
        "light-groups": bool(shot.light_groups),
        "animation": shot.animation is not None,
        "parameters": bool(shot.parameters),
    }
    for name, there in asked.items():
        if there:
            raise OptionError(
                f"'{name}' is for Mitsuba scenes: Cycles renders whole pictures of so many "
                "samples, with all features and the file's own animation and light groups",
                remedy=f"leave out {name} for a .blend",
            )


def _cycles(
    source: Any, shot: Shot, goal: Goal, output: Output, listeners: Listeners
) -> list[Rendered]:
    """A .blend file, frame by frame from one Blender."""
    from lambent.render.cycles.blend import numbered, render_blend_frames

    numbers = None if shot.frames is None else tuple(shot.frames)
    made = render_blend_frames(
        source,
        numbers,
        output=output.path,
        overwrite=output.overwrite,
        spp=goal.spp or CYCLES_SPP,
        time=goal.seconds,
        size=shot.size,
        camera=None if shot.camera is None else str(shot.camera),
        depth=shot.depth,
        seed=shot.seed,
        device=shot.device,
        halves=True,
        progress=listeners.report_cycles,
    )
    done = []
    for number, frame in made:
        count = 1 if numbers is None else len(numbers)
        path = None if output.path is None else numbered(output.path, number, count)
        for text in frame.notes:
            tell(listeners.note, text)
        done.append(Rendered(frame, path, None if numbers is None else number))
    return done


def _flagged(frame: Frame, before: Frame | None) -> Frame:
    """With a mask of what the frame before did not show."""
    if before is None or "previous_depth" not in frame.extras:
        return frame
    if "first_depth" not in before.extras or before[Role.COLOUR].shape != frame[Role.COLOUR].shape:
        return frame
    mask = disoccluded(frame, before)[:, :, None].astype(np.float32)
    return frame.with_layer(Layer(Role.ID, mask, name="disocclusion_mask"))


def _depth(depth: int | None, loaded: LoadedScene) -> int:
    if depth is not None:
        return depth
    return DEFAULT_DEPTH if loaded.depth is None else loaded.depth


def _integrator(wish: Any, loaded: LoadedScene) -> Any:
    from lambent.render.variant import mitsuba

    if wish == "path":
        return None
    if wish == "scene":
        return loaded.scene.integrator()
    if isinstance(wish, str):
        mi = mitsuba()
        reason = ""
        try:
            plugins.check(mi, {wish: ""}, "--integrator")
            made = mi.load_dict({"type": wish})
            if isinstance(made, mi.Integrator):
                return made
        except Exception as error:
            stop_by_interrupt(error)
            reason = f": {getattr(error, 'message', None) or complaint(error)}"
        raise OptionError(
            f"Mitsuba has no integrator '{wish}'{reason}",
            remedy="take path, volpath, prb, direct, … or scene for the scene's own",
        )
    return wish


def _camera_text(sensor: Any) -> str:
    import hashlib

    return hashlib.sha256(str(sensor).encode()).hexdigest()[:12]


def _animation(wish: Any, loaded: LoadedScene, numbers: tuple[int, ...] | None) -> Animation | None:
    if isinstance(wish, (str, os.PathLike)):
        return read_keyframes(Path(wish))
    if wish is None and numbers is not None and loaded.path is not None:
        beside = loaded.path.with_suffix(".toml")
        return read_keyframes(beside) if beside.exists() else None
    moving: Animation | None = wish
    return moving


def frames_of(animation: str | os.PathLike[str] | None, scene: Any) -> tuple[int, ...] | None:
    """The frames that an animation file speaks of, for ``--frames all``; None without one."""
    path = None if animation is None else Path(animation)
    if path is None and isinstance(scene, (str, os.PathLike)):
        beside = Path(scene).with_suffix(".toml")
        path = beside if beside.exists() else None
    if path is None:
        return None
    found: Keyframes = read_keyframes(path)
    return found.frames


__all__ = ["Rendered", "frames_of", "render", "render_all", "stamp_of"]
