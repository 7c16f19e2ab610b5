"""Lambent's own network: a small U-Net that predicts the kernels of a pyramid.

What it predicts and why: `kernel_pyramid` and `denoise.inputs`. The backbone is as plain as it can
be, because plain 3x3 convolutions with ReLU are what int8 runs fastest: no normalisation, no
attention, strided convolutions on the way down, nearest neighbours on the way up::

    half      stem ─ enc0 ──────────────────────── dec0a ─ dec0b ─ head1, head0, albedo (full size)
    quarter        down1 ─ enc1 ────────────── dec1a ─ dec1b ─ head2
    eighth                down2 ─ enc2 ─ dec2a ─ dec2b ─ head3
    sixteenth                    down3 ─ enc3a ─ enc3b ─ head4

The full-size logits come out of the half-size features by a shuffle of 2x2 pixels (sub-pixel
convolution), so nothing ever runs at full size.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lambent.denoise.inputs import CHANNELS
from lambent.learn.networks.kernel_pyramid import LOGITS, NEAR, OWN, apply, near

#: Widths of the four levels, by size.
WIDTHS = {
    "fast": (32, 48, 64, 80),
    "default": (64, 96, 128, 192),
    "best": (112, 128, 144, 160),
}
#: The image's sides must be multiples of this.
MULTIPLE = 32
#: Logit of a pixel's own albedo in a fresh network: the albedo nearly as it is, 8 others at 0.
AS_IT_IS = 5.0


class LambentNet(nn.Module):
    """Packed inputs ``(B, CHANNELS, H/2, W/2)`` to logits.

    Returns the logits of five levels: ``(B, 4·36, H/2, W/2)`` for the full size, the gate's last,
    then ``(B, 35, …)`` at half, quarter and eighth, ``(B, 25, …)`` at a sixteenth; and those of the
    albedo's kernels, ``(B, 4·9, H/2, W/2)``.
    """

    def __init__(self, size: str = "default") -> None:
        super().__init__()
        a, b, c, d = WIDTHS[size]
        self.size = size
        self.stem = _conv(CHANNELS, a)
        self.enc0 = _conv(a, a)
        self.down1 = _conv(a, b, stride=2)
        self.enc1 = _conv(b, b)
        self.down2 = _conv(b, c, stride=2)
        self.enc2 = _conv(c, c)
        self.down3 = _conv(c, d, stride=2)
        self.enc3a = _conv(d, d)
        self.enc3b = _conv(d, d)
        self.dec2a = _conv(d + c, c)
        self.dec2b = _conv(c, c)
        self.dec1a = _conv(c + b, b)
        self.dec1b = _conv(b, b)
        self.dec0a = _conv(b + a, a)
        self.dec0b = _conv(a, a)
        self.head0 = nn.Conv2d(a, 4 * (LOGITS + 1), 1)
        self.head1 = nn.Conv2d(a, LOGITS, 1)
        self.head2 = nn.Conv2d(b, LOGITS, 1)
        self.head3 = nn.Conv2d(c, LOGITS, 1)
        self.head4 = nn.Conv2d(d, OWN, 1)
        self.albedo = nn.Conv2d(a, 4 * NEAR, 1)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                nn.init.zeros_(module.bias)  # type: ignore[arg-type]
        for head in (self.head0, self.head1, self.head2, self.head3, self.head4, self.albedo):
            nn.init.normal_(head.weight, std=0.02)  # begin with nearly equal weights
        with torch.no_grad():
            own = 4 * (NEAR // 2)
            self.albedo.bias[own : own + 4] = AS_IT_IS  # type: ignore[index]

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """The logits of the five levels, finest first, and those of the albedo."""

        def r(name: str, z: Tensor) -> Tensor:
            return self.rounded(name, F.relu(z))

        x = self.rounded("input", x)
        # what is put side by side is rounded alike: it becomes one tensor
        e0 = r("at_half", self.enc0(r("stem", _wide(self.stem, x))))
        e1 = r("at_quarter", self.enc1(r("down1", self.down1(e0))))
        e2 = r("at_eighth", self.enc2(r("down2", self.down2(e1))))
        e3 = r("at_eighth", self.enc3b(r("enc3a", self.enc3a(r("down3", self.down3(e2))))))
        d2 = r("at_quarter", self.dec2b(r("dec2a", self.dec2a(torch.cat([_up(e3), e2], 1)))))
        d1 = r("at_half", self.dec1b(r("dec1a", self.dec1a(torch.cat([_up(d2), e1], 1)))))
        d0 = r("dec0b", self.dec0b(r("dec0a", self.dec0a(torch.cat([_up(d1), e0], 1)))))
        levels = self.head0(d0), self.head1(d0), self.head2(d1), self.head3(d2), self.head4(e3)
        return *levels, self.albedo(d0)

    def rounded(self, name: str, x: Tensor) -> Tensor:
        """An activation as int8 knows it; as it is, in this network in float (`rounded`)."""
        return x


def denoised(outputs: tuple[Tensor, ...], colour: Tensor, divisor: Tensor) -> Tensor:
    """Filter ``colour`` ``(B, 3, H, W)`` with the network's outputs.

    With F the filter of the pyramid, d the divisor, a(p, q) the albedo's kernels, 3x3 softmax
    weights, and g the gate in (0, 1):

        d̂(p) = Σ a(p, q) d(q)
        out  = g · d̂ · F(colour / d̂) + (1 - g) · F(colour)

    The first term keeps texture under light that varies slowly; the second is for pixels whose
    albedo says nothing (glass, smoke). d̂, because the albedo is noise itself, at few samples and
    where it is fog's or out of focus: what it multiplies would have all of that noise again.
    """
    *levels, of_albedo = outputs
    d = near(of_albedo, divisor)
    both = apply(levels, torch.cat([colour / d, colour], 1))
    gate = torch.sigmoid(F.pixel_shuffle(levels[0][:, 4 * LOGITS :].float(), 2))
    return gate * d * both[:, :3] + (1 - gate) * both[:, 3:]


def _conv(inputs: int, outputs: int, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, stride, 1)


def _wide(conv: nn.Conv2d, x: Tensor) -> Tensor:
    """``conv(x)``. Matrix units want multiples of 8 channels: on CUDA, zeros are added."""
    lacking = -x.shape[1] % 8
    if not x.is_cuda or not lacking or type(conv) is not nn.Conv2d:
        out: Tensor = conv(x)
        return out
    more = (0, 0, 0, 0, 0, lacking)
    x = F.pad(x, more).contiguous(memory_format=torch.channels_last)
    return F.conv2d(x, F.pad(conv.weight, more), conv.bias, 1, 1)


def _up(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
