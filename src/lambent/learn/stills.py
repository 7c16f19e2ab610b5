"""The stills of a cache, and rows drawn from them.

The data have many crops of few samples and few of many. A bin of log2(spp) is drawn with a weight
proportional to the fourth root of what is in it: the rare ones nearly as often as the others. From
`HIGHEST` on all is one bin, so that a handful of crops is not learned by heart.

On a GPU all stills lie in its memory as half floats (1.6 MB each). On a processor they are read
from their files as they are drawn: the operating system keeps in memory what there is room for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.learn.cache import PLANES_OF, STORED, TARGET_PLANES, Cached
from lambent.learn.rows import ALL_PLANES, AT, NAMES, PLANES, Rows, layer_of, random

#: Share of the rows whose levels are put together.
MERGED = 0.4
#: Samples from which on all are in one bin.
HIGHEST = 64
#: Levels that are merged at most.
_MOST_LEVELS = 4


class Stills:
    """The stills of a list, for rows on a device. `add` brings in more.

    ``lobes``: rows have the layers of `denoise.lobes` too.
    """

    def __init__(
        self, stills: Sequence[Cached], device: str | torch.device = "cpu", lobes: bool = False
    ) -> None:
        self.device = torch.device(device)
        self.names = tuple(STORED) if lobes else NAMES
        self.planes = ALL_PLANES if lobes else PLANES
        #: The target's planes: colour, deviation, and the diffuse part of it.
        self.of_target = TARGET_PLANES if lobes else 4
        self.all: list[Cached] = []
        self._known: set[str] = set()
        self._spp: list[int] = []
        self._still: list[int] = []
        self._there: list[list[float]] = []
        self._held: tuple[Tensor, Tensor] | None = None
        self.edge = 0
        self.add(stills)

    def __len__(self) -> int:
        return len(self.all)

    def add(self, stills: Sequence[Cached]) -> int:
        """Bring in those that are not here yet; how many that were."""
        new = [s for s in stills if str(s.file) not in self._known]
        if not new:
            return 0
        self.edge = min(np.load(new[0].file, mmap_mode="r").shape[1:])
        if self.device.type != "cpu":
            self._hold(new)
        for number, still in enumerate(new, len(self.all)):
            self._known.add(str(still.file))
            for spp, names in zip(still.spp, still.layers, strict=True):
                self._spp.append(max(1, int(spp)))
                self._still.append(number)
                self._there.append([float(name in names) for name in self.names])
        self.all += new
        self._index()
        return len(new)

    def _hold(self, new: Sequence[Cached]) -> None:
        """Bring files into the device's memory."""
        edge = np.load(new[0].file, mmap_mode="r").shape[1:]
        if self._held is None:
            empty = torch.zeros(0, 1, *edge, dtype=torch.float16, device=self.device)
            self._held = empty.expand(0, self.planes, *edge), empty.expand(0, self.of_target, *edge)
        # room for all of them at once: put together piece by piece, they would need it twice
        at, still = len(self._held[0]), len(self._held[1])
        levels = _with_room(self._held[0], sum(len(s.spp) for s in new), edge)
        targets = _with_room(self._held[1], len(new), edge)
        with ThreadPoolExecutor(4) as pool:
            for number, (one, memory) in enumerate(_loaded(new, pool), still):
                planes = torch.from_numpy(memory).to(self.device)
                parts = planes[:-TARGET_PLANES].unflatten(0, (len(one.spp), PLANES_OF))
                levels[at : at + len(parts)] = parts[:, : self.planes]
                targets[number] = planes[-TARGET_PLANES:][: self.of_target]
                at += len(parts)
        self._held = levels, targets

    def _levels(self, number: Tensor, used: Tensor) -> Tensor:
        """The planes of levels, by their numbers; anything finite where they are not used."""
        if self._held is not None:
            return self._held[0][number].float()
        planes = torch.zeros(len(number), self.planes, *self._edges(), device=self.device)
        for i, (n, use) in enumerate(zip(number.tolist(), used.tolist(), strict=True)):
            if use:
                still = self._still[n]
                level = (n - int(self.first[still])) * PLANES_OF
                memory = np.load(self.all[still].file, mmap_mode="r")
                planes[i] = torch.from_numpy(memory[level : level + self.planes].astype(np.float32))
        return planes

    def _targets(self, still: Tensor) -> Tensor:
        if self._held is not None:
            return self._held[1][still].float()
        targets = [
            np.load(self.all[i].file, mmap_mode="r")[-TARGET_PLANES:][: self.of_target]
            for i in still.tolist()
        ]
        return torch.from_numpy(np.stack(targets).astype(np.float32))

    def _edges(self) -> tuple[int, ...]:
        return tuple(np.load(self.all[0].file, mmap_mode="r").shape[1:])

    def _index(self) -> None:
        """What a draw needs: the chance of each level, and the levels of each still."""
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
        """Levels drawn so that spp is spread over its range; some merged with others."""
        chosen = torch.multinomial(self.chance, size, replacement=True, generator=rng)
        merge = random(size, 1, rng) < MERGED
        others = random(size, _MOST_LEVELS, rng) < 0.5
        return self.merged(chosen, merge & others)

    def merged(self, chosen: Tensor, others: Tensor) -> Rows:
        """Levels, by their numbers, with ``others`` ``(B, _MOST_LEVELS)`` of their stills.

        Independent renders of one picture are one with the sum of their samples. A variance is
        known if a level with at least two samples has one; levels of a single sample then count as
        noisy as the others are per sample.
        """
        dev, size = self.device, len(chosen)
        still = self.still[chosen]
        total = torch.zeros(size, device=dev)
        told = torch.zeros(size, len(self.names), device=dev)
        known = torch.ones(size, len(self.names), device=dev)
        shape = (size, self.planes, *self._edges())
        mean, variance = torch.zeros(shape, device=dev), torch.zeros(shape, device=dev)
        of_plane = layer_of(dev)[: self.planes - 3]
        for k in range(_MOST_LEVELS):
            number = self.first[still] + k
            own = number == chosen
            used = (k < self.count[still]) & (own | others[:, k])
            number = torch.where(used, number, chosen)
            n = self.spp[number] * used
            planes = self._levels(number, used)
            there = self.there[number]
            mean.addcmul_(planes, n[:, None, None, None])
            # the variance of one sample, weighted with the samples that tell it
            weight = F.pad((n[:, None] * there)[:, of_plane], (3, 0))
            weight = weight[:, :, None, None] * n[:, None, None, None]
            variance.addcmul_(planes * planes, weight)
            total += n
            told += n[:, None] * there
            known = torch.where(used[:, None], known * there, known)
        planes = mean / total[:, None, None, None]
        for i, name in enumerate(self.names):
            if name.endswith("_std"):
                one = variance[:, AT[name]] / told[:, i, None, None, None].clamp_min(1e-6)
                planes[:, AT[name]] = (one / total[:, None, None, None]).sqrt()
                known[:, i] = (told[:, i] > 0).float()
        return Rows(planes, known, self._targets(still), total)


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
