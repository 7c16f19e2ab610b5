"""The box filter: the plain mean over a window.

The simplest case of the generic filter ĉ_p = Σ_q w_pq c_q with w_pq = 1/n for all n pixels q of the
window around p. It is the floor that every other filter has to beat: variance falls by n, and every
edge is washed out. At the border of the image the window is cut, n is smaller.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lambent.device import Device
from lambent.filters.denoiser import About, Denoiser
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage


@dataclass(frozen=True)
class Box(Denoiser):
    """Mean over ``2·radius + 1`` pixels a side."""

    radius: int = 2
    device: Device = "auto"

    about: ClassVar[About] = About(
        name="box",
        title="Box filter",
        paper="(textbook)",
        cost="2·(2·radius + 1) additions a pixel and channel",
        when="never for a result; as the floor of a comparison",
        group="floor",
    )

    def margin(self) -> int:
        """The window's radius."""
        return self.radius

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Mean of ``targets`` ``(H, W, C)`` over the window."""
        from lambent.kernels.separable import separable_mean

        return separable_mean(targets, [1.0] * (2 * self.radius + 1), device=self.device)
