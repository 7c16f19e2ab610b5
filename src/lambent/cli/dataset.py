"""Make training data: crops with several noise levels, every feature and a clean target.

A recipe, a small TOML file, states which scenes, how many crops and how noisy; the documentation
lists its keys. The same command continues where it stopped, whatever stopped it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lambent.cli.options import (
    DeviceOption,
    JsonOption,
    OverwriteOption,
    PluginsOption,
    print_json,
    seconds_of,
    time_option,
)
from lambent.cli.progress import Progress, show_seconds
from lambent.cli.terminal import remark, say

if TYPE_CHECKING:
    from lambent.dataset.make import Outcome

EPILOG = "Example: lambent dataset make recipes/mitsuba.toml -o data --time 2h"

dataset = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    help=__doc__,
    epilog=EPILOG,
)

RecipeArgument = Annotated[Path, typer.Argument(metavar="RECIPE", help="A TOML file.")]
AssetsOption = Annotated[
    Path | None,
    typer.Option(
        "--assets",
        metavar="DIR",
        help='Models, textures, maps and scenes for a recipe with source = "assets".',
    ),
]
FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="A data set.")]


@dataset.callback(invoke_without_command=True)
def _without_command(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        say(*context.get_help().split("\n"))


@dataset.command()
def make(
    recipe: RecipeArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Folder of the set. Default: in the cache, under its name.",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option("--count", metavar="N", help="Number of crops, instead of the recipe's."),
    ] = None,
    clips: Annotated[
        int | None,
        typer.Option("--clips", metavar="N", help="Number of clips, instead of the recipe's."),
    ] = None,
    first: Annotated[
        int,
        typer.Option(
            "--first",
            metavar="N",
            help="Index of the first crop, if those before it are made elsewhere.",
        ),
    ] = 0,
    first_clip: Annotated[
        int, typer.Option("--first-clip", metavar="N", help="The same for clips.")
    ] = 0,
    processes: Annotated[
        int,
        typer.Option(
            "--processes",
            metavar="N",
            help="Processes; one already uses all cores. On a cluster: workers, 0 for all.",
        ),
    ] = 1,
    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="ADDRESS",
            help="Work on a Ray cluster: its address, 'auto' for the one running here, or 'local'.",
        ),
    ] = None,
    time: Annotated[str | None, time_option("Stop after this time")] = None,
    trust: Annotated[
        bool,
        typer.Option("--trust", help="Check existing files by size only, not by hash."),
    ] = False,
    assets: AssetsOption = None,
    allow_plugins: PluginsOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Make a set, or what is missing of one.

    Validation scenes are refused. Damaged files are made again.
    """
    import dataclasses

    from lambent.dataset.make import default_folder
    from lambent.dataset.make import make as run
    from lambent.dataset.recipe import load_recipe
    from lambent.render.plugins import allow

    allow(allow_plugins or ())
    chosen = load_recipe(recipe, assets)
    if count is not None:
        chosen = dataclasses.replace(chosen, count=count)
    if clips is not None:
        chosen = dataclasses.replace(chosen, clip_count=clips)
    folder = output if output is not None else default_folder(chosen)
    if cluster is None and processes == 0:
        processes = 1
    with Progress(chosen.name, quiet=as_json) as progress:
        try:
            outcome = run(
                chosen,
                folder,
                processes=processes,
                cluster=cluster,
                device=device,
                seconds=seconds_of("--time", time),
                trust=trust,
                first=first,
                first_clip=first_clip,
                progress=progress.report,
            )
        except KeyboardInterrupt:
            _say_resume(folder)
            raise
    if as_json:
        print_json(outcome.as_dict())
    else:
        _print_outcome(outcome)
    if outcome.failed:
        raise typer.Exit(1)


@dataset.command()
def preview(
    what: Annotated[
        Path, typer.Argument(metavar="DIR|RECIPE", help="A data set, or a recipe to try.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="SHEET.png",
            help="The contact sheet. Default: DIR_preview.png or RECIPE_preview.png.",
        ),
    ] = None,
    count: Annotated[int, typer.Option("--count", metavar="N", help="How many to show.")] = 24,
    spp: Annotated[
        int, typer.Option("--spp", metavar="N", help="Samples per pixel of a recipe's views.")
    ] = 32,
    assets: AssetsOption = None,
    overwrite: OverwriteOption = False,
    allow_plugins: PluginsOption = None,
    device: DeviceOption = "auto",
) -> None:
    """Show a set, or the scenes that a recipe gives, as one contact sheet."""
    from lambent.dataset.preview import preview_recipe, preview_set
    from lambent.dataset.recipe import load_recipe
    from lambent.errors import OptionError
    from lambent.frame.atomic import check_target
    from lambent.render.plugins import allow

    allow(allow_plugins or ())
    if count < 1 or spp < 2:
        raise OptionError("--count needs 1 or more, --spp 2 or more")
    whole = what.resolve()  # "." has no name
    output = output or whole.with_name(f"{whole.name if what.is_dir() else whole.stem}_preview.png")
    check_target(output, overwrite)
    with Progress(what.name) as progress:
        if what.is_dir():
            preview_set(what, output, count, overwrite)
        else:
            recipe = load_recipe(what, assets)
            preview_recipe(recipe, output, count, spp, device, overwrite, progress.report)
    say(output)


