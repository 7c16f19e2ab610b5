"""One item of a data set: a crop with its noise levels and its target, or a clip of such."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lambent.frame.frame import Frame


@dataclass(frozen=True)
class Still:
    """One picture: independent renders of rising spp, and the low-noise target.

    Every frame has colour, its variance and half buffers, the features and their variances, and
    the lighting layers; the target's variance is that of its own mean.
    """

    levels: tuple[Frame, ...]
    target: Frame


@dataclass(frozen=True)
class Item:
    """A crop (one still) or a clip (several, in time order, each with motion to the one before).

    ``about`` is what the file says of itself: source, scene, camera, window, spp, density.
    """

    stills: tuple[Still, ...]
    about: Mapping[str, Any]

    @property
    def levels(self) -> tuple[Frame, ...]:
        """The noise levels of the (first) still."""
        return self.stills[0].levels

    @property
    def target(self) -> Frame:
        """The target of the (first) still."""
        return self.stills[0].target

    @property
    def is_clip(self) -> bool:
        """Whether there is more than one still."""
        return len(self.stills) > 1
