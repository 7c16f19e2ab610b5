"""SURE-based filtering.

Tzu-Mao Li, Yu-Ting Wu, Yung-Yu Chuang, "SURE-based optimization for adaptive sampling and
reconstruction", SIGGRAPH Asia 2012. A bank of cross-bilateral filters with spatial scales σ_s,

    w_ij = exp(−|p_i − p_j|²/2σ_s²) · exp(−|c_i − c_j|²/2σ_r²) · Π_k exp(−D(f_ik, f_jk)²/2σ_k²)  (1)
    D(f_ik, f_jk)² = |f̄_ik − f̄_jk|² / (σ_ik² + σ_jk²)                                          (2)

with σ_ik² the variance of feature k among the *samples* of pixel i: features blurred by focus or
motion count less. Which scale is best at a pixel tells Stein's unbiased risk estimate of its
squared error, from the noisy colour c_i and the variance σ_i² of its mean alone:

    SURE(F(c_i)) = |F(c_i) − c_i|² + 2σ_i² dF(c_i)/dc_i − σ_i²                                  (3)
    dF(c_i)/dc_i = 1/Σ_j w_ij + (F²(c_i) − F(c_i)²)/σ_r²                                         (4)

where F² is the filtered square of the colour. SURE is noisy itself, so that its map is filtered
with (1) at σ_s = 8 before the scale of least error is taken, pixel by pixel. Each result is a
weighted average with weights from the frame: all targets are filtered with them.

`SUREFilter` is the paper's form. Its text was not at hand; the numbers are those of the authors'
own code as others keep it (σ of normals 0.8, albedo 0.25, depth 0.6; σ_ik² + σ_jk² at least 0.01;
the map of SURE filtered at σ_s = 8, averaged over the channels; windows of 2σ_s; the term with σ_r
left out, since it made results noisy) and, for the bank of σ_s = 1, 2, 4, 8, those of an
independent implementation. ``sigma_colour`` turns σ_r on (in units of radiance at the automatic
exposure). What differs:

- Depth is compared as its logarithm over the median; the authors divide it by its maximum.
- The paper's other half, placing more samples where SURE is large, cannot be done to a finished
  frame.
- Frames tell the variance of means; times spp it is that of samples (times 1 where spp is unknown).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lambent.device import Device
from lambent.errors import OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.features import (
    MARGIN,
    Scales,
    features,
    fit_scales,
    smoothed_variance,
    variance_of,
)
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role

#: Windows reach this many σ_s.
REACH = 2.0
#: Exposed radiance squared below which errors are no longer relative (mid-grey is 0.18).
DARK = 0.01


@dataclass(frozen=True)
class SUREFilter(Denoiser):
    """Cross-bilateral filters of several sizes, the best one chosen per pixel by SURE.

    ``scales``: σ_s of the bank, from ``smallest`` doubling up to ``largest`` pixels. ``selection``:
    σ_s with which the SURE map is filtered. σ of features in units of their own deviation (2),
    whose square is at least ``floor``. ``relative``: whether errors are compared relative to the
    radiance; ``by_variance``: whether what is noisier than the pixel weighs less (both not in the
    paper, see `lambent.filters.sbf_tuned`).
    """

    smallest: float = 1.0
    largest: float = 8.0
    selection: float = 8.0
    sigma_albedo: float = 0.25
    sigma_normal: float = 0.8
    sigma_depth: float = 0.6
    sigma_position: float = 0.6
    sigma_roughness: float = 0.25
    sigma_colour: float | None = None
    floor: float = 0.01
    relative: bool = False
    by_variance: bool = False
    device: Device = "auto"
    _scales: Scales | None = None
    _exposure: float | None = None

    about: ClassVar[About] = About(
        name="sbf",
        title="SURE-based filter",
        paper="Li, Wu and Chuang 2012",
        needs=("colour", "colour.variance|colour.half_a"),
        uses=(
            "albedo",
            "normal",
            "depth",
            "albedo.variance",
            "normal.variance",
            "depth.variance",
        ),
        cost="windows of 5, 9, 17 and 33 pixels a side, and one of 33 for the choice",
        when="the paper's form, for comparison; for work sbf-tuned",
    )

    def __post_init__(self) -> None:
        if not self.floor > 0:
            raise OptionError("'floor' is a variance above 0", remedy="the paper's code has 0.01")
        if not (0 < self.smallest <= self.largest):
            raise OptionError(
                f"'{self.about.name}' cannot have scales from {self.smallest} to {self.largest}",
                remedy="give 0 < smallest <= largest",
            )

    def bank(self) -> list[float]:
        """The spatial scales σ_s in pixels."""
        found = [self.smallest]
        while found[-1] * 2 <= self.largest * 1.0001:
            found.append(found[-1] * 2)
        return found

    def margin(self) -> int:
        """The largest window, that of the choice, and what a variance from halves looks at."""
        return reach(self.bank()[-1]) + reach(self.selection) + MARGIN + 1

    def bytes_per_pixel(self, channels: int) -> int:
        """Planes of guide and targets, and a result for every scale."""
        return 4 * (2 * channels * (len(self.bank()) + 1) + 64)

    def fitted(self, frame: Frame) -> SUREFilter:
        """With the feature scales and the exposure of the whole frame."""
        return dataclasses.replace(
            self, _scales=fit_scales(frame), _exposure=auto_exposure(frame.colour)
        )

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """The targets ``(H, W, C)`` at the scale that suits the beauty best, pixel by pixel."""
        guide = self.guide(frame)
        errors = []
        results = []
        for sigma in self.bank():
            means, squares, total, filtered = self._apply(frame, targets, guide, sigma)
            errors.append(self.sure(frame, means, squares, total))
            results.append(filtered)
        chosen = self.choose(errors, guide)
        result = results[0]
        for index, image in enumerate(results[1:], start=1):
            result = np.where((chosen == index)[:, :, None], image, result)
        return result

    def sure(
        self, frame: Frame, mean: FloatImage, square: FloatImage, total: FloatImage
    ) -> FloatImage:
        """Equations 3 and 4, exposed and summed over the channels[, relative to the mean]: (H, W).

        ``mean`` ``(H, W, 3)``: the filtered colour, ``square``: the filtered squares, ``total``
        ``(H, W)``: Σw. Negative where luck has it; zero on average where the filter is perfect.
        """
        colour = frame.colour
        variance = variance_of(frame, Role.COLOUR)
        if variance is None:
            raise frame.missing(Role.COLOUR)
        slope = np.repeat(1 / np.maximum(total, 1e-6)[:, :, None], 3, axis=2)
        exposure = self._exposed(frame)
        if self.sigma_colour is not None:
            slope = slope + (square - mean**2) * np.float32((exposure / self.sigma_colour) ** 2)
        risk = (mean - colour) ** 2 + 2 * variance * slope - variance
        total = risk.sum(axis=2) * np.float32(exposure**2)
        if self.relative:
            total /= (mean**2).mean(axis=2) * np.float32(exposure**2) + np.float32(DARK)
        return np.asarray(total, np.float32)

    def choose(self, errors: list[FloatImage], guide: FloatImage) -> NDArray[np.intp]:
        """Index into the bank ``(H, W)``: the least error after filtering the maps of errors."""
        from lambent.kernels.taps import weighted_taps

        stack = np.stack(errors, axis=2)
        if self.selection > 0:
            offsets, factors = gaussian_taps(self.selection)
            # Errors of the noise alone must not be matched by the noise: features only.
            plain = guide if self.sigma_colour is None else _without_colour(guide)
            stack, _ = weighted_taps(stack, plain, offsets, _weight, factors, self.device)
        return np.asarray(np.argmin(np.nan_to_num(stack, nan=np.inf), axis=2))

    def guide(self, frame: Frame) -> FloatImage:
        """Features over σ_k·√(2·floor), [exposed colour over √2·σ_r,] variances over the floor.

        The variance that stands for the colour is 1/2: |c_i − c_j|² is divided by 1. By variance
        the noise level is one more plane at the end: an odd number.
        """
        found = features(frame, scales=self._scales)
        # Over the floor, so that the least σ_i² + σ_j² is 1.
        stack = found.stack * found.per_sigma(
            math.sqrt(2 * self.floor),
            albedo=self.sigma_albedo, normal=self.sigma_normal, depth=self.sigma_depth,
            position=self.sigma_position, roughness=self.sigma_roughness,
        )  # fmt: skip
        spread = np.zeros_like(stack) if found.variance is None else found.variance
        spread = spread * np.float32((frame.spp or 1) / self.floor)
        if self.sigma_colour is not None:
            factor = np.float32(self._exposed(frame) / (math.sqrt(2) * self.sigma_colour))
            stack = np.concatenate([stack, frame.colour * factor], axis=2)
            half = np.full((*stack.shape[:2], 3), 0.5, np.float32)
            spread = np.concatenate([spread, half], axis=2)
        result = np.concatenate([stack, spread], axis=2)
        if result.shape[2] == 0:  # no features: spatial weights alone
            result = np.zeros((*stack.shape[:2], 2), np.float32)
            result[:, :, 1] = 1
        if self.by_variance:
            result = np.concatenate([result, smoothed_variance(frame)[:, :, None]], axis=2)
        result[~found.valid] = np.nan
        return result

    def _apply(
        self, frame: Frame, targets: FloatImage, guide: FloatImage, sigma: float
    ) -> tuple[FloatImage, FloatImage, FloatImage, FloatImage]:
        """Filtered colour, filtered squares of it, Σw, and filtered targets, at one scale."""
        from lambent.kernels.taps import weighted_taps

        offsets, factors = gaussian_taps(sigma)
        colour = frame.colour
        inside = np.array_equal(targets[:, :, :3], colour)  # as when a frame is denoised
        stack = [targets] if inside else [colour, targets]
        if self.sigma_colour is not None:
            stack.append(colour**2)
        means, total = weighted_taps(
            np.concatenate(stack, axis=2), guide, offsets, _weight, factors, self.device
        )
        first = 0 if inside else 3
        # Without σ_r nobody reads the squares.
        squares = means[:, :, :3] if self.sigma_colour is None else means[:, :, -3:]
        return means[:, :, :3], squares, total, means[:, :, first : first + targets.shape[2]]

    def _exposed(self, frame: Frame) -> float:
        return auto_exposure(frame.colour) if self._exposure is None else self._exposure


def reach(sigma: float) -> int:
    """The radius in pixels of a window for σ_s."""
    return math.ceil(REACH * sigma)


def gaussian_taps(sigma: float) -> tuple[list[tuple[int, int]], list[float]]:
    """Offsets of the window for σ_s, and −|offset|²/2σ_s² of each."""
    from lambent.kernels.taps import square

    offsets = square(reach(sigma))
    return offsets, [-(dx * dx + dy * dy) / (2 * sigma * sigma) for dx, dy in offsets]


def _without_colour(guide: FloatImage) -> FloatImage:
    """The guide with the colour's three channels made equal everywhere."""
    half = guide.shape[2] // 2
    plain = guide.copy()
    plain[:, :, half - 3 : half] = np.where(np.isnan(guide[:, :, half - 3 : half]), np.nan, 0)
    return plain


def _weight(p: list[Any], q: list[Any], k: list[Any], s: Any) -> Any:
    """exp(s − Σ (f_p − f_q)²/max(1, v_p + v_q)) [times min(1, u_p/u_q)].

    The guide holds features, then as many variances[, then the noise level u].
    """
    import drjit as dr

    from lambent.kernels.exponential import exp_weight
    from lambent.kernels.extremes import greater, smaller

    count = len(p) // 2
    exponent = s
    for f in range(count):
        step = p[f] - q[f]
        exponent -= step * step * dr.rcp(greater(p[count + f] + q[count + f], 1.0))
    weight = exp_weight(exponent)
    if len(p) % 2:
        weight *= smaller(p[-1] * dr.rcp(q[-1] + 1e-20), type(p[-1])(1))
    return weight
