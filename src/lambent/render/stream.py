"""Random numbers of a lane: PCG32, seeded by the picture and the pixel.

Mitsuba numbers the streams of its samplers by the lane. Here a stream belongs to a seed and a pixel
of a window, wherever in a launch its lane is, so that a window has the same samples whether it is
rendered alone or together with others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi


@dataclass
class Stream:
    """What our paths need of a sampler: numbers in [0, 1). Part of the state of a loop."""

    state: Any

    def next_1d(self) -> Any:
        """A number."""
        return self.state.next_float32()

    def next_2d(self) -> Any:
        """A point."""
        x = self.state.next_float32()
        return mi.Point2f(x, self.state.next_float32())


def streams(seed: Any, pixel: Any) -> Stream:
    """One stream a lane; ``seed`` and ``pixel``: `UInt32`, one a lane or one for all.

    Both go through the Tiny Encryption Algorithm (Zafar, Olano and Curtis, "GPU random numbers via
    the Tiny Encryption Algorithm", HPG 2010), as Mitsuba's samplers do with seed and lane.
    """
    a, b = mi.sample_tea_32(seed, pixel)
    c, d = mi.sample_tea_32(seed ^ mi.UInt32(0x9E3779B9), pixel)
    start = mi.UInt64(a) | (mi.UInt64(c) << 32)
    sequence = mi.UInt64(b) | (mi.UInt64(d) << 32)
    return Stream(mi.PCG32(1, start, sequence))
