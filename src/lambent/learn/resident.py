"""Stills that live on the device, and whole batches made there.

On a large GPU the network is done with a crop long before a processor has read, turned and coloured
the next one (`learn.batches`). So all stills are kept in the device's memory as half floats (1.6 MB
each), and everything that `learn.augment`, `learn.lamps` and `learn.splat` do to one example
is done here to all rows of a batch at once, with random numbers that follow from the seed,
the step and the process. Five things are added that a row at a time would be too slow for:

- **paint**: all surfaces get another texture. Colour, target and albedo are multiplied by one
  picture, since light that has left the surface once is proportional to the albedo;
- **shadows**: blinds, leaves, window frames, spots of light. Colour and target are multiplied by a
  pattern that no feature knows of, so that the network learns to find edges in the light itself;
- **shrinking**: some batches are four times as many crops at half their size. Four pixels together
  are a pixel of the smaller picture with four times the samples, noisy picture and target alike.
  That is exact, and it is where crops of 64 to 1,024 samples come from, which are dear to render;
- **thinning**: of the samples of a crop some are dropped and the others weigh more, as if the
  renderer had drawn one lamp of several, or ended paths by chance. The mean stays, the noise grows,
  and at few samples there are pixels without light, as Cycles has them and Mitsuba has not;
- **haze**: some samples end in thin fog, before they reach a surface, with fog's light and fog's
  features. At few samples the albedo is then speckled, and where it is dark the light is not: what
  is divided by it is no light on a surface any more.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.denoise.inputs import LAYERS, MASKS, OFFSET, Signals, divisor, encode, pack
from lambent.learn import lamps
from lambent.learn.augment import ALL, COLOUR, PLAIN, STOPS, TINT
from lambent.learn.batches import HIGHEST, MERGED, NEUTRAL, SPLATTED
from lambent.learn.cache import PLANES_OF, STORED, TARGET_PLANES, Cached
from lambent.learn.splat import FILTERS, GROUPS

#: Layers of a level here, in the order of the cache's file, without what only lobes have.
NAMES = tuple(name for name in STORED if name in LAYERS)
PLANES = 3 + sum(LAYERS[name] for name in NAMES)
#: The planes of each layer.
_ENDS = list(itertools.accumulate((LAYERS[name] for name in NAMES), initial=3))
_AT = {name: slice(a, b) for name, a, b in zip(NAMES, _ENDS, _ENDS[1:], strict=False)}
#: Where those planes lie in a level of the cache's file, which also has what only lobes have.
_STORED = [None] * 3 + [name for name, count in STORED.items() for _ in range(count)]
_FROM = [k for k, name in enumerate(_STORED) if name is None or name in LAYERS]
#: The layers without deviations, which come first: what a renderer's film splats.
_MEANS = slice(0, max(_AT[n].stop for n in NAMES if not n.endswith("_std")))
#: Share of the rows that get another texture, and another pattern of light.
PAINTED, SHADED = 0.3, 0.3
#: Share of the rows whose samples are thinned, and the shares of samples that are kept.
THINNED, KEPT = 0.3, (0.15, 0.9)
#: Share of the rows in thin fog, and the shares of samples that end in it.
HAZED, IN_FOG = 0.15, (0.005, 0.15)
#: Share of the batches that are at half size.
SHRUNK = 0.35
#: Smaller crops than this are not made: a pixel of the coarsest scale is 16 wide.
LEAST = 64
#: Levels that are merged at most.
_MOST_LEVELS = 4


@dataclass
class Rows:
    """A batch at work. ``planes`` ``(B, PLANES, H, W)``; ``there`` ``(B, len(NAMES))``: 1 if known.

    ``target`` ``(B, 4, H, W)``: colour, and the deviation of its mean; ``spp`` ``(B,)``.
    """

    planes: Tensor
    there: Tensor
    target: Tensor
    spp: Tensor

    def layer(self, name: str) -> Tensor:
        """The planes of a layer, to be read or written."""
        return self.planes[:, _AT[name]]


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
        dev = self.device
        chosen = torch.multinomial(self.chance, size, replacement=True, generator=rng)
        still = self.still[chosen]
        merge = _random(size, 1, rng) < MERGED
        others = _random(size, _MOST_LEVELS, rng) < 0.5
        total = torch.zeros(size, device=dev)
        told = torch.zeros(size, len(NAMES), device=dev)
        known = torch.ones(size, len(NAMES), device=dev)
        shape = (size, PLANES, *self.levels.shape[2:])
        mean, variance = torch.zeros(shape, device=dev), torch.zeros(shape, device=dev)
        for k in range(_MOST_LEVELS):
            number = self.first[still] + k
            own = number == chosen
            used = (k < self.count[still]) & (own | (merge[:, 0] & others[:, k]))
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
                one = variance[:, _AT[name]] / told[:, i, None, None, None].clamp_min(1e-6)
                planes[:, _AT[name]] = (one / total[:, None, None, None]).sqrt()
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
        rows = shrunk(residents.rows(size, rng))
    else:
        rows = residents.rows(size, rng)
    rows = turned(rows, rng)
    _some(rows, THINNED, rng, thinned)
    _some(rows, SHADED, rng, shaded)
    _some(rows, HAZED, rng, hazed)
    _some(rows, lamps.SHARE, rng, lit)
    spp = rows.spp.clone()
    splat = _chosen(size, SPLATTED, rng)
    _some(rows, splat, rng, filtered)
    recoloured(rows, rng)
    _some(rows, PAINTED, rng, painted)
    masks, spp = without_some(rows, spp, rng)
    neutral = _random(size, 2, rng)
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
    size = torch.where(spp > 0, torch.log2(spp.clamp_min(1)) / 10, 0.0)
    numbers = torch.stack([*flags, size, (spp > 0).float(), preference], 1)
    packed = pack(torch, planes * keep[:, :, None, None], numbers)
    target, deviation = rows.target[:, :3], rows.target[:, 3:]
    return packed, colour.contiguous(), d.contiguous(), target, deviation, preference


# ------------------------------------------------------- what is done to rows: learn.augment


def shrunk(rows: Rows) -> Rows:
    """At half size: 2x2 pixels are one, with four times the samples.

    What is independent averages: a deviation of the mean of four means is half of their mean
    square's root.
    """
    planes = F.avg_pool2d(rows.planes, 2)
    deviations = slice(_MEANS.stop, None)
    planes[:, deviations] = F.avg_pool2d(rows.planes[:, deviations] ** 2, 2).sqrt() / 2
    target = F.avg_pool2d(rows.target, 2)
    target[:, 3:] = F.avg_pool2d(rows.target[:, 3:] ** 2, 2).sqrt() / 2
    return Rows(planes, rows.there, target, 4 * rows.spp)


def turned(rows: Rows, rng: torch.Generator) -> Rows:
    """Mirrored and turned by quarters; normals rotated at random (half of the time)."""
    size = len(rows.planes)
    dice = _random(size, 3, rng) < 0.5
    both = torch.cat([rows.planes, rows.target], 1)
    for axis in (2, 3):
        both = torch.where(dice[:, axis - 2, None, None, None], both.flip(axis), both)
    both = torch.where(dice[:, 2, None, None, None], both.transpose(2, 3), both)
    rows = Rows(both[:, :PLANES], rows.there, both[:, PLANES:], rows.spp)
    q = _rotations(size, rng)
    turn = _random(size, 1, rng)[:, :, None] < 0.5
    q = torch.where(turn, q, torch.eye(3, device=q.device))
    normal = rows.layer("normal").flatten(2)
    rows.planes[:, _AT["normal"]] = torch.bmm(q, normal).unflatten(2, both.shape[2:])
    return rows


def thinned(rows: Rows, rng: torch.Generator) -> None:
    """Each sample is kept with a chance p, and then weighs 1 / p: the same light, more noise.

    Of a pixel's n samples only the mean c and its variance σ² are known: k ~ B(n, p) of them are
    kept, with that mean. c' = c k / (n p) then has the variance σ² + (μ² + σ²) (1 - p) / (n p),
    which is told as k / (n p) (σ² + c² (1 - p) / (n p)): the same in the mean, and none where no
    sample has light, as a renderer would say.
    """
    size = len(rows.planes)
    p = _log_uniform(_random(size, 1, rng), KEPT)[:, :, None, None]
    n = rows.spp.round().clamp_min(1)[:, None, None, None]
    shape = (size, 1, *rows.planes.shape[2:])
    kept = torch.binomial(n.expand(shape).contiguous(), p.expand(shape).contiguous(), generator=rng)
    share = kept / (n * p)
    colour, spread = rows.planes[:, :3], rows.layer("colour_std")
    squares = (colour * colour).mean(1, keepdim=True)
    told = share * (spread * spread + squares * (1 - p) / (n * p))
    rows.planes[:, _AT["colour_std"]] = told.sqrt()
    rows.planes[:, :3] = colour * share


def hazed(rows: Rows, rng: torch.Generator) -> None:
    """A share q of the samples ends in fog of radiance f, of which one sample says no more than
    that its light is drawn from an exponential distribution around f.

    Of a pixel's n samples k ~ B(n, q) do: c' = (1 - k/n) c + k/n f G with G ~ Γ(k, 1/k), features
    likewise, with one value each for the fog; the target is (1 - q) r + q f.
    """
    size = len(rows.planes)
    dice = _random(size, 4, rng)
    q = _log_uniform(dice[:, :1], IN_FOG)[:, :, None, None]
    n = rows.spp.round().clamp_min(1)[:, None, None, None]
    shape = (size, 1, *rows.planes.shape[2:])
    k = torch.binomial(n.expand(shape).contiguous(), q.expand(shape).contiguous(), generator=rng)
    share, some = k / n, k.clamp_min(1)
    spread = share * (1 - share) / (n - 1).clamp_min(1)
    stops = (dice[:, 1] * 6 - 2)[:, None, None, None]
    tint = torch.exp(0.2 * torch.randn(size, 3, 1, 1, generator=rng, device=rng.device))
    fog = rows.target[:, :3].mean((1, 2, 3), keepdim=True) * torch.exp2(stops) * tint
    light = fog * torch._standard_gamma(some, generator=rng) / some
    colour, noise = rows.planes[:, :3], rows.layer("colour_std")
    step = (light - colour).mean(1, keepdim=True)
    # within the fog, within the rest, between the two: what a renderer's sums of squares say
    own = (some - 1) * fog.mean(1, keepdim=True) ** 2 / (n * (n - 1)).clamp_min(1)
    told = own + (1 - share) * noise**2 + spread * step**2
    rows.planes[:, _AT["colour_std"]] = told.sqrt()
    rows.planes[:, :3] = torch.lerp(colour, light, share)
    for name, value in (
        ("albedo", 0.2 * dice[:, 2]), ("normal", torch.zeros(size, device=rng.device)),
        ("roughness", torch.ones(size, device=rng.device)), ("depth", dice[:, 3] - 0.5),
    ):  # fmt: skip
        there, value = rows.layer(name), value[:, None, None, None]
        if f"{name}_std" in _AT:
            step = (value - there).abs().mean(1, keepdim=True)
            before = (1 - share) * rows.layer(f"{name}_std") ** 2
            rows.planes[:, _AT[f"{name}_std"]] = (before + spread * step**2).sqrt()
        rows.planes[:, _AT[name]] = torch.lerp(there, value, share)
    rows.target[:, :3] = torch.lerp(rows.target[:, :3], fog.expand_as(rows.target[:, :3]), q)
    rows.target[:, 3:] *= 1 - q


def recoloured(rows: Rows, rng: torch.Generator) -> None:
    """Another exposure, coloured light, channels in another order, paler or tinted textures."""
    size, dev = len(rows.planes), rows.planes.device
    order = torch.argsort(_random(size, 3, rng), 1)
    keep = _random(size, 1, rng) < 0.5
    order = torch.where(keep, order, torch.arange(3, device=dev))
    stops = (_random(size, 1, rng) * 2 - 1) * STOPS
    gain = torch.exp2(stops) * torch.exp(TINT * torch.randn(size, 3, generator=rng, device=dev))
    paint = _random(size, 3, rng) * 0.7 + 0.3
    paint = torch.where(_random(size, 1, rng) < 0.5, paint, 1.0)
    paint = torch.where(rows.there[:, :1] > 0, paint, 1.0)
    gain = gain * paint
    swap = order[:, :, None, None].expand(-1, -1, *rows.planes.shape[2:])
    scale, grey = gain[:, :, None, None], gain.mean(1)[:, None, None, None]
    rows.planes[:, :3] = rows.planes[:, :3].gather(1, swap) * scale
    rows.target[:, :3] = rows.target[:, :3].gather(1, swap) * scale
    rows.target[:, 3:] *= grey
    rows.planes[:, _AT["colour_std"]] *= grey
    rows.planes[:, _AT["albedo"]] = rows.layer("albedo").gather(1, swap) * paint[:, :, None, None]
    rows.planes[:, _AT["albedo_std"]] *= paint.mean(1)[:, None, None, None]
    depth = rows.layer("depth")
    shift = 0.1 * torch.randn(size, 1, 1, 1, generator=rng, device=dev)
    rows.planes[:, _AT["depth"]] = torch.where(depth >= 1, depth, (depth + shift).clamp(-1, 1))


def painted(rows: Rows, rng: torch.Generator) -> None:
    """Another texture on everything that has an albedo: albedo and light multiplied alike."""
    size = len(rows.planes)
    height, width = rows.planes.shape[2:]
    first, second = pattern(2 * size, height, width, rng).chunk(2)
    tints = _random(size, 6, rng)
    a, b = (tints[:, i : i + 3, None, None] * 0.8 + 0.2 for i in (0, 3))
    grey = _random(size, 1, rng)[:, :, None, None] < 0.5
    a, b = (torch.where(grey, t.mean(1, keepdim=True), t) for t in (a, b))
    coarse = _random(size, 1, rng)[:, :, None, None] < 0.5
    mix = torch.where(coarse, first * second, first)
    paint = a * mix + b * (1 - mix)
    paint = torch.where(rows.there[:, :1, None, None] > 0, paint, 1.0)
    rows.planes[:, :3] *= paint
    rows.target[:, :3] *= paint
    grey_paint = paint.mean(1, keepdim=True)
    rows.target[:, 3:] *= grey_paint
    rows.planes[:, _AT["colour_std"]] *= grey_paint
    rows.planes[:, _AT["albedo"]] *= paint
    rows.planes[:, _AT["albedo_std"]] *= grey_paint


def shaded(rows: Rows, rng: torch.Generator) -> None:
    """Another pattern of light: colour and target multiplied by what no feature shows."""
    size = len(rows.planes)
    height, width = rows.planes.shape[2:]
    dark = torch.exp2(-_random(size, 1, rng) * 4)[:, :, None, None]
    bright = torch.exp2(_random(size, 1, rng) * 3)[:, :, None, None]
    light = dark + (bright - dark) * pattern(size, height, width, rng)
    tint = torch.exp(0.15 * torch.randn(size, 3, 1, 1, generator=rng, device=rows.planes.device))
    light = light * tint
    grey = light.mean(1, keepdim=True)
    rows.planes[:, :3] *= light
    rows.planes[:, _AT["colour_std"]] *= grey
    rows.target[:, :3] *= light
    rows.target[:, 3:] *= grey


def pattern(size: int, height: int, width: int, rng: torch.Generator) -> Tensor:
    """Something between 0 and 1 with edges, sharp or soft ``(size, 1, H, W)``.

    Stripes (blinds, boards), grids (windows, tiles), level sets of smooth noise (leaves, stains),
    half planes (the edge of a wall's shadow) and discs, seen at an angle and in perspective.
    """
    dev = rng.device
    p = _random(size, 16, rng)[:, :, None, None]
    y = torch.linspace(-1, 1, height, device=dev)[None, :, None]
    x = torch.linspace(-1, 1, width, device=dev)[None, None, :]

    def number(i: int, low: float, high: float) -> Tensor:
        return low + (high - low) * p[:, i]

    angle = number(0, 0, 2 * math.pi)
    u = torch.cos(angle) * x + torch.sin(angle) * y + number(1, -0.5, 0.5)
    v = torch.cos(angle) * y - torch.sin(angle) * x + number(2, -0.5, 0.5)
    depth = 1 + number(3, -0.35, 0.35) * u + number(4, -0.35, 0.35) * v
    u, v = u / depth, v / depth
    often = torch.exp2(number(5, 0.5, 5.0))
    duty = number(6, 0.15, 0.85)
    # distances to the nearest edge, positive inside; as a share of the picture's half
    stripes = _teeth(u * often, duty) / often
    grid = torch.minimum(stripes, _teeth(v * often * number(7, 0.4, 1.5), duty) / often)
    discs = _dots(u * often, v * often, duty) / often
    half = u
    coarse = torch.randn(size, 1, 20, 20, generator=rng, device=dev)
    fine = torch.randn(size, 1, 64, 64, generator=rng, device=dev)
    noise = F.interpolate(coarse, (height, width), mode="bicubic")[:, 0]
    noise = noise + number(8, 0, 0.6) * F.interpolate(fine, (height, width), mode="bicubic")[:, 0]
    leaves = 0.1 * (noise + number(9, -1, 1))
    kind = p[:, 10] * 5
    edge = torch.where(kind < 1, stripes, torch.where(kind < 2, grid, torch.where(
        kind < 3, discs, torch.where(kind < 4, leaves, half))))  # fmt: skip
    # from half a pixel to an eighth of the picture
    soft = torch.exp2(number(11, -7.5, -3.0)) * 2
    found = torch.sigmoid(4 * edge / soft)
    found = torch.where(p[:, 12] < 0.5, found, 1 - found)
    return found[:, None]


def lit(rows: Rows, rng: torch.Generator) -> None:
    """One to `lamps.MOST` lamps before what is there: see `learn.lamps`."""
    size, dev = len(rows.planes), rows.planes.device
    height, width = rows.planes.shape[2:]
    # what does not depend on what is behind, for all lamps at once
    most = lamps.MOST
    count = 1 + (_random(size, 1, rng) * most).long()
    on = (torch.arange(most, device=dev) < count).T.reshape(-1, 1, 1, 1).float()
    dice = _random(most * size, 16, rng)
    covers = _lamp_cover(dice, height, width, rng) * on
    levels = _log_uniform(dice[:, 8:9], lamps.RADIANCE)
    tints = torch.exp(0.3 * torch.randn(most * size, 3, generator=rng, device=dev))
    lights = (levels * tints / tints.mean(1, keepdim=True))[:, :, None, None]
    normals = F.normalize(torch.randn(most * size, 3, generator=rng, device=dev), dim=1)
    n = rows.spp.round().clamp_min(1)[:, None, None, None]
    counts = n.repeat(most, 1, 1, 1).expand_as(covers).contiguous()
    hits = torch.binomial(counts, covers.clamp(0, 1), generator=rng) / counts
    spreads = hits * (1 - hits) / (counts - 1).clamp_min(1)
    parts = (part.split(size) for part in (dice, covers, lights, normals, hits, spreads))
    for p, cover, radiance, normal, hit, spread in zip(*parts, strict=True):
        rest = 1 - hit

        def behind(name: str, step: Tensor, rest: Tensor = rest, spread: Tensor = spread) -> None:
            there = rows.layer(name) * rest
            rows.planes[:, _AT[name]] = (there * there + spread * step * step).sqrt()

        colour = rows.planes[:, :3]
        behind("colour_std", (radiance - colour).abs().mean(1, keepdim=True))
        own = (p[:, 9] < 0.5).float()[:, None, None, None]
        grey = (p[:, 10:11] * 3).floor() / 2
        near = rows.layer("depth").amin((2, 3)) + 0.2 * p[:, 11:12] - 0.1
        for name, value in (
            ("albedo", grey.expand(-1, 3)), ("normal", normal),
            ("roughness", torch.ones_like(grey)), ("depth", near.clamp(-1, 1)),
        ):  # fmt: skip
            value = value[:, :, None, None]
            there = rows.layer(name)
            if f"{name}_std" in _AT:
                step = (value - there).abs().mean(1, keepdim=True)
                behind(f"{name}_std", step, 1 - own * hit, own * spread)
            rows.planes[:, _AT[name]] = torch.lerp(there, value.expand_as(there), own * hit)
        rows.planes[:, :3] = colour * rest + hit * radiance
        rows.target[:, :3] = rows.target[:, :3] * (1 - cover) + cover * radiance
        rows.target[:, 3:] *= 1 - cover


def filtered(rows: Rows, rng: torch.Generator) -> None:
    """As a renderer writes that splats samples: see `learn.splat`. Deviations are not known."""
    size, dev = len(rows.planes), rows.planes.device
    kind = (_random(size, 1, rng) * len(FILTERS)).long()[:, :, None, None]
    image = rows.planes[:, _MEANS]
    height, width = image.shape[2:]
    reach = 2
    steps = torch.arange(-reach, reach + 1, device=dev, dtype=torch.float32)[None, :, None, None]
    shape, side = (height + 2 * reach, width + 2 * reach), 2 * reach + 1
    # all samples of a pixel have its value: their weights add up before they are spread
    at = torch.rand(2, size * GROUPS, 1, height, width, generator=rng, device=dev) - 0.5
    kinds = kind.repeat_interleave(GROUPS, 0)
    down, across = _filter(steps - at[0], kinds), _filter(steps - at[1], kinds)
    w = (down[:, :, None] * across[:, None]).flatten(1, 2)  # (n · GROUPS, 25, H, W)
    there = torch.arange(GROUPS, device=dev) < rows.spp[:, None]
    w = (w.unflatten(0, (size, GROUPS)) * there[:, :, None, None, None]).sum(1)
    both = torch.cat([image, torch.ones_like(image[:, :1])], 1)
    spread = (both[:, :, None] * w[:, None]).flatten(1, 2).flatten(2)
    folded = F.fold(spread, shape, side)[:, :, reach:-reach, reach:-reach]
    total, weight = folded[:, :-1], folded[:, -1:]
    rows.planes[:, _MEANS] = total / torch.where(weight.abs() < 0.05, 0.05, weight)
    fine = (torch.arange(64, device=dev) + 0.5) / 64 - 0.5
    line = _filter(steps - fine[None, None, :, None], kind).mean((2, 3))  # (n, 5)
    plane = (line[:, :, None] * line[:, None])[:, None]
    stack = torch.cat([rows.target, torch.ones_like(weight)], 1)
    kernel = plane.expand(-1, stack.shape[1], -1, -1).flatten(0, 1)[:, None]
    blurred = F.conv2d(
        stack.flatten(0, 1)[None], kernel, padding=reach, groups=len(kernel)
    ).unflatten(1, stack.shape[:2])[0]
    rows.target[:] = blurred[:, :-1] / blurred[:, -1:]
    rows.target[:, 3:].clamp_min_(0)
    for i, name in enumerate(NAMES):
        if name.endswith("_std"):
            rows.there[:, i] = 0


def without_some(rows: Rows, spp: Tensor, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Masks ``(B, len(MASKS))`` as `augment.without_some` draws them, and spp, 0 if unknown."""
    size = len(rows.planes)
    names = list(MASKS)
    kind = _random(size, 1, rng)
    keep = (_random(size, len(names), rng) < 0.6).float()
    plain = torch.tensor([float(n in ("albedo", "normal")) for n in names], device=spp.device)
    keep = torch.where(kind < ALL + PLAIN + COLOUR, 0.0, keep)
    keep = torch.where(kind < ALL + PLAIN, plain, keep)
    keep = torch.where(kind < ALL, 1.0, keep)
    return keep, torch.where(_random(size, 1, rng)[:, 0] < 0.3, 0.0, spp)


# ------------------------------------------------------------------- private


def _rotations(size: int, rng: torch.Generator) -> Tensor:
    """Orthogonal 3x3 matrices, mirrors among them, uniform: unit quaternions (Shoemake 1992)."""
    q = F.normalize(torch.randn(size, 4, generator=rng, device=rng.device), dim=1)
    w, x, y, z = q.unbind(1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    found = torch.stack([torch.stack(row, 1) for row in rows], 1)
    return found * torch.where(_random(size, 1, rng) < 0.5, 1.0, -1.0)[:, :, None]


def _of_layers(masks: Tensor) -> Tensor:
    """Masks ``(B, len(MASKS))`` to layers ``(B, len(NAMES))``; no deviation without its layer."""
    found = masks[:, _mask_of(masks.device)]
    for guide in ("albedo", "normal", "depth"):
        found[:, NAMES.index(f"{guide}_std")] *= found[:, NAMES.index(guide)]
    return found


def _random(size: int, count: int, rng: torch.Generator) -> Tensor:
    return torch.rand(size, count, generator=rng, device=rng.device)


def _chosen(size: int, share: float, rng: torch.Generator) -> Tensor:
    """The numbers of a random share of the rows."""
    order = torch.argsort(_random(1, size, rng)[0])
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


def _teeth(t: Tensor, duty: Tensor) -> Tensor:
    """Signed distance to the edges of stripes of period 1 and width ``duty``, in periods."""
    return duty / 2 - (t - t.round()).abs()


def _dots(u: Tensor, v: Tensor, duty: Tensor) -> Tensor:
    """The same for discs on a grid."""
    return duty / 2 - torch.hypot(u - u.round(), v - v.round())


def _log_uniform(p: Tensor, bounds: tuple[float, float]) -> Tensor:
    low, high = (math.log(b) for b in bounds)
    return torch.exp(low + (high - low) * p)


def _lamp_cover(p: Tensor, height: int, width: int, rng: torch.Generator) -> Tensor:
    """The share of each pixel that a lamp covers ``(B, 1, H, W)``: `lamps.draw`, 4x4 places."""
    size, dev, fine = len(p), p.device, 4
    half = _log_uniform(p[:, :2], lamps.SIZE)
    half = torch.where(p[:, 2:3] < 0.4, half[:, :1], half)
    tube = p[:, 3:4] < 0.15
    half = torch.where(tube, half * torch.tensor([0.5, 4.0], device=dev), half)
    power = torch.where(p[:, 4] < 0.6, 2.0, torch.where(p[:, 4] < 0.7, 1.0, 16.0))
    angle = p[:, 5] * math.pi
    jitter = torch.rand(2, size, 1, 1, generator=rng, device=dev)
    y = torch.arange(height * fine, device=dev)[None, :, None] + jitter[0]
    x = torch.arange(width * fine, device=dev)[None, None, :] + jitter[1]
    y = y / fine - (p[:, 6] * height)[:, None, None]
    x = x / fine - (p[:, 7] * width)[:, None, None]
    cos, sin = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
    power = power[:, None, None]
    u = ((cos * y + sin * x) / half[:, :1, None]).abs()
    v = ((cos * x - sin * y) / half[:, 1:, None]).abs()
    inside = (u.clamp_max(2) ** power + v.clamp_max(2) ** power <= 1).float()
    return F.avg_pool2d(inside[:, None], fine)


def _filter(t: Tensor, kind: Tensor) -> Tensor:
    """`splat.FILTERS` of a distance, each row its own."""
    a = t.abs()
    tent = (1 - a).clamp_min(0)
    gaussian = (torch.exp(-2 * a * a) - math.exp(-8)).clamp_min(0)
    near = (7 * a**3 - 12 * a**2 + 16 / 3) / 6
    far = (-7 / 3 * a**3 + 12 * a**2 - 20 * a + 32 / 3) / 6
    mitchell = torch.where(a < 1, near, torch.where(a < 2, far, 0.0))
    return torch.where(kind == 0, tent, torch.where(kind == 1, gaussian, mitchell))
