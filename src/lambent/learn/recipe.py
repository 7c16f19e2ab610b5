"""The recipe of a training run: a small TOML file. Unknown keys are errors.

::

    name = "lambent"
    task = "denoise"
    size = "default"
    data = ["../mitsuba.toml"]
    steps = 20000

Every other key has the default below; a table ``[options]`` is handed to the task.
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from lambent.errors import OptionError
from lambent.settings import Range, read_toml, record_from
from lambent.training.schedule import OPTIMISERS, Schedule


@dataclass(frozen=True)
class TrainRecipe:
    """Settings of a run.

    ``data``: folders of data sets, or their recipes (``.toml``): made first (`learn.data`).
    ``steps`` of ``batch`` crops each; ``rate``: the highest
    learning rate, reached after ``warmup`` steps, which then falls along a cosine to ``last_rate``
    times it. ``decay``: of the running mean of the weights. ``held_out``: share of the scenes that
    are never trained on. ``check_every``: steps from one validation to the next. ``clip``: largest
    norm of a gradient. ``size``: of the network. ``optimiser``: a name in `OPTIMISERS`.
    ``known_failures``: sentences for the model's card.
    ``options``: what the task itself has to be told, a table ``[options]``.
    """

    name: str
    seed: int = 1
    task: str = "denoise"
    size: str = "default"
    data: tuple[str, ...] = ()
    steps: int = 20000
    batch: int = 16
    rate: float = 1e-3
    warmup: int = 300
    last_rate: float = 0.01
    decay: float = 0.999
    clip: float = 1.0
    held_out: float = 0.05
    check_every: int = 1000
    checked: int = 96
    optimiser: str = "adam"
    known_failures: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Every key with its value, as JSON and TOML know them."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @property
    def schedule(self) -> Schedule:
        """What the loop has to know."""
        return Schedule(
            self.steps, self.rate, self.warmup, self.last_rate, self.decay, self.clip,
            check_every=self.check_every, optimiser=self.optimiser, seed=self.seed,
        )  # fmt: skip


#: Keys that do not make another run.
MAY_DIFFER = ("data", "checked", "known_failures")

_RANGES: tuple[Range, ...] = (
    ("seed", 0, 2**31 - 1),
    ("steps", 1, 1 << 30),
    ("batch", 1, 4096),
    ("rate", 1e-8, 1),
    ("warmup", 0, 1 << 30),
    ("last_rate", 0, 1),
    ("decay", 0, 0.999999),
    ("clip", 1e-6, 1e9),
    ("held_out", 0, 0.9),
    ("check_every", 1, 1 << 30),
    ("checked", 1, 1 << 20),
)


def load_train_recipe(path: str | os.PathLike[str]) -> TrainRecipe:
    """The recipe in a TOML file; data are found from the recipe's own folder.

    Raises `FileError` (missing, no TOML) and `OptionError` (unknown key, senseless value).
    """
    path = Path(path)
    recipe = train_recipe_from(read_toml(path), path)
    folders = []
    for text in recipe.data:
        place = Path(os.path.expandvars(text)).expanduser()
        folders.append(str(place if place.is_absolute() else (path.parent / place).resolve()))
    return replace(recipe, data=tuple(folders))


def train_recipe_from(settings: dict[str, Any], file: object = None) -> TrainRecipe:
    """A recipe from keys and values. Raises `OptionError`."""
    recipe = record_from(TrainRecipe, settings, _RANGES, file, required=("name",))
    if not recipe.name or any(c in recipe.name for c in "/\\\0") or recipe.name.startswith("."):
        raise OptionError(f"'{recipe.name}' cannot be the name of a run", file=file)
    if recipe.optimiser not in OPTIMISERS:
        raise OptionError(
            f"there is no optimiser '{recipe.optimiser}'",
            file=file,
            remedy=f"take one of {', '.join(OPTIMISERS)}",
        )
    return recipe
