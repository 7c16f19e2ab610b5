"""Modular kernel prediction: a denoiser of parts that can be trained, and exchanged, one by one.

"Denoising with Kernel Prediction and Asymmetric Loss Functions" (Vogels, Rousselle, McWilliams,
Röthlin, Harvill, Adler, Meyer and Novák 2018, SIGGRAPH), for still frames, in the paper's order::

    planes ─ source encoder ─ f_0 ──────── residual blocks ─ kernel predictor ─ o_0    full size
             (one a renderer)  └ mean 2x2 ─ f_1 ─ the same ─ the same ──────── o_1     half
                                            └ mean 2x2 ─ f_2 … ───────────────  o_2    quarter

- *Source encoder* (sec. 4.2): two convolutions that bring what a renderer writes into a space that
  all share. Another renderer needs an encoder, not a network: `ModularOptions.frozen`.
- *Spatial-feature extractor* (sec. 4.1): residual blocks, x + Conv(ReLU(Conv(ReLU(x)))).
- *Kernel predictor*: logits of a window, softmax, weighted mean (`networks.kernels`).
- *Scales* (sec. 4.4): D is the mean of 2x2 pixels, U repeats a pixel; where the coarse result is
  the better one, α near 1 takes its low frequencies, with i_l the kernels' mean at scale l,

      o_l = i_l - α_l U D i_l + α_l U o_{l+1}                                       (1)

- *Asymmetric loss* (sec. 6): SMAPE, more where the result lies beyond the target as seen from the
  input (`losses.asymmetric`): the network rather leaves noise than inventing. λ is drawn at random
  in training and is an input, so that a user sets it at run time.

A temporal form sits between extractor and predictor (sec. 4.3): features of warped neighbouring
frames are joined there, and the predictor gives one window a frame. `features` and `predicted` are
apart for that.

Departures: both lobes in one network, on the colour divided by the albedo (half the cost); the
coarser scales see means of the encoder's features instead of an encoding of the smaller frame, and
α comes from the features instead of from the filtered pictures, so that one pass through the
network gives everything; sizes are for a processor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lambent.denoise.lobes import PLANES
from lambent.errors import OptionError
from lambent.learn import losses
from lambent.learn.networks import kernels
from lambent.learn.rendered import RenderedBatch, RenderedNetwork, rendered_task
from lambent.learn.task import Learnable
from lambent.training.task import Weights


@dataclass(frozen=True)
class ModularOptions:
    """The table ``[options]`` of a recipe with ``task = "modular"``.

    ``width`` features; ``blocks`` residual ones; ``kernel``: side of the windows; ``scales``.
    ``frozen``: learn the source encoder alone, the rest stays what the run began with.
    ``asymmetry``: λ - 1 of the asymmetric loss at preference 1 (0: symmetric).
    """

    width: int = 32
    blocks: int = 5
    kernel: int = 7
    scales: int = 3
    frozen: bool = False
    asymmetry: float = 8.0
    patch: int = 64


class Modular(RenderedNetwork):
    """Planes and λ ``(B, PLANES + 1, H, W)`` to the logits of every scale.

    H and W are multiples of `multiple`. Of scale l ``(B, kernel² + 1, H / 2^l, W / 2^l)``: the
    window's logits and that of α; the coarsest has no α.
    Raises `OptionError` for a window without a centre.
    """

    uses_preference: ClassVar[bool] = True

    def __init__(self, options: ModularOptions | None = None) -> None:
        super().__init__()
        self.options = o = options or ModularOptions()
        if o.kernel % 2 == 0:
            raise OptionError("kernel needs a centre", remedy="take an odd number")
        self.encoder = SourceEncoder(PLANES, o.width)
        self.extractor = nn.Sequential(*(ResidualBlock(o.width) for _ in range(o.blocks)))
        self.bias_of_preference = nn.Conv2d(1, o.width, 1, bias=False)
        self.predictor = nn.Sequential(nn.ReLU(), nn.Conv2d(o.width, o.kernel**2 + 1, 3, 1, 1))
        nn.init.zeros_(self.bias_of_preference.weight)
        for module in (self.extractor, self.bias_of_preference, self.predictor):
            module.requires_grad_(not o.frozen)

    @property
    def multiple(self) -> int:
        """Height and width must be multiples of this."""
        return int(2 ** (self.options.scales - 1))

    def features(self, x: Tensor) -> list[Tensor]:
        """What encoder and extractor find at every scale, ``(B, width, H / 2^l, W / 2^l)``."""
        f = self.encoder(x[:, :PLANES]) + self.bias_of_preference(x[:, PLANES:])
        found = []
        for scale in range(self.options.scales):
            f = f if scale == 0 else F.avg_pool2d(f, 2)
            found.append(self.extractor(f))
        return found

    def predicted(self, features: list[Tensor]) -> tuple[Tensor, ...]:
        """The logits of every scale."""
        taps = self.options.kernel**2
        found = [self.predictor(f) for f in features]
        return (*found[:-1], found[-1][:, :taps])

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """The logits of every scale, finest first."""
        return self.predicted(self.features(x))

    def inputs(self, b: RenderedBatch) -> tuple[Tensor, ...]:
        """The planes of the whole light, and λ."""
        count, _, height, width = b.whole_planes.shape
        # torch.cat of tensors in channels last is 50 times as slow
        both = b.whole_planes.new_empty((count, PLANES + 1, height, width))
        both = both.to(memory_format=torch.channels_last)
        both[:, :PLANES] = b.whole_planes
        both[:, PLANES] = b.preference.reshape(-1, 1, 1)
        return (both,)

    def cleaned(self, outputs: tuple[Tensor, ...], b: RenderedBatch) -> Tensor:
        """(1) from the coarsest scale up, times the albedo: radiance ``(B, 3, H, W)``."""
        taps = self.options.kernel**2
        images = [b.whole]
        for _ in outputs[1:]:
            images.append(F.avg_pool2d(images[-1], 2))
        out: Tensor | None = None
        for logits, image in zip(reversed(outputs), reversed(images), strict=True):
            mean = kernels.apply(logits[:, :taps], image)
            if out is not None:
                alpha = torch.sigmoid(logits[:, taps:].float())
                mean = mean + alpha * _up(out - F.avg_pool2d(mean, 2))
            out = mean
        assert out is not None
        return out * b.whole_albedo

    def loss(self, outputs: tuple[Tensor, ...], b: RenderedBatch) -> dict[str, Tensor]:
        """Asymmetric SMAPE, less where the target is noise itself."""
        x = self.cleaned(outputs, b)
        weight = losses.trust(b.target, b.deviation)
        weight = weight / weight.mean((1, 2, 3), keepdim=True)
        preference = b.preference * (self.options.asymmetry / losses.ASYMMETRY)
        beyond = losses.asymmetric(x, b.target, b.noisy, preference)
        return {"smape": (weight * beyond * losses.smape(x, b.target)).mean()}

    def started(self, weights: Weights | None) -> Weights | None:
        """Those named, but a fresh encoder where the rest is frozen.

        Raises `OptionError` where the rest is frozen and there is none.
        """
        if weights is None and self.options.frozen:
            raise OptionError(
                "frozen = true keeps what a run begins with, and it begins with nothing",
                remedy="add --from RUN, the folder of the run that made the rest",
            )
        if weights is None:
            return None
        if not self.options.frozen:
            return weights
        own = {f"encoder.{name}": value for name, value in self.encoder.state_dict().items()}
        return {**weights, **own}

    def reach(self) -> int:
        """Pixels that a result may depend on, to each side: most of it by the coarsest scale."""
        o = self.options
        coarsest = 2 ** (o.scales - 1)
        return 3 + coarsest * (2 * o.blocks + 1 + o.kernel // 2) + 2 * coarsest


class SourceEncoder(nn.Module):
    """What a renderer writes, in the terms that all share."""

    def __init__(self, planes: int, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(planes, width, 3, 1, 1)
        self.second = nn.Conv2d(width, width, 3, 1, 1)
        for conv in (self.first, self.second):
            _begin(conv)

    def forward(self, planes: Tensor) -> Tensor:
        """``(B, planes, H, W)`` to ``(B, width, H, W)``."""
        found: Tensor = self.second(F.relu(self.first(planes)))
        return found


class ResidualBlock(nn.Module):
    """x + Conv(ReLU(Conv(ReLU(x)))), 3x3, after He et al. 2016; no batch normalisation."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, 1, 1)
        self.second = nn.Conv2d(width, width, 3, 1, 1)
        _begin(self.first)
        _begin(self.second, 0.1)  # a stack of blocks begins near the identity

    def forward(self, x: Tensor) -> Tensor:
        """The same shape."""
        found: Tensor = x + self.second(F.relu(self.first(F.relu(x))))
        return found


_RANGES = (
    ("width", 1, 1024),
    ("blocks", 0, 64),
    ("kernel", 1, 63),
    ("scales", 1, 6),
    ("asymmetry", 0, 1000),
    ("patch", 16, 1024),
)
LEARN_MODULAR = Learnable(ModularOptions, _RANGES, Modular, rendered_task)


# ------------------------------------------------------------------- private


def _begin(conv: nn.Conv2d, gain: float = 1.0) -> None:
    nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
    with torch.no_grad():
        conv.weight *= gain
    assert conv.bias is not None
    nn.init.zeros_(conv.bias)


def _up(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="nearest")
