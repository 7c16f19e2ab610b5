"""Solve the light of a scene once; `lambent view` then shows it from anywhere.

SCENE is a Mitsuba scene (.xml). By radiosity: surfaces are cut into patches, taken as diffuse, and
the light between them is solved for, with all its bounces. Materials that are not diffuse are
replaced by the nearest that is, and named. Ctrl-C keeps the solution so far; --resume continues.
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
    seconds_of,
    time_option,
)
from lambent.cli.progress import Progress, show_seconds
from lambent.cli.terminal import remark, say

if TYPE_CHECKING:
    from lambent.render.scene import LoadedScene

EPILOG = (
    "Examples: lambent solve scene.xml -o room.lambent; "
    "lambent solve scene.xml --patches 64000 --adaptive --report -o room.lambent"
)


def complete_solvers(incomplete: str) -> list[tuple[str, str]]:
    """For the shell: names of solvers, with what they are good for."""
    from lambent.transport.radiosity.solvers import SOLVERS

    return [(n, words) for n, (_, words) in SOLVERS.items() if n.startswith(incomplete)]


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
    method: Annotated[str, typer.Option(metavar="NAME", help="radiosity.")] = "radiosity",
    patches: Annotated[
        int | None, typer.Option("--patches", metavar="N", help="Roughly this many patches (4000).")
    ] = None,
    patch_size: Annotated[
        float | None,
        typer.Option("--patch-size", metavar="S", help="Their size in scene units instead."),
    ] = None,
    adaptive: Annotated[
        bool | None, typer.Option("--adaptive", help="Refine where the picture changes.")
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="cg (default), direct, jacobi, gauss-seidel, southwell, least-squares, "
            "matrix-free.",
            autocompletion=complete_solvers,
        ),
    ] = None,
    factors: Annotated[
        str | None,
        typer.Option(metavar="rays|pairs", help="Form factors by rays (default), or pair by pair."),
    ] = None,
    rays: Annotated[int | None, typer.Option(metavar="N", help="Rays per patch (256).")] = None,
    samples: Annotated[
        int | None,
        typer.Option(metavar="N", help="Samples of the emitters per patch (512)."),
    ] = None,
    direct: Annotated[
        str | None,
        typer.Option(
            metavar="samples|factors",
            help="Direct light: sampled (default), or through form factors.",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="X", help="Stop at this residual, relative to the first light (1e-6)."
        ),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(metavar="N", help="At most this many steps of the solver (1000).")
    ] = None,
    time: Annotated[str | None, time_option("Stop the solver after this time")] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Seed of the random numbers.")
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
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.cli.options import definitions
    from lambent.frame.atomic import check_target
    from lambent.render.plugins import allow
    from lambent.transport.solve import solve as run

    allow(allow_plugins or ())

    target = output or scene.with_name(_default_name(scene))
    given = {
        "patches": patches, "size": patch_size, "adaptive": adaptive, "solver": solver,
        "factors": factors, "rays": rays, "samples": samples, "direct": direct,
        "tolerance": tolerance, "steps": steps, "seconds": seconds_of("--time", time), "seed": seed,
    }  # fmt: skip
    path, page = page_for(report, target.with_suffix(".html")), None
    if path is not None:
        page = _Page(scene, check_target(path, overwrite or resume), definitions(define))
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
            **{name: value for name, value in given.items() if value is not None},
        )
        if page is not None:
            progress.report(1, 1, "writing the page")
            page.finish(solution)
    if as_json:
        print_json(_as_dict(solution, target))
    else:
        _print(solution, target, page)
    if solution.interrupted:
        remark(f"the light so far is kept in {target}; --resume goes on")
        raise typer.Exit(130)


# ------------------------------------------------------------------- private


class _Page:
    """The report, written again while the light grows; the solver says how often."""

    def __init__(self, scene: Path, path: Path, parameters: dict[str, str]) -> None:
        self.scene, self.path, self.parameters = scene, path, parameters
        self.loaded: LoadedScene | None = None
        self.views: dict[str, Any] = {}
        self.pictures: list[tuple[int, Any]] = []

    def show(self, solution: Any) -> None:
        """After a step of the solver."""
        self._write(solution, running=True)

    def finish(self, solution: Any) -> None:
        """With the final pictures, and no more reloading; after Ctrl-C without new ones."""
        if solution.interrupted and not self.pictures:
            return
        self._write(solution, running=False)

    def _write(self, solution: Any, running: bool) -> None:
        from lambent.report.solving import write_solving
        from lambent.transport.scene import load_for_light
        from lambent.transport.solution import picture
        from lambent.transport.surfaces import surfaces_of

        if self.loaded is None:
            self.loaded = load_for_light(self.scene, parameters=self.parameters)
            width, height = self.loaded.sensor.film().crop_size()
            scale = min(1.0, 640 / max(width, height))
            size = max(1, round(width * scale)), max(1, round(height * scale))
            self.loaded = load_for_light(self.scene, parameters=self.parameters, size=size)
            self.surfaces = surfaces_of(self.loaded.scene)
        kinds = ["smooth"] if running else ["smooth", "mesh", "irradiance", "residual"]
        made = {}
        if solution.interrupted:
            kinds, made = [], {"smooth": self.pictures[-1][1]}
        for kind in kinds:
            if kind in self.views:
                self.views[kind].update(solution)
            else:
                self.views[kind] = solution.integrator(kind)
            shown = picture(self.views[kind], self.loaded, spp=8, features="none")
            made[kind] = shown.colour
        if not solution.interrupted:
            self.pictures.append((len(solution.history.steps), made["smooth"]))
        write_solving(
            self.path, self.scene.name, solution, made, self.pictures,
            balance=solution.balance(self.surfaces), areas=solution.patches_on(self.surfaces).area,
            running=running,
        )  # fmt: skip


def _default_name(scene: Path) -> str:
    stem = scene.parent.resolve().name if scene.stem == "scene" else scene.stem
    return f"{stem}.lambent"


def _print(solution: Any, target: Path, page: _Page | None) -> None:
    say(target)
    history = solution.history
    residual = history.residuals[-1] if history.residuals else float("nan")
    spent = ", ".join(f"{name} {show_seconds(s)}" for name, s in solution.seconds.items())
    say(f"  holds    {len(solution):,} patches; {int(solution.live.sum()):,} faces see light")
    say(f"  solved   {len(history.steps)} steps, residual {residual:.1e}; {spent}")
    if solution.error is not None:
        rays = solution.settings["rays"]
        say(f"  error    {100 * solution.error:.1f} % of a patch's indirect light ({rays} rays)")
    for note in solution.notes:
        say(f"  note     {note}")
    if page is not None:
        say(f"  report   {page.path}")
    say(f"  look     lambent view {target} -o view.png")


def _as_dict(solution: Any, target: Path) -> dict[str, Any]:
    return {
        "path": str(target),
        "patches": len(solution),
        "live_faces": int(solution.live.sum()),
        "steps": len(solution.history.steps),
        "residual": solution.history.residuals[-1] if solution.history.residuals else None,
        "seconds": solution.seconds,
        "error": solution.error,
        "interrupted": solution.interrupted,
        "notes": list(solution.notes),
    }
