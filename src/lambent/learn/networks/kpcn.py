"""KPCN and DPCN: a kernel for every pixel, or its colour at once.

"Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings" (Bako, Vogels,
McWilliams, Meyer, Novák, Harvill, Sen, DeRose and Rousselle 2017, SIGGRAPH). Diffuse and specular
light go through networks of their own (sec. 4.2 and `denoise.lobes`, which has the transforms and
the inputs), each nine layers::

    planes ─ [Conv 5x5, 100, ReLU] x 8 ─ Conv 5x5 ┬─ 21² logits ─ softmax ─ mean of c̃   KPCN
                                                  └─ 3 values = ĉ                        DPCN

Training (sec. 5.2): ℓ = |ĉ - c|, each network by itself on its own target, then both together on
the final colour,

    ĉ = (f_albedo + ε) ĉ_diffuse + exp(ĉ_specular) - 1                                  (10)

What the paper claims and `benchmarks/papers.py` shows: both can represent much the same, but the
kernel's result never leaves the range of what was rendered, so it is learned in far fewer steps,
and fails more mildly on what was never seen.

Departures: `|ĉ - c|` of the diffuse light is taken of log(1 + c̃), since one lamp would outweigh
a picture; for a processor there is a lean network, narrower and with a smaller window.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from lambent.denoise import lobes
from lambent.denoise.lobes import PLANES
from lambent.errors import OptionError
from lambent.learn.networks import kernels
from lambent.learn.rendered import RenderedBatch, RenderedNetwork, rendered_task
from lambent.learn.task import Learnable


@dataclass(frozen=True)
class KPCNOptions:
    """The table ``[options]`` of a recipe with ``task = "kpcn"`` or ``"dpcn"``.

    ``width`` filters of ``filter`` x ``filter`` in each of ``hidden`` layers; ``kernel``: side of
    the predicted kernels. The defaults are the paper's. ``alone``: share of the steps in which each
    part has a loss of its own; after that both are tuned together. ``patch``: side of the crops.
    """

    width: int = 100
    hidden: int = 8
    filter: int = 5
    kernel: int = 21
    alone: float = 0.7
    patch: int = 64


class KPCN(RenderedNetwork):
    """Planes of both parts ``(B, PLANES, H, W)`` to the logits of both ``(B, kernel², H, W)``.

    Raises `OptionError` for windows without a centre.
    """

    needs_lobes = True
    options: KPCNOptions

    def __init__(self, options: KPCNOptions | None = None) -> None:
        super().__init__()
        self.options = o = options or KPCNOptions()
        if o.filter % 2 == 0 or o.kernel % 2 == 0:
            raise OptionError("filter and kernel need a centre", remedy="take odd numbers")
        self.diffuse = _part(o, self.outputs())
        self.specular = _part(o, self.outputs())

    def outputs(self) -> int:
        """Values that a part's network gives a pixel."""
        return self.options.kernel**2

    def forward(self, diffuse_planes: Tensor, specular_planes: Tensor) -> tuple[Tensor, Tensor]:
        """What each network says of its part."""
        return self.diffuse(diffuse_planes), self.specular(specular_planes)

    def inputs(self, b: RenderedBatch) -> tuple[Tensor, ...]:
        """What `forward` takes of a batch."""
        return b.diffuse_planes, b.specular_planes

    def parts(self, outputs: tuple[Tensor, ...], b: RenderedBatch) -> tuple[Tensor, Tensor]:
        """ĉ of both parts: the kernels' means."""
        return kernels.apply(outputs[0], b.diffuse), kernels.apply(outputs[1], b.specular)

    def cleaned(self, outputs: tuple[Tensor, ...], b: RenderedBatch) -> Tensor:
        """(10): radiance ``(B, 3, H, W)``."""
        diffuse, specular = self.parts(outputs, b)
        return lobes.together(torch, diffuse, specular, b.albedo)  # type: ignore[no-any-return]

    def loss(self, outputs: tuple[Tensor, ...], b: RenderedBatch) -> dict[str, Tensor]:
        """Terms of the loss, to be summed."""
        diffuse, specular = self.parts(outputs, b)
        if b.progress < self.options.alone:
            return {
                "diffuse": (_log(diffuse) - _log(b.target_diffuse)).abs().mean(),
                "specular": (specular - b.target_specular).abs().mean(),
            }
        x = lobes.together(torch, diffuse, specular, b.albedo)
        return {"colour": (_log(x) - _log(b.target)).abs().mean()}

    def receptive_field(self) -> int:
        """Side of the square of pixels that a kernel's values depend on (gradients not counted)."""
        return (self.options.hidden + 1) * (self.options.filter - 1) + 1

    def reach(self) -> int:
        """Pixels that a result may depend on, to each side."""
        return self.receptive_field() // 2 + self.options.kernel // 2 + 1


class DPCN(KPCN):
    """The direct twin: the same networks, whose last layer gives ĉ itself."""

    def outputs(self) -> int:
        """The three channels of ĉ."""
        return 3

    def parts(self, outputs: tuple[Tensor, ...], b: RenderedBatch) -> tuple[Tensor, Tensor]:
        """ĉ of both parts as they come; the diffuse network speaks in log(1 + c̃), as it is fed."""
        return torch.expm1(outputs[0].float()), outputs[1].float()

    def cleaned(self, outputs: tuple[Tensor, ...], b: RenderedBatch) -> Tensor:
        """(10), of parts that are no less than 0: nothing holds the networks to that."""
        diffuse, specular = (part.clamp_min(0) for part in self.parts(outputs, b))
        return lobes.together(torch, diffuse, specular, b.albedo)  # type: ignore[no-any-return]

    def reach(self) -> int:
        """Pixels that a result may depend on, to each side."""
        return self.receptive_field() // 2 + 1


_RANGES = (
    ("width", 1, 1024),
    ("hidden", 1, 64),
    ("filter", 1, 31),
    ("kernel", 1, 63),
    ("alone", 0, 1),
    ("patch", 16, 1024),
)
LEARN_KPCN = Learnable(KPCNOptions, _RANGES, KPCN, rendered_task)
LEARN_DPCN = Learnable(KPCNOptions, _RANGES, DPCN, rendered_task)


# ------------------------------------------------------------------- private


def _part(o: KPCNOptions, outputs: int) -> nn.Sequential:
    """One network: eight hidden layers, and the one that says the kernel or the colour."""
    layers: list[nn.Module] = []
    inputs = PLANES
    for _ in range(o.hidden):
        layers += [nn.Conv2d(inputs, o.width, o.filter, 1, o.filter // 2), nn.ReLU(inplace=True)]
        inputs = o.width
    layers.append(nn.Conv2d(inputs, outputs, o.filter, 1, o.filter // 2))
    for layer in layers:
        if isinstance(layer, nn.Conv2d):
            nn.init.xavier_uniform_(layer.weight, gain=2**0.5)  # sec. 5.2; the gain of ReLU
            assert layer.bias is not None
            nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def _log(values: Tensor) -> Tensor:
    return torch.log1p(values.clamp_min(0))
