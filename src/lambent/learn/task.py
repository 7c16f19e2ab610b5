"""What the one training loop asks of anything that is to be learned.

A task builds its network, makes its batches, says what the loss is and how good the network is on
data it has not seen. Everything else (optimiser, schedule, averaging of weights, resuming, logs,
several processes) is the loop's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

#: Pictures by name, ``(H, W, 3)`` linear radiance, for the report page.
Pictures = Mapping[str, Any]


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


class Task(Protocol):
    """Something to learn."""

    def network(self) -> nn.Module:
        """A network with fresh weights; the seed is set by the caller."""

    def batches(self, first: int, rank: int, world: int) -> Iterator[Any]:
        """The batches from step ``first`` on, the share of process ``rank`` of ``world``."""

    def loss(self, model: nn.Module, batch: Any, device: torch.device) -> tuple[Tensor, dict]:
        """The loss of a batch, and its terms to be logged."""

    def score(self, model: nn.Module, device: torch.device) -> tuple[dict[str, float], Pictures]:
        """Figures of merit on held-out data; the key ``score`` is the one to make small."""


@runtime_checkable
class RecordableTask(Task, Protocol):
    """A task whose step is the same operations in every step: `graphed` may record it."""

    def tensors(self, batch: Any, device: torch.device) -> Sequence[Tensor]:
        """A batch on the device."""

    def loss_of(
        self, model: nn.Module, tensors: Sequence[Tensor]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """`loss` of those tensors, without asking the device for a number."""


class ShippedTask(Task, Protocol):
    """A task whose network can be written as a model file."""

    def exportable(self, model: nn.Module) -> Exportable:
        """The trained network as a model file holds it."""

    def says(self, scores: Mapping[str, float]) -> str:
        """For the card: the score in words."""

    def calibration(self) -> Sequence[Any]:
        """Inputs to measure the ranges of activations on, for int8; one array each."""

    def about_data(self) -> list[dict[str, Any]]:
        """For the card: what it was trained on."""
