"""Look at a solved scene: a picture, a film, or a mesh that carries its light.

SOLUTION is a file of `lambent solve`. The output's ending decides what is made: .exr (all features,
which `lambent denoise` can use), .png, .mp4 (with --frames), .ply and .glb (light in the vertices);
an .exr with --lightmap holds the light of all surfaces as one image.
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
    print_json,
)
from lambent.cli.progress import Progress
from lambent.cli.terminal import say

if TYPE_CHECKING:
    from lambent.frame.frame import Frame
    from lambent.transport.solution import Solution

EPILOG = (
    "Examples: lambent view room.lambent -o view.png; "
    "lambent view room.lambent --show gather --spp 64 -o view.exr; "
    "lambent view room.lambent --frames 1-48 --animation fly.toml -o fly.mp4"
)

#: Endings of what can be written.
PICTURES, FILMS, MESHES = (".exr", ".png"), (".mp4",), (".ply", ".glb")


def complete_shows(incomplete: str) -> list[tuple[str, str]]:
    """For the shell: kinds of views, of whatever method."""
    from lambent.transport.methods import METHODS

    known = {name: words for method in METHODS.values() for name, words in method.shows.items()}
    return [(name, words) for name, words in known.items() if name.startswith(incomplete)]


def shows_help() -> str:
    """The kinds of views of each method."""
    from lambent.transport.methods import METHODS

    return "; ".join(f"of {n}: {', '.join(METHODS[n].shows)}" for n in METHODS) + "."


def view(
    solution: Annotated[Path, typer.Argument(metavar="SOLUTION", help="A .lambent file.")],
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT",
            help=".exr, .png, .mp4, .ply or .glb; shot.####.exr. Default: SOLUTION.png; with "
            "--frames SOLUTION.mp4, with --lightmap SOLUTION_lightmap.exr.",
        ),
    ] = None,
    show: Annotated[
        str | None,
        typer.Option(metavar="NAME", help=shows_help(), autocompletion=complete_shows),
    ] = None,
    camera: Annotated[
        str | None, typer.Option(metavar="NAME|N", help="Which camera of the scene.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option("--origin", metavar="X,Y,Z", help="Position of a camera of your own."),
    ] = None,
    target: Annotated[
        str | None, typer.Option("--target", metavar="X,Y,Z", help="The point it looks at.")
    ] = None,
    fov: Annotated[
        float | None, typer.Option(metavar="DEGREES", help="Its horizontal field of view.")
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Size in pixels instead of the scene's.")
    ] = None,
    spp: Annotated[int | None, typer.Option(metavar="N", help="Samples per pixel (64).")] = None,
    features: Annotated[
        str, typer.Option(metavar="all|none|NAME,...", help="Layers of an .exr.")
    ] = "all",
    frames: Annotated[
        str | None, typer.Option(metavar="1-48", help="Frames of a moving camera.")
    ] = None,
    animation: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml", help="Its keyframes. Default: SCENE.toml beside the scene."
        ),
    ] = None,
    fps: Annotated[float, typer.Option(metavar="N", help="Frames a second of a film.")] = 24.0,
    exposure: Annotated[
        float | None,
        typer.Option(
            metavar="X", help="Factor. Default: automatic for .png and .mp4, 1 for .glb and .ply."
        ),
    ] = None,
    lightmap: Annotated[
        bool, typer.Option("--lightmap", help="Write the light of all surfaces as one image.")
    ] = False,
    scene: Annotated[
        Path | None, typer.Option(metavar="SCENE", help="Path of the scene, if it has moved.")
    ] = None,
    define: DefineOption = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the random numbers.")] = 0,
    overwrite: OverwriteOption = False,
    allow_plugins: PluginsOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.cli.options import definitions, point_of, size_of
    from lambent.errors import OptionError
    from lambent.frame.atomic import check_target
    from lambent.frame.sequence import has_place, parse_range
    from lambent.transport.extra import check_extra

    check_extra()

    output = output or _default_output(solution, frames is not None, lightmap)
    suffix = Path(output).suffix.lower()
    known = (*PICTURES, *FILMS, *MESHES)
    if suffix not in known:
        raise OptionError(f"'{output}' is no kind of view", remedy=f"end it in {', '.join(known)}")
    moves = frames is not None
    light_alone = suffix in MESHES or lightmap
    own = origin is not None or target is not None or fov is not None
    for clash, words in (
        (
            own and moves,
            "--origin, --target and --fov are of one picture; keyframes move the camera",
        ),
        (own and light_alone, "--origin, --target and --fov make no sense for what has no camera"),
        (moves and light_alone, "--frames makes no sense for what has no camera"),
        (animation is not None and not moves, "--animation needs --frames"),
        (not moves and has_place(output), f"'{output}' has a place for a number, but no --frames"),
        (exposure is not None and exposure <= 0, f"an exposure of {exposure} shows nothing"),
        (not 0 < fps <= 1000, f"{fps:g} frames a second make no film"),
    ):
        if clash:
            raise OptionError(words, remedy="see lambent view --help")
    if suffix in FILMS and frames is None:
        raise OptionError("a film needs frames", remedy="give --frames 1-48 and --animation")
    if frames is not None and suffix in PICTURES and not has_place(output):
        raise OptionError(
            f"'{output}' has no place for a frame number", remedy="take -o shot.####.exr"
        )
    if not has_place(output):
        check_target(Path(output), overwrite)
    from lambent.render.plugins import allow
    from lambent.render.variant import mitsuba

    allow(allow_plugins or ())
    mitsuba(device)  # before anything of Mitsuba's is named
    from lambent.transport import solution as look

    opened = look.open_solution(solution)
    show = look.method_of(opened).show(show)
    where: dict[str, Any] = {
        "scene": scene,
        "camera": camera,
        "size": size_of(size),
        "device": device,
        "parameters": definitions(define),
    }
    looks: dict[str, Any] = {"show": show, "spp": spp, "features": features, "seed": seed}
    if suffix == ".png" or suffix in FILMS:
        looks["features"] = "none"
    written: list[str] = []
    told: list[str] = []
    with Progress(solution.name, quiet=as_json) as progress:
        progress.report(0, 1, "loading the scene")
        if suffix in MESHES or lightmap:
            factor = 1.0 if exposure is None else exposure
            _export(opened, Path(output), lightmap, where, factor, overwrite)
            written.append(output)
        elif frames is not None:
            path = animation or _beside(opened, scene)
            made = look.film(
                opened, parse_range(frames), path, progress=progress.report, **where, **looks
            )
            written += _film(made, output, suffix, fps, exposure, overwrite)
        else:
            frame = look.view(
                opened, stand=point_of("--origin", origin), target=point_of("--target", target),
                fov=fov, **where, **looks,
            )  # fmt: skip
            _write(frame, Path(output), exposure, overwrite)
            written.append(output)
            told += frame.notes
    if as_json:
        print_json({"written": written, "show": show, "notes": told})
        return
    for name in written:
        say(name)
    for text in told:
        say(f"  note     {text}")


# ------------------------------------------------------------------- private


def _default_output(solution: Path, moves: bool, lightmap: bool) -> str:
    ending = "_lightmap.exr" if lightmap else ".mp4" if moves else ".png"
    return str(solution.with_name(solution.stem + ending))


def _beside(solution: Solution, scene: Path | None) -> Path:
    from lambent.errors import OptionError

    source = scene or (Path(solution.scene) if solution.scene else None)
    beside = source.with_suffix(".toml") if source is not None else None
    if beside is None or not beside.exists():
        raise OptionError(
            "frames were asked for, but nothing says how the camera moves",
            remedy="name keyframes: --animation FILE.toml",
        )
    return beside


def _write(frame: Frame, path: Path, exposure: float | None, overwrite: bool) -> None:
    from lambent.frame.atomic import atomic
    from lambent.frame.files import write
    from lambent.frame.tonemap import to_png

    if path.suffix.lower() == ".png":
        with atomic(path, overwrite) as handle:
            handle.write(to_png(frame.colour, exposure))
    else:
        write(path, frame, overwrite=overwrite)


def _film(
    made: Any, output: str, suffix: str, fps: float, exposure: float | None, overwrite: bool
) -> list[str]:
    from lambent.frame.atomic import check_target
    from lambent.frame.exposure import auto_exposure
    from lambent.frame.sequence import put_number
    from lambent.transport.film import write_film

    if suffix in FILMS:
        write_film(output, (frame for _, frame in made), fps, exposure, overwrite)
        return [output]
    written = []
    for number, frame in made:
        path = put_number(output, number)
        check_target(Path(path), overwrite)
        if exposure is None and suffix == ".png":
            exposure = auto_exposure(frame.colour)  # one for all, or the film would flicker
        _write(frame, Path(path), exposure, overwrite)
        written.append(str(path))
    return written


def _export(
    solution: Solution, path: Path, lightmap: bool, where: dict[str, Any], exposure: float,
    overwrite: bool,
) -> None:  # fmt: skip
    from lambent.errors import OptionError
    from lambent.transport.solution import method_of, scene_of

    method = method_of(solution)
    if lightmap and path.suffix.lower() != ".exr":
        raise OptionError("a lightmap is an EXR", remedy="end it in .exr")
    kind = "lightmap" if lightmap else "mesh"
    if kind not in method.exports:
        raise OptionError(f"a solution by {method.name} has no {kind}", remedy="take -o view.png")
    method.exports[kind](solution, scene_of(solution, **where), path, exposure, overwrite)
