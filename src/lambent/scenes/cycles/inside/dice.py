"""Chance: one seed gives the same scene on every machine.

Python's own generator is used, whose sequence is fixed by the language for a seed of text; arrays
come from NumPy's PCG64. Parts of a scene take dice of their own (`Dice.child`), so that a change of
one part leaves the others as they were.
"""

from __future__ import annotations

import colorsys
import math
import random
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

Colour = tuple[float, float, float]
T = TypeVar("T")


class Dice:
    """Draws for one part of a scene."""

    def __init__(self, *names: object) -> None:
        self.name = " ".join(str(n) for n in names)
        self._random = random.Random(self.name)
        self.arrays = np.random.Generator(
            np.random.PCG64(int.from_bytes(self.name.encode(), "little"))
        )

    def child(self, *names: object) -> Dice:
        """Dice for a part, independent of how often these were thrown."""
        return Dice(self.name, *names)

    def uniform(self, low: float = 0.0, high: float = 1.0) -> float:
        """A number between two."""
        return self._random.uniform(low, high)

    def log(self, low: float, high: float) -> float:
        """A positive number, its logarithm uniform."""
        return math.exp(self._random.uniform(math.log(low), math.log(high)))

    def normal(self, mean: float = 0.0, deviation: float = 1.0) -> float:
        """A normal number, cut at two deviations."""
        return mean + deviation * max(-2.0, min(2.0, self._random.gauss(0.0, 1.0)))

    def whole(self, low: int, high: int) -> int:
        """A whole number, both ends included."""
        return self._random.randint(low, high)

    def chance(self, probability: float) -> bool:
        """True with a probability."""
        return self._random.random() < probability

    def pick(self, options: Sequence[T]) -> T:
        """One of several."""
        return options[self._random.randrange(len(options))]

    def weighted(self, **weights: float) -> str:
        """One of several names with weights."""
        return self._random.choices(list(weights), list(weights.values()))[0]

    def some(self, options: Sequence[T], count: int) -> list[T]:
        """Several different ones."""
        return self._random.sample(list(options), min(count, len(options)))

    # ---------------------------------------------------------------- colours

    def colour(self, saturation: float = 0.6, value: float = 0.7) -> Colour:
        """Linear reflectance; ``saturation`` and ``value`` are upper ends of what is usual."""
        s = saturation * self._random.betavariate(1.2, 1.6)
        v = value * self._random.betavariate(3.0, 1.5)
        r, g, b = colorsys.hsv_to_rgb(self._random.random(), s, max(v, 0.02))
        return (r**2.2, g**2.2, b**2.2)

    def vivid(self) -> Colour:
        """A strong colour."""
        r, g, b = colorsys.hsv_to_rgb(
            self._random.random(), self.uniform(0.6, 1.0), self.uniform(0.5, 0.95)
        )
        return (r**2.2, g**2.2, b**2.2)

    def near(self, colour: Colour, spread: float = 0.3) -> Colour:
        """A colour like another: its shade and a little of its hue differ."""
        factor = math.exp(self.normal(0.0, spread))
        made = [min(0.95, max(0.005, c * factor * math.exp(self.normal(0, 0.15)))) for c in colour]
        return (made[0], made[1], made[2])

    def palette(self) -> list[Colour]:
        """Colours that were chosen together: one hue and its neighbours or opposite, and greys."""
        hue, spread = self._random.random(), self.pick((0.04, 0.1, 0.33, 0.5))
        colours: list[Colour] = []
        for n in range(self.whole(4, 7)):
            h = (hue + spread * (n % 3) + self.normal(0, 0.03)) % 1.0
            s = self.pick((0.08, 0.3, 0.55, 0.85)) * self.uniform(0.5, 1.0)
            r, g, b = colorsys.hsv_to_rgb(h, s, self.uniform(0.15, 0.95))
            colours.append((max(r**2.2, 0.01), max(g**2.2, 0.01), max(b**2.2, 0.01)))
        return colours

    def warmth(self) -> Colour:
        """The colour of a lamp, luminance about 1: a black body of 2000 to 9000 K, seldom vivid."""
        if self.chance(0.15):
            r, g, b = self.vivid()
        else:
            t = self.uniform(0.0, 1.0)  # 0 warm, 1 cold; fitted by eye to black bodies
            r, g, b = 1.0, 0.45 + 0.55 * t, 0.12 + 1.05 * t
        y = 0.2126 * r + 0.7152 * g + 0.0722 * b
        return (r / y, g / y, b / y)

    def unit(self) -> Any:
        """A random direction ``(3,)``."""
        v = self.arrays.normal(size=3)
        return v / np.linalg.norm(v)
