"""Predicted kernels: a softmax over a window's logits, and the weighted mean that it makes.

"Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings" (Bako et al. 2017):
logits z_pq of pixel p for the k x k pixels q around it become weights, and the weights a mean,

    w_pq = exp(z_pq) / Σ_q' exp(z_pq')        (eq. 6)          ĉ_p = Σ_q w_pq c_q        (eq. 5)

so that the result stays within the values of the window, whatever the network says, and its
gradient with respect to the logits is well behaved. Pixels outside the image take no part.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

#: A logit that is never chosen.
NEVER = -1e4


def apply(logits: Tensor, image: Tensor) -> Tensor:
    """(5) with (6): logits ``(B, k², H, W)`` and an image ``(B, C, H, W)`` to ``(B, C, H, W)``."""
    return gather(softmax(logits), image)


def softmax(logits: Tensor) -> Tensor:
    """(6), in float32 at least; taps outside the image get weight 0. Tap j of row i is i k + j."""
    _, taps, height, width = logits.shape
    precise = logits if logits.dtype == torch.float64 else logits.float()
    return torch.softmax(precise + outside(round(taps**0.5), height, width, logits.device), 1)


def gather(weights: Tensor, image: Tensor) -> Tensor:
    """(5): weights ``(B, k², H, W)``, image ``(B, C, H, W)``."""
    found = _Gather.apply(weights, image)
    assert isinstance(found, Tensor)
    return found


def outside(side: int, height: int, width: int, device: torch.device) -> Tensor:
    """``(1, side², H, W)``: `NEVER` where a tap lies outside the image, else 0."""
    key = (side, height, width, device)
    if key not in _masks:
        if len(_masks) > 64:
            _masks.clear()
        r = side // 2
        inside = F.unfold(F.pad(torch.ones(1, 1, height, width), (r, r, r, r)), side)
        _masks[key] = ((1 - inside.reshape(1, side * side, height, width)) * NEVER).to(device)
    return _masks[key]


_masks: dict[tuple[int, int, int, torch.device], Tensor] = {}


class _Gather(torch.autograd.Function):
    """Tap by tap: an unfolded image would be k² times as large."""

    @staticmethod
    def forward(ctx, weights, image):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(weights, image)
        side, r = _side(weights)
        padded = F.pad(image, (r, r, r, r))
        h, w = image.shape[2:]
        out = torch.zeros_like(image)
        for k in range(side * side):
            y, x = divmod(k, side)
            out.addcmul_(weights[:, k : k + 1], padded[:, :, y : y + h, x : x + w])
        return out

    @staticmethod
    def backward(ctx, grad):  # type: ignore[no-untyped-def]
        weights, image = ctx.saved_tensors
        side, r = _side(weights)
        padded = F.pad(image, (r, r, r, r))
        h, w = image.shape[2:]
        to_weights = torch.empty_like(weights)
        to_padded = torch.zeros_like(padded) if ctx.needs_input_grad[1] else None
        for k in range(side * side):
            y, x = divmod(k, side)
            at = padded[:, :, y : y + h, x : x + w]
            torch.sum(grad * at, 1, out=to_weights[:, k])
            if to_padded is not None:
                to_padded[:, :, y : y + h, x : x + w].addcmul_(weights[:, k : k + 1], grad)
        if to_padded is None:
            return to_weights, None
        return to_weights, to_padded[:, :, r : r + h, r : r + w]


def _side(weights: Tensor) -> tuple[int, int]:
    side = round(weights.shape[1] ** 0.5)
    assert side * side == weights.shape[1]
    assert side % 2 == 1
    return side, side // 2
