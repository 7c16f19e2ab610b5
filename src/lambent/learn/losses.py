"""Losses for radiance: high range, noisy targets, and a preference between blur and noise.

All take output x, target r and, where named, noisy input c as ``(B, 3, H, W)`` at an exposure where
the mean is near 0.18, and return one value a pixel ``(B, 1, H, W)`` or less.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.metrics.relmse import EPSILON

#: How strongly the noise of a target takes from its weight.
DISCOUNT = 4.0
#: A noisy input that is off by less than this counts as no cleaner; one off by so much weighs 1.
CLEAN, TYPICAL = 0.02, 0.15
#: A relative error of this and more is all the same to `relative_square`.
FAR = 4.0
#: The ε of a second `relative_square`. relMSE's is a radiance of the frame (`metrics.relmse`), a
#: network sees frames at an exposure: of dim frames, ε is 0.1 to 0.6 there, and errors are what
#: lamps and highlights have.
WHITE = 0.25
#: The weights of both: dots and rims, which few pixels have, are most of what is left.
SQUARE, BRIGHT = 1.0, 4.0
#: The weight of `structure`.
STRUCTURE = 2.5
#: A preference of 1 multiplies the loss by 1 + ASYMMETRY on the wrong side.
ASYMMETRY = 8.0


def smape(x: Tensor, r: Tensor) -> Tensor:
    """|x - r| / (|x| + |r| + ε), mean of the channels: the same for dark and bright."""
    return ((x - r).abs() / (x.abs() + r.abs() + EPSILON)).mean(1, keepdim=True)


def logarithmic(x: Tensor, r: Tensor) -> Tensor:
    """½ |ln((x + ε) / (r + ε))|, mean of the channels.

    For x near r it is SMAPE. Far above, where a kernel lets a lamp shine into the dark pixels
    beside it, SMAPE's slope dies off as r / x², this one's as 1 / x: in terms of a kernel's logit,
    whose effect grows as x, the pull away from the lamp stays.
    """
    ratio = (x.clamp_min(0) + EPSILON) / (r.clamp_min(0) + EPSILON)
    return 0.5 * torch.log(ratio).abs().mean(1, keepdim=True)


def relative_square(
    x: Tensor, r: Tensor, deviation: Tensor, epsilon: float | Tensor = EPSILON
) -> Tensor:
    """√(1 + e²) - 1 with e² = (x - r)² / (r̄² + σ² + ε): relMSE's square, without outliers' power.

    σ² is the target's own variance over 5x5 pixels: a target that is dark by chance shall not
    count as if it were sure (Lehtinen et al. 2018, sec. 3.3, divide by the output for that reason;
    then what is far too bright costs no more than what is twice too bright).
    What is off by more than `FAR` does not pull here, only in `logarithmic`: in a fresh network
    lamps shine everywhere, and this term was ten to twenty times the others.
    """
    variance = F.avg_pool2d(deviation**2, 5, 1, 2, count_include_pad=False)
    size = r.mean(1, keepdim=True) ** 2 + variance + epsilon
    square = ((x - r) ** 2).mean(1, keepdim=True) / size
    return torch.sqrt(1 + square.clamp_max(FAR**2)) - 1


def unbiased(x: Tensor, r: Tensor, epsilon: float | Tensor = EPSILON) -> Tensor:
    """Mean of (x - r)² / (x̄² + ε), x̄ held fast: noise of the target does not move its minimum.

    A single pixel of the target, far off, counts as 100 at most.
    """
    size = x.detach().mean(1, keepdim=True) ** 2 + epsilon
    return ((x - r) ** 2 / size).clamp_max(100.0).mean()


def gradient(x: Tensor, r: Tensor) -> Tensor:
    """Differences of neighbours in log(1 + 16 v), down and across: edges where they belong."""
    d = torch.log1p(16 * x.clamp_min(0)) - torch.log1p(16 * r.clamp_min(0))
    down = F.pad((d[:, :, 1:] - d[:, :, :-1]).abs(), (0, 0, 0, 1))
    across = F.pad((d[:, :, :, 1:] - d[:, :, :, :-1]).abs(), (0, 1))
    return (down + across).mean(1, keepdim=True) / 6


def displayed(x: Tensor) -> Tensor:
    """What a screen shows of it, in [0, 1]: `frame.tonemap.srgb`, with a gradient up to 1."""
    x = x.clamp(0, 1)
    return torch.where(
        x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(0.0031308) ** (1 / 2.4) - 0.055
    )


def structure(x: Tensor, r: Tensor, deviation: Tensor) -> Tensor:
    """(1 - SSIM) / 2 of what a screen shows (Wang et al. 2004, eq. 13), in windows of 5x5 pixels.

    The target's noise is no structure of the picture: its variance, carried through the slope of
    the display, is taken from the target's, or else a picture with noise would be the most similar.
    """
    a, b = displayed(x), displayed(r)
    c1, c2 = 0.01**2, 0.03**2
    means = F.avg_pool2d(torch.cat([a, b, a * a, b * b, a * b]), 5, 1)
    ma, mb, aa, bb, ab = means.chunk(5)
    slope = torch.where(r < 1, 0.44 * r.clamp_min(0.0031308) ** (1 / 2.4 - 1), 0.0)
    noise = F.avg_pool2d((slope * deviation) ** 2, 5, 1)
    both, squares = ma * mb, ma * ma + mb * mb
    vb = (bb - mb * mb - noise).clamp_min(0)
    above = (2 * both + c1) * (2 * (ab - both) + c2)
    below = (squares + c1) * ((aa - ma * ma) + vb + c2)
    return F.pad((1 - above / below).mean(1, keepdim=True) / 2, (2, 2, 2, 2))


def asymmetric(x: Tensor, r: Tensor, c: Tensor, preference: Tensor) -> Tensor:
    """Vogels et al. 2018, eq. 9: more where the output lies beyond the target, seen from the input.

    1 + (λ - 1) H((x - r)(r - c)) for every channel, averaged; λ = 1 + `ASYMMETRY` · preference.
    """
    beyond = ((x - r) * (r - c) > 0).float().mean(1, keepdim=True)
    return 1 + ASYMMETRY * preference[:, None, None, None] * beyond


def trust(r: Tensor, deviation: Tensor) -> Tensor:
    """The weight of a target pixel: s² / (s² + 4 σ²), with s the signal and σ the target's noise.

    Both are averaged over 5x5 pixels first. A pixel that is bright by chance also has a large σ by
    chance; a weight from that pixel alone would prefer dark targets, and darken the result.
    """
    s = F.avg_pool2d(r.mean(1, keepdim=True), 5, 1, 2, count_include_pad=False) + EPSILON
    variance = F.avg_pool2d(deviation**2, 5, 1, 2, count_include_pad=False)
    return s * s / (s * s + DISCOUNT * variance)


def evened(r: Tensor, c: Tensor, weight: Tensor) -> Tensor:
    """Weights of crops ``(B, 1, 1, 1)``: the less, the noisier the input c is.

    An error is judged by its ratio to another denoiser's on the same frame. A loss left as it is
    would be that of crops with one or two samples; those of hundreds have a tenth of it, and so
    hardly a say. With L the input's own `logarithmic` loss the weight goes as 1 / √(L + `CLEAN`):
    the root, because in a clean crop much of what is left is the target's noise.
    """
    noise = (weight * logarithmic(c, r)).mean((1, 2, 3), keepdim=True)
    return ((TYPICAL + CLEAN) / (noise + CLEAN)).sqrt()


def denoising(
    x: Tensor, r: Tensor, c: Tensor, deviation: Tensor, preference: Tensor
) -> tuple[Tensor, dict[str, Tensor]]:
    """The loss that Lambent's denoiser is trained with, and its terms."""
    weight = trust(r, deviation)
    weight = weight / weight.mean((1, 2, 3), keepdim=True)
    share = evened(r, c, weight)
    weight = weight * share
    own = weight * asymmetric(x, r, c, preference)
    wide = logarithmic(F.avg_pool2d(x, 4), F.avg_pool2d(r, 4))
    terms = {
        "log": (own * logarithmic(x, r)).mean(),
        "square": (own * relative_square(x, r, deviation)).mean(),
        "bright": (own * relative_square(x, r, deviation, WHITE)).mean(),
        "gradient": (weight * gradient(x, r)).mean(),
        "wide": (share * wide).mean(),
        "structure": (share * structure(x, r, deviation)).mean(),
    }
    total = terms["log"] + SQUARE * terms["square"] + BRIGHT * terms["bright"]
    total = total + 0.5 * terms["gradient"] + 0.5 * terms["wide"]
    return total + STRUCTURE * terms["structure"], terms
