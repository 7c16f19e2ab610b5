"""Rows: a batch of crops at work, on whatever device, before the network reads it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor

from lambent.denoise.inputs import LAYERS
from lambent.learn.cache import STORED

#: Layers of a level here, in the order of the cache's file, without what only lobes have.
NAMES = tuple(name for name in STORED if name in LAYERS)
PLANES = 3 + sum(LAYERS[name] for name in NAMES)
#: The planes of each layer.
_ENDS = list(itertools.accumulate((LAYERS[name] for name in NAMES), initial=3))
AT = {name: slice(a, b) for name, a, b in zip(NAMES, _ENDS, _ENDS[1:], strict=False)}
#: The layers without deviations, which come first: what a renderer's film splats.
MEANS = slice(0, max(AT[n].stop for n in NAMES if not n.endswith("_std")))


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
        return self.planes[:, AT[name]]


def random(size: int, count: int, rng: torch.Generator) -> Tensor:
    """Uniform numbers in [0, 1) ``(size, count)``."""
    return torch.rand(size, count, generator=rng, device=rng.device)
