"""Lighting layers that add up to the beauty: finding them, and keeping the sum.

A linear filter keeps every such sum by itself. For one that is not linear (OIDN) the sums of
the input are found here by looking at the pixels, not at names: direct + indirect, diffuse +
specular, light groups, whatever a renderer wrote. Layers may enter with a factor image: Cycles
writes light divided by the surface's colour, so that its beauty is Σ colour·(direct + indirect) +
emission + environment. A layer may subtract.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.repair import NEGATIVE_SHARE
from lambent.frame.role import Role, Space

#: A sum is one where it misses the beauty by less than this share of it: halves of beauty, layer
#: and factor round by 2^-11 each.
RELATIVE = 3e-3
#: ... or by this share of the mean beauty, for dark pixels.
ABSOLUTE = 1e-4
#: This share of the pixels must fit (renderers clamp and composite single pixels).
FITTING = 0.999

_SAMPLES = 256
_MOST_STEPS = 20_000
_MOST_SUMS = 8

#: Ends of Cycles' layer names: light, and the colour it was divided by (new names, then old).
CYCLES = ((" Direct", " Color"), (" Indirect", " Color"), ("Dir", "Col"), ("Ind", "Col"))


@dataclass(frozen=True, eq=False)
class Term:
    """One summand: a layer by index, times a factor image ``(H, W, 3)`` or nothing.

    ``signed``: the layer has negative light, and what settles its sums may be negative.
    """

    layer: int
    factor: FloatImage | None = None
    signed: bool = False

    def of(self, images: Sequence[FloatImage]) -> FloatImage:
        """The value of the summand with these images as the layers."""
        image = images[self.layer]
        return image if self.factor is None else image * self.factor


def terms(layers: Sequence[Layer], all_layers: Iterable[Layer]) -> list[Term]:
    """The summands that layers of radiance can be; ``all_layers`` may hold their factors."""
    by_name = {layer.name.lower(): layer for layer in all_layers}
    found = []
    for index, layer in enumerate(layers):
        factor = None
        for light, colour in CYCLES:
            if layer.name.endswith(light):
                partner = by_name.get((layer.name[: -len(light)] + colour).lower())
                if partner is not None and partner.data.shape == layer.data.shape:
                    factor = partner.data
        found.append(Term(index, factor, has_negative_light(layer.data)))
    return found


def has_negative_light(image: FloatImage) -> bool:
    """Whether an image is negative by more than a thousandth of its mean absolute value."""
    low = float(image.min(initial=0))
    return low < 0 and low < -NEGATIVE_SHARE * float(np.abs(image).mean(dtype=np.float64))


def find_sums(
    beauty: FloatImage, images: Sequence[FloatImage], summands: Sequence[Term]
) -> list[tuple[Term, ...]]:
    """Every set of summands (two or more) whose sum is the beauty ``(H, W, C)``.

    Looked for at some hundred pixels with a bounded search, then checked at all of them.
    Layers without any light belong to no sum.
    """
    summands = [t for t in summands if images[t.layer].shape == beauty.shape]
    values = [t.of(images) for t in summands]
    where = _samples([beauty, *values])
    at = [v.reshape(-1, v.shape[2])[where].astype(np.float64) for v in values]
    lit = [i for i in range(len(at)) if at[i].any()]
    lit.sort(key=lambda i: -float(np.abs(at[i]).sum()))
    goal = beauty.reshape(-1, beauty.shape[2])[where].astype(np.float64)
    slack = _slack(goal, float(np.abs(beauty).mean(dtype=np.float64)))
    sums = []
    for chosen in _subsets([at[i] for i in lit], goal, slack):
        members = [lit[i] for i in chosen]
        if len(members) > 1 and _fits(beauty, [values[i] for i in members]):
            sums.append(tuple(summands[i] for i in sorted(members)))
    return sums


class FrameSums:
    """The sums among the layers of a frame, looked for once and kept while tiles are filtered."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self._sums: dict[tuple[str, ...], list[tuple[Term, ...]]] = {}

    def among(self, piece: Frame, parts: Sequence[Layer]) -> list[tuple[Term, ...]]:
        """The sums of ``parts[1:]`` that give ``parts[0]``, their factors cut as ``piece`` is.

        ``piece``: the frame itself or a tile of it, ``parts``: layers of that piece. Layers that
        the frame does not have are judged by the piece alone.
        """
        names = tuple(layer.name for layer in parts)
        if names not in self._sums:
            by_name = {layer.name: layer for layer in self._frame.all_layers()}
            if not all(name in by_name for name in names):
                return _sums_of(piece, parts)
            self._sums[names] = _sums_of(self._frame, [by_name[name] for name in names])
        own = {t.layer: t for t in terms(parts[1:], piece.all_layers())}
        return [
            tuple(dataclasses.replace(own[t.layer], signed=t.signed) for t in members)
            for members in self._sums[names]
        ]


