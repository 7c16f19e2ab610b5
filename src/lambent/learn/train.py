"""The verb: a recipe in, a run out, and a model file where one is wanted."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import Tensor

from lambent.denoise.model_file import find_model, read_model
from lambent.frame.atomic import atomic, check_target
from lambent.learn.data import with_data
from lambent.learn.export import export_run, float_weights
from lambent.learn.loop import Run, join
from lambent.learn.loop import train as run_loop
from lambent.learn.recipe import TrainRecipe, load_train_recipe
from lambent.learn.tasks import TASKS
from lambent.progress import Progress
from lambent.startup import cache_folder


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
    after_check: Callable[[Run], None] | None = None,
) -> Run:
    """Train from a recipe (a TOML file or a `TrainRecipe`), or go on training.

    ``run``: folder of the run (None: `run_folder`). ``output``: write the best weights as a model
    file. ``start``: a model, by name or path, or a run's folder, to begin with. ``steps``: stop
    after so many in all, for now. ``seconds``: train for so long instead, with the schedule of the
    rate by the clock. ``after_check`` is called after each validation. Example::

        run = lambent.train("recipes/train/denoiser.toml", output="mine.lambent")
        run.lines()[-1]

    Raises `FileError`, `OptionError`, `UnknownNameError`, `OutputError`, `EngineError`.
    """
    chosen = recipe if isinstance(recipe, TrainRecipe) else load_train_recipe(recipe)
    if output is not None:
        check_target(output, overwrite)
    make_task = TASKS[chosen.task]
    here = join(device)
    place = cache_folder() / "training"
    if not here.first:  # data are made and unpacked once
        here.wait()
    chosen = with_data(chosen, device, progress, missing=here.first)
    task = make_task(chosen, place, progress if here.first else None)
    if here.first:
        here.wait()
    folder = Path(run) if run is not None else run_folder(chosen)
    weights = None
    if not Run(folder).state.exists():  # a run that goes on has weights of its own
        if start is not None:
            weights = _weights(start)
        if start is not None and here.first:
            folder.mkdir(parents=True, exist_ok=True)
            with atomic(Run(folder).begun, overwrite=True) as handle:
                handle.write(json.dumps(story(start), indent=1).encode())
        if hasattr(task, "device"):
            task.device = here.device.type
        if hasattr(task, "started"):
            weights = task.started(weights)
    try:
        done = run_loop(
            chosen, task, folder, device, start=weights, steps=steps, seconds=seconds,
            progress=progress, after_check=after_check,
        )  # fmt: skip
    finally:
        close = getattr(task, "close", None)
        if close is not None:
            close()
    if output is not None and here.first:
        export_run(done, task, Path(output), overwrite)
    return done


def _weights(start: str) -> dict[str, Tensor]:
    """Of a model by name or path, or of the folder of a run. Raises `FileError`."""
    if Path(start).is_dir():
        return Run(Path(start)).weights()
    return float_weights(start, steps=True)


def story(start: str) -> list[dict[str, Any]]:
    """How the weights of a model, by name or path, or of a run's folder came about, oldest first.

    Raises `FileError`.
    """
    if Path(start).is_dir():
        run = Run(Path(start))
        return [*run.before(), run.told()]
    card = read_model(find_model(start)).card
    keys = ("name", "recipe", "step", "hours", "trained_with", "score", "curve", "data", "averaged")
    return [*card.get("begun_with", []), {k: card[k] for k in keys if k in card}]


def run_folder(recipe: TrainRecipe) -> Path:
    """``$LAMBENT_CACHE`` or ``~/.cache/lambent``, and in it ``runs/NAME``."""
    return cache_folder() / "runs" / recipe.name
