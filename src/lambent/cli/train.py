"""Train a denoiser from a recipe, or fine-tune one to your own renders.

A recipe is a small TOML file; the run keeps its state, log, pictures and best weights in a folder,
and the same command continues it, whatever stopped it. Needs the extra `train`
(pip install 'lambent[train]').
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lambent.cli.options import (
    DeviceOption,
    JsonOption,
    OverwriteOption,
    ThreadsOption,
    page_for,
    print_json,
    seconds_of,
    time_option,
)
from lambent.cli.progress import Progress
from lambent.cli.terminal import remark, say

if TYPE_CHECKING:
    from lambent.learn.recipe import TrainRecipe
    from lambent.training.run import Run

#: Seconds that fine-tuning takes at most, unless --time says otherwise.
FINE_TUNING = 600.0

EPILOG = "Example: lambent train recipes/train/denoiser.toml --report"


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
        typer.Option(
            "--run", metavar="DIR", help="Folder of the run. Default: in the cache, by name."
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option("--steps", metavar="N", help="Stop after this many steps in all, for now."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="MODEL", help="Begin with the weights of a model or a run."),
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
        typer.Option(
            "--output",
            "-o",
            metavar="MODEL",
            help="Write the best weights so far as a model. Default: of a recipe, none; of --data, "
            "EXR_tuned.lambent.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    report: Annotated[
        str | None,
        typer.Option(
            "--report",
            metavar="[PAGE.html]",
            help="Write a page that follows the run; without a name, report.html in its folder.",
        ),
    ] = None,
    time: Annotated[
        str | None,
        time_option("Fine-tune for at most this time (10m); a recipe: this long, not its steps"),
    ] = None,
    threads: ThreadsOption = None,
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
        from lambent.training.run import Run
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
    seconds = seconds_of("--time", time)
    if data and output is None:
        output = data[0].with_name(f"{data[0].stem}_tuned.lambent")
    if output is not None:
        check_target(output, overwrite)
    if threads is not None:
        use_threads(threads)
    if data:
        if recipe is not None:
            raise OptionError("a recipe and --data exclude each other", remedy="leave one out")
        if report is not None:
            raise OptionError("fine-tuning writes no page", remedy="leave out --report")
        assert output is not None
        with Progress("fine-tuning", quiet=as_json) as progress:
            result = finetune(
                data, start or "lambent", output, seconds or FINE_TUNING, device,
                overwrite=overwrite, progress=progress.report,
            )  # fmt: skip
        print_json(result) if as_json else _print_finetuned(result, output)
        return
    if recipe is None:
        raise OptionError("a recipe is missing", remedy="lambent train RECIPE.toml, or --data")
    chosen = load_train_recipe(recipe)

    folder = run if run is not None else run_folder(chosen)
    page = page_for(report, folder / "report.html")
    begun = Run(folder).state.exists()
    if page is not None and page.parent != folder:
        check_target(page, overwrite or begun)
    with Progress(chosen.name, quiet=as_json) as progress:
        watch = _Watch(Run(folder), chosen, page, progress)
        try:
            done = run_training(
                chosen, folder, output=output, overwrite=overwrite, start=start, steps=steps,
                seconds=seconds, device=device, progress=watch.report,
            )  # fmt: skip
        except KeyboardInterrupt:
            remark(f"stopped; the same command continues it. The run is in {folder}")
            raise
    if int(os.environ.get("RANK", 0)):  # by torchrun: the first process tells
        return
    watch.write_page(running=False)
    checks = done.checks()
    best = min(checks, key=lambda line: line["check"]["score"]) if checks else None
    if as_json:
        written = {"output": output and str(output), "report": page and str(page)}
        print_json({"run": str(done.folder), "best": best, **written})
    else:
        words = f"best score {best['check']['score']:.4f} at step {best['step']}" if best else ""
        say(f"{done.folder}: {words or 'not validated yet'}")
        if page is not None:
            say(f"report {page}")
        if output is not None:
            say(f"wrote {output}")
        elif best:
            say(f"for a model to denoise with, the same command with -o {chosen.name}.lambent")


# ------------------------------------------------------------------- private


class _Watch:
    """Follows the log of a run while it trains: its newest figures beside the progress, a page."""

    def __init__(self, run: Run, recipe: TrainRecipe, page: Path | None, shown: Progress) -> None:
        self.run, self.recipe, self.page, self.shown = run, recipe, page, shown
        self._size = -1
        self._words = ""

    def report(self, done: float, total: float, text: str) -> None:
        """A step is over, or some of the data is made."""
        size = self.run.log.stat().st_size if self.run.log.exists() else -1
        if size != self._size:
            self._size = size
            self._words = _figures(self.run)
            self.write_page()
        self.shown.report(done, total, text + self._words)

    def write_page(self, running: bool = True) -> None:
        """Write the page, if there is to be one; the first process does."""
        if self.page is None or int(os.environ.get("RANK", 0)):
            return
        import io

        from PIL import Image

        from lambent.report.training import write_training

        pictures = []
        for file in sorted(self.run.pictures.glob("*.png")):
            data = file.read_bytes()
            pictures.append((data, Image.open(io.BytesIO(data)).size))
        steps, lines = self.recipe.steps, self.run.lines()
        write_training(self.page, self.recipe.name, lines, pictures, steps=steps, running=running)


def _figures(run: Run) -> str:
    """The newest loss and the newest score, for the progress line."""
    loss = score = ""
    for line in run.lines():
        loss = f", loss {line['loss']:.4f}" if "loss" in line else loss
        score = f", score {line['check']['score']:.3f}" if "check" in line else score
    return loss + score


def _print_finetuned(result: dict[str, float], output: Path) -> None:
    say(
        f"error on held-out tiles {result['before']:.4f} before, {result['after']:.4f} after "
        f"({100 * (result['after'] / result['before'] - 1):+.1f} %), "
        f"{int(result['steps'])} steps in {result['seconds']:.0f} s"
    )
    say(f"wrote {output}; use it: lambent denoise noisy.exr --model {output}")
