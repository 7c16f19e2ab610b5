"""NFOR: nonlinearly weighted first-order regression.

"Nonlinearly Weighted First-Order Regression for Denoising Monte Carlo Renderings", Bitterli,
Rousselle, Moon, Iglesias-Guitián, Adler, Mitchell, Jarosz and Novák, EGSR 2016. The steps, with the
paper's sections:

1. features (normal, albedo, depth, ...) are filtered by NLM with their own variance (5.1);
2. each half of the samples is regressed on features and position, with NLM weights from the colour
   of the *other* half, at bandwidths k/2 and k; every window predicts all its pixels, and the
   predictions are averaged (5.2, "collaborative"; `lambent.kernels.regression`);
3. the error of each candidate is estimated against the other half, smoothed, and the better one is
   chosen, pixel by pixel (5.3);
4. the result is regressed once more with weights from itself and its residual variance (5.4).

Where we depart from the paper (and its public implementation in the Tungsten renderer):

- *One linear operator for all layers.* The paper filters half A with weights from half B and
  averages. Lighting layers have no halves, so here both operators, ½(L_A + L_B), act on the mean.
  Layers that sum to the beauty still sum. Halves choose the bandwidth and steer the last pass.
- Weights average the normalised distance over channels (Rousselle 2012); Tungsten takes the least
  weight of the channels. One choice of bandwidth a pixel, not one a channel.
- Centres of windows on every ``stride``-th pixel (2: a quarter of the work). The paper has 1.
- Error and choice are smoothed with the regression's weights (7x7 patches), not with a further NLM
  (3x3 patches); features are filtered once, from their mean and variance, not crosswise twice.
- The normal equations are solved by Cholesky with a small ridge; the paper uses QR.
- Every colour variance is averaged over 3x3 pixels first. At 16 spp (three scenes) that lowered the
  error by 7 to 16 %; the one operator for all layers cost nothing there; a stride of 2 cost up
  to 20 % (relMSE without the worst pixels), one of 4 up to 35 %.
- *Without half buffers*: weights come from the image itself, and the error is SURE: the residual,
  with the divergence measured by one random probe (Ramani et al. 2008, "Monte-Carlo SURE").
- *Without any variance*: it is estimated from second differences (Immerkær 1996, "Fast Noise
  Variance Estimation"), averaged over 7x7 pixels. Texture then counts as noise: the weakest form.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError
from lambent.filters.denoiser import About, Denoiser, Device
from lambent.filters.features import MARGIN, Features, Scales, features, fit_scales, variance_of
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role, Stat
from lambent.kernels.nlm import PatchSearch, nlm_mean
from lambent.kernels.regression import Weights, Window, first_order, patch_weights, spread

#: Half side of the box over which a variance without samples behind it is averaged.
_SMOOTH = 3
#: Half side of the box over which every variance is averaged.
_VARIANCE_SMOOTH = 1
#: Radius, patch and k of the feature filter (paper, 5.1).
_FEATURE_RADIUS, _FEATURE_PATCH, _FEATURE_K = 5, 3, 0.5


@dataclass(frozen=True)
class NFOR(Denoiser):
    """First-order regression on features, in windows of ``2·radius + 1`` pixels.

    ``patch``: half side of the patches that weights compare; ``k``: the wider of the two
    bandwidths, the other is half of it; ``stride``: distance of window centres (tiles begin at
    multiples of 32: 1, 2, 4 and 8 leave no seams); ``ridge``: share of a feature's energy that is
    added to its own; ``prefilter``: whether noisy features are filtered.
    """

    radius: int = 9
    patch: int = 3
    k: float = 1.0
    stride: int = 2
    ridge: float = 1e-4
    prefilter: bool = True
    device: Device = "auto"
    _scales: Scales | None = None
    _noisy: tuple[str, ...] | None = None

    about: ClassVar[About] = About(
        name="nfor",
        title="Nonlinearly weighted first-order regression",
        paper="Bitterli, Rousselle, Moon, Iglesias-Guitián, Adler, Mitchell, Jarosz and Novák, "
        "EGSR 2016",
        needs=("colour",),
        uses=(
            "colour.variance",
            "colour.half_a",
            "colour.half_b",
            "albedo",
            "normal",
            "depth",
            "albedo.variance",
            "normal.variance",
            "depth.variance",
        ),
        cost="three NLM searches and five regressions with 10 unknowns over 361 pixels",
        when="the best classical filter for final frames that carry features and half buffers",
    )

    def __post_init__(self) -> None:
        if self.radius < 1 or self.patch < 0:
            raise OptionError(
                f"'nfor' needs radius >= 1 and patch >= 0, not {self.radius} and {self.patch}",
                remedy="the paper's are 9 and 3",
            )
        if not 1 <= self.stride <= self.radius:
            raise OptionError(
                f"'stride' of 'nfor' lies between 1 and the radius ({self.radius}), "
                f"not at {self.stride}",
                remedy="take 1 (the paper's), 2 or 4",
            )

    def margin(self) -> int:
        """Two regressions, the smoothed choice between them, and what they are made from."""
        regression = 2 * self.radius + self.patch
        choice = 2 * (self.radius + 1)
        made_from = (
            max(_FEATURE_RADIUS + _FEATURE_PATCH + 1, _SMOOTH + 1 + _VARIANCE_SMOOTH) + MARGIN
        )
        return 2 * regression + choice + made_from

    def fitted(self, frame: Frame) -> NFOR:
        """Depth range, and which features are noisy at all."""
        scales = fit_scales(frame)
        seen = features(frame, scales=scales)
        return dataclasses.replace(self, _scales=scales, _noisy=_noisy(seen))

    def bytes_per_pixel(self, channels: int) -> int:
        """The weights of a window for every centre, and the coefficients of its regression."""
        centres = 1 / self.stride**2
        window = (2 * self.radius + 1) ** 2
        return int(4 * (centres * (window + 250) + 180 + 10 * channels))  # measured: 1460 at 720p

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """What is estimated because the frame does not tell it."""
        if frame.has(Role.COLOUR, Stat.HALF_A) and frame.has(Role.COLOUR, Stat.HALF_B):
            return ()
        if frame.has(Role.COLOUR, Stat.VARIANCE):
            return ("nfor: no half buffers, so bandwidths are chosen by SURE.",)
        return (
            "nfor: neither variance nor half buffers of the colour: the noise is estimated from "
            "second differences, in which texture counts as noise.",
        )

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter ``targets`` ``(H, W, C)``: linear in them, the weights come from the frame."""
        window = Window(self.radius, self.patch, self.stride)
        seen = features(frame, scales=self._scales)
        guide = self._prefiltered(seen)
        colour = _finite(frame.colour)
        variance = variance_of(frame, Role.COLOUR)
        if variance is None:
            variance = spatial_variance(colour)
        # A variance of few samples is noisy itself, and low where no bright path was met.
        variance = box_mean(np.array(np.broadcast_to(variance, colour.shape)), _VARIANCE_SMOOTH)
        a, b = frame.get(Role.COLOUR, Stat.HALF_A), frame.get(Role.COLOUR, Stat.HALF_B)
        if a is not None and b is not None:
            halves = [_finite(np.broadcast_to(h, colour.shape)) for h in (a, b)]
            once, pilot, spread_ = self._crossed(halves, variance, guide, targets, window)
        else:
            once, pilot, spread_ = self._single(colour, variance, guide, targets, window)
        weights = patch_weights(pilot, spread_, window, self.device, self.k)
        return first_order(weights, guide, once, ridge=self.ridge)[0]

    # ------------------------------------------------------------------ first pass

    def _crossed(
        self,
        halves: list[FloatImage],
        variance: FloatImage,
        guide: FloatImage,
        targets: FloatImage,
        window: Window,
    ) -> tuple[FloatImage, FloatImage, FloatImage]:
        """With half buffers: the targets filtered once, the pilot image and its variance."""
        fits: list[list[FloatImage]] = []
        for own, other in (halves, halves[::-1]):
            weights = patch_weights(other, 2 * variance, window, self.device, self.k)
            images = np.concatenate([own, targets], axis=2)
            fits.append(first_order(weights, guide, images, (4, 1), self.ridge))
        errors = []
        for i in range(2):
            fit_a, fit_b = fits[0][i][:, :, :3], fits[1][i][:, :, :3]
            error = ((halves[1] - fit_a) ** 2 + (halves[0] - fit_b) ** 2) / 2
            errors.append(_single_precision(error - 2 * variance - (fit_b - fit_a) ** 2 / 4))
        share = _choice(errors, weights)
        one, two = (fits[h][0] + share * (fits[h][1] - fits[h][0]) for h in range(2))
        mean = _single_precision((one + two) / 2)
        residual = _single_precision((one[:, :, :3] - two[:, :, :3]) ** 2 / 4)
        return mean[:, :, 3:], mean[:, :, :3], residual

    def _single(
        self,
        colour: FloatImage,
        variance: FloatImage,
        guide: FloatImage,
        targets: FloatImage,
        window: Window,
    ) -> tuple[FloatImage, FloatImage, FloatImage]:
        """Without half buffers: the same three, errors by SURE."""
        weights = patch_weights(colour, variance, window, self.device, self.k)
        mean_variance = variance.mean(axis=2, keepdims=True, dtype=np.float32)
        probe = _signs(colour) * np.sqrt(mean_variance)
        images = np.concatenate([colour, probe, targets], axis=2)
        fits = first_order(weights, guide, images, (4, 1), self.ridge)
        errors = [
            (fit[:, :, :3] - colour) ** 2 - variance + 2 * probe * fit[:, :, 3:4] for fit in fits
        ]
        share = _choice(errors, weights)
        fit = fits[0] + share * (fits[1] - fits[0])
        # The probe has the noise's variance: what is left of it is the noise that is left.
        left = box_mean(fit[:, :, 3:4] ** 2, _SMOOTH)
        scale = variance / np.maximum(mean_variance, 1e-30)
        return fit[:, :, 4:], fit[:, :, :3], (left * scale).astype(np.float32)

    def _prefiltered(self, seen: Features) -> FloatImage:
        """The features, the noisy ones filtered by NLM with their own variance."""
        stack = seen.stack
        if seen.variance is None or not self.prefilter:
            return stack
        noisy = self._noisy if self._noisy is not None else _noisy(seen)
        result = stack.copy()
        for role in dict.fromkeys(noisy):
            at = seen.index(Role(role))
            image, variance = stack[:, :, at], seen.variance[:, :, at]
            numbers = (_FEATURE_K**2, 1.0, 1e-10)
            search = PatchSearch.of(
                image,
                variance,
                _FEATURE_RADIUS,
                _FEATURE_PATCH,
                numbers=numbers,
                device=self.device,
            )
            result[:, :, at] = nlm_mean(image, search)
        return result


