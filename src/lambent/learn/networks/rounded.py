"""Our own network as int8 computes it, in float: quantisation-aware training.

"Quantization and Training of Neural Networks for Efficient Integer-Arithmetic-Only Inference"
(Jacob et al. 2018): weights and activations are rounded in the forward pass to what int8 can hold,
and the gradient passes as if they had not been. "Learned Step Size Quantization" (Esser et al.
2020): the size of a step is learned too. With s the step and [lo, hi] the integers there are,

    x̂ = s · round(clip(x / s, lo, hi))                                              (1)

Weights have a step for each output channel, from their largest one. Activations come after ReLU, so
their integers are 0 to 255; the input's are -128 to 127. `torch.fake_quantize_*`, which the model
file is made of, compute (1) as OpenVINO's FakeQuantize does, which it runs in int8.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from lambent.learn.networks.lambent import LambentNet

#: Activations that share a step: see `LambentNet.forward`.
NAMES = (
    "input", "stem", "at_half", "down1", "at_quarter", "down2", "at_eighth", "down3", "enc3a",
    "dec2a", "dec1a", "dec0a", "dec0b",
)  # fmt: skip
#: The largest integers of an activation, and of the input.
HIGHEST = (255, 127)
#: Where the range of an activation begins: so much of what is measured lies within.
WITHIN = 0.9999


def step_after(conv: str | None) -> str:
    """The name of the step that the output of a convolution is rounded to; of the input: None."""
    joined = {"enc0": "at_half", "dec1b": "at_half", "enc1": "at_quarter", "dec2b": "at_quarter"}
    joined |= {"enc2": "at_eighth", "enc3b": "at_eighth"}
    return "input" if conv is None else joined.get(conv, conv)


class RoundedConv(nn.Conv2d):
    """A convolution with weights rounded to 255 values a channel."""

    def forward(self, x: Tensor) -> Tensor:
        """As `nn.Conv2d`."""
        step = self.weight.detach().abs().amax((1, 2, 3)).clamp_min(1e-8) / 127
        if self.training:
            w = rounded(self.weight, step[:, None, None, None], -127, 127)
        else:
            zero = torch.zeros_like(step, dtype=torch.int32)
            w = torch.fake_quantize_per_channel_affine(self.weight, step, zero, 0, -127, 127)
        return self._conv_forward(x, w, self.bias)


class RoundedNet(LambentNet):
    """`LambentNet` with every convolution in int8. Its weights are a `LambentNet`'s and more."""

    def __init__(self, size: str = "default") -> None:
        super().__init__(size)
        for name, module in list(self.named_children()):
            if isinstance(module, nn.Conv2d):
                conv = RoundedConv(
                    module.in_channels, module.out_channels, module.kernel_size,  # type: ignore[arg-type]
                    module.stride, module.padding,  # type: ignore[arg-type]
                )  # fmt: skip
                conv.load_state_dict(module.state_dict())
                setattr(self, name, conv)
        #: ln of the step of each activation: a step is positive, and learns relative to its size.
        self.steps = nn.ParameterDict({n: nn.Parameter(torch.tensor(0.0)) for n in NAMES})
        self._seen: dict[str, Tensor] | None = None

    def rounded(self, name: str, x: Tensor) -> Tensor:
        """(1), or measuring what is to be rounded (`fit`)."""
        if self._seen is not None:
            values = x.detach().abs().float().flatten()
            values = values[:: max(1, len(values) // (1 << 20))]
            top = torch.quantile(values, WITHIN) if name != "input" else values.amax()
            self._seen[name] = torch.maximum(self._seen.get(name, top), top)
            return x
        low, high = (-128, 127) if name == "input" else (0, 255)
        step = torch.exp(self.steps[name])
        if self.training:
            return rounded(x, step, low, high)
        return torch.fake_quantize_per_tensor_affine(x.float(), float(step), 0, low, high)

    @torch.no_grad()
    def fit(self, packed: Tensor) -> None:
        """Begin with the steps that fit the activations of these inputs ``(B, CHANNELS, h, w)``."""
        self._seen = {}
        for part in packed.split(8):
            self(part)
        for name, top in self._seen.items():
            levels = HIGHEST[name == "input"]
            self.steps[name].copy_(torch.log(top.clamp_min(1e-6) / levels))
        self._seen = None


def rounded(x: Tensor, step: Tensor, low: int, high: int) -> Tensor:
    """(1), with gradients to x and to the step (Esser et al. 2020, eq. 3)."""
    with torch.autocast(x.device.type, enabled=False):
        scaled = (x.float() / step).clamp(low, high)
        whole = scaled + (scaled.round() - scaled).detach()
        return whole * step
