"""From a job to its finished items: scene, pilot, windows, noise levels, target.

The noise levels of an item and every pass of its target draw from random numbers of their own, so
that all are independent of each other. A target begins with the recipe's spp, or a multiple of the
highest noise level, and goes on in passes until its expected relMSE is small enough.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lambent.dataset.item import Item, Still
from lambent.dataset.pack import packed
from lambent.dataset.plan import (
    STILL,
    Job,
    cameras,
    generator,
    level_spp,
    number,
    per_scene,
    scene_seed,
)
from lambent.dataset.recipe import Recipe
from lambent.dataset.source import (
    Draw,
    Scene,
    Source,
    UnfitSceneError,
    View,
    WholeScene,
    Window,
)
from lambent.dataset.windows import Choice, choose
from lambent.errors import LambentError, stop_by_interrupt
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat
from lambent.interrupts import stop_if_came
from lambent.metrics.relmse import EPSILON, expected_relmse
from lambent.phases import Phases

#: So many crops of a camera are rendered together on this machine. It changes nothing in them;
#: recording the kernel takes 0.3 s, and this many crops are lost when a process is killed.
BATCH = 4
#: So many scenes are tried in the place of one that is unfit.
ATTEMPTS = 8


@dataclass(frozen=True)
class Made:
    """A finished item: the bytes of its file, their hash, and what is known of it."""

    what: str
    index: int
    content: bytes
    sha256: str
    about: dict[str, Any]
    seconds: float


@dataclass(frozen=True)
class Failed:
    """Items of a job that could not be made, and why."""

    job: Job
    reason: str


@dataclass(frozen=True)
class _Set:
    """A scene that is fit, with the crops that are to be cut from it: camera and choice of each."""

    scene: Scene | WholeScene
    attempt: int
    crops: tuple[tuple[int, Choice], ...]
    rejected: tuple[str, ...]


def produce(
    recipe: Recipe, source: Source, job: Job, phases: Phases, batch: int = BATCH
) -> Iterator[Made]:
    """The items of a job, one after the other. Raises `LambentError` if no scene is fit."""
    start = time.perf_counter()
    found = _find(recipe, source, job, phases)
    spent = time.perf_counter() - start
    for items in _batches(recipe, job, found, batch):
        start = time.perf_counter()
        drawn = _batch(recipe, job, items, found, phases)
        # What is common to several items is shared by them.
        shared = (time.perf_counter() - start) / len(items) + spent / len(job.items)
        for index, stills in zip(items, drawn, strict=True):
            start = time.perf_counter()
            with phases("encode"):
                about = _about(recipe, job, index, found, stills)
                content = packed(Item(stills, about))
                sha = hashlib.sha256(content).hexdigest()
            seconds = time.perf_counter() - start + shared
            yield Made(job.what, index, content, sha, about, seconds)


def attempt(
    recipe: Recipe, source: Source, job: Job, phases: Phases, batch: int = BATCH
) -> Iterator[Made | Failed]:
    """Like `produce`; what goes wrong with a scene becomes a `Failed`, so that others go on.

    Raises `KeyboardInterrupt`, in whatever disguise it comes.
    """
    try:
        yield from produce(recipe, source, job, phases, batch)
    except Exception as error:  # whatever a renderer raises for one scene
        stop_by_interrupt(error)
        yield Failed(job, f"{type(error).__name__}: {error}")


# ------------------------------------------------------------------- private


def _place(recipe: Recipe, job: Job, index: int) -> int:
    return index - job.number * per_scene(recipe, job.what)


def _find(recipe: Recipe, source: Source, job: Job, phases: Phases) -> _Set:
    """The first fit scene of a job. Depends on the recipe and the job's number alone.

    So another takes the place of one that is itself unfit, and never of one that met with an error:
    that may lie in the machine, in the moment, or in a signal, and would change the set for good.
    """
    rejected = []
    for attempt in range(ATTEMPTS):
        seed = scene_seed(recipe, job, attempt)
        stop_if_came()
        try:
            with phases("scene"):
                scene = source.scene(
                    seed, job.number, 1 if job.what == STILL else recipe.clip_frames
                )
            crops = _crops(recipe, job, scene, attempt, phases)
        except UnfitSceneError as error:  # anything else may go well the next time
            rejected.append(f"seed {seed}: {error}")
            continue
        return _Set(scene, attempt, crops, tuple(rejected))
    raise LambentError(
        f"none of {ATTEMPTS} scenes for {job.what} {job.first} is usable: {'; '.join(rejected)}",
        remedy="look at them: lambent dataset preview RECIPE",
    )


def _crops(
    recipe: Recipe, job: Job, scene: Scene | WholeScene, attempt: int, phases: Phases
) -> tuple[tuple[int, Choice], ...]:
    """Camera and window of every item that the scene gives. Raises `UnfitSceneError`."""
    total = per_scene(recipe, job.what)
    if isinstance(scene, WholeScene):
        whole = Choice(Window(0, 0, recipe.crop), 0.0, 1.0)
        return tuple((k % scene.cameras, whole) for k in range(total))
    number_of_cameras = min(cameras(recipe, job.what), scene.cameras)
    size = tuple(max(16, round(length * recipe.pilot_scale)) for length in recipe.view)
    pilots: dict[int, Frame] = {}
    for camera in range(number_of_cameras):
        with phases("scene"):
            views = scene.views(camera)
        with phases("pilot"):
            seed = number(recipe, job.what, "pilot", job.number, attempt, camera)
            pilots[camera] = views[len(views) // 2].pilot(
                (size[0], size[1]), recipe.pilot_spp, seed
            )
    chosen: dict[int, list[Choice]] = {}
    for camera, pilot in pilots.items():
        random = generator(recipe, job.what, "windows", job.number, attempt, camera)
        # Enough for all items, should the other cameras see nothing.
        found = choose(pilot, recipe.view, recipe.crop, total, recipe.uniform, random)
        if found:
            chosen[camera] = list(found)
    if not chosen:
        raise UnfitSceneError("every view is black or smooth")
    # Cameras take turns.
    crops: list[tuple[int, Choice]] = []
    while len(crops) < total:
        for camera in sorted(chosen):
            crops += [(camera, chosen[camera].pop(0))] if chosen[camera] else []
    return tuple(crops[:total])


def _batches(recipe: Recipe, job: Job, found: _Set, batch: int) -> list[list[int]]:
    """The items of a job, in groups of one camera that are rendered together."""
    size = batch if job.what == STILL and not isinstance(found.scene, WholeScene) else 1
    by_camera: dict[int, list[int]] = {}
    for index in sorted(job.items):
        by_camera.setdefault(found.crops[_place(recipe, job, index)][0], []).append(index)
    return [items[k : k + size] for items in by_camera.values() for k in range(0, len(items), size)]


def _batch(
    recipe: Recipe, job: Job, items: list[int], found: _Set, phases: Phases
) -> list[tuple[Still, ...]]:
    """The stills of some items of one camera."""
    camera = found.crops[_place(recipe, job, items[0])][0]
    scene = found.scene
    if isinstance(scene, WholeScene):
        made = []
        for index in items:
            spp = level_spp(recipe, job, index)
            stills = scene.stills(camera, recipe.crop, spp, _least(recipe, job, spp))
            for frame in (frame for still in stills for frame in (*still.levels, still.target)):
                if (frame.height, frame.width) != (recipe.crop, recipe.crop):
                    raise LambentError(
                        f"a crop of {recipe.crop} pixels came out {frame.width}x{frame.height}"
                    )
                _sound(frame)
            made.append(stills)
        return made
    with phases("scene"):
        views = scene.views(camera)
    by_frame = [_frame(recipe, job, items, k, v, found, phases) for k, v in enumerate(views)]
    return [tuple(stills) for stills in zip(*by_frame, strict=True)]


def _frame(
    recipe: Recipe, job: Job, items: list[int], frame: int, view: View, found: _Set, phases: Phases
) -> list[Still]:
    """One still of each item: levels and the least targets at once, then more for some targets."""
    draws: list[Draw] = []
    levels = {index: level_spp(recipe, job, index) for index in items}
    windows = {index: found.crops[_place(recipe, job, index)][1].window for index in items}
    for index, spp in levels.items():
        for n, count in enumerate(spp):
            seed = number(recipe, job.what, index, frame, "level", n)
            draws.append(Draw(windows[index], count, seed))
        seed = number(recipe, job.what, index, frame, "target", 0)
        draws.append(Draw(windows[index], _least(recipe, job, spp), seed))
    with phases("samples"):
        samples = iter(view.sample(draws))
    noisy: dict[int, tuple[Frame, ...]] = {}
    totals: dict[int, Any] = {}
    for index, spp in levels.items():
        noisy[index] = tuple(_sound(next(samples).frame()) for _ in spp)
        totals[index] = next(samples)
    targets = {index: _sound(total.frame()) for index, total in totals.items()}
    # A clip's frames are alike: more for one of them would make it flicker.
    step = 1
    while job.what == STILL:
        more = {
            index: max(_least(recipe, job, levels[index]) // 2, 2)
            for index in items
            if relative_error(targets[index]) > recipe.target_error
        }
        more = {i: n for i, n in more.items() if totals[i].spp + n <= recipe.target_most}
        if not more:
            break
        draws = [
            Draw(windows[i], n, number(recipe, job.what, i, frame, "target", step))
            for i, n in more.items()
        ]
        with phases("more samples for targets"):
            for index, extra in zip(more, view.sample(draws), strict=True):
                totals[index] = totals[index] + extra
                targets[index] = _sound(totals[index].frame())
        step += 1
    return [Still(noisy[index], targets[index]) for index in items]


def _about(
    recipe: Recipe, job: Job, index: int, found: _Set, stills: tuple[Still, ...]
) -> dict[str, Any]:
    """What an item's file says of it."""
    camera, choice = found.crops[_place(recipe, job, index)]
    window = choice.window
    return {
        "what": job.what,
        "index": index,
        "recipe": recipe.name,
        "essence": recipe.essence,
        "source": recipe.source,
        **found.scene.about,
        "attempt": found.attempt,
        "rejected": list(found.rejected),
        "camera": camera,
        "view": list(recipe.view),
        "window": [window.x, window.y, window.edge],
        "frames": len(stills),
        "spp": list(level_spp(recipe, job, index)),
        "target_spp": [still.target.spp for still in stills],
        "target_error": [round(relative_error(still.target), 6) for still in stills],
        "score": round(choice.score, 5),
        "density": round(choice.density, 5),
    }


def _least(recipe: Recipe, job: Job, spp: tuple[int, ...]) -> int:
    """The samples per pixel that a target takes at least."""
    wanted = recipe.target_spp if job.what == STILL else recipe.clip_target_spp
    return max(wanted, round(recipe.target_over_level * max(spp)))


def _sound(frame: Frame) -> Frame:
    if not np.isfinite(frame.colour).all():
        raise UnfitSceneError("the render has radiance that is not finite")
    return frame


def relative_error(frame: Frame) -> float:
    """The expected relMSE of a frame by its own variance, without its worst 0.1 % of pixels.

    The floor of the denominator is a hundredth of the crop's mean radiance squared, so that the
    measure knows no exposure.
    """
    variance = frame.get(Role.COLOUR, Stat.VARIANCE)
    if variance is None:
        return float("inf")
    floor = EPSILON * float(frame.colour.mean(dtype=np.float64)) ** 2 + 1e-20
    return expected_relmse(frame.colour, variance, floor)
