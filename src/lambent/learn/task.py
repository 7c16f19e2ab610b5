"""What learning here adds to `training.task`: a network that ends up in a model file."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor, nn

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
