"""The verb `solve`: a scene in, its light out."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lambent.errors import FileError, OptionError, UnknownNameError
from lambent.frame.atomic import check_target
from lambent.progress import Progress
from lambent.transport.solution import METHODS, method_class


def solve(
    scene: Any,
    method: str = "radiosity",
    *,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    resume: bool = False,
    device: str = "auto",
    parameters: dict[str, Any] | None = None,
    progress: Progress | None = None,
    watch: Callable[[Any], None] | None = None,
    **settings: Any,
) -> Any:
    """Solve a scene's light once; look at it from anywhere with `Solution.view`.

    ``scene``: a Mitsuba scene file, dictionary or object. ``settings``: those of the method, for
    radiosity `lambent.transport.radiosity.solve.Settings`. ``output``: a file for the solution;
    ``resume``: go on with what it holds: its patches, form factors and settings are kept, but for
    the solver's. ``watch`` gets the solution as it grows. Example::

        solution = lambent.solve("scene.xml", patches=16000, output="scene.lambent")
        frame = solution.view(show="gather", spp=64)

    Ctrl-C while solving ends it; what was reached is returned (and written), ``interrupted``.
    Raises `FileError`, `OptionError`, `UnknownNameError`, `OutputError`, `EngineError`.
    """
    from lambent.render.complaint import explaining
    from lambent.render.variant import mitsuba
    from lambent.transport.scene import load_for_light

    mitsuba(device)  # the method's modules name what a variant has
    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    if resume and output is None:
        raise OptionError("resuming needs the solution's file", remedy="give it: -o FILE.lambent")
    start = None
    if output is not None:
        path = Path(output)
        if path.suffix != ".lambent":
            raise OptionError(
                f"'{path.name}' is no name for a solution", remedy="end it in .lambent"
            )
        check_target(path, overwrite or resume)
        if resume:
            if not path.exists():
                raise FileError("does not exist", file=path, remedy="leave --resume out")
            start = method_class(method).load(path)
            parameters = {**start.parameters, **(parameters or {})}
    loaded = load_for_light(scene, device=device, parameters=parameters)
    chosen, run = _method(method, settings, start)
    texts = {k: str(v) for k, v in (parameters or {}).items()}
    with explaining(loaded.path or "the scene", "solved"):
        solution = run(loaded, chosen, start=start, progress=progress, watch=watch)
    solution = dataclasses.replace(solution, parameters=texts)
    if output is not None:
        solution.save(output, overwrite or resume)
    return solution


# ------------------------------------------------------------------- private


#: What a run that is resumed may have otherwise than the one before.
_SOLVERS_OWN = {"solver", "tolerance", "steps", "seconds"}


def _method(method: str, settings: dict[str, Any], start: Any) -> tuple[Any, Any]:
    """Settings and function of a method.

    Raises `OptionError` for settings it does not know, or that would mix two solutions.
    """
    from lambent.transport.radiosity.solve import Settings
    from lambent.transport.radiosity.solve import solve as run

    known = {field.name for field in dataclasses.fields(Settings)}
    strange = sorted(set(settings) - known)
    if strange:
        raise OptionError(
            f"{method} has no setting {', '.join(strange)}",
            remedy=f"there are: {', '.join(sorted(known))}",
        )
    if start is None:
        return Settings(**settings), run
    other = [
        f"{k} ({start.settings.get(k)} there, {v} here)" for k, v in sorted(settings.items())
        if k not in _SOLVERS_OWN and start.settings.get(k) != v
    ]  # fmt: skip
    if other:
        raise OptionError(
            f"the solution to go on with has another {', '.join(other)}",
            remedy="leave that out, or begin anew with --overwrite",
        )
    kept = {k: v for k, v in start.settings.items() if k not in _SOLVERS_OWN or k == "solver"}
    return Settings(**{**kept, **settings}), run
