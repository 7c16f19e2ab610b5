"""Where the time goes: seconds by name, added up."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Phases:
    """Seconds of each phase of the work. Phases may stand inside each other; the inner one counts.

    ``with phases("target"): …``
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._open: list[list[float]] = []

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Count what happens in the block under this name."""
        start = time.perf_counter()
        inner = [0.0]
        self._open.append(inner)
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            self._open.pop()
            if self._open:
                self._open[-1][0] += spent
            self.seconds[name] = self.seconds.get(name, 0.0) + spent - inner[0]

    def add(self, other: dict[str, float]) -> None:
        """Add seconds that were counted elsewhere."""
        for name, spent in other.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + spent
