"""Frames as renderers with splatted pixel filters write them, made from box-filtered ones.

Mitsuba and pbrt spread a sample at x over the pixels p around it, with weights f(x - p), and divide
by the sum of the weights that a pixel has received. Neighbouring pixels then share samples, and
their noise is alike. A crop holds pixel means, not samples, so the samples are made up: the n of a
pixel are taken as up to `GROUPS` groups with the pixel's mean value, each at a random place in its
pixel. Means, correlation and the noise of the weights themselves come out as with a real splat;
what is lost is that a pixel's samples differ, which a mean cannot tell.

The reference of such a frame is what infinitely many samples would give: the same, with weights
averaged over the pixel (`expected`).
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.learn.rows import MEANS, NAMES, Rows, random

#: Pixel filters, by number: a tent; Mitsuba's Gaussian of deviation 0.5, cut at 4 deviations, where
#: it is 0; Mitchell and Netravali 1988 with B = C = 1/3, radius 2.
FILTERS = ("tent", "gaussian", "mitchell")
#: Whole pixels that a filter reaches, to each side.
REACH = 2
#: Samples of a pixel are taken together in so many groups at most: more would be all but even.
GROUPS = 4


def filtered(rows: Rows, rng: torch.Generator) -> None:
    """Make rows those of a renderer that splats: deviations are not known then."""
    kind = (random(len(rows.planes), 1, rng) * len(FILTERS)).long()
    rows.planes[:, MEANS] = splatted(rows.planes[:, MEANS], rows.spp, kind, rng)
    rows.target[:] = expected(rows.target, kind)
    rows.target[:, 3:].clamp_min_(0)
    for i, name in enumerate(NAMES):
        if name.endswith("_std"):
            rows.there[:, i] = 0


def splatted(image: Tensor, spp: Tensor, kind: Tensor, rng: torch.Generator) -> Tensor:
    """``image`` ``(B, C, H, W)`` of ``spp`` ``(B,)`` samples a pixel, splatted. Same shape.

    ``kind`` ``(B, 1)``: numbers of `FILTERS`. All channels of a pixel have the same samples.
    """
    size, _, height, width = image.shape
    dev = image.device
    steps = torch.arange(-REACH, REACH + 1, device=dev, dtype=torch.float32)[None, :, None, None]
    kinds = kind[:, :, None, None]
    # all samples of a pixel have its value: their weights add up before they are spread
    w: Tensor | float = 0.0
    for group in range(GROUPS):
        at = torch.rand(2, size, 1, height, width, generator=rng, device=dev) - 0.5
        down, across = (weight(steps - a, kinds) for a in at)
        there = (group < spp.clamp_min(1))[:, None, None, None, None]
        w = w + there * down[:, :, None] * across[:, None]
    assert isinstance(w, Tensor)  # (B, 5, 5, H, W)
    both = torch.cat([image, torch.ones_like(image[:, :1])], 1)
    sums = F.pad(torch.zeros_like(both), (REACH,) * 4)
    for dy in range(2 * REACH + 1):
        for dx in range(2 * REACH + 1):
            sums[:, :, dy : dy + height, dx : dx + width].addcmul_(both, w[:, dy, dx, None])
    sums = sums[:, :, REACH:-REACH, REACH:-REACH]
    # Mitchell's lobes may take nearly all of a pixel's weight away: renderers leave it at that
    total = torch.where(sums[:, -1:].abs() < 0.05, 0.05, sums[:, -1:])
    return sums[:, :-1] / total


def expected(image: Tensor, kind: Tensor) -> Tensor:
    """``image`` ``(B, C, H, W)`` under the filters, with infinitely many samples a pixel."""
    dev = image.device
    steps = torch.arange(-REACH, REACH + 1, device=dev, dtype=torch.float32)[None, :, None]
    fine = (torch.arange(64, device=dev) + 0.5) / 64 - 0.5
    line = weight(steps - fine, kind[:, :, None]).mean(2)  # (B, 5)
    both = torch.cat([image, torch.ones_like(image[:, :1])], 1)
    size, channels = both.shape[:2]
    kernel = (line[:, :, None] * line[:, None]).repeat_interleave(channels, 0)[:, None]
    blurred = F.conv2d(both.flatten(0, 1)[None], kernel, padding=REACH, groups=len(kernel))
    blurred = blurred.unflatten(1, (size, channels))[0]
    return blurred[:, :-1] / blurred[:, -1:]


def weight(t: Tensor, kind: Tensor) -> Tensor:
    """The filters of a distance in pixels, each row its own."""
    a = t.abs()
    tent = (1 - a).clamp_min(0)
    gaussian = (torch.exp(-2 * a * a) - math.exp(-8)).clamp_min(0)
    near = (7 * a**3 - 12 * a**2 + 16 / 3) / 6
    far = (-7 / 3 * a**3 + 12 * a**2 - 20 * a + 32 / 3) / 6
    mitchell = torch.where(a < 1, near, torch.where(a < 2, far, 0.0))
    return torch.where(kind == 0, tent, torch.where(kind == 1, gaussian, mitchell))
