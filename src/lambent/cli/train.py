"""Train a denoiser from a recipe, or fine-tune one to your own renders.

A recipe is a small TOML file; the run keeps its state, log, pictures and best weights in a folder,
and goes on where it stopped, whatever stopped it: give the same command again. Needs the extra
`train` (pip install 'lambent[train]').
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lambent.cli.options import DeviceOption, JsonOption, print_json
from lambent.cli.progress import Progress
from lambent.cli.terminal import remark, say

if TYPE_CHECKING:
    from lambent.learn.recipe import TrainRecipe
    from lambent.training.run import Run

EPILOG = "Example: lambent train recipes/train/denoiser.toml --report training.html"


def train(
    recipes: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[RECIPE | average RUN...]",
            help="A TOML file; none to fine-tune. average: the mean of the weights of several runs "
            "(folders) or models, to the output.",
        ),
    ] = None,
    run: Annotated[
        Path | None,
        typer.Option("--run", metavar="DIR", help="Folder of the run; else in the cache, by name."),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option("--steps", metavar="N", help="Stop after so many steps in all, for now."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="MODEL", help="Begin with this model's weights."),
    ] = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(
            "--data",
            metavar="EXR",
            help="Fine-tune to these frames; NAME.exr with NAME.reference.exr beside it, or with "
            "half buffers. Repeatable.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="MODEL", help="Write the best weights so far."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the output.")] = False,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="PAGE.html", help="A page that follows.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            "--minutes",
            metavar="M",
            help="At most so long to fine-tune (10); of a recipe: so long instead of its steps.",
        ),
    ] = None,
    threads: Annotated[
        int | None, typer.Option("--threads", metavar="N", help="Processors to use.")
    ] = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.errors import EngineError, OptionError, stop_by_interrupt
    from lambent.frame.atomic import check_target

    try:
        from lambent.learn.averaging import average
        from lambent.learn.finetune import finetune
        from lambent.learn.train import run_folder
        from lambent.learn.train import train as run_training
        from lambent.training.process import use_threads
    except ImportError as error:
        stop_by_interrupt(error)
        if (error.name or "").split(".")[0] != "torch":
            raise
        raise EngineError(
            "training needs PyTorch, which is not installed",
            remedy="pip install 'lambent[train]'",
        ) from error
    from lambent.learn.recipe import load_train_recipe

    if recipes and str(recipes[0]) == "average":
        if output is None:
            raise OptionError("a mean needs a place for the model", remedy="-o mine.lambent")
        card = average([str(source) for source in recipes[1:]], output, overwrite)
        print_json(card) if as_json else say(f"wrote {output}; its score is not measured")
        return
    if len(recipes or ()) > 1:
        raise OptionError("one recipe at a time", remedy="lambent train RECIPE.toml")
    recipe = recipes[0] if recipes else None
    if output is not None:
        check_target(output, overwrite)
    if threads is not None:
        use_threads(threads)
    if data:
        if recipe is not None:
            raise OptionError("a recipe and --data exclude each other", remedy="leave one out")
        if output is None:
            raise OptionError("fine-tuning needs a place for the model", remedy="-o mine.lambent")
        with Progress("fine-tuning", quiet=as_json) as progress:
            result = finetune(
                data, start or "lambent", output, (minutes or 10.0) * 60, device,
                overwrite=overwrite, progress=progress.report,
            )  # fmt: skip
        print_json(result) if as_json else _print_finetuned(result, output)
        return
    if recipe is None:
        raise OptionError("a recipe is missing", remedy="lambent train RECIPE.toml, or --data")
    chosen = load_train_recipe(recipe)

    def page(it: Run, running: bool = True) -> None:
        if report is not None:
            _write_page(report, it, chosen, running)

    with Progress(chosen.name, quiet=as_json) as progress:
        try:
            done = run_training(
                chosen, run, output=output, overwrite=overwrite, start=start, steps=steps,
                seconds=minutes and minutes * 60, device=device, progress=progress.report,
                after_check=page,
            )  # fmt: skip
        except KeyboardInterrupt:
            place = run if run is not None else run_folder(chosen)
            remark(f"stopped; the same command goes on. The run is in {place}")
            raise
    if int(os.environ.get("RANK", 0)):  # by torchrun: the first process tells
        return
    page(done, running=False)
    checks = done.checks()
    best = min(checks, key=lambda line: line["check"]["score"]) if checks else None
    if as_json:
        print_json({"run": str(done.folder), "best": best, "output": output and str(output)})
    else:
        words = f"best score {best['check']['score']:.4f} at step {best['step']}" if best else ""
        say(f"{done.folder}: {words or 'not validated yet'}")
        if output is not None:
            say(f"wrote {output}")


# ------------------------------------------------------------------- private


def _write_page(path: Path, run: Run, recipe: TrainRecipe, running: bool) -> None:
    import io

    from PIL import Image

    from lambent.report.training import write_training

    pictures = []
    for file in sorted(run.pictures.glob("*.png")):
        data = file.read_bytes()
        pictures.append((data, Image.open(io.BytesIO(data)).size))
    write_training(path, recipe.name, run.lines(), pictures, steps=recipe.steps, running=running)


def _print_finetuned(result: dict[str, float], output: Path) -> None:
    say(
        f"error on held-out tiles {result['before']:.4f} before, {result['after']:.4f} after "
        f"({100 * (result['after'] / result['before'] - 1):+.1f} %), "
        f"{int(result['steps'])} steps in {result['seconds']:.0f} s"
    )
    say(f"wrote {output}; use it: lambent denoise noisy.exr --model lambent --set weights={output}")
