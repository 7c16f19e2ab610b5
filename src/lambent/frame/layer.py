"""One layer of a render: an image with a meaning."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError
from lambent.frame.role import INFO, Role, Space, Stat

FloatImage = NDArray[np.float32]


@dataclass(frozen=True)
class Source:
    """Where in its file a layer comes from: the part's index and the channels, in order."""

    part: int
    channels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Layer:
    """A float32 image ``(H, W, C)`` with its role, its name in the file, and its space.

    ``pixels`` is the array, or a function that makes it: a layer that nobody looks at is never
    decoded. ``why`` says how the role was found ("Cycles: pass 'Denoising Albedo'").
    Raises `LayerError` from `data` when the channel count does not suit the role.
    """

    role: Role
    pixels: NDArray[Any] | Callable[[], NDArray[Any]] = field(repr=False)
    stat: Stat = Stat.MEAN
    name: str = ""
    space: Space | None = None
    source: Source | None = None
    why: str = ""
    _decoded: list[FloatImage] = field(default_factory=list, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.space is None:
            object.__setattr__(self, "space", INFO[self.role].space)
        if not self.name:
            suffix = "" if self.stat is Stat.MEAN else f".{self.stat.value}"
            object.__setattr__(self, "name", self.role.value + suffix)

    @property
    def data(self) -> FloatImage:
        """The pixels, float32 ``(H, W, C)``, C-contiguous, read-only. Decoded once."""
        if not self._decoded:
            raw = self.pixels() if callable(self.pixels) else self.pixels
            image = np.asarray(raw)
            if image.ndim == 2:
                image = image[:, :, None]
            if image.ndim != 3:
                raise LayerError(
                    f"an image has shape (H, W, C), this has {image.shape}", layer=self.name
                )
            allowed = INFO[self.role].channels
            if allowed and image.shape[2] not in allowed:
                raise LayerError(
                    f"{INFO[self.role].title} has {' or '.join(map(str, allowed))} channels, "
                    f"this has {image.shape[2]}",
                    layer=self.name,
                    remedy=f"map another layer: --map {self.role.value}=NAME",
                )
            image = np.ascontiguousarray(image, dtype=np.float32).view()
            image.flags.writeable = False
            self._decoded.append(image)
        return self._decoded[0]

    @property
    def key(self) -> tuple[Role, Stat]:
        """Role and statistic: what a frame finds the layer by."""
        return self.role, self.stat

    def with_data(self, data: NDArray[Any]) -> Layer:
        """The same layer with other pixels."""
        return dataclasses.replace(self, pixels=data, _decoded=[])
