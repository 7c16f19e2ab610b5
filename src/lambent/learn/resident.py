"""Stills that live on the device, and whole batches made there.

On a large GPU the network is done with a crop long before a processor has read, turned and coloured
the next one (`learn.batches`). So all stills are kept in the device's memory as half floats (1.6 MB
each), and everything that is done to a row (`learn.changes`) is done here to all rows of a batch at
once, with random numbers that follow from the seed, the step and the process.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.denoise import samples
from lambent.denoise.inputs import LAYERS, MASKS, OFFSET, Signals, divisor, encode, pack
from lambent.frame import noise_level
from lambent.learn import changes, lamps
from lambent.learn.batches import HIGHEST, MERGED, NEUTRAL, SPLATTED
from lambent.learn.cache import PLANES_OF, STORED, TARGET_PLANES, Cached
from lambent.learn.rows import AT, NAMES, PLANES, Rows, random

#: Where the planes of rows lie in a level of the cache's file, which also has what only lobes have.
_STORED = [None] * 3 + [name for name, count in STORED.items() for _ in range(count)]
_FROM = [k for k, name in enumerate(_STORED) if name is None or name in LAYERS]
#: Share of the batches that are at half size.
SHRUNK = 0.35
#: Smaller crops than this are not made: a pixel of the coarsest scale is 16 wide.
LEAST = 64
#: Levels that are merged at most.
_MOST_LEVELS = 4


class Residents:
    """The stills of a list on a device. `add` brings in more."""

    def __init__(self, stills: Sequence[Cached], device: torch.device) -> None:
        self.device = device
        self.known: set[str] = set()
        self.levels = torch.zeros(0, PLANES, 1, 1, dtype=torch.float16, device=device)
        self.targets = torch.zeros(0, 4, 1, 1, dtype=torch.float16, device=device)
        self._spp: list[int] = []
        self._still: list[int] = []
        self._there: list[list[float]] = []
        self.add(stills)

    def __len__(self) -> int:
        return len(self.known)

    def add(self, stills: Sequence[Cached]) -> int:
        """Bring in those that are not here yet; how many that were."""
        new = [s for s in stills if str(s.file) not in self.known]
        if not new:
            return 0
        # room for all of them at once: put together piece by piece, they would need it twice
        edge = np.load(new[0].file, mmap_mode="r").shape[1:]
        at, still = len(self.levels), len(self.targets)
        self.levels = _with_room(self.levels, sum(len(s.spp) for s in new), edge)
        self.targets = _with_room(self.targets, len(new), edge)
        with ThreadPoolExecutor(4) as pool:
            for number, (one, memory) in enumerate(_loaded(new, pool), still):
                planes = torch.from_numpy(memory).to(self.device)
                self.known.add(str(one.file))
                parts = planes[:-TARGET_PLANES].unflatten(0, (len(one.spp), PLANES_OF))
                self.levels[at : at + len(parts)] = parts[:, _FROM]
                self.targets[number] = planes[-TARGET_PLANES : 4 - TARGET_PLANES]
                at += len(parts)
                for spp, names in zip(one.spp, one.layers, strict=True):
                    self._spp.append(max(1, int(spp)))
                    self._still.append(number)
                    self._there.append([float(name in names) for name in NAMES])
        self._index()
        return len(new)

    def _index(self) -> None:
        """What a draw needs: the same bins as `batches.Sampler`, and the levels of each still."""
        spp = np.array(self._spp)
        bins = np.log2(np.minimum(spp, HIGHEST)).astype(int)
        counts = np.bincount(bins)
        weights = np.where(counts > 0, counts.astype(float) ** 0.25, 0)
        chance = (weights / weights.sum() / np.maximum(counts, 1))[bins]
        device = self.device
        self.chance = torch.tensor(chance, dtype=torch.float64, device=device)
        self.spp = torch.tensor(spp, dtype=torch.float32, device=device)
        still = np.array(self._still)
        self.still = torch.tensor(still, device=device)
        self.there = torch.tensor(self._there, dtype=torch.float32, device=device)
        first = np.searchsorted(still, np.arange(still[-1] + 1))  # levels of a still are neighbours
        self.first = torch.tensor(first, device=device)
        self.count = torch.tensor(np.bincount(still), device=device)

    def rows(self, size: int, rng: torch.Generator) -> Rows:
        """Levels drawn so that spp is spread over its range; some with others of the still added.

        See `batches.Sampler` and `augment.merged`: a variance is told by the levels that have one.
        """
        chosen = torch.multinomial(self.chance, size, replacement=True, generator=rng)
        merge = random(size, 1, rng) < MERGED
        others = random(size, _MOST_LEVELS, rng) < 0.5
        return self.merged(chosen, merge & others)

    def merged(self, chosen: Tensor, others: Tensor) -> Rows:
        """Levels, by their numbers, with ``others`` ``(B, _MOST_LEVELS)`` of their stills."""
        dev, size = self.device, len(chosen)
        still = self.still[chosen]
        total = torch.zeros(size, device=dev)
        told = torch.zeros(size, len(NAMES), device=dev)
        known = torch.ones(size, len(NAMES), device=dev)
        shape = (size, PLANES, *self.levels.shape[2:])
        mean, variance = torch.zeros(shape, device=dev), torch.zeros(shape, device=dev)
        for k in range(_MOST_LEVELS):
            number = self.first[still] + k
            own = number == chosen
            used = (k < self.count[still]) & (own | others[:, k])
            number = torch.where(used, number, chosen)
            n = self.spp[number] * used
            planes = self.levels[number].float()
            there = self.there[number]
            mean.addcmul_(planes, n[:, None, None, None])
            # the variance of one sample, weighted with the samples that tell it
            weight = F.pad((n[:, None] * there)[:, _layer_of(dev)], (3, 0))
            weight = weight[:, :, None, None] * n[:, None, None, None]
            variance.addcmul_(planes * planes, weight)
            total += n
            told += n[:, None] * there
            known = torch.where(used[:, None], known * there, known)
        planes = mean / total[:, None, None, None]
        for i, name in enumerate(NAMES):
            if name.endswith("_std"):
                one = variance[:, AT[name]] / told[:, i, None, None, None].clamp_min(1e-6)
                planes[:, AT[name]] = (one / total[:, None, None, None]).sqrt()
                known[:, i] = (told[:, i] > 0).float()
        target = self.targets[still].float()
        return Rows(planes, known, target, total)


def _loaded(
    stills: Sequence[Cached], pool: ThreadPoolExecutor, ahead: int = 32
) -> Iterator[tuple[Cached, np.ndarray]]:
    """Stills with their planes; a pool asked for all would hold what is not taken yet."""
    for begin in range(0, len(stills), ahead):
        part = stills[begin : begin + ahead]
        yield from zip(part, pool.map(lambda s: np.load(s.file), part), strict=True)


def _with_room(tensor: Tensor, count: int, edge: tuple[int, ...]) -> Tensor:
    """A copy with room for so many more pictures of ``edge`` (height, width)."""
    found = tensor.new_empty(len(tensor) + count, tensor.shape[1], *edge)
    if len(tensor):
        found[: len(tensor)] = tensor
    return found


@functools.lru_cache(maxsize=8)
def _layer_of(device: torch.device) -> Tensor:
    """The number of the layer of each plane after the colour's."""
    return torch.tensor([i for i, n in enumerate(NAMES) for _ in range(LAYERS[n])], device=device)


