"""What is known of every pixel after some samples: counts, means, spreads, half buffers.

`Moments` of different samples of the same picture add up, exactly as if all had been taken at once
(Chan, Golub and LeVeque, "Updating formulae and a pairwise algorithm for computing sample
variances", 1979), so that a render can be stopped, kept, and gone on with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import Role, Space, Stat
from lambent.metrics.relmse import expected_relmse
from lambent.render.channels import Group


@dataclass(frozen=True, eq=False)
class Moments:
    """Statistics of the samples of a picture; ``groups`` names the channels, colour first.

    ``spp``: samples asked for; ``count`` ``(H, W)``: those that were finite; ``mean``, ``spread``
    ``(H, W, C)``: mean and sum of squared deviations; ``half_a``, ``half_b`` ``(H, W, 3)``:
    mean colour of the samples with even and with odd numbers, ``half_count`` how many are even;
    ``dropped``: samples whose radiance was not
    finite, which take no part. All float32.
    """

    groups: tuple[Group, ...]
    spp: int
    count: FloatImage
    mean: FloatImage
    spread: FloatImage
    half_a: FloatImage
    half_b: FloatImage
    half_count: FloatImage
    dropped: int = 0

    def __add__(self, other: Moments) -> Moments:
        """Both sets of samples together; they must be of the same picture and channels."""
        if [g.name for g in self.groups] != [g.name for g in other.groups]:
            raise ValueError("moments of different channels cannot be added")
        if self.mean.shape != other.mean.shape:
            raise ValueError(f"sizes differ: {self.mean.shape} and {other.mean.shape}")
        count = self.count + other.count
        share = _ratio(other.count, count)[:, :, None]
        apart = other.mean - self.mean
        half_count = self.half_count + other.half_count
        odd, more_odd = self.count - self.half_count, other.count - other.half_count
        share_a = _ratio(other.half_count, half_count)[:, :, None]
        share_b = _ratio(more_odd, odd + more_odd)[:, :, None]
        return Moments(
            self.groups,
            self.spp + other.spp,
            count,
            self.mean + apart * share,
            self.spread + other.spread + apart * apart * (share * self.count[:, :, None]),
            self.half_a + (other.half_a - self.half_a) * share_a,
            self.half_b + (other.half_b - self.half_b) * share_b,
            half_count,
            self.dropped + other.dropped,
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return int(self.mean.shape[1]), int(self.mean.shape[0])

    def at(self, name: str) -> slice:
        """The channels of a group in `mean` and `spread`. Raises `KeyError`."""
        start = 0
        for group in self.groups:
            if group.name == name:
                return slice(start, start + group.channels)
            start += group.channels
        raise KeyError(name)

    def variance(self) -> FloatImage:
        """Unbiased variance of the mean ``(H, W, C)``; 0 where there is one sample only."""
        freedom = np.maximum(self.count - 1, 1) * np.maximum(self.count, 1)
        result: FloatImage = self.spread / freedom[:, :, None]
        return result

    def error(self) -> float:
        """The expected relMSE of the colour, from its variance."""
        colour = self.at("colour")
        return expected_relmse(self.mean[:, :, colour], self.variance()[:, :, colour])

    def frame(self, *, variance: bool = True, halves: bool = True, **fields: Any) -> Frame:
        """A `Frame`: every group a layer, with its variance, and two half buffers.

        One sample has neither: a variance of 0 would tell filters that there is no noise.
        """
        layers = []
        spread = self.variance() if variance and self.spp >= 2 else None
        for group in self.groups:
            at = self.at(group.name)
            layers.append(_layer(group, self.mean[:, :, at], Stat.MEAN))
            if spread is not None:
                layers.append(_layer(group, spread[:, :, at], Stat.VARIANCE))
        if halves and self.spp >= 2:
            layers.append(Layer(Role.COLOUR, self.half_a, stat=Stat.HALF_A))
            layers.append(Layer(Role.COLOUR, self.half_b, stat=Stat.HALF_B))
        made = Frame.from_layers(layers, spp=self.spp, dialect="generic", **fields)
        if self.dropped:
            made = made.noted(
                f"{self.dropped} samples had a radiance that is not finite; they were left out."
            )
        return made


def _ratio(part: NDArray[Any], whole: NDArray[Any]) -> FloatImage:
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)


def _layer(group: Group, image: FloatImage, stat: Stat) -> Layer:
    spaces = {Role.NORMAL: Space.WORLD, Role.POSITION: Space.WORLD}
    name = group.name if stat is Stat.MEAN else f"{group.name}_variance"
    space = spaces.get(group.role)
    if group.role in (Role.LIGHTING, Role.OTHER):
        role = group.role if stat is Stat.MEAN else Role.OTHER
        return Layer(role, image, name=name, space=space)
    return Layer(group.role, image, stat=stat, space=space)
