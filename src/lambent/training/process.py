"""Which of how many processes this is, where it computes, and with how many threads."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass

import torch

from lambent.device import choose_device

#: The first process may have data to make before the others can go on.
PATIENCE = datetime.timedelta(days=7)


@dataclass(frozen=True)
class Process:
    """This process among those of ``torchrun``."""

    rank: int
    world: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether it is the one that writes."""
        return self.rank == 0

    def wait(self) -> None:
        """Until all processes are here."""
        if self.world > 1:
            torch.distributed.all_reduce(torch.zeros(1))


def join(device: str) -> Process:
    """This process among those of ``torchrun``; alone without it.

    Raises `OptionError` for an unknown device, `EngineError` for one that is not there.
    """
    kind = choose_device(device, torch.cuda.is_available)
    world, rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
    here = int(os.environ.get("LOCAL_RANK", 0))
    place = torch.device("cuda", here) if kind == "cuda" else torch.device("cpu")
    if world > 1 and not torch.distributed.is_initialized():
        backend = "cpu:gloo,cuda:nccl" if kind == "cuda" else "gloo"
        torch.distributed.init_process_group(backend, timeout=PATIENCE)
    return Process(rank, world, place)


def use_threads(count: int) -> None:
    """Let PyTorch use so many processors."""
    torch.set_num_threads(count)