# ------------------------------------------------------------------ estimates


def spatial_variance(image: FloatImage) -> FloatImage:
    """The noise of an image ``(H, W, C)`` without samples: Immerkær's mask, over 7x7 pixels.

    The mask [1 −2 1; −2 4 −2; 1 −2 1] is blind to constants, ramps and straight edges along the
    axes; on noise of variance σ² its square has the mean 36 σ².
    """
    pad = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = pad[:-2] - 2 * pad[1:-1] + pad[2:]
    second = rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:]
    return box_mean(second**2 / 36, _SMOOTH)


def box_mean(image: FloatImage, radius: int) -> FloatImage:
    """Mean over ``2·radius + 1`` pixels a side, edge pixels repeated. ``(H, W, C)``."""
    for axis in (0, 1):
        width = [(radius, radius) if i == axis else (0, 0) for i in range(3)]
        pad = np.pad(image, width, mode="edge")
        size = image.shape[axis]
        total = np.zeros_like(image)
        for shift in range(2 * radius + 1):
            total += pad[shift : shift + size] if axis == 0 else pad[:, shift : shift + size]
        image = total / np.float32(2 * radius + 1)
    return image


def _choice(errors: list[FloatImage], weights: Weights) -> FloatImage:
    """``(H, W, 1)`` in [0, 1]: how much of the wider candidate to take (5.3)."""
    means = [box_mean(e.mean(axis=2, keepdims=True, dtype=np.float32), 1) for e in errors]
    narrow, wide = np.split(spread(weights, np.concatenate(means, axis=2)), 2, axis=2)
    return spread(weights, (wide <= narrow).astype(np.float32))


