"""Data that a network never learns from, and how it is judged on them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from lambent.dataset.reader import open_dataset
from lambent.errors import OptionError
from lambent.filters.denoiser import create
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.learn.cache import Cached
from lambent.learn.rows import Example
from lambent.metrics.relmse import TRIM, relmse
from lambent.metrics.smape import smape


def parted(stills: Sequence[Cached], share: float) -> tuple[list[Cached], list[Cached]]:
    """Those to learn from, and those held out. Raises `OptionError` for too few scenes."""
    held = [s for s in stills if is_held_out(s.scene, share)]
    kept = [s for s in stills if not is_held_out(s.scene, share)]
    if not kept or (share and not held):
        raise OptionError(
            f"{len(stills)} stills are too few to hold some scenes out",
            remedy="make more data, or set held_out = 0",
        )
    return kept, held


def is_held_out(scene: str, share: float) -> bool:
    """By the scene's name, so that no scene is on both sides, whatever else is in the data."""
    digest = hashlib.sha256(scene.encode()).digest()
    return int.from_bytes(digest[:4], "big") / 2**32 < share


def spread(held: Sequence[Cached], most: int, lobes: bool = False) -> list[tuple[Example, float]]:
    """Up to ``most`` held-out levels, evenly over log2(spp), the same each time."""
    bins: dict[int, list[tuple[Cached, int]]] = {}
    for still in held:
        for k, spp in enumerate(still.spp):
            bins.setdefault(int(np.log2(max(spp, 1))), []).append((still, k))
    found = []
    share = max(1, most // max(1, len(bins)))
    for spp in sorted(bins):
        entries = bins[spp]
        for i in np.linspace(0, len(entries) - 1, min(share, len(entries))).round().astype(int):
            still, k = entries[int(i)]
            levels, target, deviation = still.load(lobes)
            found.append((Example(levels[k], target, deviation), float(still.spp[k])))
    return found


def errors_of(x: FloatImage, example: Example) -> tuple[float, float]:
    """Trimmed relMSE less the target's own noise, and SMAPE, at the target's exposure."""
    image, target = x.transpose(1, 2, 0), example.target[:3].transpose(1, 2, 0)
    variance = np.repeat(example.deviation[0, :, :, None] ** 2, 3, axis=2)
    return relmse(image, target, TRIM, reference_variance=variance), smape(image, target)


def by_oidn(example: Example, guides: Sequence[str]) -> FloatImage:
    """What OIDN High makes of an example ``(3, H, W)`` with those of its layers: the yardstick."""
    layers = example.noisy.layers
    given: dict[str, Any] = {
        name: np.ascontiguousarray(layers[name].transpose(1, 2, 0))
        for name in guides
        if name in layers
    }
    image = np.ascontiguousarray(example.noisy.colour.transpose(1, 2, 0))
    frame = Frame.from_arrays(colour=image, **given)
    return create("oidn")(frame, "beauty").colour.transpose(2, 0, 1)


def about_sets(folders: Iterable[str]) -> list[dict[str, Any]]:
    """For a card: what each data set is, how much of it there is, made of what."""
    found = []
    for folder in folders:
        data = open_dataset(folder)
        found.append(
            {
                "name": data.recipe.name,
                "crops": len(data.crops),
                "clips": len(data.clips),
                "scenes": len({data.line(i).get("seed") for i in range(len(data))}),
                "licences": data.manifest.get("licences", {}),
                "essence": data.recipe.essence,
            }
        )
    return found
