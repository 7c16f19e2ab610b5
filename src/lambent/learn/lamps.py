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
from dataclasses import dataclass, replace

import numpy as np

from lambent.frame.layer import FloatImage
from lambent.learn.augment import Example

#: Share of the examples that get lamps, and the most that one gets.
SHARE, MOST = 0.25, 4
#: Radiance of a lamp where the mean of the crop is about 0.18, log-uniform.
RADIANCE = (1.0, 4000.0)
#: Its half width in pixels, log-uniform.
SIZE = (0.4, 8.0)
#: Places in a pixel, down and across, that its coverage is measured at.
_FINE = 8


@dataclass(frozen=True)
class Lamp:
    """``cover`` ``(H, W)`` in [0, 1]; ``radiance`` ``(3,)``; ``features``: it has its own."""

    cover: FloatImage
    radiance: FloatImage
    features: bool


def draw(shape: tuple[int, int], rng: np.random.Generator) -> Lamp:
    """A disc, an ellipse, a bar or a polygonal panel somewhere in a picture."""
    height, width = shape
    half = np.exp(rng.uniform(math.log(SIZE[0]), math.log(SIZE[1]), 2))
    if rng.random() < 0.4:
        half[1] = half[0]
    if rng.random() < 0.15:  # a tube
        half *= (0.5, 4.0)
    centre = rng.uniform(0, 1, 2) * (height, width)
    angle = rng.uniform(0, np.pi)
    power = (2.0, 1.0, 16.0)[int(rng.choice(3, p=(0.6, 0.1, 0.3)))]  # ellipse, rhomb, panel
    reach = float(np.hypot(*half)) + 1
    top, left = (max(0, int(c - reach)) for c in centre)
    bottom, right = (
        min(n, int(c + reach) + 1) for c, n in zip(centre, (height, width), strict=True)
    )
    cover = np.zeros(shape, np.float32)
    if bottom > top and right > left:
        y = (np.arange((bottom - top) * _FINE) + 0.5) / _FINE + top - centre[0]
        x = (np.arange((right - left) * _FINE) + 0.5) / _FINE + left - centre[1]
        u = (np.cos(angle) * y[:, None] + np.sin(angle) * x) / half[0]
        v = (np.cos(angle) * x - np.sin(angle) * y[:, None]) / half[1]
        inside = (np.abs(u) ** power + np.abs(v) ** power <= 1).astype(np.float32)
        cells = inside.reshape(bottom - top, _FINE, right - left, _FINE)
        cover[top:bottom, left:right] = cells.mean((1, 3))
    tint = np.exp(rng.normal(0, 0.3, 3))
    level = np.exp(rng.uniform(math.log(RADIANCE[0]), math.log(RADIANCE[1])))
    return Lamp(cover, (level * tint / tint.mean()).astype(np.float32), rng.random() < 0.5)


def lit(example: Example, rng: np.random.Generator) -> Example:
    """The example with one to `MOST` lamps, each before what is there."""
    for _ in range(int(rng.integers(1, MOST + 1))):
        example = add(example, draw(example.target.shape[1:], rng), rng)
    return example


def add(example: Example, lamp: Lamp, rng: np.random.Generator) -> Example:
    """The example with a lamp before what is there."""
    noisy, cover = example.noisy, lamp.cover[None]
    spp = max(1, round(noisy.spp or 1))
    hit = (rng.binomial(spp, lamp.cover) / spp).astype(np.float32)[None]
    radiance = lamp.radiance[:, None, None]
    # between what was there and the lamp: a sample sees the one or the other
    spread = hit * (1 - hit) / max(1, spp - 1)
    layers = dict(noisy.layers)

    def behind(name: str, step: FloatImage) -> None:
        """The deviation of a layer whose value jumps by ``step`` at the lamp's rim."""
        if name in layers:
            rest = layers[name] * (1 - hit)
            layers[name] = np.sqrt(rest * rest + spread * step * step)

    jump = np.abs(radiance - noisy.colour).mean(0, keepdims=True)
    behind("colour_std", jump)
    if lamp.features:
        grey = (0.0, 0.5, 1.0)[int(rng.integers(3))]
        normal = rng.normal(size=3)
        own = {
            "albedo": np.full(3, grey),
            "normal": normal / np.linalg.norm(normal),
            "roughness": np.ones(1),
        }
        if "depth" in layers:
            near = float(np.clip(layers["depth"].min() + rng.uniform(-0.1, 0.1), -1, 1))
            own["depth"] = np.array([near])
        for name, value in own.items():
            if name in layers:
                there, mine = layers[name], value.astype(np.float32)[:, None, None]
                behind(f"{name}_std", np.abs(mine - there).mean(0, keepdims=True))
                layers[name] = (1 - hit) * there + hit * mine
    colour = (1 - hit) * noisy.colour + hit * radiance
    target = (1 - cover) * example.target + cover * radiance
    return replace(
        example,
        noisy=replace(noisy, colour=colour, layers=layers),
        target=target,
        deviation=example.deviation * (1 - cover),
    )
