"""Batches for Lambent's own network, made on whatever device it learns on.

What a batch holds follows from seed, step and the number of the process, so a run that was stopped
goes on with the very batches it would have seen. All rows of a batch are changed at once
(`learn.changes`, `learn.lamps`, `learn.splat`): on a large GPU the network is done with a crop long
before a processor has made the next one.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.denoise import samples
from lambent.denoise.inputs import MASKS, OFFSET, Signals, divisor, encode, pack
from lambent.frame import noise_level
from lambent.learn import changes, lamps, splat
from lambent.learn.rows import NAMES, PLANES, Rows, layer_of, random
from lambent.learn.stills import Stills

#: Share of the rows that get a splatted pixel filter.
SPLATTED = 0.2
#: Share of the rows that are trained for least error (preference 0).
NEUTRAL = 0.5
#: Share of the batches that are at half size.
SHRUNK = 0.35
#: Smaller crops than this are not made: a pixel of the coarsest scale is 16 wide.
LEAST = 64


def batch_of(
    stills: Stills, seed: int, step: int, size: int, rank: int = 0
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """A batch for the network: packed inputs, colour, divisor, target, deviation, preference.

    Shapes as in `learn.denoising.Batch`; a shrunk one has 4 B crops. The same for the same seed,
    step and stills.
    """
    dev = stills.device
    numbers = np.random.SeedSequence((seed, step, rank)).generate_state(2)
    rng = torch.Generator(dev).manual_seed(int(numbers[0]))
    if numbers[1] < SHRUNK * 2**32 and stills.edge >= 2 * LEAST:
        size *= 4
        rows = changes.shrunk(stills.rows(size, rng))
    else:
        rows = stills.rows(size, rng)
    rows = changes.turned(rows, rng)
    _some(rows, changes.COLLAGED, rng, changes.collaged)
    _some(rows, changes.THINNED, rng, changes.thinned)
    _some(rows, changes.SHADED, rng, changes.shaded)
    _some(rows, changes.EMBOSSED, rng, changes.embossed)
    _some(rows, changes.HAZED, rng, changes.hazed)
    _some(rows, lamps.SHARE, rng, lamps.lit)
    spp = rows.spp.clone()
    _some(rows, SPLATTED, rng, splat.filtered)
    changes.recoloured(rows, rng)
    _some(rows, changes.PAINTED, rng, changes.painted)
    masks, spp = changes.without_some(rows, spp, rng)
    neutral = random(size, 2, rng)
    preference = torch.where(neutral[:, 0] < NEUTRAL, 0.0, neutral[:, 1])
    return ready(rows, masks, spp, preference)


def ready(
    rows: Rows,
    masks: Tensor,
    spp: Tensor,
    preference: Tensor,
    guess: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Rows as the network reads them; ``masks`` ``(B, len(MASKS))``, ``spp`` 0 where unknown.

    ``guess`` ``(B,)``: what spp seems to be, 0 where that is to be guessed from the rows.
    """
    shown = rows.there * _of_layers(masks)
    albedo = torch.where(shown[:, :1, None, None] > 0, rows.layer("albedo"), 1 - OFFSET)
    layers = {name: rows.layer(name) for name in NAMES} | {"albedo": albedo}
    colour = rows.planes[:, :3]
    d = divisor(torch, albedo)
    planes = encode(torch, Signals(colour, layers), 1.0)
    keep = shown[:, layer_of(shown.device)[: PLANES - 3]]
    keep = F.pad(F.pad(keep, (3, 0), value=1.0), (0, planes.shape[1] - PLANES))
    flags = []
    for of in MASKS.values():
        parts = [shown[:, NAMES.index(n)] for n in of if n in NAMES]
        flags.append(torch.stack(parts).amax(0) if parts else torch.zeros_like(spp))
    size = torch.log2(spp.clamp_min(1)) / 10
    unknown = (spp <= 0) & (shown[:, NAMES.index("colour_std")] <= 0)
    seeming = guessed(colour / d, shown[:, 0] > 0)
    if guess is not None:
        seeming = torch.where(guess > 0, torch.log2(guess.clamp_min(1)), seeming)
    size = torch.where(unknown, seeming / 10, size)
    numbers = torch.stack([*flags, size, (spp > 0).float(), preference], 1)
    packed = pack(torch, planes * keep[:, :, None, None], numbers)
    target, deviation = rows.target[:, :3], rows.target[:, 3:4]
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


@functools.lru_cache(maxsize=8)
def _mask_of(device: torch.device) -> Tensor:
    """The number of the mask of each layer."""
    names = list(MASKS)
    of = [next(i for i, n in enumerate(names) if layer in MASKS[n]) for layer in NAMES]
    return torch.tensor(of, device=device)


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


def _some(
    rows: Rows, share: float, rng: torch.Generator, change: Callable[[Rows, torch.Generator], None]
) -> None:
    """Change a random share of the rows."""
    which = _chosen(len(rows.planes), share, rng)
    if not len(which):
        return
    part = Rows(rows.planes[which], rows.there[which], rows.target[which], rows.spp[which])
    change(part, rng)
    rows.planes[which], rows.target[which], rows.there[which] = part.planes, part.target, part.there
