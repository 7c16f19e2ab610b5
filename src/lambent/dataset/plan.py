"""What an item is, by its number: scene, camera, seeds. Pure arithmetic, the same everywhere.

An item's number decides all of it: crop ``i`` is cut from scene ``i // items_per_scene``, clip
``i`` from animated scene ``i // clips_per_scene``. So it matters neither how many processes work,
nor in which order, nor whether the work was interrupted, nor how large the set is to become.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.dataset.recipe import Recipe
from lambent.dataset.validation import SEEDS

STILL, CLIP = "crop", "clip"


@dataclass(frozen=True)
class Job:
    """One scene and the numbers of the items that are cut from it: the unit of work."""

    what: str
    number: int
    items: tuple[int, ...]

    @property
    def first(self) -> int:
        """The number of the scene's first item, wanted or not."""
        return self.items[0]


def number(recipe: Recipe, *names: object) -> int:
    """A random number in [0, 2^31) that belongs to these names; never a validation seed."""
    for again in range(1 << 20):
        text = "/".join(map(str, (recipe.seed, *names, *([again] if again else []))))
        found = int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little") >> 1
        if found not in SEEDS:
            return found
    raise AssertionError("sha256 has lost its randomness")


def generator(recipe: Recipe, *names: object) -> np.random.Generator:
    """A random generator that belongs to these names."""
    return np.random.Generator(np.random.PCG64(number(recipe, *names)))


def scene_seed(recipe: Recipe, job: Job, attempt: int) -> int:
    """The seed of a job's scene; later attempts follow where a scene was unfit."""
    if recipe.seeds:
        return recipe.seeds[(job.number + attempt) % len(recipe.seeds)]
    return number(recipe, job.what, "scene", job.number, attempt)


def per_scene(recipe: Recipe, what: str) -> int:
    """How many items a scene gives."""
    return recipe.items_per_scene if what == STILL else recipe.clips_per_scene


def cameras(recipe: Recipe, what: str) -> int:
    """How many views of a scene the items are cut from."""
    return min(recipe.cameras_per_scene, per_scene(recipe, what))


def jobs(recipe: Recipe, missing: dict[str, set[int]]) -> Iterator[Job]:
    """The scenes that hold missing items, crops and clips evenly mixed."""
    lists = []
    for what in (STILL, CLIP):
        size = per_scene(recipe, what)
        by_scene: dict[int, list[int]] = {}
        for index in sorted(missing.get(what, ())):
            by_scene.setdefault(index // size, []).append(index)
        lists.append([Job(what, n, tuple(items)) for n, items in by_scene.items()])
    ranked = [((k + 0.5) / len(listed), i, j) for i, listed in enumerate(lists)
              for k, j in enumerate(listed)]  # fmt: skip
    for _, _, job in sorted(ranked, key=lambda entry: entry[:2]):
        yield job


def level_spp(recipe: Recipe, job: Job, item: int) -> tuple[int, ...]:
    """The spp of an item's noise levels, rising, all different where the range allows.

    A scene has a highest level of its own: a power of two, log-uniform up to a knee (`kneed`) such
    that its mean is ``mean_spp``. Its items draw from that level and those below, the more rarely
    the further, and now and then from one above.
    """
    choices = powers(*recipe.spp)
    still = job.what == STILL
    count = recipe.levels if still else recipe.clip_levels
    mean = recipe.mean_spp if still else recipe.clip_mean_spp
    weights = kneed(choices, mean)
    random = generator(recipe, job.what, "levels", job.number)
    top = random.choice(len(choices), p=weights)
    above = np.arange(len(choices)) - top
    spread = np.where(above > 0, 0.5, 2.0 ** random.uniform(0.5, 2.0))
    near = np.exp(-0.5 * (above / spread) ** 2) + 1e-12
    near /= near.sum()
    random = generator(recipe, job.what, "levels", job.number, item)
    drawn = random.choice(len(choices), min(count, len(choices)), replace=False, p=near)
    return tuple(choices[k] for k in sorted(drawn))


def powers(low: int, high: int) -> tuple[int, ...]:
    """Powers of two from ``low`` to ``high``; ``low`` itself where there is none."""
    first, last = math.ceil(math.log2(low)), math.floor(math.log2(high))
    return tuple(2**k for k in range(first, last + 1)) or (low,)


def kneed(choices: tuple[int, ...], mean: float) -> NDArray[np.float64]:
    """Probabilities that are even up to a knee and then fall, 1 / (1 + (spp / knee)^2).

    The knee makes their mean ``mean``, as near as it goes.
    """
    values = np.array(choices, np.float64)
    low, high = -20.0, 30.0
    for _ in range(60):
        knee = (low + high) / 2
        weights = 1 / (1 + (values / 2.0**knee) ** 2)
        weights /= weights.sum()
        low, high = (knee, high) if weights @ values < mean else (low, knee)
    return weights
