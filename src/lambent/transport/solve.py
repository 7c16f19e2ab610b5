"""The verb `solve`: a scene in, its light out."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

from lambent.errors import FileError, OptionError
from lambent.frame.atomic import check_target
from lambent.progress import Progress
from lambent.transport.extra import check_extra
from lambent.transport.methods import DEFAULT_METHOD, METHODS, Method, Watch
from lambent.transport.solution import Solution, open_solution


def solve(
    scene: Any,
    method: str | None = None,
    *,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    resume: bool = False,
    device: str = "auto",
    parameters: dict[str, Any] | None = None,
    progress: Progress | None = None,
    watch: Watch[Solution] | None = None,
    **settings: Any,
) -> Solution:
    """Solve a scene's light once; look at it from anywhere with `Solution.view`.

    ``scene``: a Mitsuba scene file, dictionary or object. ``method``: one of
    `lambent.transport.methods.METHODS`; None for the default, or the one that is gone on with.
    ``settings``: those of the method. ``output``: a file for the solution; ``resume``: go on with
    what it holds, with its settings but for those that say when to end. ``watch`` gets the
    solution as it grows. Example::

        solution = lambent.solve("scene.xml", patches=16000, output="scene.lambent")
        frame = solution.view(show="gather", spp=64)

    Ctrl-C while solving ends it; what was reached is returned (and written), ``interrupted``.
    Raises `FileError`, `OptionError`, `UnknownNameError`, `OutputError`, `EngineError`.
    """
    from lambent.render.complaint import explaining
    from lambent.render.variant import mitsuba
    from lambent.transport.scene import load_for_light

    check_extra()
    mitsuba(device)  # the method's modules name what a variant has
    if resume and output is None:
        raise OptionError("resuming needs the solution's file", remedy="give it: -o FILE.lambent")
    start: Solution | None = None
    if output is not None:
        path = Path(output)
        if path.suffix != ".lambent":
            raise OptionError(
                f"'{path.name}' cannot be the name of a solution", remedy="end it in .lambent"
            )
        check_target(path, overwrite or resume)
        if resume:
            if not path.exists():
                raise FileError("there is no such file", file=path, remedy="leave --resume out")
            start = open_solution(path, method)
            parameters = {**start.parameters, **(parameters or {})}
    by: Method[Any] = METHODS[method or (start.method if start is not None else DEFAULT_METHOD)]
    chosen = by.configured(settings, None if start is None else start.settings)
    loaded = load_for_light(scene, device=device, parameters=parameters)
    texts = {k: str(v) for k, v in (parameters or {}).items()}
    with explaining(loaded.path or "the scene", "solved"):
        made = by.solve(loaded, chosen, start, progress, watch)
    solution: Solution = dataclasses.replace(made, parameters=texts)
    if output is not None:
        solution.save(output, overwrite or resume)
    return solution
