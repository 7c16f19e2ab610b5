"""How the weights of a run or a model came about, as a model's card tells it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from lambent.denoise.model_file import find_model, read_model
from lambent.errors import FileError
from lambent.frame.atomic import atomic
from lambent.settings import fits, parse_json, read_text
from lambent.training.run import Run

#: What a card keeps of the account of a run.
KEYS = ("name", "recipe", "step", "hours", "trained_with", "score", "curve", "data", "averaged")
_REMEDY = "begin the run anew"


def account(run: Run) -> dict[str, Any]:
    """What a card says of a run: recipe, hours, machine, best step and score, the curve.

    Raises `FileError` where there is no run, or none that was validated.
    """
    recipe = run.recipe()
    recipe["data"] = [Path(folder).name for folder in recipe["data"]]
    about, checks = run.about(), run.checks()
    if not checks:
        raise FileError("was never validated", file=run.folder, remedy="train on")
    best = min(checks, key=lambda line: line["check"]["score"])
    return {
        "name": recipe["name"],
        "recipe": recipe,
        "step": best["step"],
        "hours": round(about["seconds"] / 3600, 2),
        "trained_with": {
            k: about.get(k) for k in ("lambent", "commit", "torch", "processor", "cuda")
        },
        "score": best["check"],
        "curve": [[line["step"], line["check"]["score"]] for line in checks],
    }


def note_start(run: Run, start: str) -> None:
    """Keep in a run's folder how the weights that it begins with came about."""
    run.folder.mkdir(parents=True, exist_ok=True)
    with atomic(_file(run), overwrite=True) as handle:
        handle.write(json.dumps(story(start), indent=1).encode())


def before(run: Run) -> list[dict[str, Any]]:
    """The runs that a run began with, oldest first; none where its first weights were random.

    Raises `FileError`.
    """
    file = _file(run)
    if not file.exists():
        return []
    try:
        runs = parse_json(read_text(file, "account of a run", _REMEDY))
    except ValueError as error:
        raise FileError(f"is not valid JSON: {error}", file=file, remedy=_REMEDY) from None
    if not fits(runs, list[dict[str, Any]]):
        raise FileError("is not a list of runs", file=file, remedy=_REMEDY)
    return list(runs)


def story(start: str) -> list[dict[str, Any]]:
    """How the weights of a model, by name or path, or of a run's folder came about, oldest first.

    Raises `FileError`.
    """
    if Path(start).is_dir():
        run = Run(Path(start))
        return [*before(run), account(run)]
    card = read_model(find_model(start)).card
    return [*card.get("begun_with", []), {k: card[k] for k in KEYS if k in card}]


def _file(run: Run) -> Path:
    return run.folder / "begun_with.json"
