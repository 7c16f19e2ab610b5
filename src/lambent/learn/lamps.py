"""Lamps in view: small bright things that are light, not noise.

A lamp of a few pixels looks like a firefly, but all of a pixel's samples that hit it see the same
radiance: it stands still, and its noise is that of how many samples hit it. Few training crops have
one, and a network that has not seen them deletes them. So they are put in, into input and target
alike: with L the lamp's radiance, C the share of a pixel that it covers and c ~ Binomial(n, C) / n
the share of the pixel's n samples that hit it,

    input = (1 - c) input + c L,    target = (1 - C) target + C L,    Var[c L] = L² C (1 - C) / n.

Half of them are seen in a mirror, or by a renderer that leaves light sources out of its features,
and the other half have an albedo, a normal and a depth of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.learn.changes import log_uniform
from lambent.learn.rows import AT, Rows, random

#: Share of the rows that get lamps, and the most that one gets.
SHARE, MOST = 0.25, 4
#: Radiance of a lamp where the mean of the crop is about 0.18, log-uniform.
RADIANCE = (1.0, 4000.0)
#: Its half width in pixels, log-uniform.
SIZE = (0.4, 8.0)
#: Places in a pixel, down and across, that its coverage is measured at.
_FINE = 4


@dataclass
class Lamps:
    """A lamp a row. ``cover`` ``(B, 1, H, W)`` in [0, 1]; ``radiance`` ``(B, 3, 1, 1)``.

    ``own`` ``(B, 1, 1, 1)``: 1 where it has features of its own: ``albedo`` and ``normal``
    ``(B, 3, 1, 1)``; ``before`` ``(B, 1, 1, 1)``: its depth less the least depth of the crop.
    """

    cover: Tensor
    radiance: Tensor
    own: Tensor
    albedo: Tensor
    normal: Tensor
    before: Tensor

    def parts(self, count: int) -> list[Lamps]:
        """As ``count`` lamps a row, where all were drawn at once."""
        fields = (self.cover, self.radiance, self.own, self.albedo, self.normal, self.before)
        return [Lamps(*part) for part in zip(*(f.chunk(count) for f in fields), strict=True)]


def draw(size: int, height: int, width: int, rng: torch.Generator) -> Lamps:
    """Discs, ellipses, bars or polygonal panels somewhere in ``size`` pictures."""
    dev = rng.device
    dice = random(size, 16, rng)
    level = log_uniform(dice[:, 8:9], RADIANCE)
    tint = torch.exp(0.3 * torch.randn(size, 3, generator=rng, device=dev))
    normal = F.normalize(torch.randn(size, 3, generator=rng, device=dev), dim=1)
    grey = (dice[:, 10:11] * 3).floor() / 2
    return Lamps(
        _cover(dice, height, width, rng),
        (level * tint / tint.mean(1, keepdim=True))[:, :, None, None],
        (dice[:, 9] < 0.5).float()[:, None, None, None],
        grey.expand(-1, 3)[:, :, None, None],
        normal[:, :, None, None],
        (0.2 * dice[:, 11] - 0.1)[:, None, None, None],
    )


def lit(rows: Rows, rng: torch.Generator) -> None:
    """Put one to `MOST` lamps before what is there."""
    size = len(rows.planes)
    count = 1 + (random(size, 1, rng) * MOST).long()
    height, width = rows.planes.shape[2:]
    every = draw(MOST * size, height, width, rng)
    for number, lamp in enumerate(every.parts(MOST)):
        lamp.cover = lamp.cover * (number < count)[:, :, None, None]
        add(rows, lamp, rng)


def add(rows: Rows, lamp: Lamps, rng: torch.Generator) -> None:
    """Put a lamp before what is there in each row."""
    n = rows.spp.round().clamp_min(1)[:, None, None, None].expand_as(lamp.cover).contiguous()
    hit = torch.binomial(n, lamp.cover.clamp(0, 1), generator=rng) / n
    # between what was there and the lamp: a sample sees the one or the other
    spread = hit * (1 - hit) / (n - 1).clamp_min(1)

    def behind(name: str, step: Tensor, share: Tensor | float) -> None:
        """The deviation of a layer whose value jumps by ``step`` at the lamp's rim."""
        there = rows.layer(name) * (1 - share * hit)
        rows.planes[:, AT[name]] = (there * there + share * spread * step * step).sqrt()

    colour = rows.planes[:, :3]
    behind("colour_std", (lamp.radiance - colour).abs().mean(1, keepdim=True), 1.0)
    near = rows.layer("depth").amin((2, 3), keepdim=True) + lamp.before
    for name, value in (
        ("albedo", lamp.albedo), ("normal", lamp.normal),
        ("roughness", torch.ones_like(near)), ("depth", near.clamp(-1, 1)),
    ):  # fmt: skip
        there = rows.layer(name)
        if f"{name}_std" in AT:
            behind(f"{name}_std", (value - there).abs().mean(1, keepdim=True), lamp.own)
        rows.planes[:, AT[name]] = torch.lerp(there, value.expand_as(there), lamp.own * hit)
    rows.planes[:, :3] = colour * (1 - hit) + hit * lamp.radiance
    rows.target[:, :3] = rows.target[:, :3] * (1 - lamp.cover) + lamp.cover * lamp.radiance
    rows.target[:, 3:] *= 1 - lamp.cover


# ------------------------------------------------------------------- private


def _cover(p: Tensor, height: int, width: int, rng: torch.Generator) -> Tensor:
    """The share of each pixel that a lamp covers ``(B, 1, H, W)``."""
    size, dev = len(p), p.device
    half = log_uniform(p[:, :2], SIZE)
    half = torch.where(p[:, 2:3] < 0.4, half[:, :1], half)
    tube = p[:, 3:4] < 0.15
    half = torch.where(tube, half * torch.tensor([0.5, 4.0], device=dev), half)
    # ellipse, rhomb, panel
    power = torch.where(p[:, 4] < 0.6, 2.0, torch.where(p[:, 4] < 0.7, 1.0, 16.0))
    angle = p[:, 5] * math.pi
    jitter = torch.rand(2, size, 1, 1, generator=rng, device=dev)
    y = torch.arange(height * _FINE, device=dev)[None, :, None] + jitter[0]
    x = torch.arange(width * _FINE, device=dev)[None, None, :] + jitter[1]
    y = y / _FINE - (p[:, 6] * height)[:, None, None]
    x = x / _FINE - (p[:, 7] * width)[:, None, None]
    cos, sin = torch.cos(angle)[:, None, None], torch.sin(angle)[:, None, None]
    power = power[:, None, None]
    u = ((cos * y + sin * x) / half[:, :1, None]).abs()
    v = ((cos * x - sin * y) / half[:, 1:, None]).abs()
    inside = (u.clamp_max(2) ** power + v.clamp_max(2) ** power <= 1).float()
    return F.avg_pool2d(inside[:, None], _FINE)
