"""StatMC: means over pixels that Welch's t-test cannot tell apart.

"A Statistical Approach to Monte Carlo Denoising", Sakai, Freude, Auzinger, Hahn and Wimmer,
SIGGRAPH Asia 2024. Every pixel is a random variable of which the renderer knows the mean, the
variance and the number of samples. Two pixels are averaged only if a two-sided test at level α
does not reject that their means are equal, in every colour channel; for symmetric weights and
normal samples that is the best rule in the mean-squared sense. The members are weighted by a
Gaussian in the image and in albedo and normal (`lambent.kernels.statistics`).

Samples of radiance are not normal. So the test looks at Box-Cox transformed samples
x = (c^λ − 1)/λ, λ = 1/2, and the mean is corrected for their skewness: m + μ₃/(6 s² n), Johnson
1978. Frames carry these as layers ``boxcox``, ``boxcox_variance`` (of the mean), ``boxcox_skew``
(the third central moment of the samples). What is averaged is always the radiance itself.

Test, transform, correction and feature widths are the authors' (checked against their public
implementation): σ = 0.1 for normals, 0.02 for albedo, α = 0.005, ν = 2n − 2 degrees of freedom.

`StatMC` is the paper's form: radius 20, σ = 10, the test alone. What differs:

- *Without Box-Cox layers* the test looks at the radiance, with its variance.
- *The disc's last row and column* are in our window; the public kernel leaves them out.
- *The number of samples* is `Frame.spp`; where unknown, the normal distribution stands for
  Student's (ν = ∞), which rejects more.
- *Half buffers instead of a variance*: (a − b)²/4 has one degree of freedom a pixel; averaged over
  5x5 pixels it has about 25, which replaces 2n − 2 where that is larger.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lambent.device import Device
from lambent.errors import LayerError, OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.features import MARGIN, features, smoothed_variance, variance_of
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role, Stat
from lambent.kernels.statistics import t_quantile, welch_mean

#: Degrees of freedom of a variance from half buffers averaged over 5x5 pixels.
_HALVES_FREEDOM = 25.0


@dataclass(frozen=True)
class StatMC(Denoiser):
    """Means over the statistically equal pixels of a disc.

    ``radius`` and ``sigma`` in pixels; ``alpha``: level of the two-sided test (smaller joins more
    pixels); ``normal_sigma``, ``albedo_sigma``: widths in feature space; ``boxcox``: whether
    Box-Cox layers are used where the frame has them; ``by_variance``: whether members noisier than
    the pixel weigh less (`lambent.filters.statmc_tuned`; not in the paper).
    """

    radius: int = 20
    sigma: float = 10.0
    alpha: float = 0.005
    normal_sigma: float = 0.1
    albedo_sigma: float = 0.02
    boxcox: bool = True
    by_variance: bool = False
    device: Device = "auto"

    about: ClassVar[About] = About(
        name="statmc",
        title="Statistical filter: Welch's test decides who is averaged",
        paper="Sakai, Freude, Auzinger, Hahn and Wimmer, SIGGRAPH Asia 2024",
        needs=("colour", "colour.variance|colour.half_a"),
        uses=("albedo", "normal"),
        cost="1256 taps a pixel, each a test of three channels",
        when="the paper's form, for comparison; from 64 spp on and without fireflies",
    )

    def __post_init__(self) -> None:
        if not 0.0 < self.alpha < 1.0:
            raise OptionError(f"'alpha' is a probability, not {self.alpha}", remedy="0.005")

    def margin(self) -> int:
        """The disc, the 3x3 of the noise level, and the smoothing of half buffers."""
        return self.radius + MARGIN + 1

    def bytes_per_pixel(self, channels: int) -> int:
        """Planes of the test, the features and the targets, padded, on both sides."""
        return 4 * (4 * channels + 44)

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """What is assumed because the frame does not tell it."""
        name = self.about.name
        notes = []
        if not frame.has(Role.COLOUR, Stat.VARIANCE):
            notes.append(
                f"{name}: the variance is estimated from two half buffers, over 5x5 pixels."
            )
        if frame.spp is None:
            notes.append(
                f"{name}: the samples a pixel are unknown; the test takes the normal distribution."
            )
        return tuple(notes)

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter ``targets`` ``(H, W, C)``: linear in them, the weights come from the frame."""
        mean, variance, freedom = self.tested(frame)
        bound = np.float32(t_quantile(self.alpha, freedom) ** 2) * variance
        seen = features(frame, [r for r in (Role.ALBEDO, Role.NORMAL) if frame.has(r)])
        stack = seen.stack * seen.per_sigma(
            np.sqrt(2), albedo=self.albedo_sigma, normal=self.normal_sigma
        )
        noise = smoothed_variance(frame) if self.by_variance else None
        return welch_mean(targets, mean, bound, stack, self.radius, self.sigma, self.device, noise)

    def tested(self, frame: Frame) -> tuple[FloatImage, FloatImage, float]:
        """What is tested: means ``(H, W, 3)``, variances of them, and degrees of freedom ν."""
        variance = variance_of(frame, Role.COLOUR)
        if variance is None:
            raise LayerError(
                f"the model '{self.about.name}' needs colour.variance, "
                "or both colour.half_a and colour.half_b",
                file=frame.path,
                remedy="let the renderer write a variance pass, or take the model nfor-tuned",
            )
        freedom = 2.0 * frame.spp - 2.0 if frame.spp is not None else np.inf
        if freedom <= 0:
            freedom = np.inf  # one sample a pixel: ν means nothing
        if not frame.has(Role.COLOUR, Stat.VARIANCE):
            freedom = min(freedom, _HALVES_FREEDOM)
        mean = np.nan_to_num(frame.colour, nan=0.0, posinf=0.0, neginf=0.0)
        transformed = frame.extras.get("boxcox")
        spread = frame.extras.get("boxcox_variance")
        if self.boxcox and transformed is not None and spread is not None:
            mean, variance = transformed.data, np.maximum(spread.data, 0)
            skew = frame.extras.get("boxcox_skew")
            if skew is not None and frame.spp is not None:
                mean = johnson(mean, variance, skew.data, frame.spp)
        return mean, np.broadcast_to(variance, mean.shape), float(freedom)


def johnson(mean: FloatImage, variance: FloatImage, skew: FloatImage, spp: int) -> FloatImage:
    """Johnson's correction of a mean for skewed samples: m + μ₃/(6 s² n), s² = n · variance."""
    spread = variance * np.float32(spp)
    sound = spread > np.finfo(np.float32).eps
    return mean + np.where(sound, skew / (6 * np.where(sound, spread, 1) * spp), 0).astype(
        np.float32
    )
