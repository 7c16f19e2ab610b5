"""Building blocks side by side: one small denoiser in which each choice can be exchanged.

The network is always the same: the planes of `denoise.lobes`, a first convolution, some blocks, a
last convolution that says what to add to log(1 + c̃). What is exchanged:

==============  ====================================================================================
activation      sigmoid, tanh; ReLU (Nair and Hinton 2010); leaky ReLU (Maas 2013); ELU (Clevert
                2016); maxout (Goodfellow 2013): the larger one of two channels
norm            batch normalisation (Ioffe and Szegedy 2015) after each convolution, or none
block           plain: two 3x3 convolutions; residual (He et al. 2016): the same with a sum around;
                attention: in windows of 8x8 pixels, every second block shifted by half a window,
                after Liu et al. 2021 (Swin; here the outermost windows wrap around the image)
loss            L1, L2, SMAPE (Vogels et al. 2018) of log(1 + c̃)
==============  ====================================================================================

"Of equal cost" means multiply-adds a pixel: a maxout layer computes two channels for one, so its
network is narrower; an attention block has the width at which projections, products and its two
dense layers cost what two convolutions do (`macs_of_block`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lambent.denoise.lobes import PLANES
from lambent.errors import OptionError
from lambent.learn import losses
from lambent.learn.rendered import RenderedBatch, RenderedNetwork, rendered_task
from lambent.learn.task import Learnable

#: Side of a window of attention, and channels of one of its heads.
WINDOW, HEAD = 8, 8


@dataclass(frozen=True)
class BlocksOptions:
    """The table ``[options]`` of a recipe with ``task = "blocks"``.

    ``width`` channels of a plain network with ReLU; the others get the width of equal cost.
    """

    width: int = 16
    blocks: int = 3
    activation: str = "relu"
    norm: bool = False
    block: str = "plain"
    loss: str = "l1"
    patch: int = 64


class Maxout(nn.Module):
    """``(B, 2 C, H, W)`` to ``(B, C, H, W)``: of each pair of channels the larger one."""

    def forward(self, x: Tensor) -> Tensor:
        """max over pairs."""
        return torch.maximum(*x.chunk(2, 1))


ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {
    "sigmoid": nn.Sigmoid,
    "tanh": nn.Tanh,
    "relu": nn.ReLU,
    "leaky-relu": lambda: nn.LeakyReLU(0.1),
    "elu": nn.ELU,
    "maxout": Maxout,
}
LOSSES = ("l1", "l2", "smape")
BLOCKS = ("plain", "residual", "attention")


class Blocks(RenderedNetwork):
    """Planes ``(B, PLANES, H, W)``, sides multiples of 8, to what is added ``(B, 3, H, W)``.

    Raises `OptionError` for a name that is none of the known.
    """

    def __init__(self, options: BlocksOptions | None = None) -> None:
        super().__init__()
        self.options = o = options or BlocksOptions()
        for value, known in (
            (o.activation, tuple(ACTIVATIONS)),
            (o.loss, LOSSES),
            (o.block, BLOCKS),
        ):
            if value not in known:
                raise OptionError(f"there is no '{value}'", remedy=f"take one of {known}")
        self.width = width = width_of(o)
        self.first = _layer(PLANES, width, o)
        if o.block == "attention":
            body: list[nn.Module] = [Attention(width, n % 2 == 1) for n in range(o.blocks)]
        else:
            body = [_Convolutions(width, o) for _ in range(o.blocks)]
        self.body = nn.Sequential(*body)
        self.last = nn.Conv2d(width, 3, 3, 1, 1)
        nn.init.normal_(self.last.weight, std=1e-3)

    def forward(self, planes: Tensor) -> Tensor:
        """What is to be added to log(1 + c̃)."""
        found: Tensor = self.last(self.body(self.first(planes)))
        return found

    @property
    def multiple(self) -> int:
        """Height and width must be multiples of this."""
        return WINDOW if self.options.block == "attention" else 1

    def inputs(self, b: RenderedBatch) -> tuple[Tensor, ...]:
        """The planes of the whole light."""
        return (b.whole_planes,)

    def _logarithm(self, outputs: Tensor, b: RenderedBatch) -> Tensor:
        return torch.log1p(b.whole.clamp_min(0)) + outputs.float()

    def cleaned(self, outputs: Tensor, b: RenderedBatch) -> Tensor:
        """Radiance ``(B, 3, H, W)``."""
        return torch.expm1(self._logarithm(outputs, b)) * b.whole_albedo

    def loss(self, outputs: Tensor, b: RenderedBatch) -> dict[str, Tensor]:
        """The chosen loss of log(1 + c̃)."""
        x = self._logarithm(outputs, b)
        target = torch.log1p((b.target / b.whole_albedo).clamp_min(0))
        if self.options.loss == "smape":
            return {"smape": losses.smape(x, target).mean()}
        error = x - target
        return {self.options.loss: (error.abs() if self.options.loss == "l1" else error**2).mean()}

    def reach(self) -> int:
        """Pixels that a result may depend on, to each side."""
        a_block = WINDOW if self.options.block == "attention" else 2
        return 3 + self.options.blocks * a_block


class Attention(nn.Module):
    """Self-attention within windows, then two dense layers, each with a sum around and a norm.

    softmax(q kᵀ / √d) v over the 64 pixels of a window (Vaswani et al. 2017, eq. 1), 8 channels a
    head. ``shifted``: the windows are moved by half their side, around the image's borders.
    """

    def __init__(self, width: int, shifted: bool) -> None:
        super().__init__()
        self.shift = WINDOW // 2 if shifted else 0
        self.norm_a, self.norm_b = nn.GroupNorm(1, width), nn.GroupNorm(1, width)
        self.qkv = nn.Conv2d(width, 3 * width, 1)
        self.out = nn.Conv2d(width, width, 1)
        self.dense = nn.Sequential(
            nn.Conv2d(width, 2 * width, 1), nn.ReLU(), nn.Conv2d(2 * width, width, 1)
        )
        self.place = nn.Parameter(torch.zeros(1, width, WINDOW, WINDOW))
        nn.init.normal_(self.place, std=0.02)

    def forward(self, x: Tensor) -> Tensor:
        """The same shape."""
        b, c, h, w = x.shape
        y = torch.roll(self.norm_a(x), (-self.shift, -self.shift), (2, 3))
        y = y + self.place.repeat(1, 1, h // WINDOW, w // WINDOW)
        q, k, v = (_windows(t, c // HEAD) for t in self.qkv(y).chunk(3, 1))
        y = F.scaled_dot_product_attention(q, k, v)
        y = y.reshape(b, h // WINDOW, w // WINDOW, c // HEAD, WINDOW, WINDOW, HEAD)
        y = y.permute(0, 3, 6, 1, 4, 2, 5).reshape(b, c, h, w)
        x = x + torch.roll(self.out(y), (self.shift, self.shift), (2, 3))
        found: Tensor = x + self.dense(self.norm_b(x))
        return found


def macs_of_block(width: int, block: str, activation: str = "relu") -> int:
    """Multiply-adds a pixel of one block."""
    if block == "attention":
        dense = 3 * width * width + width * width + 4 * width * width
        return dense + 2 * WINDOW * WINDOW * width
    return 2 * 9 * width * width * (2 if activation == "maxout" else 1)


def width_of(o: BlocksOptions) -> int:
    """The width whose block costs what a plain one with ReLU costs at ``o.width``, or less."""
    step = HEAD if o.block == "attention" else 1
    most = macs_of_block(o.width, "plain")
    fit = [
        w for w in range(step, 8 * o.width, step)
        if macs_of_block(w, o.block, o.activation) <= most
    ]  # fmt: skip
    return max(fit, default=step)


_RANGES = (
    ("width", 1, 1024),
    ("blocks", 0, 64),
    ("patch", 16, 1024),
)
LEARN_BLOCKS = Learnable(BlocksOptions, _RANGES, Blocks, rendered_task)


# ------------------------------------------------------------------- private


class _Convolutions(nn.Module):
    """Two layers, with a sum around them in a residual block."""

    def __init__(self, width: int, o: BlocksOptions) -> None:
        super().__init__()
        self.layers = nn.Sequential(_layer(width, width, o), _layer(width, width, o))
        self.residual = o.block == "residual"

    def forward(self, x: Tensor) -> Tensor:
        """The same shape."""
        found: Tensor = self.layers(x)
        return x + found if self.residual else found


def _layer(inputs: int, outputs: int, o: BlocksOptions) -> nn.Sequential:
    """Convolution, perhaps a batch normalisation, activation."""
    wide = outputs * (2 if o.activation == "maxout" else 1)
    layers: list[nn.Module] = [nn.Conv2d(inputs, wide, 3, 1, 1, bias=not o.norm)]
    nn.init.kaiming_normal_(layers[0].weight, nonlinearity="relu")  # type: ignore[arg-type]
    if o.norm:
        layers.append(nn.BatchNorm2d(wide))
    return nn.Sequential(*layers, ACTIVATIONS[o.activation]())


def _windows(x: Tensor, heads: int) -> Tensor:
    """``(B, C, H, W)`` to ``(B · windows, heads, 64, 8)``."""
    b, c, h, w = x.shape
    x = x.reshape(b, heads, c // heads, h // WINDOW, WINDOW, w // WINDOW, WINDOW)
    x = x.permute(0, 3, 5, 1, 4, 6, 2)
    return x.reshape(-1, heads, WINDOW * WINDOW, c // heads)
