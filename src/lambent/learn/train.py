"""The verb: a recipe in, a run out, and a model file where one is wanted."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path
from typing import Any

from torch import Tensor

from lambent.frame.atomic import check_target
from lambent.learn.account import note_start
from lambent.learn.data import with_data
from lambent.learn.export import export_run, float_weights
from lambent.learn.recipe import MAY_DIFFER, TrainRecipe, load_train_recipe
from lambent.learn.task import Learnable
from lambent.learn.tasks import TASKS
from lambent.progress import Progress
from lambent.startup import cache_folder
from lambent.training.loop import train as run_loop
from lambent.training.process import join
from lambent.training.run import Run
from lambent.training.task import Task


def train(
    recipe: str | os.PathLike[str] | TrainRecipe,
    run: str | os.PathLike[str] | None = None,
    *,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    start: str | None = None,
    steps: int | None = None,
    seconds: float | None = None,
    device: str = "auto",
    progress: Progress | None = None,
) -> Run:
    """Train from a recipe (a TOML file or a `TrainRecipe`), or go on training.

    ``run``: folder of the run (None: `run_folder`). ``output``: write the best weights as a model
    file. ``start``: a model, by name or path, or a run's folder, to begin with. ``steps``: stop
    after so many in all, for now. ``seconds``: train for so long instead, with the schedule of the
    rate by the clock. Example::

        run = lambent.train("recipes/train/denoiser.toml", output="mine.lambent")
        run.lines()[-1]

    Raises `FileError`, `OptionError`, `UnknownNameError`, `OutputError`, `EngineError`.
    """
    chosen = recipe if isinstance(recipe, TrainRecipe) else load_train_recipe(recipe)
    if output is not None:
        check_target(output, overwrite)
    entry: Learnable = TASKS[chosen.task]
    entry.options_from(chosen.options)  # what is wrong with them is said before data are made
    here = join(device)
    place = cache_folder() / "training"
    if not here.first:  # data are made and unpacked once
        here.wait()
    chosen = with_data(chosen, device, progress, missing=here.first)
    with closing(entry.make(chosen, place, progress if here.first else None)) as task:
        if here.first:
            here.wait()
        folder = Path(run) if run is not None else run_folder(chosen)
        weights = None
        if start is not None and not Run(folder).state.exists():
            weights = _weights(start)  # a run that goes on has weights of its own
            if here.first:
                note_start(Run(folder), start)
        done = train_task(
            chosen, task, folder, device, start=weights, steps=steps, seconds=seconds,
            progress=progress,
        )  # fmt: skip
        if output is not None and here.first:
            export_run(done, task, Path(output), overwrite)
    return done


def train_task(
    recipe: TrainRecipe, task: Task, folder: Path, device: str = "auto", **more: Any
) -> Run:
    """`training.loop.train` with a recipe's schedule; the run's folder keeps the whole recipe."""
    return run_loop(
        recipe.schedule, task, folder, device, settings=recipe.as_dict(), may_differ=MAY_DIFFER,
        **more,
    )  # fmt: skip


def _weights(start: str) -> dict[str, Tensor]:
    """Of a model by name or path, or of the folder of a run. Raises `FileError`."""
    if Path(start).is_dir():
        return Run(Path(start)).weights()
    return float_weights(start, steps=True)


def run_folder(recipe: TrainRecipe) -> Path:
    """``$LAMBENT_CACHE`` or ``~/.cache/lambent``, and in it ``runs/NAME``."""
    return cache_folder() / "runs" / recipe.name