@functools.lru_cache(maxsize=8)
def _mask_of(device: torch.device) -> Tensor:
    """The number of the mask of each layer."""
    names = list(MASKS)
    of = [next(i for i, n in enumerate(names) if layer in MASKS[n]) for layer in NAMES]
    return torch.tensor(of, device=device)


def batch_of(
    residents: Residents, seed: int, step: int, size: int, rank: int = 0
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """A batch for the network: packed inputs, colour, divisor, target, deviation, preference.

    Shapes as in `learn.denoising.Batch`; a shrunk one has 4 B crops. The same for the same seed,
    step and stills.
    """
    dev = residents.device
    numbers = np.random.SeedSequence((seed, step, rank)).generate_state(2)
    rng = torch.Generator(dev).manual_seed(int(numbers[0]))
    if numbers[1] < SHRUNK * 2**32 and residents.levels.shape[2] >= 2 * LEAST:
        size *= 4
        rows = changes.shrunk(residents.rows(size, rng))
    else:
        rows = residents.rows(size, rng)
    rows = changes.turned(rows, rng)
    _some(rows, changes.COLLAGED, rng, changes.collaged)
    _some(rows, changes.THINNED, rng, changes.thinned)
    _some(rows, changes.SHADED, rng, changes.shaded)
    _some(rows, changes.EMBOSSED, rng, changes.embossed)
    _some(rows, changes.HAZED, rng, changes.hazed)
    _some(rows, lamps.SHARE, rng, changes.lit)
    spp = rows.spp.clone()
    splat = _chosen(size, SPLATTED, rng)
    _some(rows, splat, rng, changes.filtered)
    changes.recoloured(rows, rng)
    _some(rows, changes.PAINTED, rng, changes.painted)
    masks, spp = changes.without_some(rows, spp, rng)
    neutral = random(size, 2, rng)
    preference = torch.where(neutral[:, 0] < NEUTRAL, 0.0, neutral[:, 1])
    return ready(rows, masks, spp, preference)


def ready(
    rows: Rows, masks: Tensor, spp: Tensor, preference: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Rows as the network reads them; ``masks`` ``(B, len(MASKS))``, ``spp`` 0 where unknown."""
    shown = rows.there * _of_layers(masks)
    albedo = torch.where(shown[:, :1, None, None] > 0, rows.layer("albedo"), 1 - OFFSET)
    layers = {name: rows.layer(name) for name in NAMES} | {"albedo": albedo}
    colour = rows.planes[:, :3]
    d = divisor(torch, albedo)
    planes = encode(torch, Signals(colour, layers), 1.0)
    keep = shown[:, _layer_of(shown.device)]
    keep = F.pad(F.pad(keep, (3, 0), value=1.0), (0, planes.shape[1] - PLANES))
    flags = []
    for of in MASKS.values():
        parts = [shown[:, NAMES.index(n)] for n in of if n in NAMES]
        flags.append(torch.stack(parts).amax(0) if parts else torch.zeros_like(spp))
    size = torch.log2(spp.clamp_min(1)) / 10
    unknown = (spp <= 0) & (shown[:, NAMES.index("colour_std")] <= 0)
    size = torch.where(unknown, guessed(colour / d, shown[:, 0] > 0) / 10, size)
    numbers = torch.stack([*flags, size, (spp > 0).float(), preference], 1)
    packed = pack(torch, planes * keep[:, :, None, None], numbers)
    target, deviation = rows.target[:, :3], rows.target[:, 3:]
    return packed, colour.contiguous(), d.contiguous(), target, deviation, preference


def guessed(x: Tensor, with_albedo: Tensor) -> Tensor:
    """`samples.guess` of rows: log2 of it ``(B,)``, 0 without evidence.

    ``x`` ``(B, 3, H, W)``: light over the albedo; ``with_albedo`` ``(B,)``: whether there is one.
    """
    u = torch.log1p(samples.SLOPE * x.clamp_min(0)).mean(1)
    across = u[:, :-2] + u[:, 2:] - 2 * u[:, 1:-1]
    seen = (across[:, :, :-2] + across[:, :, 2:] - 2 * across[:, :, 1:-1]).abs().flatten(1)
    differs = seen > noise_level.LEAST
    ranked = seen.sort(1).values  # what does not differ comes first
    count = differs.sum(1, keepdim=True)
    at = seen.shape[1] - 1 - (0.25 * (count - 1).clamp_min(0)).round().long()
    sigma = ranked.gather(1, at)[:, 0] / (6 * noise_level.QUARTILE)
    (a, b), (c, d) = samples.WITH_ALBEDO, samples.WITHOUT
    log = torch.log2(sigma.clamp_min(noise_level.LEAST / 10))
    found = torch.where(with_albedo, (a - log) / b, (c - log) / d)
    found = found.clamp(0, math.log2(samples.MOST))
    return torch.where(count[:, 0] >= noise_level.ENOUGH, found, 0.0)


# ------------------------------------------------------------------- private


def _of_layers(masks: Tensor) -> Tensor:
    """Masks ``(B, len(MASKS))`` to layers ``(B, len(NAMES))``; no deviation without its layer."""
    found = masks[:, _mask_of(masks.device)]
    for guide in ("albedo", "normal", "depth"):
        found[:, NAMES.index(f"{guide}_std")] *= found[:, NAMES.index(guide)]
    return found


def _chosen(size: int, share: float, rng: torch.Generator) -> Tensor:
    """The numbers of a random share of the rows."""
    order = torch.argsort(random(1, size, rng)[0])
    return order[: round(share * size)]


def _some(rows: Rows, which: float | Tensor, rng: torch.Generator, change) -> None:  # type: ignore[no-untyped-def]
    """Change some rows, by their numbers or a random share of them."""
    if not isinstance(which, Tensor):
        which = _chosen(len(rows.planes), which, rng)
    if not len(which):
        return
    part = Rows(rows.planes[which], rows.there[which], rows.target[which], rows.spp[which])
    change(part, rng)
    rows.planes[which], rows.target[which], rows.there[which] = part.planes, part.target, part.there
