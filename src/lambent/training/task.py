"""What the training loop asks of anything that is to be learned.

A task builds its network, makes its batches, computes the loss and judges the network on data that
it has not seen. Everything else (optimiser, schedule, averaging of weights, resuming, logs, several
processes) is the loop's. What is random in a task follows from the number of the step, or is part
of its `state`; then a run that is resumed takes the steps that it would have taken.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor, nn

#: Pictures by name, ``(H, W, 3)`` linear radiance, for the report page.
Pictures = Mapping[str, Any]
Weights = Mapping[str, "Tensor"]


class Task(ABC):
    """Something to learn. `network`, `loss` and `score` are needed; the rest has defaults."""

    #: Where the loop computes, as PyTorch names it ("cpu", "cuda:0"). The loop sets it before it
    #: asks for anything.
    device: str = "cpu"

    @abstractmethod
    def network(self) -> nn.Module:
        """A network with fresh weights; the loop sets PyTorch's seed."""

    def started(self, weights: Weights | None) -> Weights | None:
        """The weights that a new run begins with, from those that the caller names (None: none).

        None: those of `network`.
        """
        return weights

    def batches(self, first: int, rank: int, world: int) -> Generator[Any, None, None]:
        """The batches from step ``first`` on, the share of process ``rank`` of ``world``.

        By default the numbers of the steps, for a task that makes its data within `loss`.
        """
        yield from itertools.count(first)

    @abstractmethod
    def loss(self, model: nn.Module, batch: Any) -> tuple[Tensor, Mapping[str, Tensor]]:
        """The loss of a batch, and its terms to be logged. ``model`` is on `device`."""

    @abstractmethod
    def score(self, model: nn.Module) -> tuple[Mapping[str, float], Pictures]:
        """Figures of merit on held-out data; the key ``score`` is the one to make small."""

    def state(self) -> Mapping[str, Any]:
        """What a resumed run has to know of the task, beside the step: tensors and numbers."""
        return {}

    def resume(self, state: Mapping[str, Any]) -> None:  # noqa: B027 (most have no state)
        """Take up a `state` again."""

    def close(self) -> None:  # noqa: B027 (most hold nothing)
        """Let go of processes and files: called by whoever made the task, once it is done with."""


class RecordableTask(Task):
    """A task whose step is the same operations in every step: `graphed` may record it."""

    @abstractmethod
    def tensors(self, batch: Any) -> Sequence[Tensor]:
        """A batch on the device."""

    @abstractmethod
    def loss_of(
        self, model: nn.Module, tensors: Sequence[Tensor]
    ) -> tuple[Tensor, Mapping[str, Tensor]]:
        """`loss` of those tensors, without asking the device for a number."""

    def loss(self, model: nn.Module, batch: Any) -> tuple[Tensor, Mapping[str, Tensor]]:
        """`loss_of` the batch's tensors."""
        return self.loss_of(model, self.tensors(batch))
