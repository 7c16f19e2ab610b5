"""How long a training goes on, and how fast it learns at every step of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Adam with decoupled weight decay; stochastic gradient descent with and without momentum.
OPTIMISERS = ("adam", "momentum", "sgd")


@dataclass(frozen=True)
class Schedule:
    """What the loop has to know of a training.

    ``rate``: the highest learning rate, reached after ``warmup`` steps, which then falls along a
    cosine to ``last_rate`` times it. ``decay``: of the running mean of the weights. ``clip``:
    largest norm of a gradient. ``check_every``: steps from one validation to the next.
    ``optimiser``: a name in `OPTIMISERS`. ``seed``: of the first weights.
    """

    steps: int
    rate: float = 1e-3
    warmup: int = 300
    last_rate: float = 0.01
    decay: float = 0.999
    clip: float = 1.0
    weight_decay: float = 1e-4
    check_every: int = 1000
    optimiser: str = "adam"
    seed: int = 1

    def rate_at(self, step: int, share: float | None = None) -> float:
        """The learning rate of a step: a ramp, then half a cosine.

        ``share``: of the run that is over, where it has a time rather than a number of steps.
        """
        if step < self.warmup:
            return self.rate * (step + 1) / self.warmup
        if share is None:
            share = (step - self.warmup) / max(1, self.steps - self.warmup)
        cosine = 0.5 * (1 + math.cos(math.pi * min(share, 1)))
        return self.rate * (self.last_rate + (1 - self.last_rate) * cosine)
