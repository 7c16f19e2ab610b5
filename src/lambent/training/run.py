"""A training run on disk::

recipe.json      the settings        run.json       version, hardware, seconds spent
log.jsonl        one line now and then: step, loss and its terms, or a validation
state.pt         weights, mean weights, optimiser, step: all that resuming needs
best.pt          the mean weights with the best validation score so far
pictures/        validation pictures of the newest validation
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lambent.errors import DamagedFileError, FileError, OptionError, stop_by_interrupt
from lambent.frame.atomic import atomic
from lambent.settings import parse_json, read_json

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class Run:
    """The folder of a run."""

    folder: Path

    @property
    def state(self) -> Path:
        """All that resuming needs."""
        return self.folder / "state.pt"

    @property
    def best(self) -> Path:
        """The best weights so far."""
        return self.folder / "best.pt"

    @property
    def log(self) -> Path:
        """What has happened, a JSON object a line."""
        return self.folder / "log.jsonl"

    @property
    def pictures(self) -> Path:
        """The folder of the newest validation's pictures."""
        return self.folder / "pictures"

    def recipe(self) -> dict[str, Any]:
        """The settings of the run. Raises `FileError`."""
        return read_json(self.folder / "recipe.json", "recipe of a run", "name a run's folder")

    def about(self) -> dict[str, Any]:
        """Version, hardware and seconds spent. Raises `FileError`."""
        return read_json(self.folder / "run.json", "account of a run", "begin the run anew")

    def lines(self) -> list[dict[str, Any]]:
        """The log; a last line that was cut off is left out."""
        lines = []
        if self.log.exists():
            for line in self.log.read_text(encoding="utf-8").splitlines():
                with suppress(ValueError):
                    lines.append(parse_json(line))
        return lines

    def checks(self) -> list[dict[str, Any]]:
        """The lines of the log that are validations."""
        return [line for line in self.lines() if "check" in line]

    def weights(self) -> dict[str, Tensor]:
        """The best mean weights. Raises `FileError` before the first validation."""
        return dict(load(self.best)["weights"])

    def last_weights(self) -> dict[str, Tensor]:
        """The mean weights where the run stopped. Raises `FileError` before the first step."""
        return dict(load(self.state)["mean"])

    def prepare(self, settings: Mapping[str, Any], may_differ: Collection[str] = ()) -> None:
        """Make the folder, or make sure that it holds a run with these settings.

        ``may_differ``: keys that do not matter. Raises `OptionError`.
        """
        path = self.folder / "recipe.json"
        if not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            with atomic(path) as handle:
                handle.write(json.dumps(settings, indent=1).encode())
            return
        known = self.recipe()
        different = sorted(
            k for k, v in settings.items() if known.get(k) != v and k not in may_differ
        )
        if different:
            raise OptionError(
                f"holds a run with another recipe: {', '.join(different)} differ",
                file=self.folder,
                remedy="train into another folder with --run, or delete this one",
            )


def load(path: Path) -> dict[str, Any]:
    """A file of tensors and numbers; nothing in it is run. Raises `FileError`."""
    import torch

    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise FileError("is not there yet", file=path, remedy="train first") from None
    except Exception as error:
        stop_by_interrupt(error)
        raise DamagedFileError(
            f"cannot be read: {error}", file=path, remedy="delete it, or the whole run"
        ) from None
    if not isinstance(stored, dict):
        raise DamagedFileError(
            "is not part of a run", file=path, remedy="delete it, or the whole run"
        )
    return stored
