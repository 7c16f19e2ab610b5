"""Rows: a batch of crops at work, on whatever device, before a network reads it."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from lambent.denoise.inputs import LAYERS, Signals
from lambent.frame.layer import FloatImage
from lambent.learn.cache import STORED

#: The planes of each layer, in the order of the cache's file: those of the denoiser come first,
#: then what only `denoise.lobes` has.
_ENDS = list(itertools.accumulate(STORED.values(), initial=3))
AT = {name: slice(a, b) for name, a, b in zip(STORED, _ENDS, _ENDS[1:], strict=False)}
#: The denoiser's layers, how many planes they and the colour have, and all of them.
NAMES = tuple(name for name in STORED if name in LAYERS)
PLANES, ALL_PLANES = 3 + sum(LAYERS[name] for name in NAMES), _ENDS[-1]
#: The denoiser's layers without deviations, which come first: what a renderer's film splats.
MEANS = slice(0, max(AT[n].stop for n in NAMES if not n.endswith("_std")))


@dataclass(frozen=True)
class Example:
    """A noisy frame and what it should become. Channels first, at the target's exposure.

    ``target`` ``(3, H, W)``, or ``(6, H, W)`` with its diffuse part; ``deviation`` ``(1, H, W)``:
    of the target's mean.
    """

    noisy: Signals
    target: FloatImage
    deviation: FloatImage


@dataclass
class Rows:
    """A batch at work. Changed in place.

    ``planes`` ``(B, PLANES, H, W)``; with lobes `ALL_PLANES`. ``there`` ``(B, layers)``: 1 for the
    layers of `STORED` that are known. ``target`` ``(B, 4, H, W)``: colour, and the deviation of its
    mean; with lobes three more, its diffuse part. ``spp`` ``(B,)``.
    """

    planes: Tensor
    there: Tensor
    target: Tensor
    spp: Tensor

    def layer(self, name: str) -> Tensor:
        """The planes of a layer, to be read or written."""
        return self.planes[:, AT[name]]

    def known(self, name: str) -> Tensor:
        """Whether a layer is known ``(B, 1, 1, 1)``."""
        return self.there[:, list(STORED).index(name), None, None, None] > 0


def rows_of(examples: Sequence[Example], device: str | torch.device = "cpu") -> Rows:
    """Examples of one size as rows; with lobes if the targets have them. Unknown samples are 0."""
    lobes = len(examples[0].target) > 3
    count, names = (ALL_PLANES, tuple(STORED)) if lobes else (PLANES, NAMES)
    size = examples[0].target.shape[1:]
    planes = np.zeros((len(examples), count, *size), np.float32)
    there = np.zeros((len(examples), len(names)), np.float32)
    for i, example in enumerate(examples):
        planes[i, :3] = example.noisy.colour
        for k, name in enumerate(names):
            if name in example.noisy.layers:
                planes[i, AT[name]], there[i, k] = example.noisy.layers[name], 1
    target = np.stack([np.concatenate([e.target[:3], e.deviation, e.target[3:]]) for e in examples])
    spp = np.array([e.noisy.spp or 0 for e in examples], np.float32)
    parts = (torch.from_numpy(part).to(device) for part in (planes, there, target, spp))
    return Rows(*parts)


@functools.lru_cache(maxsize=8)
def layer_of(device: torch.device) -> Tensor:
    """The number of the layer of each plane after the colour's."""
    return torch.tensor([i for i, n in enumerate(STORED.values()) for _ in range(n)], device=device)


def random(size: int, count: int, rng: torch.Generator) -> Tensor:
    """Uniform numbers in [0, 1) ``(size, count)``."""
    return torch.rand(size, count, generator=rng, device=rng.device)


def generator(device: str | torch.device, *numbers: int) -> torch.Generator:
    """Random numbers that follow from some numbers."""
    seed = int(np.random.SeedSequence(numbers).generate_state(1)[0])
    return torch.Generator(device).manual_seed(seed)
