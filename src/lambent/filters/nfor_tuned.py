"""NFOR as we would use it: narrower bandwidths, limited planes, one linear operator.

"Nonlinearly Weighted First-Order Regression for Denoising Monte Carlo Renderings", Bitterli,
Rousselle, Moon, Iglesias-Guitián, Adler, Mitchell, Jarosz and Novák, EGSR 2016. As the
paper has it, it is `lambent.filters.nfor`. The steps, with the paper's sections:

1. features (normal, albedo, depth, ...) are filtered by NLM with their own variance (5.1);
2. the image is regressed on features and position, with NLM weights from the colour of each half
   of the samples, at bandwidths k/2 and k; every window predicts all its pixels, and the
   predictions are averaged (5.2, "collaborative"; `lambent.kernels.regression`);
3. the error of each candidate is estimated against the other half, smoothed, and the better one is
   chosen, pixel by pixel (5.3).

Where we depart from the paper (and its public implementation in the Tungsten renderer). Measured
on still-life, cornell-box, living-room and veach-mis at 16 spp, relMSE without the worst 0.1 % of
the pixels unless said otherwise:

- *One linear operator for all layers.* The paper filters half A with weights from half B and
  averages. Lighting layers have no halves, so here both operators, ½(L_A + L_B), act on the mean.
  Layers that sum to the beauty still sum. Halves choose the bandwidth.
- *Narrower bandwidths*: k is 0.5, so that ¼ and ½ are tried; the paper has ½ and 1. Weights average
  the normalised distance over channels (Rousselle 2012), Tungsten takes the least weight of the
  channels, which is narrower at the same k. Without choice and limit, 1 had up to 12 times the
  error of ½, except in the Cornell box (0.9 times). Where noise is weak and even, and features
  explain everything, k = 1 is better still.
- *A limit on the planes.* Beside a firefly a plane is steep: it falls below zero, and rises to
  many times what is there. The weighted mean of the same window (the zeroth order) cannot. Each
  pixel goes from the mean towards the plane as far as the beauty stays between 0 and twice the
  mean; how far is one number a pixel for all layers, so they still sum. In the living room this
  halved the untrimmed error of the candidate at k, and took 7 % off after the choice; of 1795
  negative pixels none is left beyond rounding.
- *No second regression* (5.4): it changed the error of the narrower candidates by −16 to +3 % and
  up to doubled the untrimmed one (living room), at a sixth of the time.
- Errors are compared relative to the squared mean, as grey, smoothed over 7x7 pixels, and the
  choice over 5x5; the paper filters both by NLM, and chooses a channel at a time.
- Centres of windows on every ``stride``-th pixel (2: a quarter of the work). The paper has 1.
- Features are filtered once, from their mean and variance, not crosswise twice. The normal
  equations are solved by Cholesky with a small ridge; the paper uses QR.
- Every colour variance is averaged over 3x3 pixels first.
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

from lambent.device import Device
from lambent.errors import OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.features import MARGIN, Features, Scales, features, fit_scales, variance_of
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role, Stat
from lambent.kernels.nlm import PatchSearch, nlm_mean
from lambent.kernels.regression import Window, first_order, patch_weights, zeroth_order

#: Half side of the box over which a variance without samples behind it is averaged.
_SMOOTH = 3
#: Half side of the box over which every variance is averaged.
_VARIANCE_SMOOTH = 1
#: Half side of the box over which the choice is averaged.
_CHOICE_SMOOTH = 2
#: Radiance squared below which errors count absolutely.
_DARK = 0.01
#: The candidates: w⁴ has half the bandwidth of w.
_POWERS = (4, 1)
#: Radius, patch and k of the feature filter (paper, 5.1).
_FEATURE_RADIUS, _FEATURE_PATCH, _FEATURE_K = 5, 3, 0.5


@dataclass(frozen=True)
class NFORTuned(Denoiser):
    """First-order regression on features, in windows of ``2·radius + 1`` pixels.

    ``patch``: half side of the patches that weights compare; ``k``: the wider of the two
    bandwidths, the other is half of it; ``stride``: distance of window centres (tiles begin at
    multiples of 32: 1, 2, 4 and 8 leave no seams); ``ridge``: share of a feature's energy that is
    added to its own; ``prefilter``: whether noisy features are filtered.
    """

    radius: int = 9
    patch: int = 3
    k: float = 0.5
    stride: int = 2
    ridge: float = 1e-4
    prefilter: bool = True
    device: Device = "auto"
    _scales: Scales | None = None
    _noisy: tuple[str, ...] | None = None

    about: ClassVar[About] = About(
        name="nfor-tuned",
        title="Nonlinearly weighted first-order regression, tuned",
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
        cost="two NLM searches and four regressions with 10 unknowns over 361 pixels",
        when="the best classical filter; wants features and half buffers",
        group="work",
    )

    def __post_init__(self) -> None:
        if self.radius < 1 or self.patch < 0:
            raise OptionError(
                "'nfor-tuned' needs radius >= 1 and patch >= 0, "
                f"not {self.radius} and {self.patch}",
                remedy="the paper's are 9 and 3",
            )
        if not 1 <= self.stride <= self.radius:
            raise OptionError(
                f"'stride' of 'nfor-tuned' lies between 1 and the radius ({self.radius}), "
                f"not at {self.stride}",
                remedy="take 1 (the paper's), 2 or 4",
            )

    def margin(self) -> int:
        """The regression, the smoothed choice after it, and what it is made from."""
        regression = 2 * self.radius + self.patch
        choice = 2 * _SMOOTH + _CHOICE_SMOOTH
        made_from = (
            max(_FEATURE_RADIUS + _FEATURE_PATCH + 1, _SMOOTH + 1 + _VARIANCE_SMOOTH) + MARGIN
        )
        return regression + choice + made_from

    def fitted(self, frame: Frame) -> NFORTuned:
        """Depth range, and which features are noisy at all."""
        scales = fit_scales(frame)
        seen = features(frame, scales=scales)
        return dataclasses.replace(self, _scales=scales, _noisy=noisy_roles(seen))

    def bytes_per_pixel(self, channels: int) -> int:
        """The weights of a window for every centre, and the coefficients of its regression."""
        centres = 1 / self.stride**2
        window = (2 * self.radius + 1) ** 2
        return int(4 * (centres * (window + 330) + 200 + 10 * channels))  # measured: 1530 at 720p

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """What is estimated because the frame does not tell it."""
        if frame.has(Role.COLOUR, Stat.HALF_A) and frame.has(Role.COLOUR, Stat.HALF_B):
            return ()
        if frame.has(Role.COLOUR, Stat.VARIANCE):
            return ("nfor-tuned: no half buffers, so bandwidths are chosen by SURE.",)
        return (
            "nfor-tuned: neither variance nor half buffers of the colour: the noise is estimated "
            "from second differences, in which texture counts as noise.",
        )

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter ``targets`` ``(H, W, C)``: linear in them, the weights come from the frame."""
        window = Window(self.radius, self.patch, self.stride)
        seen = features(frame, scales=self._scales)
        guide = self._prefiltered(seen)
        colour = finite(frame.colour)
        variance = variance_of(frame, Role.COLOUR)
        if variance is None:
            variance = spatial_variance(colour)
        # A variance of few samples is noisy itself, and low where no bright path was met.
        variance = box_mean(np.array(np.broadcast_to(variance, colour.shape)), _VARIANCE_SMOOTH)
        # The limit needs the beauty: usually it is the first of the targets.
        count = targets.shape[2]
        if count < 3 or not np.array_equal(targets[:, :, :3], colour):
            targets = np.concatenate([colour, targets], axis=2)
        a, b = frame.get(Role.COLOUR, Stat.HALF_A), frame.get(Role.COLOUR, Stat.HALF_B)
        if a is not None and b is not None:
            halves = [finite(np.broadcast_to(h, colour.shape)) for h in (a, b)]
            result = self._crossed(halves, variance, guide, targets, window)
        else:
            result = self._single(colour, variance, guide, targets, window)
        return result[:, :, result.shape[2] - count :]

    def _crossed(
        self,
        halves: list[FloatImage],
        variance: FloatImage,
        guide: FloatImage,
        targets: FloatImage,
        window: Window,
    ) -> FloatImage:
        """With half buffers: each half tells the weights that the other is judged with."""
        grey = [_grey(half) for half in halves]
        fits: list[list[FloatImage]] = []
        means: list[FloatImage] = []
        for own, other in ((grey[0], halves[1]), (grey[1], halves[0])):
            weights = patch_weights(other, 2 * variance, window, self.device, self.k)
            images = np.concatenate([own, targets], axis=2)
            fits.append(first_order(weights, guide, images, _POWERS, self.ridge))
            means.append(zeroth_order(weights, images, _POWERS[0]))
        mean = _single_precision((means[0] + means[1]) / 2)
        found, errors = [], []
        for plane_a, plane_b in zip(*fits, strict=True):
            plane = _single_precision((plane_a + plane_b) / 2)
            share = limit(plane[:, :, 1:4], mean[:, :, 1:4])
            a, b = (m + share * (p - m) for p, m in zip((plane_a, plane_b), means, strict=True))
            found.append((a[:, :, 1:] + b[:, :, 1:]) / 2)
            a, b = a[:, :, :1], b[:, :, :1]
            error = ((grey[1] - a) ** 2 + (grey[0] - b) ** 2) / 2
            # Less the noise of the halves, which is the same for both candidates.
            errors.append(error - (b - a) ** 2 / 4)
        return _chosen(found, errors, mean[:, :, 1:4])

    def _single(
        self,
        colour: FloatImage,
        variance: FloatImage,
        guide: FloatImage,
        targets: FloatImage,
        window: Window,
    ) -> FloatImage:
        """Without half buffers: errors by SURE."""
        weights = patch_weights(colour, variance, window, self.device, self.k)
        mean_variance = variance.mean(axis=2, keepdims=True, dtype=np.float32)
        probe = _signs(colour) * np.sqrt(mean_variance)
        images = np.concatenate([probe, targets], axis=2)
        mean = zeroth_order(weights, images, _POWERS[0])
        found, errors = [], []
        for plane in first_order(weights, guide, images, _POWERS, self.ridge):
            fit = mean + limit(plane[:, :, 1:4], mean[:, :, 1:4]) * (plane - mean)
            found.append(fit[:, :, 1:])
            errors.append((fit[:, :, 1:4] - colour) ** 2 + 2 * probe * fit[:, :, :1])
        return _chosen(found, errors, mean[:, :, 1:4])

    def _prefiltered(self, seen: Features) -> FloatImage:
        """The features, the noisy ones filtered by NLM with their own variance."""
        stack = seen.stack
        if seen.variance is None or not self.prefilter:
            return stack
        noisy = self._noisy if self._noisy is not None else noisy_roles(seen)
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