def _signs(image: FloatImage) -> FloatImage:
    """``(H, W, 1)`` of ±1, from the bits of the pixels: the same in a tile as in the whole."""
    bits = np.ascontiguousarray(image, np.float32).view(np.uint32)
    mixed = np.zeros(bits.shape[:2], np.uint32)
    for channel in range(bits.shape[2]):
        mixed = (mixed ^ bits[:, :, channel]) * np.uint32(0x9E3779B1)
        mixed ^= mixed >> np.uint32(15)
    mixed *= np.uint32(0x85EBCA77)
    mixed ^= mixed >> np.uint32(13)
    return np.where(mixed & np.uint32(1), np.float32(1), np.float32(-1))[:, :, None]


def _noisy(seen: Features) -> tuple[str, ...]:
    """Roles of features whose variance is worth filtering: a standard deviation above 1/1000."""
    if seen.variance is None:
        return ()
    names = [n.partition(".")[0] for n in seen.names]
    worth = seen.variance.mean(axis=(0, 1), dtype=np.float64) > 1e-6
    return tuple(dict.fromkeys(n for n, w in zip(names, worth, strict=True) if w))


def _single_precision(image: NDArray[Any]) -> FloatImage:
    return image.astype(np.float32, copy=False)


def _finite(image: FloatImage) -> FloatImage:
    """The image with 0 where it is not finite (files are repaired, and counted, before)."""
    return np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32, copy=False)
