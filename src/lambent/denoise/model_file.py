"""A learned model as one file: its network, what it reads, and its card. Nothing in it is code.

The file is an archive (`lambent.archive`) of the kind ``model``::

    card.json      what the model is: name, size, what it reads (a key of `READS`) and the
                   version of that, how it was trained on what, its scores; ``averaged``: of
                   which weights it is a mean; ``commit``: the one that brought these weights
    network.xml    the network as OpenVINO reads it
    network.bin    its weights

`read_model` checks everything before anything is used. The weights of the float network, which
fine-tuning begins with, are read back from the same numbers (`learn.export`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from lambent.archive import KINDS, SUFFIX, Archive, check_card, read_archive, write_archive
from lambent.denoise import inputs, lobes
from lambent.errors import DamagedFileError, FileError, OptionError, UnknownNameError
from lambent.filters.denoiser import DENOISERS
from lambent.settings import shortened

#: What a network may read, and the version of its description: `inputs`, `lobes`, or the values of
#: a display-referred picture themselves.
READS: Mapping[str, int] = {"signals": inputs.VERSION, "lobes": lobes.VERSION, "pixels": 1}
NETWORK, WEIGHTS = "network.xml", "network.bin"

#: Keys of a card and their types: those that every model has, and those that it may have.
_ALWAYS = {"sha256": dict[str, str]}
_PERHAPS = {
    "name": str,
    "recipe": dict[str, Any],
    "step": int,
    "hours": float,
    "trained_with": dict[str, str | None],
    "score": dict[str, float],
    "score_says": str,
    "curve": list[list[float]],
    "parameters": int,
    "macs": int,
    "margin": int,
    "channels": int,
    "options": dict[str, Any],
    "data": list[dict[str, Any]],
    "begun_with": list[dict[str, Any]],
    "known_failures": list[str],
    "int8": bool,
    "averaged": str,
    "commit": str,
}
#: Values that sizes follow from: what needs them, lowest and highest.
_RANGES = {
    "lobes": {"margin": (0, 512)},
    "pixels": {"margin": (0, 512), "channels": (1, 3)},
}
_OPTION_RANGES = {"kernel": (1, 41), "width": (1, 4096), "scales": (1, 6)}


@dataclass(frozen=True, eq=False)
class ModelFile:
    """The content of a model file. ``card``: see the module; ``path``: where it came from."""

    card: Mapping[str, Any]
    network: bytes
    weights: bytes
    path: Path


def read_model(path: str | os.PathLike[str], reads: str | None = None) -> ModelFile:
    """A model from a file; ``reads``: what it must read, a key of `READS` (None: anything).

    Raises `FileError`: missing, no model, of another kind, made for another version of Lambent;
    `DamagedFileError`: cut off, not what its checksums say, or with a card that makes no sense.
    """
    archive = read_archive(path, "model")
    path, card, remedy = archive.path, archive.card, KINDS["model"][1]
    if not {NETWORK, WEIGHTS} <= set(archive.members):
        raise FileError("is not a Lambent model", file=path, remedy=remedy)
    kind = card.get("reads", "signals")  # models from before there were others do not say
    version = READS.get(kind) if isinstance(kind, str) else None
    if version is None or card.get("inputs") != version:
        raise FileError(
            f"was made for another version of Lambent (inputs {str(card.get('inputs'))[:40]} of "
            f"{str(kind)[:40]}; here {version})",
            file=path,
            remedy="train or export it again with this version",
        )
    _check_values(archive, kind)
    if reads is not None and kind != reads:
        raise FileError(
            f"is a model that reads {kind}, not {reads}",
            file=path,
            remedy=f"it was made for --model {card.get('recipe', {}).get('task', 'lambent')}",
        )
    return ModelFile(card, archive.members[NETWORK], archive.members[WEIGHTS], path)


def write_model(
    path: str | os.PathLike[str],
    card: Mapping[str, Any],
    network: bytes,
    weights: bytes,
    overwrite: bool = False,
) -> None:
    """A model to a file, in one step; the card's ``reads`` is a key of `READS`.

    Raises `OutputError`.
    """
    reads = card.get("reads", "signals")
    full = {**card, "reads": reads, "inputs": READS[reads]}
    write_archive(path, "model", full, {NETWORK: network, WEIGHTS: weights}, overwrite)


def shipped() -> dict[str, Path]:
    """The models that come with Lambent, by name."""
    folder = Path(str(resources.files("lambent") / "models"))
    return {path.stem: path for path in sorted(folder.glob(f"*{SUFFIX}"))}


def find_model(name: str) -> Path:
    """The file of a shipped model by name, or ``name`` itself if it is a path.

    Raises `UnknownNameError`.
    """
    known = shipped()
    if name in known:
        return known[name]
    if name.endswith(SUFFIX) or os.sep in name:
        return Path(name)
    raise UnknownNameError("network", name, list(known))


def as_denoiser(model: str, params: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The name and the parameters of a denoiser, for what ``--model`` names.

    A name stays as it is. A path (``mine.lambent``, or anything with a ``/``) becomes the denoiser
    that computes with such a model, with the path as its ``weights``. Raises `OptionError` where
    ``params`` have weights, too, and what `read_model` raises.
    """
    if model in DENOISERS or not (model.endswith(SUFFIX) or os.sep in model):
        return model, dict(params)
    if "weights" in params:
        raise OptionError(
            f"--model names the file '{model}', and weights another", remedy="name one of them"
        )
    found = loaded_model(model)
    reads, task = found.card.get("reads", "signals"), found.card.get("recipe", {}).get("task")
    name = {"signals": "lambent", "pixels": "dncnn"}.get(reads, task)  # of papers: the task
    if not isinstance(name, str) or name not in DENOISERS:
        raise FileError(
            f"holds a network of the task {shortened(task)}, which no denoiser computes with",
            file=found.path,
            remedy=f"known are {', '.join(DENOISERS)}",
        )
    return name, {**params, "weights": model}


def loaded_model(name: str, reads: str | None = None) -> ModelFile:
    """The model of a name or path, read once as long as its file does not change.

    Raises `UnknownNameError` and what `read_model` raises.
    """
    path = find_model(name)
    key = f"{reads}:{path}:{path.stat().st_mtime_ns if path.exists() else 0}"
    if key not in _loaded:
        _loaded[key] = read_model(path, reads)
    return _loaded[key]


# ------------------------------------------------------------------- private

_loaded: dict[str, ModelFile] = {}


def _check_values(archive: Archive, reads: str) -> None:
    """Whether the card's values have their types and lie in their ranges."""
    card = archive.card
    check_card(archive, {**_ALWAYS, **{k: v for k, v in _PERHAPS.items() if k in card}})
    ranges = _RANGES.get(reads, {})
    check_card(archive, dict.fromkeys(ranges, int))
    if reads == "lobes":
        check_card(archive, {"options": dict[str, Any]})
    options = card.get("options", {})
    numbers = [(name, card[name], *limits) for name, limits in ranges.items()]
    numbers += [(n, options[n], *limits) for n, limits in _OPTION_RANGES.items() if n in options]
    for name, value, low, high in numbers:
        if type(value) is not int or not low <= value <= high:
            raise DamagedFileError(
                f"is damaged: '{name}' of its card is {str(value)[:40]}, not {low} to {high}",
                file=archive.path,
                remedy=KINDS["model"][1],
            )
