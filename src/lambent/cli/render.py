"""Render a scene with every feature that a denoiser wants.

SCENE is a Mitsuba scene (.xml), rendered by path tracing, or a Blender file (.blend), rendered by
Cycles. The EXR holds colour, its variance and two half buffers, light split in several ways,
albedo, normal, depth, position, roughness and alpha, each with its variance. Of a Mitsuba scene it
is updated while the picture grows; after Ctrl-C it holds what was reached, and --resume continues.
Pictures by Cycles appear when they are finished.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
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
from lambent.cli.progress import Progress
from lambent.cli.terminal import remark, say

if TYPE_CHECKING:
    from lambent.render.accumulate import State
    from lambent.render.job import Rendered
    from lambent.render.moments import Moments

EPILOG = (
    "Examples: lambent render scene.xml --spp 64; lambent render scene.xml --spp +64 --resume; "
    "lambent render scene.xml --time 60 --report; "
    "lambent render scene.xml --frames 1-24 -o shot.####.exr"
)


def complete_features(incomplete: str) -> list[str]:
    """For the shell: names of layers and families that begin like this."""
    from lambent.render.channels import GROUPS

    names = ["all", "none", "light", "features", "first", *(g.name for g in GROUPS)]
    return [name for name in names if name.startswith(incomplete)]


def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="An .xml or a .blend.")],
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT.exr",
            help="Where to write; a pattern for frames. Default: SCENE.exr beside the scene; for "
            "a scene.xml, its folder's name.",
        ),
    ] = None,
    spp: Annotated[
        str | None,
        typer.Option(
            metavar="N|+N", help="Samples per pixel in all (64), or +N for that many more."
        ),
    ] = None,
    time: Annotated[str | None, time_option("Stop each picture after this time")] = None,
    target_error: Annotated[
        float | None,
        typer.Option(metavar="RELMSE", help="Stop when the estimated error is this small."),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Size in pixels instead of the scene's.")
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(metavar="1-24", help="Frames of an animation, or 'all' of its file."),
    ] = None,
    animation: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Keyframes. Default: SCENE.toml beside the scene."),
    ] = None,
    camera: Annotated[
        str | None, typer.Option(metavar="NAME|N", help="Which camera, if there are several.")
    ] = None,
    features: Annotated[
        str,
        typer.Option(
            metavar="all|none|NAME,...",
            help="Layers beside the colour: light, features, first, or single names.",
            autocompletion=complete_features,
        ),
    ] = "all",
    depth: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Most vertices of a path; -1 for no limit. Default: the scene's."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the random numbers.")] = 0,
    integrator: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="path (ours), scene (the scene's own), or one of Mitsuba's."
        ),
    ] = "path",
    light_group: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=ID,...",
            help="A separate layer for the light of these emitters: key=sun,lamp*. Repeatable.",
        ),
    ] = None,
    define: DefineOption = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue with what the output holds.")
    ] = False,
    overwrite: OverwriteOption = False,
    checkpoint: Annotated[
        str | None, typer.Option(metavar="TIME", help="Save the picture so far this often (60).")
    ] = None,
    report: Annotated[
        str | None, report_option("Write a page that shows the picture as it grows")
    ] = None,
    allow_plugins: PluginsOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.cli.options import definitions, light_groups, size_of
    from lambent.errors import OptionError
    from lambent.frame.sequence import parse_range
    from lambent.render.job import frames_of, render_all
    from lambent.render.options import Effort, Listeners, Output, Shot
    from lambent.render.plugins import allow

    allow(allow_plugins or ())
    numbers: tuple[int, ...] | None = None
    if frames == "all":
        numbers = frames_of(animation, scene)
    if frames is not None and numbers is None:
        numbers = parse_range(frames)
    target = output or _default_output(scene, numbers is not None)
    if report is not None and numbers is not None:
        raise OptionError("a page follows one picture, and --frames makes several")
    page = _Page(page_for(report, Path(target).with_suffix(".html")))
    told: list[str] = []

    def note(text: str) -> None:
        if text not in told:
            told.append(text)

    kept: list[str] = []

    def keep(path: Path, moments: Moments) -> None:
        kept[:] = [f"{path} holds {moments.spp} samples a pixel; --resume continues with them"]

    with _saying_what_is_kept(kept), Progress(scene.name, quiet=as_json) as progress:

        def tell(number: int | None, state: State) -> None:
            which = "" if number is None else f"frame {number}: "
            progress.report(state.share, 1, which + state.text())
            page.add(state)

        progress.report(0, 1, "loading and compiling")
        done = render_all(
            scene,
            Shot(
                size=size_of(size),
                camera=camera,
                features=features,
                depth=depth,
                seed=seed,
                integrator=integrator,
                light_groups=light_groups(light_group),
                parameters=definitions(define),
                device=device,
                frames=numbers,
                animation=animation,
            ),
            Effort(spp, seconds_of("--time", time), target_error),
            Output(target, resume, overwrite, seconds_of("--checkpoint", checkpoint) or 60.0),
            Listeners(tell, progress.report, note, keep),
        )
    page.finish(done[0])
    if as_json:
        print_json({"frames": [_as_dict(r) for r in done], "notes": told, "report": page.written})
        return
    for result in done:
        _print(result)
    for text in told:
        say(f"  note     {text}")
    if page.written:
        say(f"  report   {page.written}")


# ------------------------------------------------------------------- private


@contextmanager
def _saying_what_is_kept(kept: list[str]) -> Iterator[None]:
    """After Ctrl-C, what of the render is on disk."""
    try:
        yield
    except KeyboardInterrupt:
        remark(*(kept or ["nothing was rendered to the end of a pass, so nothing is kept"]))
        raise


class _Page:
    """The report that is written again while the picture grows (at most every few seconds)."""

    EVERY = 5.0

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.written: str | None = None
        self.states: list[tuple[float, int, float]] = []
        self._last = -1e9

    def add(self, state: State) -> None:
        """After a pass."""
        if self.path is None:
            return
        self.states.append((state.seconds, state.moments.spp, state.moments.error()))
        if state.seconds - self._last < self.EVERY:
            return
        from lambent.report.rendering import write_rendering

        self._last = state.seconds
        frame = state.moments.frame(halves=False)
        write_rendering(self.path, frame, self.states, left=state.left, running=True)
        if self.written is None:
            remark(f"the picture grows in {self.path}")
        self.written = str(self.path)

    def finish(self, result: Rendered) -> None:
        """With every layer, and no more reloading."""
        if self.path is None:
            return
        from lambent.report.rendering import write_rendering

        write_rendering(self.path, result.frame, self.states, left=None, running=False)
        self.written = str(self.path)


def _default_output(scene: Path, many: bool) -> str:
    stem = scene.parent.resolve().name if scene.stem == "scene" else scene.stem
    return str(scene.with_name(f"{stem}.####.exr" if many else f"{stem}.exr"))


def _print(result: Rendered) -> None:
    from lambent.frame.role import Role

    frame = result.frame
    say(f"{result.path}")
    grown = f", {result.began_with} of them from before" if result.began_with else ""
    say(f"  holds    {frame.width}x{frame.height}, {frame.spp} spp{grown}")
    roles = dict.fromkeys(key[0].value for key in frame.layers)
    groups = [n for n, layer in frame.lighting().items() if layer.role is Role.LIGHTING]
    say(f"  layers   {', '.join([*roles, *groups])}")


def _as_dict(result: Rendered) -> dict[str, Any]:
    return {
        "path": None if result.path is None else str(result.path),
        "frame": result.number,
        "width": result.frame.width,
        "height": result.frame.height,
        "spp": result.frame.spp,
        "began_with": result.began_with,
        "layers": [layer.name for layer in result.frame.all_layers()],
    }
