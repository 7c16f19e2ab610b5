"""NFOR: nonlinearly weighted first-order regression, as the paper has it.

"Nonlinearly Weighted First-Order Regression for Denoising Monte Carlo Renderings", Bitterli,
Rousselle, Moon, Iglesias-Guitián, Adler, Mitchell, Jarosz and Novák, EGSR 2016. The steps, with the
paper's sections; every number is that of the first author's public re-implementation (the denoiser
of the Tungsten renderer), since the paper's own text was not at hand:

1. the features of each half are filtered by NLM, one channel at a time, with weights from the other
   half (5.1: radius 5, patch 3, k = 0.5);
2. each half of the image is regressed on the features and the position, with NLM weights from the
   *other* half, at k = 1/2 and 1; the weight of a pixel is the least of its channels; every window
   predicts all its pixels (5.2, "collaborative": radius 9, patch 3; `lambent.kernels.regression`);
3. the squared error of each candidate is estimated from the other half, filtered by NLM with
   weights from the image (radius 9, patch 1, k = 1), and the better bandwidth is chosen, channel by
   channel; that choice is filtered the same way (5.3);
4. the mean of both halves is regressed once more, on the mean of the features filtered again
   (radius 2), with NLM weights from itself, whose variance the halves tell (5.4).

What differs, and why:

- *Half buffers of features* are used where the frame has them; else the features are filtered once,
  with their variance, and both halves get the same. Without either they are taken as they are.
- *Without half buffers of the colour* there is nothing to cross, and the frame is refused:
  `lambent.filters.nfor_tuned` does without.
- *Lighting layers* have no halves; theirs are made by dividing each layer between the halves as the
  beauty's pixel is divided. So all goes through the operators of the beauty, and layers that sum to
  it still sum. Other layers (alpha) are the same in both halves, and `NFOR.filter`, which knows no
  roles, treats all its targets so.
- The normal equations are solved by Cholesky in single precision, not by QR: what a feature adds
  beyond the others must be more than a millionth of its energy; slopes on what is nearly constant
  are held down (`kernels.regression.QUIET`).
- A pixel that no window likes keeps its own value.

Planes are steep beside fireflies: values below zero occur, as in the paper.
`lambent.filters.nfor_tuned` limits them, at some bias.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lambent.device import Device
from lambent.errors import OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.features import MARGIN, Features, Scales, features, fit_scales, variance_of
from lambent.filters.nfor_tuned import finite, noisy_roles
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Stat
from lambent.kernels.dense_nlm import channel_mean, least_weight_rows
from lambent.kernels.dense_regression import dense_first_order
from lambent.kernels.machine import available
from lambent.kernels.nlm import PatchSearch, nlm_mean
from lambent.kernels.regression import Window, first_order, least_weights

#: Radius, patch and k of the feature filter (5.1), and the radius of its second turn (5.4).
_FEATURE_RADIUS, _FEATURE_PATCH, _FEATURE_K, _FEATURE_AGAIN = 5, 3, 0.5, 2
#: Radius, patch and k with which errors and choices are filtered (5.3).
_CHOICE_RADIUS, _CHOICE_PATCH, _CHOICE_K = 9, 1, 1.0
#: ε of the distances.
_EPSILON = 1e-7
#: The candidates: w⁴ has half the bandwidth of w.
_POWERS = (4, 1)
#: Tikhonov term of the normal equations, as a share of each feature's energy: for rounding only.
_RIDGE = 1e-5


@dataclass(frozen=True)
class NFOR(Denoiser):
    """First-order regression on features, in windows of ``2·radius + 1`` pixels.

    ``patch``: half side of the patches that weights compare; ``k``: the wider of the two
    bandwidths, the other is half of it; ``second``: whether the result is regressed again (5.4);
    ``stride``: distance of window centres (the paper's: 1).
    """

    radius: int = 9
    patch: int = 3
    k: float = 1.0
    second: bool = True
    stride: int = 1
    device: Device = "auto"
    _scales: Scales | None = None
    _noisy: tuple[str, ...] | None = None

    about: ClassVar[About] = About(
        name="nfor",
        title="Nonlinearly weighted first-order regression",
        paper="Bitterli, Rousselle, Moon, Iglesias-Guitián, Adler, Mitchell, Jarosz and Novák, "
        "EGSR 2016",
        needs=("colour", "colour.half_a", "colour.half_b"),
        uses=(
            "colour.variance",
            "albedo",
            "normal",
            "depth",
            "albedo.variance",
            "normal.variance",
            "depth.variance",
        ),
        cost="five regressions with 10 unknowns over 361 pixels, three NLM searches for weights",
        when="final frames with half buffers, without fireflies; with those nfor-tuned",
    )

    def __post_init__(self) -> None:
        if self.radius < 1 or self.patch < 0 or not 1 <= self.stride <= self.radius:
            raise OptionError(
                f"'nfor' needs radius >= 1, patch >= 0 and a stride from 1 to the radius, not "
                f"{self.radius}, {self.patch} and {self.stride}",
                remedy="the paper's are 9, 3 and 1",
            )

    def margin(self) -> int:
        """Two regressions, two filters of errors and choice between them, and the features."""
        regression = 2 * self.radius + self.patch
        choice = 2 * (_CHOICE_RADIUS + _CHOICE_PATCH)
        made_from = _FEATURE_RADIUS + _FEATURE_PATCH + 1 + MARGIN
        again = _FEATURE_AGAIN + _FEATURE_PATCH
        return (1 + self.second) * regression + choice + made_from + again

    def fitted(self, frame: Frame) -> NFOR:
        """Depth range, and which features are noisy at all."""
        scales = fit_scales(frame)
        noisy = noisy_roles(features(frame, scales=scales))
        return dataclasses.replace(self, _scales=scales, _noisy=noisy)

    def bytes_per_pixel(self, channels: int) -> int:
        """The weights of a window for every centre, and the coefficients of its regression.

        With a centre at every pixel only some rows of them are in memory at a time: 0.9 GB in all
        at 1280x720.
        """
        if self.stride == 1 and available(self.device):
            return int(4 * (320 + 24 * channels))
        centres = 1 / self.stride**2
        window = (2 * self.radius + 1) ** 2
        return int(4 * (centres * (window + 330) + 200 + 24 * channels))

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter ``targets`` ``(H, W, C)`` by the mean of both halves' operators.

        Linear in them. Every three channels count as one colour. The beauty itself is better off
        in `filter_layers`, where either half gets the weights that it has no part in.
        """
        whole = targets.shape[2] // 3 * 3
        channels = [c % 3 if c < whole else -1 for c in range(targets.shape[2])]
        return self._regressed(frame, targets, targets, channels)[:, :, 3:]

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """The beauty from its halves; lighting layers divided between the halves as it is."""
        shares = _shares(frame)
        halves: list[list[FloatImage]] = [[], []]
        channels: list[int] = []
        for layer in layers[1:]:
            image = finite(layer.data)
            count = image.shape[2]
            channels += list(range(3)) if count == 3 else [-1] * count
            for half, share in zip(halves, shares, strict=True):
                if not INFO[layer.role].radiance:
                    half.append(image)
                elif count == 3:
                    half.append(image * share)
                else:
                    half.append(image * share.mean(axis=2, keepdims=True))
        empty = np.zeros((frame.height, frame.width, 0), np.float32)
        a, b = (np.concatenate([empty, *half], axis=2) for half in halves)
        result = self._regressed(frame, a, b, channels)
        beauty = result[:, :, :3]
        if layers[0].data.shape[2] == 1:
            beauty = beauty.mean(axis=2, keepdims=True, dtype=np.float32)
        ends = np.cumsum([layer.data.shape[2] for layer in layers[1:]])[:-1]
        rest = np.split(result[:, :, 3:], ends, axis=2) if len(layers) > 1 else []
        return [beauty, *rest]

    # ------------------------------------------------------------------ the steps

    def _regressed(
        self, frame: Frame, more_a: FloatImage, more_b: FloatImage, channels: list[int]
    ) -> FloatImage:
        """The beauty ``(H, W, 3)`` and, behind it, other images of which each half is given.

        ``channels``: which channel of the beauty decides over each of them, or −1 for the mean.
        """
        colour = finite(frame.colour)
        half_a, half_b = _halves(frame)
        variance = variance_of(frame, Role.COLOUR)
        assert variance is not None  # there are halves
        variance = np.array(np.broadcast_to(variance, colour.shape))
        features_a, features_b, features_both = self._features(frame)
        fits = []
        divided = _divided(frame)
        for own, more, other, guide in (
            (np.where(divided, half_a, colour), more_a, half_b, features_b),
            (np.where(divided, half_b, colour), more_b, half_a, features_a),
        ):
            images = np.concatenate([own, more], axis=2)
            fits.append(self._fit(other, 2 * variance, guide, images, _POWERS))
        errors = [
            estimated_error(a[:, :, :3], b[:, :, :3], half_a, half_b, variance)
            for a, b in zip(*fits, strict=True)
        ]
        wide = self._share_of_wide(errors, colour, variance)
        share = _by_channel(wide, [0, 1, 2, *channels])
        a, b = (narrow + share * (broad - narrow) for narrow, broad in fits)
        both = ((a + b) / 2).astype(np.float32)
        if not self.second:
            return both
        guide = both[:, :, :3]
        spread = ((b - a)[:, :, :3] ** 2 / 4).astype(np.float32)
        return self._fit(guide, 2 * spread, features_both, both, (1,))[0]

    def _fit(
        self,
        guide: FloatImage,
        variance: FloatImage,
        seen: FloatImage,
        images: FloatImage,
        powers: tuple[int, ...],
    ) -> list[FloatImage]:
        """``images`` regressed on the features ``seen``, with weights from ``guide``."""
        if self.stride == 1 and available(self.device):
            rows = least_weight_rows(guide, variance, self.radius, self.patch, self.k, self.device)
            return dense_first_order(rows, seen, images, powers, _RIDGE)
        window = Window(self.radius, self.patch, self.stride)
        weights = least_weights(guide, variance, window, self.device, self.k)
        return first_order(weights, seen, images, powers, _RIDGE)

    def _share_of_wide(
        self, errors: list[FloatImage], colour: FloatImage, variance: FloatImage
    ) -> FloatImage:
        """How much of the wider bandwidth each channel of each pixel takes ``(H, W, 3)`` (5.3)."""
        share = np.empty_like(colour)
        for c in range(colour.shape[2]):
            part = slice(c, c + 1)
            image, spread = colour[:, :, part], variance[:, :, part]
            sizes = (_CHOICE_RADIUS, _CHOICE_PATCH, _CHOICE_K)
            both = np.concatenate([e[:, :, part] for e in errors], axis=2)
            maps = self._nlm(both, image, spread, *sizes)
            wider = (maps[:, :, :1] >= maps[:, :, 1:]).astype(np.float32)
            share[:, :, part] = self._nlm(wider, image, spread, *sizes)
        return share

    def _features(self, frame: Frame) -> tuple[FloatImage, FloatImage, FloatImage]:
        """Features filtered for half A, for half B, and for the second regression."""
        seen = features(frame, scales=self._scales)
        halves = [self._half_features(frame, stat) for stat in (Stat.HALF_A, Stat.HALF_B)]
        found = [seen.stack.copy(), seen.stack.copy(), seen.stack.copy()]
        noisy = self._noisy if self._noisy is not None else noisy_roles(seen)
        for role in noisy:
            for channel in seen.index(Role(role)):
                part = slice(channel, channel + 1)
                assert seen.variance is not None  # else nothing is noisy
                images = self._crossed_feature(
                    [h.stack[:, :, part] for h in halves], seen.variance[:, :, part]
                )
                for whole, image in zip(found, images, strict=True):
                    whole[:, :, part] = image
        return found[0], found[1], found[2]

    def _crossed_feature(
        self, halves: list[FloatImage], variance: FloatImage
    ) -> tuple[FloatImage, FloatImage, FloatImage]:
        """One channel: A with weights from B, B with weights from A, and both, filtered again."""
        a, b = halves
        if np.array_equal(a, b):  # no halves of this feature: filtered with its own weights
            alone = self._nlm(a, a, variance, _FEATURE_RADIUS)
            return alone, alone, alone
        a, b = (
            self._nlm(own, other, 2 * variance, _FEATURE_RADIUS) for own, other in ((a, b), (b, a))
        )
        both = np.asarray((a + b) / 2, np.float32)
        apart = np.asarray((b - a) ** 2 / 4, np.float32)
        return a, b, self._nlm(both, both, apart, _FEATURE_AGAIN)

    def _nlm(
        self,
        image: FloatImage,
        guide: FloatImage,
        variance: FloatImage,
        radius: int,
        patch: int = _FEATURE_PATCH,
        k: float = _FEATURE_K,
    ) -> FloatImage:
        """``image`` ``(H, W, C)`` filtered with the weights of one channel."""
        numbers = (k * k, 1.0, _EPSILON)
        if available(self.device):
            return channel_mean(image, guide, variance, radius, patch, numbers, self.device)
        search = PatchSearch.of(guide, variance, radius, patch, numbers=numbers, device=self.device)
        return nlm_mean(image, search)

    def _half_features(self, frame: Frame, stat: Stat) -> Features:
        """The features with those of one half where the frame has both halves."""
        for role in Role:
            if not INFO[role].guide or not frame.has(role):
                continue
            if frame.has(role, Stat.HALF_A) and frame.has(role, Stat.HALF_B):
                mean = frame.layer(role)
                assert mean is not None
                frame = frame.with_layer(mean.with_data(frame[role, stat]))
        return features(frame, scales=self._scales)


# ------------------------------------------------------------------ estimates


def estimated_error(
    fit_a: FloatImage,
    fit_b: FloatImage,
    half_a: FloatImage,
    half_b: FloatImage,
    variance: FloatImage,
) -> FloatImage:
    """The squared error of ½(fit_a + fit_b), a channel and pixel (5.3); noisy, may be negative.

    ``fit_a`` is what became of half A. A half's own variance is twice that of the mean,
    ``variance``; what the two fits differ by would be averaged away.
    """
    apart_a = (half_b - fit_a) ** 2 - 2 * variance
    apart_b = (half_a - fit_b) ** 2 - 2 * variance
    return np.asarray((apart_a + apart_b) / 2 - (fit_b - fit_a) ** 2 / 4, np.float32)


def _halves(frame: Frame) -> tuple[FloatImage, FloatImage]:
    shape = frame.colour.shape
    a, b = (
        finite(np.array(np.broadcast_to(frame[Role.COLOUR, stat], shape)))
        for stat in (Stat.HALF_A, Stat.HALF_B)
    )
    return a, b


def _divided(frame: Frame) -> NDArray[np.bool_]:
    """Where a half is four times the beauty at most ``(H, W, 3)``, so that layers can be divided.

    Elsewhere, where negative light in one half meets positive light in the other, both are the
    whole in either half: layers that sum to the beauty still do.
    """
    most = 4 * np.abs(finite(frame.colour))
    a, b = _halves(frame)
    return np.asarray((np.abs(a) <= most) & (np.abs(b) <= most))


def _shares(frame: Frame) -> list[FloatImage]:
    """A and B over the beauty, ``(H, W, 3)`` within ±4: how a pixel is divided; 1 in the dark."""
    colour = finite(frame.colour)
    lit = (colour != 0) & _divided(frame)
    return [
        np.where(lit, half / np.where(lit, colour, 1), 1).astype(np.float32)
        for half in _halves(frame)
    ]


def _by_channel(share: FloatImage, channels: list[int]) -> FloatImage:
    """The share ``(H, W, 3)`` spread over channels; −1 is the mean of the three."""
    every = np.concatenate([share, share.mean(axis=2, keepdims=True)], axis=2)
    return every[:, :, [3 if c < 0 else c for c in channels]]
