"""The filter that the network predicts, in PyTorch, for training; `kernels.pyramid` runs it.

A pyramid of images, each half as large as the one before, is averaged from the coarsest to the
finest. After "Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings"
(Bako et al. 2017, eq. 6: softmax weights), "Denoising with Kernel Prediction and Asymmetric Loss
Functions" (Vogels et al. 2018, sec. 5.2: several scales) and "Neural Partitioning Pyramids for
Denoising Monte Carlo Renderings" (Balint et al. 2023: learned down- and upsampling). In the order
of computation, with c_0 the image to filter, p and q pixels of a level l:

    c_{l+1}(p) = Σ_{q in the 2x2 under p} e^{u_l(q)} c_l(q) / Σ e^{u_l(q)}               (1)
    o_4(p)     = Σ_{q in 5x5 around p} w_4(p, q) c_4(q)                                   (2)
    o_l(p)     = Σ_{q in 5x5} w_l(p, q) c_l(q) + Σ_{q in 3x3 above p} v_l(p, q) o_{l+1}(q) (3)

One softmax over the 25 weights w and the 9 weights v of a pixel makes each step an average: grey
stays grey, the range of values is kept, and the partition between the scales needs no number of
its own. Departures: the partition and the upsampling weights are one softmax, and (1) uses one
logit a pixel, so that a firefly can be kept out of the coarse levels. `near` is a single average in
3x3 pixels, which the albedo gets.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Sequence
from types import ModuleType

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from lambent.kernels import pyramid_gradient as gradient
from lambent.kernels.machine import available
from lambent.learn.networks.kernels import NEVER, gather, outside

#: Taps of a level's own window (5x5), and of the coarser level's (3x3).
OWN, COARSE = 25, 9
#: Logits of a level that has a coarser one: own taps, coarse taps, the weight for going down.
LOGITS = OWN + COARSE + 1
#: Taps of `near` (3x3).
NEAR = 9
#: Levels of the pyramid.
LEVELS = 5


def apply(logits: Sequence[Tensor], image: Tensor) -> Tensor:
    """Filter ``image`` ``(B, C, H, W)``.

    ``logits[0]`` is ``(B, 4·K, H/2, W/2)``, channel 4 k + 2 y + x for the pixels (2 i + y, 2 j + x)
    with K >= 35; ``logits[l]`` is ``(B, 35, H / 2^l, W / 2^l)``, the coarsest ``(B, 25, …)``.
    """
    images = [image]
    for level in range(len(logits) - 1):
        images.append(_down(images[-1], logits[level], packed=level == 0))
    out: Tensor | None = None
    for level in range(len(logits) - 1, -1, -1):
        out = average(logits[level], images[level], out, packed=level == 0)
    assert out is not None
    return out


def near(logits: Tensor, image: Tensor) -> Tensor:
    """``image`` averaged in windows of 3x3: ``logits`` ``(B, 36, H/2, W/2)``, packed.

    As windows of 5x5 whose other weights are 0: they have kernels, and this is little of a step.
    """
    b, _, h, w = logits.shape
    wide = logits.new_full((b, 5, 5, 4, h, w), NEVER)
    wide[:, 1:4, 1:4] = logits.reshape(b, 3, 3, 4, h, w)
    return average(wide.flatten(1, 3), image, None, packed=True)


def average(logits: Tensor, image: Tensor, coarse: Tensor | None, packed: bool) -> Tensor:
    """(2) and (3), by compiled kernels where there are any."""
    if image.device.type == "cuda" and (triton := _triton()) is not None:
        return triton.average(logits, image, coarse, packed)
    logits = logits.float()
    if image.device.type == "cpu" and available():
        channels = image.shape[1]
        if lacking := -channels % 3:  # the compiled loops take three planes at a time
            more = (0, 0, 0, 0, 0, lacking)
            image, coarse = F.pad(image, more), None if coarse is None else F.pad(coarse, more)
        out: Tensor = _Average.apply(logits, image, coarse)
        return out[:, :channels]
    if packed:
        logits = F.pixel_shuffle(logits, 2)
    count = OWN if coarse is None else OWN + COARSE
    weights = _softmax(logits[:, :count])
    own = gather(weights[:, :OWN], image)
    return own if coarse is None else own + _GatherUp.apply(weights[:, OWN:], coarse)


def _down(image: Tensor, logits: Tensor, packed: bool) -> Tensor:
    """(1)"""
    b, c, h, w = image.shape
    u = cells(logits, packed)
    e = torch.exp(u - u.amax((3, 5), keepdim=True))
    e = e / e.sum((3, 5), keepdim=True)
    return (image.reshape(b, c, h // 2, 2, w // 2, 2) * e).sum((3, 5))


@functools.lru_cache(maxsize=1)
def _triton() -> ModuleType | None:
    """`pyramid_cuda`, where Triton is installed: PyTorch for CUDA on Linux brings it."""
    try:
        return importlib.import_module("lambent.learn.networks.pyramid_cuda")
    except ImportError:
        return None


def cells(logits: Tensor, packed: bool) -> Tensor:
    """The logits u of a level, the 2x2 pixels under each coarser one ``(B, 1, H/2, 2, W/2, 2)``."""
    first = OWN + COARSE
    b, _, h, w = logits.shape
    if packed:
        u = logits[:, 4 * first : 4 * first + 4].reshape(b, 1, 2, 2, h, w)
        return u.permute(0, 1, 4, 2, 5, 3).float()
    return logits[:, first : first + 1].reshape(b, 1, h // 2, 2, w // 2, 2).float()


def _softmax(logits: Tensor) -> Tensor:
    """Over the taps, those outside the image left out."""
    outside = _outside(logits.shape[1], logits.shape[2], logits.shape[3], logits.device)
    return torch.softmax(logits.float() + outside, 1)


_masks: dict[tuple[int, int, int, torch.device], Tensor] = {}


def _outside(taps: int, height: int, width: int, device: torch.device) -> Tensor:
    """``(1, taps, H, W)``: `NEVER` where a tap lies outside the image, else 0."""
    key = (taps, height, width, device)
    if key not in _masks:
        if len(_masks) > 64:
            _masks.clear()
        found = [outside(5, height, width, device)]
        if taps > OWN:
            above = F.unfold(F.pad(torch.ones(1, 1, height // 2, width // 2), (1, 1, 1, 1)), 3)
            above = above.reshape(1, COARSE, height // 2, width // 2)
            above = F.interpolate(above, scale_factor=2, mode="nearest")
            found.append(((1 - above) * NEVER).to(device))
        _masks[key] = torch.cat(found, 1)
    return _masks[key]


class _Average(torch.autograd.Function):
    """(2) and (3) by `kernels.pyramid_gradient`."""

    @staticmethod
    def forward(ctx, logits, image, coarse):  # type: ignore[no-untyped-def]
        own = gradient.levels_of(image.detach().numpy())
        above = None if coarse is None else gradient.levels_of(coarse.detach().numpy())
        numbers = gradient.with_room(logits.detach().numpy())
        found = gradient.average(numbers, own, above)
        ctx.kept = numbers, own, above, logits.shape[3]
        return torch.from_numpy(np.stack([level.planes for level in found]))

    @staticmethod
    def backward(ctx, grad):  # type: ignore[no-untyped-def]
        numbers, own, above, width = ctx.kept
        levels = gradient.levels_of(grad.numpy(), masked=False)
        a, b, c = gradient.gradients(numbers, own, above, levels, ctx.needs_input_grad[1])
        return tuple(None if f is None else torch.from_numpy(f) for f in (a[..., :width], b, c))


class _GatherUp(torch.autograd.Function):
    """Σ_q v(p, q) o(q) over the 3x3 pixels of the coarser level around the one above p."""

    @staticmethod
    def forward(ctx, weights, coarse):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(weights, coarse)
        b, c, h, w = coarse.shape
        padded = F.pad(coarse, (1, 1, 1, 1))
        v = weights.reshape(b, 1, COARSE, h, 2, w, 2)
        out = coarse.new_zeros(b, c, h, 2, w, 2)
        for k in range(COARSE):
            y, x = divmod(k, 3)
            out.addcmul_(v[:, :, k], padded[:, :, y : y + h, None, x : x + w, None])
        return out.reshape(b, c, 2 * h, 2 * w)

    @staticmethod
    def backward(ctx, grad):  # type: ignore[no-untyped-def]
        weights, coarse = ctx.saved_tensors
        b, c, h, w = coarse.shape
        padded = F.pad(coarse, (1, 1, 1, 1))
        v = weights.reshape(b, 1, COARSE, h, 2, w, 2)
        g = grad.reshape(b, c, h, 2, w, 2)
        to_weights = weights.new_empty(b, COARSE, h, 2, w, 2)
        to_padded = torch.zeros_like(padded)
        for k in range(COARSE):
            y, x = divmod(k, 3)
            at = padded[:, :, y : y + h, None, x : x + w, None]
            torch.sum(g * at, 1, out=to_weights[:, k])
            to_padded[:, :, y : y + h, x : x + w] += (g * v[:, :, k]).sum((3, 5))
        return to_weights.reshape(weights.shape), to_padded[:, :, 1:-1, 1:-1]
