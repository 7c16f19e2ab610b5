"""DnCNN: a plain stack of convolutions that predicts the noise, not the picture.

"Beyond a Gaussian Denoiser: Residual Learning of Deep CNN for Image Denoising" (Zhang, Zuo, Chen,
Meng and Zhang 2017, IEEE TIP 26(7); arXiv 1608.03981). For a noisy picture y = x + v with values
in [0, 1], a network R of D layers (sec. III-B) gives the noise::

    layer 1          Conv 3x3, 64 filters, ReLU
    layers 2..D-1    Conv 3x3, 64 filters, batch normalisation, ReLU
    layer D          Conv 3x3, as many filters as y has channels
    x̂ = y - R(y)                                                          residual learning

    ℓ(Θ) = 1/(2N) Σ_i ‖R(y_i; Θ) - (y_i - x_i)‖²                                          (1)

D = 17 for one known noise level (receptive field 35x35), D = 20 for blind denoising (41x41), sec.
III-A. Padding with zeros keeps the size. Weights begin as He et al. 2015 say, but for the last
layer's (``small_start``).

Why it works, as the paper has it: near the optimum R is close to zero everywhere, like the blocks
of a residual network, and Gaussian noise is what batch normalisation expects; each helps the other
(fig. 2, and `benchmarks/ablations.py dncnn`). At run time a batch normalisation is a factor and an
offset, which `folded` puts into the convolution before it.
"""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn


class DnCNN(nn.Module):
    """``(B, C, H, W)`` display values in [0, 1] to cleaned ones of the same shape.

    ``depth`` D; ``width``: filters of the layers between; ``norm``: with batch normalisation;
    ``residual``: predict the noise, or else the picture itself (for the paper's comparison).
    ``small_start``: begin with x̂ near y. As the paper begins, the first R is larger than the noise,
    and a few hundred steps go by until it is as good as nothing.
    """

    def __init__(
        self,
        channels: int = 3,
        depth: int = 20,
        width: int = 64,
        norm: bool = True,
        residual: bool = True,
        small_start: bool = True,
    ) -> None:
        super().__init__()
        self.residual = residual
        layers: list[nn.Module] = [nn.Conv2d(channels, width, 3, 1, 1), nn.ReLU(inplace=True)]
        for _ in range(depth - 2):
            layers.append(nn.Conv2d(width, width, 3, 1, 1, bias=not norm))
            if norm:
                layers.append(nn.BatchNorm2d(width, eps=1e-4))
            layers.append(nn.ReLU(inplace=True))
        layers.append(nn.Conv2d(width, channels, 3, 1, 1))
        self.layers = nn.Sequential(*layers)
        last = layers[-1]
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        if residual and small_start:
            assert isinstance(last, nn.Conv2d)
            nn.init.normal_(last.weight, std=1e-3)

    def forward(self, y: Tensor) -> Tensor:
        """x̂ = y - R(y); in whatever precision R is computed, the difference is float32."""
        found = self.layers(y).float()
        return y - found if self.residual else found

    def receptive_field(self) -> int:
        """Side of the square of pixels that a result depends on: 2 D + 1."""
        return 2 * sum(isinstance(m, nn.Conv2d) for m in self.layers) + 1


def loss(cleaned: Tensor, clean: Tensor) -> Tensor:
    """(1): y - x̂ is R(y), so the difference of pictures is that of residuals. Sum, not mean."""
    return ((cleaned.float() - clean) ** 2).sum() / (2 * len(clean))


def folded(model: DnCNN) -> DnCNN:
    """The same function with batch normalisation folded into the convolutions, for inference.

    BN(w * h) = γ (w * h - μ) / √(σ² + ε) + β = (γ/√…) w * h + (β - γ μ/√…)
    """
    found = copy.deepcopy(model).eval()
    kept: list[nn.Module] = []
    for layer in found.layers:
        if isinstance(layer, nn.BatchNorm2d):
            conv = kept[-1]
            assert isinstance(conv, nn.Conv2d)
            assert layer.running_mean is not None
            assert layer.running_var is not None
            with torch.no_grad():
                scale = layer.weight / torch.sqrt(layer.running_var + layer.eps)
                conv.weight *= scale[:, None, None, None]
                conv.bias = nn.Parameter(layer.bias - layer.running_mean * scale)
        else:
            kept.append(layer)
    found.layers = nn.Sequential(*kept)
    return found
