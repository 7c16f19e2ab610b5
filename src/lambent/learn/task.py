"""What the one training loop asks of anything that is to be learned.

A task builds its network, makes its batches, says what the loss is and how good the network is on
data it has not seen. Everything else (optimiser, schedule, averaging of weights, resuming, logs,
several processes) is the loop's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor, nn

#: Pictures by name, ``(H, W, 3)`` linear radiance, for the report page.
Pictures = Mapping[str, Any]


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