def limit(plane: FloatImage, mean: FloatImage) -> FloatImage:
    """``(H, W, 1)`` in [0, 1]: how far to go from the mean to the plane, both ``(H, W, 3)``.

    As far as every channel stays between 0 and twice its mean. A plane through a firefly is steep:
    beside it, it falls below zero and rises to many times what is there.
    """
    apart = np.abs(plane - mean)
    room = np.abs(mean)
    share = np.where(apart > room, room / np.where(apart > room, apart, 1), 1)
    least: FloatImage = share.min(axis=2, keepdims=True)
    return least


def _chosen(found: list[FloatImage], errors: list[FloatImage], mean: FloatImage) -> FloatImage:
    """Of two candidates the one with the smaller error, pixel by pixel (5.3)."""
    # Relative errors: one bright pixel does not decide for all around it.
    scale = 1 / (_grey(mean) ** 2 + _DARK)
    narrow, wide = (
        box_mean(e.mean(axis=2, keepdims=True, dtype=np.float32) * scale, _SMOOTH) for e in errors
    )
    share = box_mean((wide < narrow).astype(np.float32), _CHOICE_SMOOTH)
    return _single_precision(found[0] + share * (found[1] - found[0]))


def _grey(image: FloatImage) -> FloatImage:
    return image.mean(axis=2, keepdims=True, dtype=np.float32)


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


def noisy_roles(seen: Features) -> tuple[str, ...]:
    """Roles of features whose variance is worth filtering: a standard deviation above 1/1000."""
    if seen.variance is None:
        return ()
    names = [n.partition(".")[0] for n in seen.names]
    worth = seen.variance.mean(axis=(0, 1), dtype=np.float64) > 1e-6
    return tuple(dict.fromkeys(n for n, w in zip(names, worth, strict=True) if w))


def _single_precision(image: NDArray[Any]) -> FloatImage:
    return image.astype(np.float32, copy=False)


def finite(image: FloatImage) -> FloatImage:
    """The image with 0 where it is not finite (files are repaired, and counted, before)."""
    return np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32, copy=False)
