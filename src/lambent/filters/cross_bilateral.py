"""Cross (joint) bilateral filter on the features of a frame.

Eisemann and Durand, "Flash photography enhancement via intrinsic relighting", 2004; Petschnigg et
al., "Digital photography with flash and no-flash image pairs", 2004: the range weight is taken from
another, cleaner image than the one that is filtered. Here that image is the stack of features:

    w_pq ∝ exp(-|p - q|² / 2σ_d²) · Π_f exp(-d_f² / 2σ_f²)

Where we depart: features have noise of their own (depth of field, motion, soft edges). Where the
frame tells their variance v, what noise alone would give is taken off the distance, as Rousselle,
Manzi and Zwicker 2013 do (numerator of their feature distance):

    d_f² = max(0, (f_p - f_q)² - (v_p + min(v_p, v_q)))

``sigma_colour`` adds the log colour as one more feature (None: the noisy colour is not looked at).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lambent.device import Device
from lambent.filters.bilateral import gaussian_weight, log_gaussian
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.features import MARGIN, Scales, features, fit_scales
from lambent.filters.log_colour import log_colour
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage


@dataclass(frozen=True)
class CrossBilateral(Denoiser):
    """Bilateral weights from features; each σ in the units of `lambent.filters.features`."""

    radius: int = 5
    sigma_spatial: float = 3.0
    sigma_albedo: float = 0.1
    sigma_normal: float = 0.25
    sigma_depth: float = 0.08
    sigma_position: float = 0.03
    sigma_roughness: float = 0.2
    sigma_colour: float | None = None
    device: Device = "auto"
    _scales: Scales | None = None
    _exposure: float | None = None

    about: ClassVar[About] = About(
        name="cross-bilateral",
        title="Cross-bilateral filter",
        paper="Eisemann and Durand 2004; Petschnigg et al. 2004",
        needs=("colour", "albedo|diffuse_albedo|specular_albedo|normal|depth|position|roughness"),
        uses=("albedo.variance", "normal.variance", "depth.variance", "position.variance"),
        cost="(2·radius + 1)² taps a pixel",
        when="for a quick look at 1 to 8 spp; washes out shadows, which no feature shows",
    )

    def margin(self) -> int:
        """The window's radius, and what the variance of features looks at."""
        return self.radius + MARGIN

    def fitted(self, frame: Frame) -> CrossBilateral:
        """With the feature scales and the exposure of the whole frame."""
        return dataclasses.replace(
            self, _scales=fit_scales(frame), _exposure=auto_exposure(frame.colour)
        )

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Cross-bilateral mean of ``targets`` ``(H, W, C)``, weights from the features."""
        from lambent.kernels.window import weighted_window

        found = features(frame, scales=self._scales)
        scale = found.per_sigma(
            math.sqrt(2),
            albedo=self.sigma_albedo, normal=self.sigma_normal, depth=self.sigma_depth,
            position=self.sigma_position, roughness=self.sigma_roughness,
        )  # fmt: skip
        guide = found.stack * scale
        weight = gaussian_weight
        if self.sigma_colour is not None:
            exposure = auto_exposure(frame.colour) if self._exposure is None else self._exposure
            colour = log_colour(frame.colour, exposure)
            colour *= np.float32(1 / (math.sqrt(2) * self.sigma_colour))
            guide = np.concatenate([guide, colour], axis=2)
        if found.variance is not None:
            spread = found.variance * scale**2
            if self.sigma_colour is not None:
                spread = np.concatenate([spread, np.zeros_like(colour)], axis=2)
            guide = np.concatenate([guide, spread], axis=2)
            weight = discounted_weight
        if not found.valid.all():
            guide[~found.valid] = np.nan  # takes no part
        return weighted_window(
            targets,
            guide,
            self.radius,
            weight,
            spatial=log_gaussian(self.radius, self.sigma_spatial),
            device=self.device,
        )


def discounted_weight(p: list[Any], q: list[Any], k: list[Any], s: Any) -> Any:
    """exp(s - Σ_f d_f²); the guide holds features, then as many variances, both scaled."""
    import drjit as dr

    from lambent.kernels.exponential import exp_weight
    from lambent.kernels.extremes import greater, smaller

    count = len(p) // 2
    exponent = s
    for f in range(count):
        step = p[f] - q[f]
        noise = p[count + f] + smaller(p[count + f], q[count + f])
        exponent -= greater(dr.fma(step, step, -noise), 0.0)
    return exp_weight(exponent)
