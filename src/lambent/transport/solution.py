"""What every solver of light returns, and how it is looked at.

A `Solution` is a scene's light in some form; `view` and `film` render it as frames with every
feature, so that what cleans a render cleans a gathered view, too.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lambent.archive import check_card, read_archive
from lambent.errors import FileError, OptionError, UnknownNameError
from lambent.frame.frame import Frame
from lambent.progress import Progress
from lambent.render.animation import Animation, Stage, look_at, read_keyframes
from lambent.render.complaint import explaining
from lambent.render.scene import LoadedScene, film_windows

#: Samples a pixel of views that are without noise, and of those that gather.
SMOOTH_SPP, GATHER_SPP = 64, 64


class Solution(Protocol):
    """A scene's light. ``scene``: the file it was solved for, None for a scene in memory."""

    scene: str | None

    def integrator(self, show: str) -> Any:
        """A Mitsuba integrator that shows it in one of its ways."""

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write it as a file."""


#: Method -> the class that reads its files.
METHODS = {"radiosity": "lambent.transport.radiosity.solution:RadiositySolution"}


def open_solution(path: str | os.PathLike[str]) -> Any:
    """A solution from a file, whatever its method.

    Raises `FileError`, `DamagedFileError`, `UnknownNameError`.
    """
    archive = read_archive(path, "solution")
    check_card(archive, {"method": str})
    return method_class(archive.card["method"]).load(path)


def method_class(name: str) -> Any:
    """The class of a method's solutions. Raises `UnknownNameError`."""
    import importlib

    from lambent.render.variant import mitsuba

    mitsuba()  # the method's modules name what a variant has
    if name not in METHODS:
        raise UnknownNameError("method", name, METHODS)
    module, _, attribute = METHODS[name].partition(":")
    return getattr(importlib.import_module(module), attribute)


def scene_of(solution: Any, scene: Any = None, **options: Any) -> LoadedScene:
    """The scene of a solution, loaded: ``scene`` if given, else the file it was solved for.

    Raises `FileError` where there is none, and what loading raises.
    """
    from lambent.transport.scene import load_for_light

    if isinstance(scene, LoadedScene):
        return scene
    source = scene if scene is not None else solution.scene
    options["parameters"] = {**solution.parameters, **(options.get("parameters") or {})}
    if source is None:
        raise FileError(
            "the solution is of a scene in memory", remedy="give the scene: scene=…, or --scene"
        )
    if isinstance(source, (str, os.PathLike)) and not Path(source).exists():
        raise FileError(
            "the scene that was solved is not there any more",
            file=source,
            remedy="name it: --scene SCENE.xml",
        )
    loaded = load_for_light(source, **options)
    if solution.scene_digest and loaded.path is not None and loaded.digest != solution.scene_digest:
        change = (
            "The scene's file, or the values of its parameters, have changed since the light was "
            "solved; colours and lamps are those of now, the light between them that of then."
        )
        loaded = replace(loaded, notes=(*loaded.notes, change))
    return loaded


def view(
    solution: Any,
    *,
    scene: Any = None,
    camera: str | int | None = None,
    stand: tuple[float, float, float] | None = None,
    target: tuple[float, float, float] | None = None,
    fov: float | None = None,
    size: tuple[int, int] | None = None,
    show: str = "smooth",
    spp: int | None = None,
    features: str | Iterable[str] = "all",
    seed: int = 0,
    device: str = "auto",
    parameters: Mapping[str, Any] | None = None,
) -> Frame:
    """What a camera sees of a solution, as a `Frame` with every feature.

    ``camera``: number or id of the scene's; or ``stand`` and ``target``, points of the world, and
    ``fov`` in degrees across. ``parameters``: values for the scene's ``$names``, where they are to
    be other than when it was solved. ``show``: for radiosity see `radiosity.shows.SHOWS`. ``spp``:
    64 if not given.
    Raises `FileError` (other scene), `OptionError`, `UnknownNameError`.
    """
    loaded = scene_of(
        solution, scene, camera=camera, size=size, device=device, parameters=parameters
    )
    if stand is not None or target is not None:
        _place(loaded, stand, target)
    if fov is not None:
        _widen(loaded, fov)
    return picture(solution.integrator(show), loaded, spp, features, seed)


