"""What may be done to a rendered picture so that it is another rendered picture.

Every change is applied to the noisy frame and its target alike, and each is something that a
renderer could have produced: a mirrored or turned picture, another exposure, coloured light,
channels in another order, paler or tinted textures (colour and albedo together: light that has
left the surface once is proportional to its albedo). Normals get one random rotation, since the
network must not know which way is up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lambent.denoise.inputs import MASKS, Signals
from lambent.frame.layer import FloatImage
from lambent.learn.splat import FILTERS, expected, splatted

#: Exposure varies by up to so many stops either way.
STOPS = 2.0
#: Standard deviation of the logarithm of the gain of each channel: coloured light.
TINT = 0.2
#: Shares of the examples that keep all layers; albedo and normal, as most renderers write them;
#: none. Where layers are few there is more to learn.
ALL, PLAIN, COLOUR = 0.33, 0.25, 0.2
#: Share of the examples whose samples are not told.
UNTOLD = 0.5


@dataclass(frozen=True)
class Example:
    """A noisy frame and what it should become. Channels first, at the target's exposure.

    ``deviation`` ``(1, H, W)``: of the target's mean.
    """

    noisy: Signals
    target: FloatImage
    deviation: FloatImage


def merged(levels: list[Signals]) -> Signals:
    """Independent renders of one picture as one with the sum of their samples.

    A variance is there if a level with at least two samples tells one; levels of a single sample
    then count as noisy as the others are per sample.
    """
    if len(levels) == 1:
        return levels[0]
    spp = [float(level.spp or 1) for level in levels]
    shares = [n / sum(spp) for n in spp]
    names = set.intersection(*(set(level.layers) for level in levels))
    layers = {}
    for name in names:
        if not name.endswith("_std"):
            layers[name] = _sum(
                level.layers[name] * s for level, s in zip(levels, shares, strict=True)
            )
    for name in {n for level in levels for n in level.layers if n.endswith("_std")}:
        # the variance of one sample, from the levels that tell it
        told = [
            (n, lv.layers[name]) for n, lv in zip(spp, levels, strict=True) if name in lv.layers
        ]
        one = _sum(std * std * (n * n) for n, std in told) / sum(n for n, _ in told)
        layers[name] = np.sqrt(one / np.float32(sum(spp)))
    colour = _sum(level.colour * s for level, s in zip(levels, shares, strict=True))
    return Signals(colour, layers, sum(spp))


def turned(example: Example, rng: np.random.Generator) -> Example:
    """Mirrored and turned by quarters; normals rotated at random (half of the time)."""
    flip, quarters = rng.random() < 0.5, int(rng.integers(4))
    matrix = _rotation(rng) if rng.random() < 0.5 else None

    def turn(image: FloatImage) -> FloatImage:
        image = image[..., ::-1] if flip else image
        return np.ascontiguousarray(np.rot90(image, quarters, (1, 2)))

    layers = {name: turn(layer) for name, layer in example.noisy.layers.items()}
    if matrix is not None and "normal" in layers:
        normal = layers["normal"]
        layers["normal"] = (matrix @ normal.reshape(3, -1)).reshape(normal.shape)
    noisy = replace(example.noisy, colour=turn(example.noisy.colour), layers=layers)
    return Example(noisy, turn(example.target), turn(example.deviation))


def recoloured(example: Example, rng: np.random.Generator) -> Example:
    """Another exposure, coloured light, channels in another order, paler or tinted textures."""
    order = rng.permutation(3) if rng.random() < 0.5 else np.arange(3)
    gain = np.exp2(rng.uniform(-STOPS, STOPS)) * np.exp(rng.normal(0, TINT, 3))
    layers = dict(example.noisy.layers)
    if "albedo" in layers:
        albedo = layers["albedo"][order]
        if rng.random() < 0.5:
            paint = rng.uniform(0.3, 1.0, 3)
            gain = gain * paint
            albedo = albedo * paint.astype(np.float32)[:, None, None]
            if "albedo_std" in layers:
                layers["albedo_std"] = layers["albedo_std"] * np.float32(paint.mean())
        layers["albedo"] = albedo
    scale = gain.astype(np.float32)[:, None, None]
    mean = np.float32(gain.mean())
    if "colour_std" in layers:
        layers["colour_std"] = layers["colour_std"] * mean
    if "depth" in layers:  # the median depth of a whole frame is not that of its crops
        shift = np.float32(rng.normal(0, 0.1))
        depth = layers["depth"]
        layers["depth"] = np.where(depth >= 1, depth, np.clip(depth + shift, -1, 1))
    noisy = replace(example.noisy, colour=example.noisy.colour[order] * scale, layers=layers)
    return Example(noisy, example.target[order] * scale, example.deviation * mean)


def without_some(example: Example, rng: np.random.Generator) -> Example:
    """Some layers dropped, so that one network serves every subset of them.

    `ALL`, `PLAIN`, `COLOUR`; the rest lose each mask's layers by chance.
    """
    kind = rng.random()
    if kind < ALL:
        keep = set(MASKS)
    elif kind < ALL + PLAIN:
        keep = {"albedo", "normal"}
    elif kind < ALL + PLAIN + COLOUR:
        keep = set()
    else:
        keep = {name for name in MASKS if rng.random() < 0.6}
    names = {layer for mask in keep for layer in MASKS[mask]}
    layers = {name: layer for name, layer in example.noisy.layers.items() if name in names}
    for guide in ("albedo", "normal", "depth"):
        if guide not in layers:
            layers.pop(f"{guide}_std", None)
    spp = None if rng.random() < UNTOLD else example.noisy.spp
    return replace(example, noisy=replace(example.noisy, layers=layers, spp=spp))


def filtered(example: Example, rng: np.random.Generator) -> Example:
    """As written by a renderer that splats samples under a tent, Gaussian or Mitchell filter.

    Such files come without per-pixel variance.
    """
    kind = FILTERS[int(rng.integers(len(FILTERS)))]
    noisy = example.noisy
    names = [name for name in noisy.layers if not name.endswith("_std")]
    stack = np.concatenate([noisy.colour, *(noisy.layers[name] for name in names)])
    stack = splatted(stack, noisy.spp or 1, kind, rng)
    layers, at = {}, 3
    for name in names:
        count = noisy.layers[name].shape[0]
        layers[name] = stack[at : at + count]
        at += count
    target = expected(np.concatenate([example.target, example.deviation]), kind)
    return Example(
        replace(noisy, colour=stack[:3], layers=layers), target[:3], np.maximum(target[3:], 0)
    )


def _sum(images):  # type: ignore[no-untyped-def]
    total = None
    for image in images:
        total = image if total is None else total + image
    return total


def _rotation(rng: np.random.Generator) -> FloatImage:
    """A random orthogonal 3x3 matrix (mirrors among them), uniform."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    return (q * np.sign(np.diag(r))).astype(np.float32)
