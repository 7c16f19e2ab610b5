"""The Gaussian filter: w_pq ∝ exp(-|p - q|² / 2σ²), cut at ``radius`` pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from lambent.device import Device
from lambent.filters.denoiser import About, Denoiser
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage


@dataclass(frozen=True)
class Gaussian(Denoiser):
    """Gaussian of ``sigma`` pixels over a window of ``2·radius + 1`` pixels a side."""

    sigma: float = 1.5
    radius: int = 5
    device: Device = "auto"

    about: ClassVar[About] = About(
        name="gaussian",
        title="Gaussian filter",
        paper="(textbook)",
        cost="2·(2·radius + 1) additions a pixel and channel",
        when="never for a result; shows what a filter blind to edges does",
        group="floor",
    )

    def margin(self) -> int:
        """The window's radius."""
        return self.radius

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Gaussian mean of ``targets`` ``(H, W, C)``."""
        from lambent.kernels.separable import separable_mean

        taps = [
            math.exp(-(step**2) / (2 * self.sigma**2))
            for step in range(-self.radius, self.radius + 1)
        ]
        return separable_mean(targets, taps, device=self.device)
