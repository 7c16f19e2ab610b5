"""One image of a comparison, with what is known beside its pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lambent.frame.luma import luminance
from lambent.frame.noise_level import grain
from lambent.frame.windows import Windows
from lambent.metrics.pair import FloatArray


@dataclass(frozen=True, eq=False)
class Picture:
    """One image of a comparison.

    ``image``: ``(H, W, 3)`` float32 linear radiance, as read (NaN and all). ``details``: what is
    known beside the pixels ("model", "seconds", …), for tables. ``notes``: remarks of the reader.
    ``windows``: where the pixels lie in the whole picture, None where nobody tells. ``display``:
    whether it was read from display values, which are shown as they are.
    """

    name: str
    image: FloatArray = field(repr=False)
    path: str | None = None
    spp: int | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    windows: Windows | None = None
    display: bool = False

    @property
    def label(self) -> str:
        """What error messages call it."""
        return self.path or f"image '{self.name}'"

    def statistics(self) -> dict[str, float]:
        """Facts about the pixels that need no reference.

        ``mean``, ``median``, ``max`` of the luminance and ``noise``, `frame.noise_level.grain`
        relative to the mean, over pixels that are finite; ``nonfinite``: pixels with NaN or Inf;
        ``negative``: pixels with a negative channel.
        """
        sound = np.isfinite(self.image).all(axis=2)
        y = luminance(self.image)
        values = y[sound]
        nan = float("nan")
        facts = {
            "mean": float(values.mean(dtype=np.float64)) if values.size else nan,
            "median": float(np.median(values)) if values.size else nan,
            "max": float(values.max()) if values.size else nan,
            "noise": nan,
            "nonfinite": float(sound.size - values.size),
            "negative": float((self.image < 0).any(axis=2).sum()),
        }
        if y.shape[1] >= 3 and facts["mean"] > 0:
            facts["noise"] = grain(y) / facts["mean"]
        return facts