@dataset.command()
def info(folder: FolderArgument, as_json: JsonOption = False) -> None:
    """Summarise a set: items, sizes, noise levels, kinds, times, licences."""
    from lambent.dataset.summary import summary

    found = summary(folder)
    print_json(found) if as_json else _print_info(found)


@dataset.command()
def verify(folder: FolderArgument, as_json: JsonOption = False) -> None:
    """Hash and decode every file; name damaged, missing and foreign ones. Exit code 2 if any."""
    from lambent.dataset.check import verify as check

    with Progress(str(folder), quiet=as_json) as progress:
        verdict = check(folder, progress.report)
    if as_json:
        print_json(verdict.as_dict())
    else:
        for file, wrong in verdict.corrupt.items():
            say(f"damaged   {file}: {wrong}")
        for file in verdict.missing:
            say(f"missing   {file}")
        for file in verdict.strangers:
            say(f"stranger  {file}: not in the list of items")
        say(f"{verdict.good:,} of {verdict.wanted:,} items are there and sound.")
        if verdict.corrupt or verdict.missing:
            say("The same 'lambent dataset make' makes them again.")
    if not verdict.sound:
        raise typer.Exit(2)


# ------------------------------------------------------------------- private


def _say_resume(folder: Path) -> None:
    remark(f"{folder}: the same command goes on from here")


def _print_outcome(outcome: Outcome) -> None:
    for note in outcome.notes:
        say(f"note: {note}")
    for failed in outcome.failed:
        numbers = ", ".join(map(str, failed.job.items))
        say(*f"failed: {failed.job.what} {numbers}: {failed.reason}".split("\n"))
    say(outcome.folder)
    if not outcome.made:
        left = "nothing was missing" if not outcome.left else "nothing could be made"
        say(f"{outcome.before:,} items were there; {left}.")
        return
    pace = outcome.made / max(outcome.seconds, 1e-9) * 3600
    size = outcome.bytes / outcome.made / 1e6
    say(
        f"{outcome.made:,} items made in {show_seconds(outcome.seconds)} ({pace:,.0f} an hour, "
        f"{size:.2f} MB each); {outcome.before:,} were there."
    )
    total = sum(outcome.phases.values())
    if total > 0:
        shares = sorted(outcome.phases.items(), key=lambda entry: -entry[1])
        say("Time: " + ", ".join(f"{name} {100 * s / total:.0f} %" for name, s in shares))
    if outcome.left:
        say(f"{outcome.left:,} are still to be made: the same command goes on.")


def _print_info(found: dict[str, Any]) -> None:
    say(f"{found['name']}: {found['source']}, seed {found['seed']}, in {found['folder']}", "")
    rows = [("", "made", "wanted", "MB each", "s each", "target spp", "target relMSE")]
    for what in ("crops", "clips"):
        kind = found[what]
        spp = kind["target_spp"]
        rows.append(
            (
                what,
                f"{kind['made']:,}",
                f"{kind['wanted']:,}",
                "" if kind["bytes_each"] is None else f"{kind['bytes_each'] / 1e6:.2f}",
                "" if kind["seconds_each"] is None else f"{kind['seconds_each']:.2f}",
                "" if spp is None else f"{spp[0]}-{spp[2]}, half {spp[1]}",
                "" if kind["target_relmse"] is None else f"{kind['target_relmse']:.2g}",
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        say("  ".join(t.rjust(w) for t, w in zip(row, widths, strict=True)).rstrip())
    say("", f"{found['bytes'] / 1e9:.2f} GB, {found['scenes']:,} scenes")
    say("kinds:    " + ", ".join(f"{k or 'one'} {n:,}" for k, n in found["kinds"].items()))
    say("spp:      " + ", ".join(f"{k}: {n:,}" for k, n in found["spp"].items()))
    say("licences: " + ("; ".join(found["licences"]) or "none stated"))