def lighting_among(layers: Sequence[Layer]) -> list[int]:
    """Indices of the lighting layers in a list that begins with the beauty and may hold alpha."""
    return [i for i, layer in enumerate(layers) if i and layer.role is not Role.ALPHA]


def keep_sums(
    beauty: FloatImage, images: Sequence[FloatImage], sums: Sequence[tuple[Term, ...]]
) -> list[FloatImage]:
    """The images, changed so that each of ``sums`` gives ``beauty`` again, to float rounding.

    What is missing is shared out in proportion to the layers' absolute values, which is one factor
    for all of a sum's layers in a pixel where none is negative; then nothing becomes negative.
    Where all of them are 0, it goes in equal parts to the summands without a factor (with none
    such, the pixel stays as it is). A layer of several sums is settled by the first of them that
    asks.
    """
    result = list(images)
    settled: set[int] = set()
    for members in sums:
        free = [t for t in members if t.layer not in settled]
        if not free:
            continue
        rest = beauty
        for term in members:
            if term.layer in settled:
                rest = rest - term.of(result)
        if not any(t.signed for t in members):
            rest = np.maximum(rest, 0)
        values = [t.of(result) for t in free]
        total = sum(values[1:], start=values[0])
        size = sum((np.abs(v) for v in values[1:]), start=np.abs(values[0]))
        tiny = np.finfo(np.float32).tiny
        dark = size <= tiny
        missing = ((rest - total) / np.maximum(size, tiny)).astype(np.float32)
        ratio = (rest / np.maximum(size, tiny)).astype(np.float32)
        mixed = total < size  # or the sum of all is `size`, and a ratio rounds better
        plain = sum(t.factor is None for t in free)
        for term, value in zip(free, values, strict=True):
            change = np.where(mixed, 1 + missing * np.sign(value), ratio)
            image = result[term.layer] * np.where(dark, np.float32(0), change)
            if term.factor is None:
                image = np.where(dark, rest / np.float32(plain), image)
            result[term.layer] = image
            settled.add(term.layer)
    return result


# ------------------------------------------------------------------- private


def _sums_of(frame: Frame, layers: Sequence[Layer]) -> list[tuple[Term, ...]]:
    """The sums among ``layers[1:]`` that give ``layers[0]``, all of linear radiance."""
    lighting = layers[1:]
    summands = [
        t
        for t in terms(lighting, frame.all_layers())
        if lighting[t.layer].space is not Space.SRGB and layers[0].space is not Space.SRGB
    ]
    return find_sums(layers[0].data, [layer.data for layer in lighting], summands)


def _samples(images: Sequence[FloatImage]) -> NDArray[np.intp]:
    """Indices of pixels spread over the picture, and of each image's brightest and darkest."""
    pixels = images[0].shape[0] * images[0].shape[1]
    spread = np.linspace(0, pixels - 1, min(pixels, _SAMPLES)).astype(np.intp)
    ends = [int(end) // im.shape[2] for im in images for end in (im.argmax(), im.argmin())]
    return np.unique(np.concatenate([spread, np.array(ends, np.intp)]))


def _slack(goal: NDArray[np.float64], mean: float) -> NDArray[np.float64]:
    return RELATIVE * np.abs(goal) + ABSOLUTE * abs(mean)


def _fits(beauty: FloatImage, values: Sequence[FloatImage]) -> bool:
    miss = -beauty  # in float32: its rounding is far below the slack
    for value in values:
        miss += value
    np.abs(miss, out=miss)
    miss -= np.float32(RELATIVE) * np.abs(beauty)
    limit = np.float32(ABSOLUTE * float(np.abs(beauty).mean(dtype=np.float64)))
    return bool(np.count_nonzero(miss <= limit) >= FITTING * miss.size)


def _subsets(
    parts: Sequence[NDArray[np.float64]],
    goal: NDArray[np.float64],
    slack: NDArray[np.float64],
) -> list[list[int]]:
    """Sets of ``parts`` that add up to ``goal``, by depth-first search.

    A branch ends where a pixel has too much even with all that subtracts of the rest, or too
    little even with all that adds.
    """
    least, most = [np.zeros_like(goal)], [np.zeros_like(goal)]
    for part in reversed(parts):
        least.append(least[-1] + np.minimum(part, 0))
        most.append(most[-1] + np.maximum(part, 0))
    least.reverse()
    most.reverse()
    found: list[list[int]] = []
    open_ends: list[tuple[int, list[int], NDArray[np.float64]]] = [(0, [], np.zeros_like(goal))]
    for _ in range(_MOST_STEPS):
        if not open_ends or len(found) == _MOST_SUMS:
            break
        depth, chosen, total = open_ends.pop()
        too_much = (total + least[depth] > goal + slack).any()
        if too_much or (total + most[depth] < goal - slack).any():
            continue
        if depth == len(parts):
            found.append(chosen)
            continue
        open_ends.append((depth + 1, chosen, total))
        open_ends.append((depth + 1, [*chosen, depth], total + parts[depth]))
    return found
