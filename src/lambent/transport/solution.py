"""What every method of solving light returns, and how it is looked at.

A `Solution` is a scene's light in some form; `view` and `film` render it as frames with every
feature, so that what cleans a render cleans a gathered view, too.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lambent.archive import Archive, check_card, read_archive, write_archive
from lambent.errors import FileError, OptionError
from lambent.frame.frame import Frame
from lambent.progress import Progress
from lambent.render.animation import Animation, Stage, look_at, read_keyframes
from lambent.render.complaint import explaining
from lambent.render.scene import LoadedScene, film_windows
from lambent.transport.extra import check_extra
from lambent.transport.methods import METHODS, Method, View

#: Samples a pixel of a view where nothing is said.
SPP = 64
#: What every solution has on its card.
_CARD = {
    "method": str,
    "scene": str | None,
    "scene_digest": str,
    "parameters": dict[str, str],
    "settings": dict[str, Any],
    "notes": list[str],
    "seconds": dict[str, float],
    "interrupted": bool,
}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Solution:
    """A scene's light. Subclasses hold it, and give `packed`; they may give `facts` and more.

    ``scene``: the file it was solved for, None for a scene in memory, with the values of its
    ``parameters``; ``scene_digest`` tells whether it has changed since. ``settings``: with which it
    was solved; ``seconds``: what took how long; ``interrupted``: before it was finished.
    """

    method: ClassVar[str]
    scene: str | None = None
    scene_digest: str = ""
    parameters: dict[str, str] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    interrupted: bool = False

    # ------------------------------------------------------- for subclasses

    def packed(self) -> tuple[dict[str, Any], dict[str, bytes]]:
        """What its file holds beside the fields above: entries of the card, and members."""
        raise NotImplementedError

    def facts(self) -> dict[str, str]:
        """What the terminal, a page and a notebook print of it, as words."""
        return {"time": ", ".join(f"{what} {s:.1f} s" for what, s in self.seconds.items())}

    def numbers(self) -> dict[str, Any]:
        """The same for programs, as JSON."""
        steps = self.residuals()
        return {
            "method": self.method,
            "steps": len(steps),
            "residual": steps[-1][1] if steps else None,
            "seconds": self.seconds,
            "interrupted": self.interrupted,
            "notes": list(self.notes),
        }

    def residuals(self) -> Sequence[tuple[int, float]]:
        """How far it was from agreeing with itself, step by step: step and relative residual."""
        return ()

    def tables(self, scene: Any) -> dict[str, tuple[str, dict[str, float]]]:
        """What a page lists of it: title -> heading of the numbers, and numbers by words."""
        return {}

    # ------------------------------------------------------------ for users

    def __repr__(self) -> str:
        name, value = next(iter(self.facts().items()))
        unfinished = ", interrupted" if self.interrupted else ""
        return (
            f"<{type(self).__name__} of {self.scene or 'a scene in memory'}: "
            f"{name} {value}{unfinished}>"
        )

    def _repr_html_(self) -> str:
        """What it is of and how far it got, for Jupyter."""
        facts = {
            "scene": self.scene or "in memory",
            "method": self.method,
            **self.facts(),
            "interrupted": "yes" if self.interrupted else "",
            "notes": " ".join(self.notes),
        }
        rows = (f"<tr><th>{k}</th><td>{escape(v)}</td></tr>" for k, v in facts.items() if v)
        return f"<table>{''.join(rows)}</table>"

    def integrator(self, show: str | None = None) -> View:
        """A Mitsuba integrator that shows it in one of its ways. Raises `UnknownNameError`."""
        method = method_of(self)
        return method.view(self, method.show(show))

    def view(self, **options: Any) -> Frame:
        """A picture of it; the options are those of `lambent.transport.solution.view`.

        A scene that was solved in memory has to be given again: ``scene=…``.
        """
        return view(self, **options)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write it as a file (``.lambent``), in one step. Raises `OutputError`."""
        own, members = self.packed()
        common = {name: getattr(self, name) for name in _CARD}
        write_archive(path, "solution", {**common, **own}, members, overwrite)


def card_fields(archive: Archive) -> dict[str, Any]:
    """The fields that all solutions have, from an archive. Raises `DamagedFileError`."""
    check_card(archive, _CARD)
    found = {name: archive.card[name] for name in _CARD if name != "method"}
    return {**found, "notes": tuple(found["notes"])}


def method_of(solution: Solution) -> Method[Any]:
    """The method by which it was solved."""
    method: Method[Any] = METHODS[solution.method]
    return method


def open_solution(path: str | os.PathLike[str], method: str | None = None) -> Solution:
    """A solution from a file; ``method``: the only one that will do.

    Raises `FileError`, `DamagedFileError`, `UnknownNameError`.
    """
    archive = read_archive(path, "solution")
    check_card(archive, {"method": str})
    there = archive.card["method"]
    if method is not None and there != method:
        raise FileError(f"holds a solution by {there[:40]}, not by {method}", file=path)
    check_extra()
    solution: Solution = METHODS[there].load(archive)
    return solution


def scene_of(solution: Solution, scene: Any = None, **options: Any) -> LoadedScene:
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
            "the scene that was solved no longer exists",
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
    solution: Solution,
    *,
    scene: Any = None,
    camera: str | int | None = None,
    stand: tuple[float, float, float] | None = None,
    target: tuple[float, float, float] | None = None,
    fov: float | None = None,
    size: tuple[int, int] | None = None,
    show: str | None = None,
    spp: int | None = None,
    features: str | Iterable[str] = "all",
    seed: int = 0,
    device: str = "auto",
    parameters: Mapping[str, Any] | None = None,
) -> Frame:
    """What a camera sees of a solution, as a `Frame` with every feature.

    ``camera``: number or id of the scene's; or ``stand`` and ``target``, points of the world, and
    ``fov`` in degrees across. ``parameters``: values for the scene's ``$names``, where they are to
    be other than when it was solved. ``show``: one of the method's `Method.shows`; ``spp``: 64 if
    not given.
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
    solution: Solution,
    frames: Iterable[int],
    animation: str | os.PathLike[str] | Animation,
    *,
    scene: Any = None,
    camera: str | int | None = None,
    size: tuple[int, int] | None = None,
    show: str | None = None,
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
    integrator: View,
    loaded: LoadedScene,
    spp: int | None = None,
    features: str | Iterable[str] = "all",
    seed: int = 0,
) -> Frame:
    """What the camera of a loaded scene sees through a solution's integrator."""
    from lambent.render.sampling import FrameSampler

    if spp is not None and spp < 1:
        raise OptionError(f"a picture needs at least 1 sample a pixel, not {spp}")
    with explaining(loaded.path or "the scene"):
        integrator.prepare(loaded.scene)
    sampler = FrameSampler(
        loaded.scene, loaded.sensor, features=features, integrator=integrator, file=loaded.path
    )
    frame = sampler.sample(spp or SPP, seed).frame(windows=film_windows(loaded.sensor))
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
            "your own camera needs a position and a target",
            remedy="give both: --origin X,Y,Z --target X,Y,Z",
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
        raise OptionError(f"the field of view cannot be {fov:g} degrees", remedy="take 20 to 90")
    params = mi.traverse(loaded.sensor)
    if "x_fov" not in params:
        raise OptionError("this camera has no field of view", remedy="leave --fov out")
    params["x_fov"] = mi.Float(fov)
    params.update()
