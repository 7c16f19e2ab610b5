"""Batches without state: what row r of step t holds follows from the seed, t and r alone.

So a run that was stopped goes on with the very batches it would have seen, and two processes that
share a batch see together what one would have seen.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lambent.denoise.inputs import constants, divisor, encode, pack
from lambent.denoise.samples import guessed
from lambent.frame.layer import FloatImage
from lambent.learn import lamps
from lambent.learn.augment import Example, filtered, merged, recoloured, turned, without_some
from lambent.learn.cache import Cached
from lambent.training.ahead import ahead

#: Share of the frames that get a splatted pixel filter.
SPLATTED = 0.2
#: Share of the frames that are trained for least error (preference 0).
NEUTRAL = 0.5
#: Samples from which on all are in one bin.
HIGHEST = 64
#: Share of the examples whose levels are put together.
MERGED = 0.4


@dataclass(frozen=True)
class Row:
    """One example, ready for the network: see `denoise.inputs`.

    ``packed`` ``(CHANNELS, H/2, W/2)``; ``colour``, ``divisor``, ``target`` ``(3, H, W)``;
    ``deviation`` ``(1, H, W)`` of the target; ``preference`` λ. Of fine-tuning alone: whether the
    target is as noisy as the input, and relMSE's ε at the row's exposure.
    """

    packed: FloatImage
    colour: FloatImage
    divisor: FloatImage
    target: FloatImage
    deviation: FloatImage
    preference: float
    spp: float
    noisy_target: bool = False
    epsilon: float = 0.0


class Sampler:
    """Draws levels of stills so that the number of samples is spread over its range.

    The data have many crops of few samples and few of many. A bin of log2(spp) is drawn with a
    weight proportional to the fourth root of what is in it: the rare ones nearly as often as the
    others. From `HIGHEST` on all is one bin, so that a handful of crops is not learned by heart.
    """

    def __init__(self, stills: Sequence[Cached], lobes: bool = False) -> None:
        self.stills, self.lobes = stills, lobes
        bins: dict[int, list[tuple[int, int]]] = {}
        for i, still in enumerate(stills):
            for k, spp in enumerate(still.spp):
                spp = min(max(spp, 1), HIGHEST)
                bins.setdefault(int(np.log2(spp)), []).append((i, k))
        self._bins = [bins[b] for b in sorted(bins)]
        weights = np.array([len(b) for b in self._bins]) ** 0.25
        self._weights = weights / weights.sum()

    def draw(self, rng: np.random.Generator) -> Example:
        """A level of a still, or several of its levels merged."""
        which = self._bins[int(rng.choice(len(self._bins), p=self._weights))]
        number, level = which[int(rng.integers(len(which)))]
        levels, target, deviation = self.stills[number].load(self.lobes)
        chosen = [levels[level]]
        if rng.random() < MERGED:
            chosen += [lv for k, lv in enumerate(levels) if k != level and rng.random() < 0.5]
        return Example(merged(chosen), target, deviation)


def row(sampler: Sampler, seed: int, step: int, number: int) -> Row:
    """Row ``number`` of the batch of ``step``."""
    rng = np.random.default_rng((seed, step, number))
    example = turned(sampler.draw(rng), rng)
    if rng.random() < lamps.SHARE:
        example = lamps.lit(example, rng)
    spp = float(example.noisy.spp or 1)
    if rng.random() < SPLATTED:
        example = filtered(example, rng)
    example = without_some(recoloured(example, rng), rng)
    preference = 0.0 if rng.random() < NEUTRAL else float(rng.random())
    return ready(example, preference, spp)


def ready(example: Example, preference: float, spp: float) -> Row:
    """An example as arrays for the network, with a guess of spp where it has none yet."""
    noisy = example.noisy
    if noisy.guess is None:
        noisy = replace(noisy, guess=guessed(noisy))
    albedo = noisy.layers.get("albedo")
    d = np.ones_like(noisy.colour) if albedo is None else divisor(np, albedo)
    numbers = constants(noisy, preference)
    return Row(
        pack(np, encode(np, noisy, 1.0), numbers).astype(np.float32),
        noisy.colour,
        d.astype(np.float32),
        example.target,
        example.deviation,
        preference,
        spp,
    )


def batches(
    sampler: Sampler, seed: int, first: int, size: int, rank: int = 0, world: int = 1
) -> Generator[list[Row], None, None]:
    """The batches of step ``first`` and on; of each, the rows of process ``rank`` of ``world``."""
    numbers = range(rank, size, world)
    return ahead(lambda step: [row(sampler, seed, step, n) for n in numbers], first)
