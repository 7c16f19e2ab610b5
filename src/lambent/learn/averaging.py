"""One model from several: the mean of their weights.

Between networks that began alike, and what fine-tuning made of one of them, lies often one that has
the gain of the one and most of the other's (Wortsman et al. 2022, "Model soups"). The shipped
weights are such means.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lambent.denoise.inputs import CHANNELS
from lambent.denoise.model_file import find_model, read_model
from lambent.errors import OptionError
from lambent.learn.account import account, before
from lambent.learn.export import cost_of, export, float_weights
from lambent.learn.networks.lambent import LambentNet
from lambent.learn.networks.rounded import RoundedNet
from lambent.learn.task import Exportable
from lambent.training.log import commit
from lambent.training.run import Run

#: What a mean keeps of the card of each of its parts.
KEYS = ("name", "recipe", "step", "hours", "trained_with", "score", "data", "begun_with")


def average(sources: Sequence[str], path: Path, overwrite: bool = False) -> dict[str, Any]:
    """Write the mean of the weights of runs and models of one size as a model file; its card.

    ``sources``: folders of runs (their best weights), models by name or path; of our own network.
    The card has all of them under ``parts``, each with the score of its own; of the mean no
    score is known until somebody measures it. Raises `FileError`, `OptionError`, `OutputError`.
    """
    if len(sources) < 2:
        raise OptionError("a mean needs two models or more", remedy="name more runs or models")
    weights, parts = zip(*(_part(source) for source in sources), strict=True)
    shapes = [{k: tuple(v.shape) for k, v in w.items()} for w in weights]
    if any(shape != shapes[0] for shape in shapes):
        raise OptionError(
            "models of different sizes cannot be averaged", remedy="take models of one size"
        )
    size = parts[0].get("recipe", {}).get("size", "default")
    model = (RoundedNet if "steps.input" in weights[0] else LambentNet)(size)
    model.load_state_dict({k: sum(w[k] for w in weights) / len(weights) for k in weights[0]})
    ready = Exportable(model.eval(), (torch.zeros(1, CHANNELS, 64, 64),), "signals")
    sets: list[Any] = []
    for part in parts:
        sets += [one for one in part.get("data", ()) if one not in sets]
    names = ", ".join(
        str(part.get("name", source)) for part, source in zip(parts, sources, strict=True)
    )
    card = {
        "name": path.stem,
        "recipe": parts[0].get("recipe", {}),
        "reads": ready.reads,
        **cost_of(ready),
        "data": sets,
        "commit": commit(),
        "averaged": f"over {len(parts)} sets of weights: {names}",
        "parts": list(parts),
        "score_says": "not measured: a mean of weights has an error of its own",
    }
    export(model, path, card, None, overwrite, half=True)
    return card


def _part(source: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Weights, and what is known of them."""
    if Path(source).is_dir():
        run = Run(Path(source))
        told = account(run)
        data = [{"name": name} for name in told["recipe"]["data"]]
        return run.weights(), {**told, "data": data, "begun_with": before(run)}
    card = read_model(find_model(source), "signals").card
    return float_weights(source, steps=True), {k: card[k] for k in KEYS if k in card}