def film(
    solution: Any,
    frames: Iterable[int],
    animation: str | os.PathLike[str] | Animation,
    *,
    scene: Any = None,
    camera: str | int | None = None,
    size: tuple[int, int] | None = None,
    show: str = "smooth",
    spp: int | None = None,
    features: str | Iterable[str] = "all",
    seed: int = 0,
    device: str = "auto",
    parameters: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Iterator[tuple[int, Frame]]:
    """The frames of a moving camera, one after the other, with their numbers.

    ``animation``: keyframes (`lambent.render.animation`) or a function ``frame -> Pose``. Only the
    camera may move: light was solved for shapes where they stand. Raises `OptionError`.
    """
    from lambent.render.variant import mitsuba

    loaded = scene_of(
        solution, scene, camera=camera, size=size, device=device, parameters=parameters
    )
    moving: Animation
    if isinstance(animation, (str, os.PathLike)):
        moving = read_keyframes(Path(animation))
    else:
        moving = animation
    stage = Stage(mitsuba(), loaded.scene, loaded.sensor, moving)
    shown = solution.integrator(show)
    numbers = tuple(frames)
    for k, number in enumerate(numbers):
        if progress is not None:
            progress(k, len(numbers), f"frame {number}")
        if stage.animation(number).shapes:
            raise OptionError(
                "the animation moves shapes; light was solved for where they stand",
                remedy="leave only the camera in it, or render it: lambent render",
            )
        stage.pose(number)
        yield number, picture(shown, loaded, spp, features, seed + number)


def picture(
    integrator: Any,
    loaded: LoadedScene,
    spp: int | None = None,
    features: str | Iterable[str] = "all",
    seed: int = 0,
) -> Frame:
    """What the camera of a loaded scene sees through a solution's integrator."""
    from lambent.render.sampling import FrameSampler

    if spp is not None and spp < 1:
        raise OptionError(f"a picture needs at least 1 sample a pixel, not {spp}")
    count = spp or (GATHER_SPP if integrator.show == "gather" else SMOOTH_SPP)
    with explaining(loaded.path or "the scene"):
        integrator.prepare(loaded.scene)
    sampler = FrameSampler(
        loaded.scene, loaded.sensor, features=features, integrator=integrator, file=loaded.path
    )
    frame = sampler.sample(count, seed).frame(windows=film_windows(loaded.sensor))
    told = [n for n in loaded.notes if "have changed since" in n or "crop window" in n]
    return frame.replace(notes=(*frame.notes, *told))


# ------------------------------------------------------------------- private


def _place(
    loaded: LoadedScene,
    stand: tuple[float, float, float] | None,
    target: tuple[float, float, float] | None,
) -> None:
    if stand is None or target is None:
        raise OptionError(
            "a camera of one's own needs where it stands and what it looks at",
            remedy="give both: --from X,Y,Z --to X,Y,Z",
        )
    import mitsuba as mi

    params = mi.traverse(loaded.sensor)
    old = np.array(params["to_world"].matrix, float).reshape(4, 4)
    # the axis of the world that is up in the scene's own pictures: a camera that looks down tilts
    axis = int(np.argmax(np.abs(old[:3, 1])))
    up = np.eye(3)[axis] * np.sign(old[axis, 1])
    way = np.subtract(target, stand)
    if np.linalg.norm(np.cross(up, way)) < 1e-6 * np.linalg.norm(way):
        up = old[:3, 2]  # straight up or down
    params["to_world"] = mi.Transform4f(look_at(stand, target, tuple(up)))
    params.update()


def _widen(loaded: LoadedScene, fov: float) -> None:
    import mitsuba as mi

    if not 0 < fov < 180:
        raise OptionError(f"a field of view of {fov:g} degrees cannot be", remedy="take 20 to 90")
    params = mi.traverse(loaded.sensor)
    if "x_fov" not in params:
        raise OptionError("this camera has no field of view", remedy="leave --fov out")
    params["x_fov"] = mi.Float(fov)
    params.update()
