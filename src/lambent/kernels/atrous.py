"""The edge-avoiding à-trous wavelet: 25 taps with holes, level after level.

Dammertz et al. 2010 (see `lambent.filters.atrous`). Level i looks at offsets 2^i·(dx, dy) with
dx, dy in -2..2, weighted by the B3 spline and by how alike guide and features are there:

    w = h(dx)·h(dy) · exp(-Σ_g (g_p - g_q)² s_i²) · exp(-Σ_f max(0, (f_p - f_q)² - v_p - v_q))

The guide g is filtered along with the targets, and is a smoother one on each level; the features
stay, with their variance v where it is known. All differences are symmetric in p and q, so that
the transposed filter is the same sum with the normalisation before it: `atrous_row` makes one row
of the whole matrix from that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import (
    FloatImage,
    Layout,
    Planes,
    backend,
    constants,
    to_image,
    valid_pixels,
)
from lambent.kernels.exponential import exp_weight
from lambent.kernels.extremes import greater
from lambent.kernels.window import keep_untouched

#: The cubic B-spline.
SPLINE = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)

#: Of one level: the factor on squared differences of the guide, and that or those of the features.
Factors = tuple[float, float | Sequence[float]]

#: Target channels in one kernel.
_CHANNELS = 8


def reach(levels: int) -> int:
    """How far a pixel sees in pixels: 2·(1 + 2 + 4 + …)."""
    return 2 * (2**levels - 1)


def atrous(
    targets: NDArray[Any],
    guide: NDArray[Any],
    features: NDArray[Any] | None,
    scales: Sequence[Factors],
    noise: NDArray[Any] | None = None,
    device: str = "auto",
) -> FloatImage:
    """Filter ``targets`` ``(H, W, C)``, one level for each entry of ``scales``.

    ``guide`` ``(H, W, G)`` is filtered along; ``features`` ``(H, W, F)`` stay (None: none),
    with their variance ``noise`` (None: exact).
    ``scales``: the factors on the squared differences of guide and of features on that level; of
    the features one for all, or one each.
    Pixels that are not finite take no part. Returns float32 ``(H, W, C)``.
    """
    wavelet = _Wavelet.of(guide, features, noise, len(scales), targets, device)
    results = []
    for first in range(0, targets.shape[2], _CHANNELS):
        part = targets[:, :, first : first + _CHANNELS]
        state = Planes.stacked([guide, part], wavelet.layout, wavelet.module)
        for level, factors in enumerate(scales):
            last = level == len(scales) - 1
            channels = range(guide.shape[2] if last else 0, len(state))
            values = wavelet.level(state, channels, level, factors)
            if last:
                results.append(to_image(values, wavelet.layout))
            else:
                state = state.refilled(values)
    whole = results[0] if len(results) == 1 else np.concatenate(results, axis=2)
    return keep_untouched(whole, targets)


def atrous_row(
    guide: NDArray[Any],
    features: NDArray[Any] | None,
    scales: Sequence[Factors],
    x: int,
    y: int,
    noise: NDArray[Any] | None = None,
    device: str = "auto",
) -> FloatImage:
    """The weights ``(H, W)`` of every pixel in the result of `atrous` at pixel (x, y).

    Exact: one row of the product of the levels' matrices, from the left, with transposed levels.
    """
    wavelet = _Wavelet.of(guide, features, noise, len(scales), None, device)
    layout, module = wavelet.layout, wavelet.module
    images = [np.asarray(guide, np.float32)]
    for level, factors in enumerate(scales[:-1]):
        state = Planes.of(images[-1], layout, module)
        values = wavelet.level(state, range(len(state)), level, factors)
        images.append(to_image(values, layout))
    row = np.zeros((*guide.shape[:2], 1), np.float32)
    row[y, x] = 1.0
    valid = wavelet.valid[:, :, None]
    inside = Planes.of(np.ones_like(wavelet.valid), layout, module)
    for level in reversed(range(len(scales))):
        state = Planes.stacked([images[level], row], layout, module)
        (total,) = wavelet.sums(state, range(0), level, scales[level], wavelet.mask)
        weights = to_image([total], layout)
        share = np.divide(row, weights, out=np.zeros_like(row), where=weights > 0)
        state = Planes.stacked([images[level], share], layout, module)
        channel = range(len(state) - 1, len(state))
        spread, _ = wavelet.sums(state, channel, level, scales[level], inside)
        row = to_image([spread], layout) * valid + np.where(weights > 0, np.float32(0), row)
    return np.ascontiguousarray(row[:, :, 0])


# ------------------------------------------------------------------ private


@dataclass(frozen=True, eq=False)
class _Wavelet:
    """What all levels share."""

    layout: Layout
    module: Any
    features: Planes | None
    noise: Planes | None
    valid: FloatImage
    mask: Planes
    channels: int

    @classmethod
    def of(
        cls,
        guide: NDArray[Any],
        features: NDArray[Any] | None,
        noise: NDArray[Any] | None,
        levels: int,
        targets: NDArray[Any] | None,
        device: str,
    ) -> _Wavelet:
        module = backend(device)
        layout = Layout(guide.shape[0], guide.shape[1], 2 * 2 ** (levels - 1))
        valid = valid_pixels(guide, features, noise, targets)
        fixed = None if features is None else Planes.of(features, layout, module)
        unsure = None if noise is None else Planes.of(noise, layout, module)
        mask = Planes.of(valid, layout, module)
        return cls(layout, module, fixed, unsure, valid, mask, guide.shape[2])

    def level(
        self, state: Planes, channels: Sequence[int], level: int, factors: Factors
    ) -> list[Any]:
        """The weighted means of some channels; a pixel without weights keeps its value."""
        import drjit as dr

        *sums, total = self.sums(state, channels, level, factors, self.mask)
        values = [
            dr.select(total > 0, s / total, state.view(c))
            for s, c in zip(sums, channels, strict=True)
        ]
        dr.eval(values)
        return values

    def sums(
        self,
        state: Planes,
        channels: Sequence[int],
        level: int,
        factors: Factors,
        mask: Planes,
    ) -> list[Any]:
        """Σ w·c of some channels of the state (guide first), and Σ w. Evaluated."""
        import drjit as dr

        (soft,) = constants(factors[:1], self.module)
        each = factors[1] if isinstance(factors[1], Sequence) else [factors[1]]
        hard = constants(each, self.module)
        step = 2**level
        guide = [state.view(c) for c in range(self.channels)]
        fixed = [] if self.features is None else self.features.views()
        vp = [] if self.noise is None else self.noise.views()
        sums = [self.module.Float(0) for _ in range(len(channels) + 1)]
        for j, vertical in enumerate(SPLINE):
            for i, horizontal in enumerate(SPLINE):
                dx, dy = (i - 2) * step, (j - 2) * step
                w = mask.view(0, dx, dy) * (horizontal * vertical)
                if (dx, dy) != (0, 0):
                    near = [state.view(c, dx, dy) for c in range(self.channels)]
                    apart = soft * _squares(guide, near, [])
                    if self.features is not None:
                        vq = [] if self.noise is None else self.noise.views(dx, dy)
                        unsure = [a + b for a, b in zip(vp, vq, strict=True)]
                        there = self.features.views(dx, dy)
                        if len(hard) == 1:
                            apart += hard[0] * _squares(fixed, there, unsure)
                        else:
                            for f, factor in enumerate(hard):
                                part = slice(f, f + 1)
                                apart += factor * _squares(fixed[part], there[part], unsure[part])
                    w *= exp_weight(-apart)
                for k, channel in enumerate(channels):
                    sums[k] = dr.fma(w, state.view(channel, dx, dy), sums[k])
                sums[-1] += w
        dr.eval(sums)
        return sums


def _squares(p: list[Any], q: list[Any], noise: list[Any]) -> Any:
    """Sum of squared differences, each less its noise (``noise`` empty: none)."""
    import drjit as dr

    total = type(p[0])(0)
    for f, (a, b) in enumerate(zip(p, q, strict=True)):
        step = a - b
        if noise:
            total += greater(dr.fma(step, step, -noise[f]), 0.0)
        else:
            total = dr.fma(step, step, total)
    return total
