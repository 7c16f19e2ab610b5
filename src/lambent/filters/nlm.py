"""Non-local means, alone and joined with features.

Buades, Coll and Morel, "A non-local algorithm for image denoising", CVPR 2005: pixels are averaged
whose patches look alike. Rousselle, Knaus and Zwicker, "Adaptive rendering with non-local means
filtering", 2012: the distance of patches is compared with what their noise explains,

    Δ²(p, q) = ((u_p - u_q)² - α (v_p + min(v_p, v_q))) / (ε + k² (v_p + v_q))
    w_pq = exp(-max(0, mean of Δ² over the patch and channels))

with the variance v of the pixel means. Rousselle, Manzi and Zwicker, "Robust denoising using
feature and color information", 2013: the weight is the smaller one of colour and features,

    Φ_f² = ((f_p - f_q)² - (v_fp + min(v_fp, v_fq))) / (k_f² max(τ, v_fp, |∇f_p|²))
    w_pq = min(exp(-max(0, mean Δ²)), exp(-max(0, max_f Φ_f²)))

``radius`` and ``patch`` are half-sizes: patch 3 compares 7x7 pixels. Radius 10, patch 3 and
k = 0.45 are what the authors' own code of 2012 runs with ("wnd_rad", "ptc_rad", "k" in its README);
radius 10 is also that of 2013. Radius 5 is four times as fast, and better on some frames. k_f and τ
could not be checked against the paper.

Features are compared in unit range, as there: albedo is, a normal is halved. Depth and position are
relative already (`lambent.filters.features`).

Where we depart:
- Without variance in the frame, u is log radiance (`lambent.filters.log_colour`) with one noise
  level for the whole frame, from the median of diagonal Haar details (`haar_level`).
- With half buffers, a weight found in one half is not applied to the other alone, since lighting
  layers have no halves: the weights found in A and those found in B are averaged, and applied to
  the whole. So all targets still get one set of weights. Each half has twice the variance.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lambent.device import Device
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.features import MARGIN, Features, Scales, features, fit_scales, variance_of
from lambent.filters.log_colour import log_colour
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.noise_level import haar_level
from lambent.frame.role import Role, Stat

_NEEDS_TWO = ("colour.variance", "colour.half_a", "colour.half_b")


@dataclass(frozen=True)
class NonLocalMeans(Denoiser):
    """Search over ``2·radius + 1``, patches of ``2·patch + 1`` pixels a side.

    ``k``: strength, distances are measured in k standard deviations. ``alpha`` in [0, 1]: how much
    of the noise's own part is taken off the distance.
    """

    radius: int = 10
    patch: int = 3
    k: float = 0.45
    alpha: float = 1.0
    device: Device = "auto"
    _exposure: float | None = None
    _noise: float | None = None

    about: ClassVar[About] = About(
        name="nlm",
        title="Non-local means",
        paper="Buades et al. 2005; Rousselle et al. 2012",
        uses=_NEEDS_TWO,
        cost="(2·radius + 1)² taps a pixel, whatever the patch",
        when="where there are no features; best with variance",
    )

    def margin(self) -> int:
        """Search radius and patch, and what a variance from half buffers looks at."""
        return self.radius + self.patch + MARGIN

    def bytes_per_pixel(self, channels: int) -> int:
        """Planes of guide, features, variance and sums, and of four offsets on their way."""
        return 4 * (4 * channels + 80)

    def fitted(self, frame: Frame) -> Denoiser:
        """With exposure and noise level of the whole frame."""
        exposure = auto_exposure(frame.colour)
        noise = haar_level(log_colour(frame.colour, exposure))
        return dataclasses.replace(self, _exposure=exposure, _noise=noise)

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Non-local mean of ``targets`` ``(H, W, C)``, weights from the frame's colour."""
        return self._mean(frame, targets, None, None, ())

    def _mean(
        self, frame: Frame, targets: FloatImage, guide: FloatImage | None, distance: Any, k: Any
    ) -> FloatImage:
        from lambent.kernels.nlm import (
            PatchSearch,
            nlm_mean,
            squared_difference,
            variance_difference,
        )

        joint = None if guide is None else (guide, distance)
        variance = variance_of(frame, Role.COLOUR)
        if variance is None:
            exposure = auto_exposure(frame.colour) if self._exposure is None else self._exposure
            colour = log_colour(frame.colour, exposure)
            noise = haar_level(colour) if self._noise is None else self._noise
            # the formula above with v = noise² everywhere; 1e-4 keeps a clean image as it is
            both = 2 * max(noise, 1e-4) ** 2
            h2 = self.k**2 * both
            uniform = (1 / h2, self.alpha * both / h2)
            search = PatchSearch.of(
                colour,
                None,
                self.radius,
                self.patch,
                squared_difference,
                uniform,
                device=self.device,
            )
            return nlm_mean(targets, search, joint, k)
        guides = [(frame.colour, variance)]
        a, b = frame.get(Role.COLOUR, Stat.HALF_A), frame.get(Role.COLOUR, Stat.HALF_B)
        if a is not None and b is not None:
            guides = [(a, 2 * variance), (b, 2 * variance)]
        parts = []
        for colour, spread in guides:
            numbers = (self.k**2, self.alpha, 1e-10)
            spread = np.ascontiguousarray(np.broadcast_to(spread, colour.shape))
            search = PatchSearch.of(
                colour,
                spread,
                self.radius,
                self.patch,
                variance_difference,
                numbers,
                device=self.device,
            )
            parts.append(nlm_mean(targets, search, joint, k))
        return parts[0] if len(parts) == 1 else (parts[0] + parts[1]) * np.float32(0.5)


