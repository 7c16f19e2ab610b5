"""Finding room for things: footprints on a floor, spots on a table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lambent.scenes.mitsuba.geometry import Array, rotate, translate
from lambent.scenes.mitsuba.stage import Part


@dataclass
class Floor:
    """A rectangle of ``width`` and ``depth`` about the origin, and what already stands on it."""

    width: float
    depth: float
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def free(self, x: float, y: float, w: float, d: float, gap: float = 0.05) -> bool:
        """Whether a rectangle about (x, y) lies inside and touches nothing."""
        if abs(x) + w / 2 > self.width / 2 + 1e-6 or abs(y) + d / 2 > self.depth / 2 + 1e-6:
            return False
        return all(
            abs(x - tx) > (w + tw) / 2 + gap or abs(y - ty) > (d + td) / 2 + gap
            for tx, ty, tw, td in self.taken
        )

    def take(self, x: float, y: float, w: float, d: float) -> None:
        """Note that a rectangle is in use."""
        self.taken.append((x, y, w, d))

    def by_wall(
        self,
        rng: np.random.Generator,
        w: float,
        d: float,
        *,
        wall: int | None = None,
        gap: float = 0.03,
    ) -> Array | None:
        """A pose ``(4, 4)`` with the back to a wall (0 to 3: +y, −x, −y, +x), or None."""
        for _ in range(14):
            side = int(rng.integers(4)) if wall is None else wall
            long = self.width if side % 2 == 0 else self.depth
            deep = self.depth if side % 2 == 0 else self.width
            if w > long or d > deep:
                continue
            s = rng.uniform(-(long - w) / 2, (long - w) / 2)
            pose = rotate("z", side * np.pi / 2) @ translate(s, deep / 2 - d / 2 - gap, 0)
            x, y = pose[0, 3], pose[1, 3]
            box = (w, d) if side % 2 == 0 else (d, w)
            if self.free(x, y, *box):
                self.take(x, y, *box)
                return pose
        return None

    def anywhere(self, rng: np.random.Generator, w: float, d: float) -> Array | None:
        """A pose ``(4, 4)`` on the floor, turned by multiples of a right angle, or None."""
        for _ in range(14):
            turn = int(rng.integers(4))
            box = (w, d) if turn % 2 == 0 else (d, w)
            x = rng.uniform(-1, 1) * max(self.width - box[0], 0) / 2
            y = rng.uniform(-1, 1) * max(self.depth - box[1], 0) / 2
            if self.free(x, y, *box):
                self.take(x, y, *box)
                return translate(x, y, 0) @ rotate("z", turn * np.pi / 2)
        return None


def extent(parts: list[Part]) -> tuple[Array, Array]:
    """The bounds of parts together."""
    low = np.min([g.bounds[0] for g, _ in parts], 0)
    return low, np.max([g.bounds[1] for g, _ in parts], 0)


def spots(
    rng: np.random.Generator, sizes: list[float], reach: tuple[float, float], *, spread: float = 1.0
) -> list[tuple[float, float] | None]:
    """Places for discs of radius ``sizes`` on a table of half sides ``reach``, near its middle."""
    placed: list[tuple[float, float, float]] = []
    result: list[tuple[float, float] | None] = []
    for r in sizes:
        found = None
        for attempt in range(40):
            width = spread * (0.25 + 0.75 * attempt / 40)
            x, y = rng.uniform(-1, 1, 2) * np.maximum(np.array(reach) - r, 0) * width
            if all(np.hypot(x - px, y - py) > r + pr for px, py, pr in placed):
                found = (float(x), float(y))
                placed.append((x, y, r))
                break
        result.append(found)
    return result
