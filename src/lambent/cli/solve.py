"""Solve the light of a scene once; `lambent view` then shows it from anywhere.

SCENE is a Mitsuba scene (.xml). What a method cannot show of it, such as materials that are not
diffuse, is taken for what it is nearest to, and named. Ctrl-C keeps the solution so far; --resume
goes on.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lambent.cli.options import (
    DefineOption,
    DeviceOption,
    JsonOption,
    OverwriteOption,
    PluginsOption,
    page_for,
    print_json,
    report_option,
)
from lambent.cli.progress import Progress
from lambent.cli.terminal import remark, say

if TYPE_CHECKING:
    from lambent.report.solving import SolvingPage
    from lambent.transport.solution import Solution

EPILOG = (
    "Examples: lambent solve scene.xml -o room.lambent; "
    "lambent solve scene.xml --time 60 --report -o room.lambent"
)


def complete_methods(incomplete: str) -> list[tuple[str, str]]:
    """For the shell: names of methods, with what they do."""
    from lambent.transport.methods import METHODS

    return [(n, METHODS[n].title) for n in METHODS if n.startswith(incomplete)]


def methods_help() -> str:
    """The methods, with what they do."""
    from lambent.transport.methods import DEFAULT_METHOD

    names = "; ".join(f"{name}, {title}" for name, title in complete_methods(""))
    return f"{names}. Default: {DEFAULT_METHOD}."


def settings_kinds() -> list[type]:
    """The settings of all methods: each becomes an option."""
    from lambent.transport.methods import METHODS

    return [method.settings for method in METHODS.values()]


def solve(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="A Mitsuba scene, .xml.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT.lambent",
            help="Where to write. Default: SCENE.lambent beside the scene; for a scene.xml, its "
            "folder's name.",
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(metavar="NAME", help=methods_help(), autocompletion=complete_methods),
    ] = None,
    define: DefineOption = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue with what the output holds.")
    ] = False,
    overwrite: OverwriteOption = False,
    report: Annotated[
        str | None, report_option("Write a page that shows the light as it grows")
    ] = None,
    allow_plugins: PluginsOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
    **settings: Any,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.cli.options import definitions
    from lambent.frame.atomic import check_target
    from lambent.render.plugins import allow
    from lambent.transport.solve import solve as run

    allow(allow_plugins or ())

    target = output or scene.with_name(_default_name(scene))
    path, page = page_for(report, target.with_suffix(".html")), None
    if path is not None:
        from lambent.report.solving import SolvingPage

        page = SolvingPage(scene, check_target(path, overwrite or resume), definitions(define))
    with Progress(scene.name, quiet=as_json) as progress:
        progress.report(0, 1, "loading the scene")
        solution = run(
            scene,
            method,
            output=target,
            overwrite=overwrite,
            resume=resume,
            device=device,
            parameters=definitions(define),
            progress=progress.report,
            watch=page.show if page is not None else None,
            **settings,
        )
        if page is not None:
            progress.report(1, 1, "writing the page")
            page.finish(solution)
    if as_json:
        print_json({"path": str(target), **solution.numbers()})
    else:
        _print(solution, target, page)
    if solution.interrupted:
        remark(f"the light so far is kept in {target}; --resume goes on")
        raise typer.Exit(130)


# ------------------------------------------------------------------- private


def _default_name(scene: Path) -> str:
    stem = scene.parent.resolve().name if scene.stem == "scene" else scene.stem
    return f"{stem}.lambent"


def _print(solution: Solution, target: Path, page: SolvingPage | None) -> None:
    say(target)
    lines = [*solution.facts().items(), *(("note", note) for note in solution.notes)]
    if page is not None:
        lines.append(("report", str(page.path)))
    lines.append(("look", f"lambent view {target} -o view.png"))
    for name, text in lines:
        say(f"  {name:<8} {text}")
