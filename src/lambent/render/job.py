"""The verb `render`: a scene file in, frames out.

``.xml`` and Mitsuba dictionaries are rendered by our own sampler (`lambent.render.sampling`),
``.blend`` files by Cycles (`lambent.render.cycles`). With an output the picture is kept there while
it grows.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
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
from lambent.progress import Progress
from lambent.render import plugins
from lambent.render.accumulate import (
    ATTRIBUTE,
    CHECKPOINT_SECONDS,
    Goal,
    Stamp,
    State,
    accumulate,
    resume,
    save,
    stamp_of,
)
from lambent.render.animation import Animation, Keyframes, Stage, disoccluded, read_keyframes
from lambent.render.complaint import complaint
from lambent.render.moments import Moments
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
    """Render a scene; the options are those of `render_all`.

    Returns the `Frame`, or the list of frames of an animation.

    ``lambent.render("scene.xml", spp=64)`` is a frame with colour, its variance, two half buffers,
    light split in several ways, and every feature (`lambent.render.channels`).
    """
    done = [r.frame for r in render_all(scene, output, **options)]
    return done if options.get("frames") is not None else done[0]


def render_all(
    source: Any,
    output: str | os.PathLike[str] | None = None,
    *,
    spp: int | str | None = None,
    time: float | None = None,
    target_error: float | None = None,
    size: tuple[int, int] | None = None,
    frames: Iterable[int] | None = None,
    camera: str | int | None = None,
    features: str | Iterable[str] = "all",
    depth: int | None = None,
    seed: int = 0,
    integrator: str | Any = "path",
    light_groups: Mapping[str, Iterable[str]] | None = None,
    animation: str | Animation | None = None,
    parameters: Mapping[str, Any] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    checkpoint: float = CHECKPOINT_SECONDS,
    device: str = "auto",
    report: Callable[[int | None, State], None] | None = None,
    report_cycles: Progress | None = None,
    note: Callable[[str], None] | None = None,
    written: Callable[[Path, Moments], None] | None = None,
) -> list[Rendered]:
    """Render a scene, one picture or the frames of an animation.

    ``spp``: samples a pixel in all (default 64 unless ``time`` or ``target_error`` end the render);
    ``"+64"``: so many more than there are. ``time``: seconds a picture. ``target_error``: estimated
    relMSE. ``integrator``: "path" (ours), "scene" (the scene's own), a plug-in's name, or an
    integrator. ``animation``: a TOML file of keyframes or a function ``frame -> Pose``; for a
    scene file the ``.toml`` beside it is taken when ``frames`` are asked for. ``resume``: go on
    with what ``output`` holds. ``checkpoint``: seconds after which ``output`` is written again.
    ``report(number, state)`` is called after every pass, ``note`` with remarks, ``written`` after
    every checkpoint.

    A .blend is rendered by Cycles, whole pictures with all features and the light groups and
    animation of the file: there ``time`` alone means at most 4,096 spp, and what is not Cycles' to
    do is refused.
    Raises `FileError`, `OptionError`, `UnknownNameError`, `OutputError`, `EngineError`.
    """
    if isinstance(source, (str, os.PathLike)) and str(source).endswith(".blend"):
        _refuse_for_cycles(
            {
                "target_error": target_error is not None,
                "resume": resume,
                "spp=+N": isinstance(spp, str) and spp.startswith("+"),
                "features": features != "all",
                "integrator": integrator != "path",
                "light_groups": bool(light_groups),
                "animation": animation is not None,
                "parameters": bool(parameters),
            }
        )
        return _cycles(
            source,
            output,
            None if frames is None else tuple(frames),
            note or (lambda text: None),
            report_cycles,
            spp=_wanted_spp(spp, time, None) or 4096,
            time=time,
            size=size,
            camera=camera,
            depth=depth,
            seed=seed,
            device=device,
            halves=True,
            overwrite=overwrite,
        )
    loaded = load(source, size=size, camera=camera, device=device, parameters=parameters)
    say = note or (lambda text: None)
    for text in loaded.notes:
        if integrator == "path" or "integrator" not in text:
            say(text)
    numbers = None if frames is None else tuple(frames)
    moving = _animation(animation, loaded, numbers)
    job = _Job(
        loaded,
        Goal(_wanted_spp(spp, time, target_error), time, target_error),
        spp if isinstance(spp, str) else None,
        features,
        _depth(depth, loaded),
        seed,
        _integrator(integrator, loaded),
        light_groups,
        resume,
        overwrite,
        checkpoint,
        report,
        say,
        written,
    )
    if numbers is None:
        if moving is not None:
            raise OptionError("an animation needs frames", remedy="give --frames 1-24")
        return [job.picture(None, None if output is None else Path(output))]
    if output is not None and not has_place(str(output)):
        raise OutputError(
            "has no place for a frame number", file=output, remedy="take -o shot.####.exr"
        )
    return _shot(job, moving, numbers, output)


def _signature_of_render() -> inspect.Signature:
    """For ``help``: the options of `render_all`, and `render`'s own first parameter."""
    first, *others = inspect.signature(render_all).parameters.values()
    returned = inspect.signature(render).return_annotation
    return inspect.Signature([first.replace(name="scene"), *others], return_annotation=returned)


render.__signature__ = _signature_of_render()  # type: ignore[attr-defined]


# ------------------------------------------------------------------- private


@dataclass(frozen=True)
class _Job:
    """What all pictures of one call share."""

    loaded: LoadedScene
    goal: Goal
    more: str | None
    features: str | Iterable[str]
    depth: int
    seed: int
    integrator: Any
    light_groups: Mapping[str, Iterable[str]] | None
    resume: bool
    overwrite: bool
    every: float
    report: Callable[[int | None, State], None] | None
    say: Callable[[str], None]
    written: Callable[[Path, Moments], None] | None

    def picture(
        self, number: int | None, path: Path | None, motion: Any = None, before: Frame | None = None
    ) -> Rendered:
        """One picture, begun or gone on with, written if it has a path."""
        from lambent.render.sampling import FrameSampler

        sampler = FrameSampler(
            self.loaded.scene,
            self.loaded.sensor,
            features=self.features,
            depth=self.depth,
            rr_depth=self.loaded.rr_depth or 5,
            integrator=self.integrator,
            light_groups=self.light_groups,
            motion=motion,
            file=self.loaded.path,
        )
        if sampler.left_out and number in (None, 0):
            self.say(
                "Light is not split, since only the sum is known of an integrator of Mitsuba's: "
                f"{', '.join(sampler.left_out)} left out."
            )
        stamp = self._stamp(sampler, number)
        windows = film_windows(self.loaded.sensor)
        start = self._start(path, stamp, sampler)
        began = start.spp if start else 0
        goal = self._goal(began)
        if start is not None and goal.spp is not None and began >= goal.spp:
            self.say(f"{path}: has {began} spp already; give more with --spp, or +N.")
            frame = read(path) if path is not None else start.frame(windows=windows)
            return Rendered(frame, path, number, began, skipped=True)

        def keep(moments: Moments) -> None:
            if path is not None:
                save(path, moments, stamp, windows)
                if self.written:
                    self.written(path, moments)

        def tell(state: State) -> None:
            if self.report:
                self.report(number, state)

        # Different frames have different noise, as in every renderer.
        seed = self.seed * 1_000_003 + (number or 0)
        moments = accumulate(
            sampler,
            goal,
            seed=seed,
            start=start,
            report=tell,
            checkpoint=keep if path else None,
            every=self.every,
        )
        if moments.dropped:
            self.say(
                f"{moments.dropped} samples had a radiance that is not finite (a BSDF or texture "
                "returns NaN); they were left out."
            )
        if path is None:
            return Rendered(_flagged(moments.frame(windows=windows), before), None, number, began)
        frame = _flagged(save(path, moments, stamp, windows), before)
        if before is not None:
            write(path, frame, overwrite=True, attributes={ATTRIBUTE: stamp.text()})
        if self.written:
            self.written(path, moments)
        return Rendered(frame, path, number, began)

    def _stamp(self, sampler: FrameSampler, number: int | None) -> Stamp:
        width, height = film_size(self.loaded.sensor)
        integrator = integrator_name(self.integrator) or "path"
        groups = {k: sorted(v) for k, v in (self.light_groups or {}).items()}
        return Stamp(
            self.loaded.digest,
            width,
            height,
            self.depth,
            self.seed,
            _camera_text(self.loaded.sensor),
            tuple(g.name for g in sampler.groups) + ((str(groups),) if groups else ()),
            integrator,
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
        check_target(path, overwrite=self.overwrite or self.resume or self.more is not None)
        if path.exists() and not self.overwrite:
            return resume(path, stamp, sampler.groups)
        return None

    def _goal(self, began: int) -> Goal:
        if self.more is None:
            return self.goal
        return Goal(began + int(self.more[1:]), self.goal.seconds, self.goal.error)


def _shot(
    job: _Job, moving: Animation | None, numbers: tuple[int, ...], output: Any
) -> list[Rendered]:
    """The frames of an animation, each with motion from the one before."""
    from lambent.render.variant import mitsuba

    if moving is None:
        raise OptionError(
            "frames were asked for, but nothing says what moves",
            remedy="write the keyframes to a .toml beside the scene, or name one with --animation",
        )
    stage = Stage(mitsuba(), job.loaded.scene, job.loaded.sensor, moving)
    done: list[Rendered] = []
    before: Frame | None = None
    for number in numbers:
        path = None if output is None else Path(put_number(str(output), number))
        # The first frame of all has no previous one: its motion is nought. A file of keyframes
        # says which that is; of a function it is the first that is asked for.
        first = moving.frames[0] if isinstance(moving, Keyframes) else numbers[0]
        previous = number - 1 if number > first else number
        motion = stage.motion(number, previous)
        if not done or done[-1].number != previous:  # the first of this call, or one was left out
            before = None if output is None else _earlier(Path(put_number(str(output), previous)))
        result = job.picture(number, path, motion, before if previous != number else None)
        done.append(result)
        before = result.frame
    return done


def _earlier(path: Path) -> Frame | None:
    """The frame before, where an earlier call left it."""
    return read(path) if path.exists() else None


def _refuse_for_cycles(given: Mapping[str, bool]) -> None:
    """Raises `OptionError` for an option that only Mitsuba scenes know."""
    asked = [name for name, there in given.items() if there]
    if asked:
        name = asked[0].replace("_", "-")
        raise OptionError(
            f"'{name}' is for Mitsuba scenes: Cycles renders whole pictures of so many samples, "
            "with all features and the file's own animation and light groups",
            remedy=f"leave out {name} for a .blend",
        )


def _cycles(
    source: Any,
    output: Any,
    numbers: tuple[int, ...] | None,
    say: Callable[[str], None],
    progress: Progress | None,
    **options: Any,
) -> list[Rendered]:
    """A .blend file, frame by frame from one Blender."""
    from lambent.render.cycles.blend import numbered, render_blend_frames

    done = []
    count = 1 if numbers is None else len(numbers)
    made = render_blend_frames(source, numbers, output=output, progress=progress, **options)
    for number, frame in made:
        path = None if output is None else numbered(output, number, count)
        for text in frame.notes:
            say(text)
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


def _wanted_spp(spp: int | str | None, time: float | None, error: float | None) -> int | None:
    if isinstance(spp, str):
        text = spp[1:] if spp.startswith("+") else spp
        if not text.isdigit() or int(text) < 1:
            raise OptionError(
                f"'{spp}' is no number of samples a pixel", remedy="take --spp 64, or --spp +64"
            )
        return int(text)
    if spp is None and time is None and error is None:
        return 64
    return spp


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


def _animation(
    wish: str | Animation | None, loaded: LoadedScene, numbers: tuple[int, ...] | None
) -> Animation | None:
    if isinstance(wish, (str, os.PathLike)):
        return read_keyframes(wish)
    if wish is None and numbers is not None and loaded.path is not None:
        beside = loaded.path.with_suffix(".toml")
        return read_keyframes(beside) if beside.exists() else None
    return wish


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
