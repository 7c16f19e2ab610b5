"""What learning here adds to `training.task`: a network that ends up in a model file."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor, nn

from lambent.settings import Range, record_from
from lambent.training.task import Task


@dataclass(frozen=True)
class Exportable:
    """A network as it goes into a model file.

    ``examples``: one tensor an input, with the channels that it has; height and width are free.
    ``reads``: a key of `denoise.model_file.READS`. ``about``: more for the card.
    """

    network: nn.Module
    examples: tuple[Tensor, ...]
    reads: str
    about: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Learnable:
    """An entry of `tasks.TASKS`: a network to be learned, with what a recipe may say of it.

    ``options``: the dataclass of the recipe's table ``[options]``; ``ranges`` of its fields.
    ``network``: called with those options, where the task asks for it. ``make``: the task from a
    recipe, the folder of the cache and a progress function.
    """

    options: type
    ranges: tuple[Range, ...]
    network: Any
    make: Callable[..., ShippedTask]

    def options_from(self, options: Mapping[str, Any]) -> Any:
        """The options in a recipe's table. Raises `OptionError`."""
        return record_from(self.options, dict(options), self.ranges)


class ShippedTask(Task):
    """A task whose network can be written as a model file."""

    @abstractmethod
    def exportable(self, model: nn.Module) -> Exportable:
        """The trained network as a model file holds it."""

    @abstractmethod
    def says(self, scores: Mapping[str, float]) -> str:
        """For the card: the score in words."""

    @abstractmethod
    def calibration(self) -> Sequence[Any]:
        """Inputs to measure the ranges of activations on, for int8; one array each."""

    @abstractmethod
    def about_data(self) -> list[dict[str, Any]]:
        """For the card: what it was trained on."""
