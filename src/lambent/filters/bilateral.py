"""Bilateral filter.

Tomasi and Manduchi, "Bilateral filtering for gray and color images", ICCV 1998, the Gaussian case:

    w_pq ∝ exp(-|p - q|² / 2σ_d²) · exp(-|g_p - g_q|² / 2σ_r²)

Where we depart: the range distance is Euclidean on log radiance (`lambent.filters.log_colour`),
not on CIE-Lab of a display image, so σ_r is relative: 0.4 lets values 40 % apart mix well. The
window is cut at ``radius``.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lambent.device import Device
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.log_colour import log_colour
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage


@dataclass(frozen=True)
class Bilateral(Denoiser):
    """σ_d = ``sigma_spatial`` pixels, σ_r = ``sigma_range`` in log radiance (relative)."""

    radius: int = 6
    sigma_spatial: float = 3.0
    sigma_range: float = 0.4
    device: Device = "auto"
    _exposure: float | None = None

    about: ClassVar[About] = About(
        name="bilateral",
        title="Bilateral filter",
        paper="Tomasi and Manduchi 1998",
        cost="(2·radius + 1)² taps a pixel",
        when="for weak noise without features; noise that is stronger than edges stays",
    )

    def margin(self) -> int:
        """The window's radius."""
        return self.radius

    def fitted(self, frame: Frame) -> Bilateral:
        """With the exposure of the whole frame."""
        return dataclasses.replace(self, _exposure=auto_exposure(frame.colour))

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Bilateral mean of ``targets`` ``(H, W, C)``, weights from the frame's colour."""
        from lambent.kernels.window import weighted_window

        exposure = auto_exposure(frame.colour) if self._exposure is None else self._exposure
        guide = log_colour(frame.colour, exposure)
        guide *= np.float32(1 / (math.sqrt(2) * self.sigma_range))
        return weighted_window(
            targets,
            guide,
            self.radius,
            gaussian_weight,
            spatial=log_gaussian(self.radius, self.sigma_spatial),
            device=self.device,
        )


def log_gaussian(radius: int, sigma: float) -> FloatImage:
    """-|p - q|² / 2σ² for each offset ``(2r+1, 2r+1)``, for `weighted_window`."""
    step = np.arange(-radius, radius + 1, dtype=np.float32) ** 2
    return -(step[:, None] + step[None, :]) / np.float32(2 * sigma**2)


def gaussian_weight(p: list[Any], q: list[Any], k: list[Any], s: Any) -> Any:
    """exp(s - |g_p - g_q|²) with a guide that is divided by √2·σ already."""
    import drjit as dr

    from lambent.kernels.exponential import exp_weight

    exponent = s
    for a, b in zip(p, q, strict=True):
        step = a - b
        exponent = dr.fma(-step, step, exponent)
    return exp_weight(exponent)
