"""Edge-avoiding à-trous wavelet with log colour, more features, and their variance.

As `lambent.filters.atrous` (Dammertz et al. 2010), with these changes: colour is compared as log
radiance (`lambent.filters.log_colour`), filtered from level to level with the same weights; albedo
and roughness count too, and position only where there is no depth (depth as in
`lambent.filters.features`, relative); the normal's distance is not divided by the level's step.
Where features tell their variance v, what noise alone would give is taken off their distance:
max(0, (f_p - f_q)² - v_p - v_q), after Rousselle, Manzi and Zwicker 2013.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lambent.filters.atrous import ATrous
from lambent.filters.denoiser import About
from lambent.filters.features import features
from lambent.filters.log_colour import log_colour
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage


@dataclass(frozen=True)
class ATrousTuned(ATrous):
    """σ of log colour on the first level, and of the features of `lambent.filters.features`."""

    sigma_colour: float = 3.0
    sigma_normal: float = 0.35
    sigma_albedo: float = 0.15
    sigma_roughness: float = 0.3

    about: ClassVar[About] = dataclasses.replace(
        ATrous.about,
        name="atrous-tuned",
        title="Edge-avoiding à-trous wavelet, tuned",
        uses=("albedo", "normal", "depth", "position", "roughness", "albedo.variance",
              "normal.variance", "depth.variance"),
        when="previews: wide and fast, but detail is smeared",
        group="work",
    )  # fmt: skip

    def _factors(self, stops: FloatImage | None) -> list[tuple[float, float | Sequence[float]]]:
        """1/σ_c² of each level, 1 for the features, which are divided by their σ already."""
        return [(4.0**level / self.sigma_colour**2, 1.0) for level in range(self.levels)]

    def _guides(self, frame: Frame) -> tuple[FloatImage, FloatImage | None, FloatImage | None]:
        exposure = auto_exposure(frame.colour) if self._exposure is None else self._exposure
        guide = log_colour(frame.colour, exposure)
        found = features(frame, scales=self._scales)
        if not len(found):
            return guide, None, None
        scale = found.per_sigma(
            albedo=self.sigma_albedo, normal=self.sigma_normal, depth=self.sigma_depth,
            position=self.sigma_position, roughness=self.sigma_roughness,
        )  # fmt: skip
        stops = found.stack * scale
        if not found.valid.all():
            stops[~found.valid] = np.nan  # takes no part
        noise = None if found.variance is None else found.variance * scale**2
        return guide, stops, noise
