"""The filter of `kernel_pyramid` and its gradients on CUDA, one kernel each, in Triton.

Written tap by tap in PyTorch, a level reads and writes its image 34 times, and the whole filter
takes as long as the network. Here a program has a block of pixels, reads their logits twice (once
for the largest, once for the weights) and their taps once, and keeps all sums in registers. The
weights are made again in the gradients from the logits and ln Σ exp, which alone is kept::

    w(p, k) = exp(z(p, k) - L(p)),     o(p) = Σ_k w(p, k) t_k(p)
    ∂/∂z(p, k) = w(p, k) (g(p) · t_k(p) - g(p) · o(p))
    ∂/∂c(q)    = Σ over the p whose window holds q of w(p, q) g(p)

with t_k(p) the value that tap k of p looks at (its own level, or the coarser one) and g the
gradient of the output. The last is written as a sum over p, so nothing is added from two sides.
"""
# mypy: disallow_untyped_defs=False

from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor

#: Pixels of a program; channels of an image, filled up to a power of two.
BLOCK, WIDTH = 128, 8


@triton.jit
def _logits_at(z, b, y, x, k, sb, sc, sy, sx, packed: tl.constexpr, inside):
    """Logit k of pixel (y, x): of a packed tensor channel 4 k + 2 (y mod 2) + x mod 2 at half."""
    if packed:
        at = b * sb + (4 * k + 2 * (y % 2) + x % 2) * sc + (y // 2) * sy + (x // 2) * sx
    else:
        at = b * sb + k * sc + y * sy + x * sx
    return tl.load(z + at, mask=inside, other=-1e30).to(tl.float32)


@triton.jit
def _forward(
    z, image, coarse, out, lse, count, channels, height, width, sb, sc, sy, sx,
    has_coarse: tl.constexpr, packed: tl.constexpr, block: tl.constexpr, wide: tl.constexpr,
):  # fmt: skip
    p = tl.program_id(0) * block + tl.arange(0, block)
    c = tl.arange(0, wide)
    here = p < count
    b, y, x = p // (height * width), (p // width) % height, p % width
    most = tl.full((block,), -1e30, tl.float32)
    for k in range(25):
        v, u = y + k // 5 - 2, x + k % 5 - 2
        inside = here & (v >= 0) & (v < height) & (u >= 0) & (u < width)
        most = tl.maximum(most, _logits_at(z, b, y, x, k, sb, sc, sy, sx, packed, inside))
    if has_coarse:
        for k in range(9):
            v, u = y // 2 + k // 3 - 1, x // 2 + k % 3 - 1
            inside = here & (v >= 0) & (v < height // 2) & (u >= 0) & (u < width // 2)
            most = tl.maximum(most, _logits_at(z, b, y, x, 25 + k, sb, sc, sy, sx, packed, inside))
    total = tl.zeros((block,), tl.float32)
    found = tl.zeros((block, wide), tl.float32)
    for k in range(25):
        v, u = y + k // 5 - 2, x + k % 5 - 2
        inside = here & (v >= 0) & (v < height) & (u >= 0) & (u < width)
        w = tl.exp(_logits_at(z, b, y, x, k, sb, sc, sy, sx, packed, inside) - most)
        w = tl.where(inside, w, 0.0)
        at = ((b * channels)[:, None] + c[None, :]) * (height * width) + (v * width + u)[:, None]
        t = tl.load(image + at, mask=inside[:, None] & (c < channels)[None, :], other=0.0)
        total += w
        found += w[:, None] * t
    if has_coarse:
        for k in range(9):
            v, u = y // 2 + k // 3 - 1, x // 2 + k % 3 - 1
            inside = here & (v >= 0) & (v < height // 2) & (u >= 0) & (u < width // 2)
            w = tl.exp(_logits_at(z, b, y, x, 25 + k, sb, sc, sy, sx, packed, inside) - most)
            w = tl.where(inside, w, 0.0)
            at = ((b * channels)[:, None] + c[None, :]) * ((height // 2) * (width // 2))
            at += (v * (width // 2) + u)[:, None]
            t = tl.load(coarse + at, mask=inside[:, None] & (c < channels)[None, :], other=0.0)
            total += w
            found += w[:, None] * t
    at = ((b * channels)[:, None] + c[None, :]) * (height * width) + (y * width + x)[:, None]
    tl.store(out + at, found / total[:, None], mask=here[:, None] & (c < channels)[None, :])
    tl.store(lse + p, most + tl.log(total), mask=here)


@triton.jit
def _to_logits(
    z, image, coarse, out, lse, grad, dz, count, channels, height, width, sb, sc, sy, sx,
    has_coarse: tl.constexpr, packed: tl.constexpr, block: tl.constexpr, wide: tl.constexpr,
):  # fmt: skip
    p = tl.program_id(0) * block + tl.arange(0, block)
    c = tl.arange(0, wide)
    here = p < count
    b, y, x = p // (height * width), (p // width) % height, p % width
    at = ((b * channels)[:, None] + c[None, :]) * (height * width) + (y * width + x)[:, None]
    there = here[:, None] & (c < channels)[None, :]
    g = tl.load(grad + at, mask=there, other=0.0)
    mean = tl.sum(g * tl.load(out + at, mask=there, other=0.0), 1)
    norm = tl.load(lse + p, mask=here, other=0.0)
    if packed:
        base = b * sb + (2 * (y % 2) + x % 2) * sc + (y // 2) * sy + (x // 2) * sx
        step = 4 * sc
    else:
        base = b * sb + y * sy + x * sx
        step = sc
    for k in range(25):
        v, u = y + k // 5 - 2, x + k % 5 - 2
        inside = here & (v >= 0) & (v < height) & (u >= 0) & (u < width)
        w = tl.exp(tl.load(z + base + k * step, mask=inside, other=0.0).to(tl.float32) - norm)
        at = ((b * channels)[:, None] + c[None, :]) * (height * width) + (v * width + u)[:, None]
        t = tl.load(image + at, mask=inside[:, None] & (c < channels)[None, :], other=0.0)
        d = tl.where(inside, w * (tl.sum(g * t, 1) - mean), 0.0)
        tl.store(dz + base + k * step, d.to(dz.dtype.element_ty), mask=here)
    if has_coarse:
        for k in range(9):
            v, u = y // 2 + k // 3 - 1, x // 2 + k % 3 - 1
            inside = here & (v >= 0) & (v < height // 2) & (u >= 0) & (u < width // 2)
            where = base + (25 + k) * step
            w = tl.exp(tl.load(z + where, mask=inside, other=0.0).to(tl.float32) - norm)
            at = ((b * channels)[:, None] + c[None, :]) * ((height // 2) * (width // 2))
            at += (v * (width // 2) + u)[:, None]
            t = tl.load(coarse + at, mask=inside[:, None] & (c < channels)[None, :], other=0.0)
            d = tl.where(inside, w * (tl.sum(g * t, 1) - mean), 0.0)
            tl.store(dz + where, d.to(dz.dtype.element_ty), mask=here)


@triton.jit
def _to_image(
    z, lse, grad, di, count, channels, height, width, sb, sc, sy, sx,
    packed: tl.constexpr, block: tl.constexpr, wide: tl.constexpr,
):  # fmt: skip
    q = tl.program_id(0) * block + tl.arange(0, block)
    c = tl.arange(0, wide)
    here = q < count
    b, y, x = q // (height * width), (q // width) % height, q % width
    found = tl.zeros((block, wide), tl.float32)
    for k in range(25):  # the pixel that sees q with its tap k
        v, u = y - (k // 5 - 2), x - (k % 5 - 2)
        inside = here & (v >= 0) & (v < height) & (u >= 0) & (u < width)
        norm = tl.load(lse + (b * height + v) * width + u, mask=inside, other=0.0)
        w = tl.exp(_logits_at(z, b, v, u, k, sb, sc, sy, sx, packed, inside) - norm)
        w = tl.where(inside, w, 0.0)
        at = ((b * channels)[:, None] + c[None, :]) * (height * width) + (v * width + u)[:, None]
        g = tl.load(grad + at, mask=inside[:, None] & (c < channels)[None, :], other=0.0)
        found += w[:, None] * g
    at = ((b * channels)[:, None] + c[None, :]) * (height * width) + (y * width + x)[:, None]
    tl.store(di + at, found, mask=here[:, None] & (c < channels)[None, :])


@triton.jit
def _to_coarse(
    z, lse, grad, dc, count, channels, height, width, sb, sc, sy, sx,
    packed: tl.constexpr, block: tl.constexpr, wide: tl.constexpr,
):  # fmt: skip
    q = tl.program_id(0) * block + tl.arange(0, block)  # pixels of the coarse level
    c = tl.arange(0, wide)
    here = q < count
    h, w_ = height // 2, width // 2
    b, y, x = q // (h * w_), (q // w_) % h, q % w_
    found = tl.zeros((block, wide), tl.float32)
    for n in range(36):
        k = n // 4
        v = 2 * (y - (k // 3 - 1)) + (n % 4) // 2
        u = 2 * (x - (k % 3 - 1)) + n % 2
        inside = here & (v >= 0) & (v < height) & (u >= 0) & (u < width)
        norm = tl.load(lse + (b * height + v) * width + u, mask=inside, other=0.0)
        w = tl.exp(_logits_at(z, b, v, u, 25 + k, sb, sc, sy, sx, packed, inside) - norm)
        w = tl.where(inside, w, 0.0)
        at = ((b * channels)[:, None] + c[None, :]) * (height * width) + (v * width + u)[:, None]
        g = tl.load(grad + at, mask=inside[:, None] & (c < channels)[None, :], other=0.0)
        found += w[:, None] * g
    at = ((b * channels)[:, None] + c[None, :]) * (h * w_) + (y * w_ + x)[:, None]
    tl.store(dc + at, found, mask=here[:, None] & (c < channels)[None, :])


def average(logits: Tensor, image: Tensor, coarse: Tensor | None, packed: bool) -> Tensor:
    """`kernel_pyramid`'s (2) and (3): ``image`` and the result ``(B, C, H, W)``, C up to `WIDTH`.

    ``logits`` as `kernel_pyramid.apply` takes them, float32, bfloat16 or half, in any layout.
    """
    found = _Average.apply(logits, image, coarse, packed)
    assert isinstance(found, Tensor)
    return found


class _Average(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, logits, image, coarse, packed):  # type: ignore[no-untyped-def]
        image = image.float().contiguous()
        below = image if coarse is None else coarse.float().contiguous()
        b, channels, h, w = image.shape
        assert channels <= WIDTH
        out = torch.empty_like(image)
        lse = image.new_empty(b, h, w)
        count = b * h * w
        _forward[_grid(count)](
            logits, image, below, out, lse, count, channels, h, w, *logits.stride(),
            coarse is not None, packed, BLOCK, WIDTH,
        )  # fmt: skip
        ctx.save_for_backward(logits, image, below, out, lse)
        ctx.has_coarse, ctx.packed = coarse is not None, packed
        return out

    @staticmethod
    def backward(ctx: Any, grad):  # type: ignore[no-untyped-def]
        logits, image, below, out, lse = ctx.saved_tensors
        grad = grad.float().contiguous()
        b, channels, h, w = image.shape
        count, strides = b * h * w, logits.stride()
        dz = torch.zeros_like(logits)  # the same layout; taps that are not the filter's stay 0
        assert dz.stride() == strides
        _to_logits[_grid(count)](
            logits, image, below, out, lse, grad, dz, count, channels, h, w, *strides,
            ctx.has_coarse, ctx.packed, BLOCK, WIDTH,
        )  # fmt: skip
        di = dc = None
        if ctx.needs_input_grad[1]:
            di = torch.empty_like(image)
            _to_image[_grid(count)](
                logits, lse, grad, di, count, channels, h, w, *strides, ctx.packed, BLOCK, WIDTH
            )
        if ctx.has_coarse and ctx.needs_input_grad[2]:
            dc = torch.empty_like(below)
            few = b * (h // 2) * (w // 2)
            _to_coarse[_grid(few)](
                logits, lse, grad, dc, few, channels, h, w, *strides, ctx.packed, BLOCK, WIDTH
            )
        return dz, di, dc, None


def _grid(count: int) -> tuple[int]:
    return (triton.cdiv(count, BLOCK),)
