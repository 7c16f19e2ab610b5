"""Edge-avoiding à-trous wavelet filter.

Dammertz, Sewtz, Hanika and Lensch, "Edge-avoiding à-trous wavelet transform for fast global
illumination filtering", HPG 2010. Five levels of a 5x5 B3 spline with holes, each tap weighted by
edge-stopping functions of colour, normal, position and here also albedo,

    w = exp(-|c_p - c_q|²/σ_c²) · exp(-|n_p - n_q|²/σ_n²) · exp(-|x_p - x_q|²/σ_x²) …

with σ_c halved on every level: as the image gets smoother, so must its edges be sharper
to count.

Where we depart: colour is compared as log radiance (`lambent.filters.log_colour`), filtered from
level to level with the same weights; position is taken where there is no depth (depth as in
`lambent.filters.features`, relative); the normal's distance is not divided by the level's step.
Where features tell their variance v, what noise alone would give is taken off their distance:
max(0, (f_p - f_q)² - v_p - v_q), after Rousselle, Manzi and Zwicker 2013.
``demodulate`` divides by the albedo first and multiplies afterwards, as in the paper's results, so
that texture is kept; then the weights of a pixel no longer sum to one, and layers that are no
surface light (emission, background) are better left out. Off unless asked for.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lambent.filters.denoiser import About, Denoiser, Device
from lambent.filters.features import MARGIN, Scales, features, fit_scales
from lambent.filters.log_colour import fit_exposure, log_colour
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role

#: Added to an albedo before a division: black surfaces keep their light.
_LEAST_ALBEDO = 0.01


@dataclass(frozen=True)
class ATrous(Denoiser):
    """σ of log colour on the first level, and of the features of `lambent.filters.features`."""

    levels: int = 5
    sigma_colour: float = 3.0
    sigma_normal: float = 0.35
    sigma_depth: float = 0.1
    sigma_position: float = 0.05
    sigma_albedo: float = 0.15
    sigma_roughness: float = 0.3
    demodulate: bool = False
    device: Device = "auto"
    _scales: Scales | None = None
    _exposure: float | None = None

    about: ClassVar[About] = About(
        name="atrous",
        title="Edge-avoiding à-trous wavelet",
        paper="Dammertz et al. 2010",
        uses=("albedo", "normal", "depth", "position", "roughness", "albedo.variance",
              "normal.variance", "depth.variance"),
        cost="25 taps a pixel and level",
        when="for previews: wide and fast, at the price of smeared detail",
    )  # fmt: skip

    def margin(self) -> int:
        """2·(1 + 2 + 4 + …) pixels, and what the variance of features looks at."""
        return 2 * (2**self.levels - 1) + MARGIN

    def fitted(self, frame: Frame) -> ATrous:
        """With the feature scales and the exposure of the whole frame."""
        return dataclasses.replace(self, _scales=fit_scales(frame), _exposure=fit_exposure(frame))

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """À-trous mean of ``targets`` ``(H, W, C)``, weights from colour and features."""
        from lambent.kernels.atrous import atrous

        guide, stops, noise = self._guides(frame)
        albedo = self._albedo(frame)
        if albedo is None:
            return atrous(targets, guide, stops, self._factors(), noise, self.device)
        # every three channels are one colour; a lone channel (alpha, depth) has no albedo
        shared = albedo.mean(axis=2, keepdims=True)
        whole = targets.shape[2] // 3 * 3
        factor = np.concatenate(
            [np.tile(albedo, (1, 1, whole // 3)), *[shared] * (targets.shape[2] - whole)], axis=2
        )
        level = self._factors()
        return atrous(targets / factor, guide, stops, level, noise, self.device) * factor

    def weights_at(self, frame: Frame, x: int, y: int) -> FloatImage:
        """The weights ``(H, W)`` of all pixels of a frame in the result at (x, y), exactly."""
        from lambent.kernels.atrous import atrous_row

        guide, stops, noise = self._guides(frame)
        row = atrous_row(guide, stops, self._factors(), x, y, noise, self.device)
        albedo = self._albedo(frame)
        if albedo is None:
            return row
        shared = albedo.mean(axis=2)
        return row * shared[y, x] / shared

    def _albedo(self, frame: Frame) -> FloatImage | None:
        albedo = frame.get(Role.ALBEDO) if self.demodulate else None
        if albedo is None:
            return None
        three = albedo if albedo.shape[2] == 3 else np.repeat(albedo, 3, axis=2)
        return np.nan_to_num(np.maximum(three, 0)) + np.float32(_LEAST_ALBEDO)

    def _factors(self) -> list[tuple[float, float]]:
        """1/σ_c² of each level, 1 for the features, which are divided by their σ already."""
        return [(4.0**level / self.sigma_colour**2, 1.0) for level in range(self.levels)]

    def _guides(self, frame: Frame) -> tuple[FloatImage, FloatImage | None, FloatImage | None]:
        exposure = fit_exposure(frame) if self._exposure is None else self._exposure
        guide = log_colour(frame.colour, exposure)
        found = features(frame, scales=self._scales)
        if not len(found):
            return guide, None, None
        sigmas = {
            "albedo": self.sigma_albedo,
            "diffuse_albedo": self.sigma_albedo,
            "specular_albedo": self.sigma_albedo,
            "normal": self.sigma_normal,
            "depth": self.sigma_depth,
            "position": self.sigma_position,
            "roughness": self.sigma_roughness,
            "miss": 0.25,
        }
        sigma = np.array([sigmas[n.partition(".")[0]] for n in found.names], np.float32)
        stops = found.stack / sigma
        if not found.valid.all():
            stops[~found.valid] = np.nan  # takes no part
        noise = None if found.variance is None else found.variance / sigma**2
        return guide, stops, noise