@dataclass(frozen=True)
class JointNonLocalMeans(NonLocalMeans):
    """Non-local means whose weights features may lower: the smaller of both decides.

    ``k_feature``: strength of the features; ``tau``: their least variance, in unit range.
    """

    k_feature: float = 0.6
    tau: float = 1e-3
    _scales: Scales | None = None

    about: ClassVar[About] = About(
        name="joint-nlm",
        title="Joint non-local means",
        paper="Rousselle et al. 2013",
        needs=("colour", "albedo|diffuse_albedo|specular_albedo|normal|depth|position|roughness"),
        uses=(*_NEEDS_TWO, "albedo.variance", "normal.variance", "depth.variance"),
        cost="(2·radius + 1)² taps a pixel, whatever the patch",
        when="with features, for soft shadows and textures that must stay",
    )

    def margin(self) -> int:
        """As for the colour; gradients of features need no more."""
        return self.radius + self.patch + MARGIN

    def fitted(self, frame: Frame) -> Denoiser:
        """With exposure, noise level and feature scales of the whole frame."""
        return dataclasses.replace(super().fitted(frame), _scales=fit_scales(frame))  # type: ignore[type-var]

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Joint non-local mean of ``targets`` ``(H, W, C)``."""
        found = features(frame, scales=self._scales)
        distance = feature_distance if found.variance is not None else clean_feature_distance
        return self._mean(frame, targets, self._joint_guide(found), distance, ())

    def _joint_guide(self, found: Features) -> FloatImage:
        """Features, [variances,] and 1/(k_f² max(τ, v, |∇f|²)), one stack of channels."""
        unit = np.ones(len(found), np.float32)
        unit[found.index(Role.NORMAL)] = 0.5  # components in [-1, 1]
        stack = found.stack * unit
        scale = np.maximum(np.float32(self.tau), squared_gradient(stack))
        parts = [stack]
        if found.variance is not None:
            parts.append(found.variance * unit**2)
            scale = np.maximum(scale, parts[1])
        guide = np.concatenate([*parts, 1 / (np.float32(self.k_feature**2) * scale)], axis=2)
        if not found.valid.all():
            guide[~found.valid] = np.nan  # takes no part
        return guide


def squared_gradient(image: FloatImage) -> FloatImage:
    """|∇f|² a channel of ``(H, W, C)``: central differences, one-sided ones at the borders."""
    total = np.zeros_like(image)
    for axis in (0, 1):
        if image.shape[axis] > 1:
            step = np.gradient(image, axis=axis)
            step *= step
            total += step
    return total


def feature_distance(p: list[Any], q: list[Any], k: list[Any]) -> Any:
    """max_f Φ_f², channels: features, variances, 1/denominators (of p)."""
    from lambent.kernels.extremes import greater, smaller

    count = len(p) // 3
    worst = None
    for f in range(count):
        step = p[f] - q[f]
        noise = p[count + f] + smaller(p[count + f], q[count + f])
        term = (step * step - noise) * p[2 * count + f]
        worst = term if worst is None else greater(worst, term)
    return worst


def clean_feature_distance(p: list[Any], q: list[Any], k: list[Any]) -> Any:
    """max_f (f_p - f_q)² / denominator of p, for features without variance."""
    from lambent.kernels.extremes import greater

    count = len(p) // 2
    worst = None
    for f in range(count):
        step = p[f] - q[f]
        term = step * step * p[count + f]
        worst = term if worst is None else greater(worst, term)
    return worst
