"""The data that a training recipe names: folders, or recipes of data sets, which are then made.

So `lambent train` starts on an empty machine: what is missing of a set is made first, and a stop
loses nothing of it (`lambent.dataset.make`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lambent.dataset.make import default_folder, make
from lambent.dataset.recipe import load_recipe
from lambent.errors import LambentError
from lambent.learn.recipe import TrainRecipe
from lambent.progress import Progress, silent


def with_data(
    recipe: TrainRecipe,
    device: str = "auto",
    progress: Progress | None = None,
    missing: bool = True,
) -> TrainRecipe:
    """The recipe with folders alone; sets that are named by their recipe are made, or completed.

    They go where `lambent dataset make` puts them. Not ``missing``: take what there is, since
    another process makes the rest. Raises what making a set raises, and
    `LambentError` where some of it cannot be made.
    """
    folders = []
    for text in recipe.data:
        if not text.endswith(".toml"):
            folders.append(text)
            continue
        wanted = load_recipe(text)
        folder = default_folder(wanted)
        folders.append(str(folder))
        if not missing:
            continue
        outcome = make(wanted, folder, device=device, trust=True, progress=progress or silent)
        if outcome.failed and not outcome.made and not outcome.before:
            raise LambentError(
                f"the data set '{wanted.name}' cannot be made: {outcome.failed[0].reason}",
                remedy=f"see: lambent dataset make {Path(text)}",
            )
    return replace(recipe, data=tuple(folders))
