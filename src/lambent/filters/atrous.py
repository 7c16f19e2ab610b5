"""Edge-avoiding à-trous wavelet filter, as the paper has it.

Dammertz, Sewtz, Hanika and Lensch, "Edge-avoiding à-trous wavelet transform for fast global
illumination filtering", HPG 2010. Five levels of a 5x5 B3 spline with holes, each tap weighted by
edge-stopping functions of colour, normal and position,

    w = exp(−|c_p − c_q|²/σ_c²) · exp(−|n_p − n_q|²/(s² σ_n²)) · exp(−|x_p − x_q|²/σ_x²)

with s the step of the level, and σ_c halved on every level: as the image gets smoother, so must its
edges be sharper to count. The structure is that of the shader in the paper's appendix, known here
from transcriptions of it. The paper leaves the widths to its reader, as far as those tell: ours are
σ_n² = 0.01 and σ_c² = 3.3 after a public demonstration (LWJGL's ray tracing tutorial), and σ_x is
our own choice.

Radiance has no unit, and neither has position: colour is compared at the automatic exposure, the
position in units of the scene's extent. Depth stands in where a frame has no position.
``demodulate`` divides by the albedo first and multiplies afterwards, so that texture is kept; then
the weights of a pixel no longer sum to one, and layers that are no surface light (emission,
background) are better left out. Off unless asked for.
`lambent.filters.atrous_tuned` compares ratios of radiance and more features.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lambent.device import Device
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.features import MARGIN, Scales, features, fit_scales
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role

#: Added to an albedo before a division: black surfaces keep their light.
_LEAST_ALBEDO = 0.01


@dataclass(frozen=True)
class ATrous(Denoiser):
    """σ of exposed radiance on the first level, of normals and of position over the extent.

    ``sigma_depth``: of log depth, where there is no position.
    """

    levels: int = 5
    sigma_colour: float = 1.8
    sigma_normal: float = 0.1
    sigma_position: float = 0.05
    sigma_depth: float = 0.1
    demodulate: bool = False
    device: Device = "auto"
    _scales: Scales | None = None
    _exposure: float | None = None

    about: ClassVar[About] = About(
        name="atrous",
        title="Edge-avoiding à-trous wavelet",
        paper="Dammertz et al. 2010",
        uses=("normal", "position", "depth"),
        cost="25 taps a pixel and level",
        when="the paper's form, for comparison; for previews atrous-tuned",
    )

    def margin(self) -> int:
        """2·(1 + 2 + 4 + …) pixels, and what the variance of features looks at."""
        return 2 * (2**self.levels - 1) + MARGIN

    def fitted(self, frame: Frame) -> ATrous:
        """With the feature scales and the exposure of the whole frame."""
        return dataclasses.replace(
            self, _scales=fit_scales(frame), _exposure=auto_exposure(frame.colour)
        )

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """À-trous mean of ``targets`` ``(H, W, C)``, weights from colour and features."""
        from lambent.kernels.atrous import atrous

        guide, stops, noise = self._guides(frame)
        albedo = self._albedo(frame)
        if albedo is None:
            return atrous(targets, guide, stops, self._factors(stops), noise, self.device)
        # every three channels are one colour; a lone channel (alpha, depth) has no albedo
        shared = albedo.mean(axis=2, keepdims=True)
        whole = targets.shape[2] // 3 * 3
        factor = np.concatenate(
            [np.tile(albedo, (1, 1, whole // 3)), *[shared] * (targets.shape[2] - whole)], axis=2
        )
        level = self._factors(stops)
        return atrous(targets / factor, guide, stops, level, noise, self.device) * factor

    def weights_at(self, frame: Frame, x: int, y: int) -> FloatImage:
        """The weights ``(H, W)`` of all pixels of a frame in the result at (x, y), exactly."""
        from lambent.kernels.atrous import atrous_row

        guide, stops, noise = self._guides(frame)
        row = atrous_row(guide, stops, self._factors(stops), x, y, noise, self.device)
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

    def _factors(self, stops: FloatImage | None) -> list[tuple[float, float | Sequence[float]]]:
        """1/σ_c² of each level; of the features the normal's three channels, first, by 1/s²."""
        others = 0 if stops is None else max(0, stops.shape[2] - 3)
        return [
            (4.0**level / self.sigma_colour**2, (*[4.0**-level] * 3, *[1.0] * others))
            for level in range(self.levels)
        ]

    def _guides(self, frame: Frame) -> tuple[FloatImage, FloatImage | None, FloatImage | None]:
        """What is filtered along, the features over their σ, and the variance of these."""
        exposure = auto_exposure(frame.colour) if self._exposure is None else self._exposure
        guide = frame.colour * np.float32(exposure)
        place = Role.POSITION if frame.has(Role.POSITION) else Role.DEPTH
        roles = [role for role in (Role.NORMAL, place) if frame.has(role)]
        if not roles:
            return guide, None, None
        found = features(frame, roles, self._scales)
        stops = found.stack * found.per_sigma(
            normal=self.sigma_normal, position=self.sigma_position, depth=self.sigma_depth
        )
        if Role.NORMAL not in roles:  # its place stays: the factors go by position
            nothing = np.zeros((*stops.shape[:2], 3), np.float32)
            stops = np.concatenate([nothing, stops], axis=2)
        if not found.valid.all():
            stops[~found.valid] = np.nan  # takes no part
        return guide, stops, None
