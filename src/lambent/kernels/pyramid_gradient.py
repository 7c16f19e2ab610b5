"""`kernels.pyramid` for training: one level of a batch, forwards and backwards.

With e the exponentials of the logits, m the mask, w_k = e_k m_k / Σ e m the weights of a pixel, and
o = Σ_k w_k c(p + δ_k) its result, a gradient g of o gives

    ∂w_k = Σ_c g_c c_c(p + δ_k),     ∂logit_k = w_k (∂w_k - Σ_j w_j ∂w_j)                  (1)
    ∂c(q) = Σ_k w_k(q - δ_k) g(q - δ_k)                                                     (2)
    ∂coarse(q) = Σ_k Σ_{p under q - δ_k} w_k(p) g(p)                                        (3)

PyTorch needs thirty passes over memory for each of these; here (1) is one pass, in which logits,
weights and sums of a few pixels stay in the first cache. The pictures of a batch are shared out
among threads, so that each kernel call is a whole picture. That takes 0.12 s a batch of sixteen
128x128 crops where PyTorch's operations take 0.33 s, beside 0.13 s for the network
(docs/training.md).
"""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from lambent.kernels.arrays import FloatImage, aligned
from lambent.kernels.machine import LANES, Code, Kernel
from lambent.kernels.pyramid import (
    _EVEN,
    _ODD,
    _TWICE,
    _WEAVE,
    COARSE,
    OWN,
    TINY,
    Level,
    _gather_kernel,
    _Image,
    _sum,
)

_SCRATCH = 2 * (OWN + COARSE) * 2 * LANES


def levels_of(images: FloatImage, masked: bool = True) -> list[Level]:
    """Pictures ``(B, C, H, W)`` as levels; the mask is 1 inside (or 0)."""
    count, height, width = images.shape[1:]
    found = []
    for image in images:
        level = Level.empty(count, height, width)
        level.planes[...] = image
        if masked:
            level.mask[...] = 1
        found.append(level)
    return found


def average(
    logits: FloatImage, own: Sequence[Level], coarse: Sequence[Level] | None
) -> list[Level]:
    """The levels filtered with ``logits`` (from `with_room`); channels in threes."""
    assert own[0].channels % 3 == 0
    packed = is_packed(logits, own[0])
    kernel = _gather_kernel(packed, coarse is not None, False, 5)
    outs = [Level.empty(level.channels, level.height, level.width) for level in own]

    def work(b: int, scratch: FloatImage) -> None:
        level, above, out = own[b], (coarse or own)[b], outs[b]
        out.memory[0] = level.memory[0]
        numbers = [*level.params, *above.params, *out.params, *_of_logits(logits[b]), level.width]
        kernel.call(numbers, 0, level.height, scratch)

    _each(len(own), work)
    return outs


def gradients(
    logits: FloatImage,
    own: Sequence[Level],
    coarse: Sequence[Level] | None,
    grad: Sequence[Level],
    needs_own: bool,
) -> tuple[FloatImage, FloatImage | None, FloatImage | None]:
    """Of the logits, of the own and of the coarser images, from that of the result.

    ``logits``: from `with_room`; their gradient has the same shape. ``grad``: without masks, 0
    around.
    """
    packed = is_packed(logits, own[0])
    channels = own[0].channels
    taps = OWN + (COARSE if coarse is not None else 0)
    kept = 0 if needs_own else OWN  # weights that (2) and (3) need, as planes
    to_logits = logits_like(logits)
    batch, height, width = len(own), own[0].height, own[0].width
    to_own = np.empty((batch, channels, height, width), np.float32) if needs_own else None
    to_coarse = None
    if coarse is not None:
        to_coarse = np.empty((batch, channels, height // 2, width // 2), np.float32)
    first = _weights_kernel(packed, coarse is not None, channels, kept)

    def work(b: int, scratch: FloatImage) -> None:
        level, above, g = own[b], (coarse or own)[b], grad[b]
        planes = Level.empty(max(taps - kept, 1), height, width)
        logit = _of_logits(logits[b])
        numbers = [*level.params, *above.params, *g.params, *planes.params]
        first.call([*numbers, *logit, _of_logits(to_logits[b])[0], width], 0, height, scratch)
        if to_own is not None:
            out = Level.empty(channels, height, width)
            _own_kernel(channels).call(
                [*g.params, *planes.params, *out.params, width], 0, height, scratch
            )
            to_own[b] = out.planes
        if to_coarse is not None:
            out = Level.empty(channels, height // 2, width // 2)
            numbers = [*g.params, *planes.params, *out.params, width // 2]
            _coarse_kernel(channels, OWN - kept).call(numbers, 0, height // 2, scratch)
            to_coarse[b] = out.planes

    _each(batch, work)
    return to_logits, to_own, to_coarse


def is_packed(logits: FloatImage, level: Level) -> bool:
    """Whether logits are those of 2x2 pixels in four times as many channels."""
    return logits.shape[2] * 2 == level.height


def logits_like(logits: FloatImage) -> FloatImage:
    """Zeros of that shape, with room behind the end for whole vectors."""
    return with_room(np.zeros(logits.shape, np.float32))


def with_room(array: FloatImage) -> FloatImage:
    """A copy with rows of whole vectors, 0 at their ends, and room behind the last.

    Kernels read and write whole vectors; where a row is no whole number of them, the rest is here.
    """
    *front, width = array.shape
    shape = (*front, -(-width // LANES) * LANES)
    count = int(np.prod(shape))
    copy = aligned((count + 4 * LANES,))[:count].reshape(shape)
    copy[..., :width] = array
    return copy


# ------------------------------------------------------------------- private


def _of_logits(logits: FloatImage) -> list[int | np.ndarray]:
    return [logits, logits.shape[2], logits.shape[1] * logits.shape[2]]


@functools.lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count() or 1)


def _each(count: int, work: Callable[[int, FloatImage], None]) -> None:
    """``work(b, scratch)`` for every b, on all threads."""
    numbers = itertools.count()

    def run(_: int) -> None:
        scratch = aligned((_SCRATCH,))
        while (b := next(numbers)) < count:
            work(b, scratch)

    threads = min(count, os.cpu_count() or 1)
    if threads == 1:
        return run(0)
    list(_pool().map(run, range(threads)))


@functools.lru_cache(maxsize=16)
def _weights_kernel(packed: bool, with_coarse: bool, channels: int, kept: int) -> Kernel:
    """(1): gradients of the logits; weights from number ``kept`` on as planes."""
    taps = OWN + (COARSE if with_coarse else 0)
    parts = 2 if packed else 1
    step = parts * LANES

    def write(code: Code) -> None:
        own, above, grad, planes = (_Image.of(code, first) for first in (0, 4, 8, 12))
        w, stride, plane = code.address(16), code.param(17), code.param(18)
        to, width = code.address(19), code.param(20)

        def slot(k: int, part: int, second: int = 0) -> str:
            return code.at("%scratch", step * (k + second * taps) + LANES * part)

        with code.loop("%first", "%last") as row:
            half = code.integer("lshr", row.i, 1)
            parity = code.integer("and", row.i, 1)
            lines = [
                code.integer("mul", code.integer("add", row.i, dy), own.stride)
                for dy in range(-2, 3)
            ]
            lines2 = [
                code.integer("mul", code.integer("add", half, dy), above.stride)
                for dy in range(-1, 2)
            ]
            if packed:
                begin = code.integer("mul", half, stride)
                begin = code.integer(
                    "add", begin, code.integer("mul", code.integer("mul", parity, 2), plane)
                )
            else:
                begin = code.integer("mul", row.i, stride)
            g_line = code.integer("mul", row.i, grad.stride)
            w_line = code.integer("mul", row.i, planes.stride)
            with code.loop(0, width, step) as x:
                x_half = code.integer("lshr", x.i, 1)
                here = code.integer("add", begin, x_half if packed else x.i)

                def place(k: int, part: int) -> str:
                    number = 4 * k + part if packed else k
                    return code.integer("add", here, code.integer("mul", plane, number))

                def values(k: int, offset: str, offset2: str) -> list[str]:
                    if k < OWN:
                        dy, dx = divmod(k, 5)
                        at = _sum(code, offset, lines[dy], x.i)
                        return [
                            code.load(code.at(own.base, at, LANES * p + dx - 2))
                            for p in range(parts)
                        ]
                    dy, dx = divmod(k - OWN, 3)
                    at = _sum(code, offset2, lines2[dy], x_half)
                    both = code.load(code.at(above.base, at, dx - 1))
                    return [code.shuffle(both, both, _TWICE[p]) for p in range(parts)]

                highest = [code.load(code.at(w, place(0, p))) for p in range(parts)]
                for k in range(1, taps):
                    highest = [
                        code.greater(h, code.load(code.at(w, place(k, p))))
                        for p, h in enumerate(highest)
                    ]
                total = [code.number(TINY)] * parts
                for k in range(taps):
                    e = [
                        code.exp(code.op("fsub", code.load(code.at(w, place(k, p))), highest[p]))
                        for p in range(parts)
                    ]
                    if packed:
                        e = [code.shuffle(e[0], e[1], lanes) for lanes in _WEAVE]
                    masks = values(k, own.mask, above.mask)
                    for p in range(parts):
                        e[p] = code.op("fmul", e[p], masks[p])
                        total[p] = code.op("fadd", total[p], e[p])
                        code.store(e[p], slot(k, p))
                scale = [code.op("fdiv", code.number(1.0), t) for t in total]
                g_at = code.integer("add", g_line, x.i)
                g = [
                    [
                        code.load(
                            code.at(grad.base, code.integer("mul", grad.plane, c), g_at, LANES * p)
                        )
                        for p in range(parts)
                    ]
                    for c in range(channels)
                ]
                dot = [code.number(0.0)] * parts
                for k in range(taps):
                    change = [code.number(0.0)] * parts
                    for c in range(channels):
                        found = values(
                            k,
                            code.integer("mul", own.plane, c),
                            code.integer("mul", above.plane, c),
                        )
                        change = [code.fma(g[c][p], found[p], change[p]) for p in range(parts)]
                    for p in range(parts):
                        weight = code.op("fmul", code.load(slot(k, p)), scale[p])
                        dot[p] = code.fma(weight, change[p], dot[p])
                        code.store(weight, slot(k, p))
                        code.store(change[p], slot(k, p, 1))
                        if k >= kept:
                            at = _sum(
                                code,
                                code.integer("mul", planes.plane, k - kept),
                                w_line,
                                x.i,
                            )
                            code.store(weight, code.at(planes.base, at, LANES * p))
                for k in range(taps):
                    d = [
                        code.op(
                            "fmul",
                            code.load(slot(k, p)),
                            code.op("fsub", code.load(slot(k, p, 1)), dot[p]),
                        )
                        for p in range(parts)
                    ]
                    if packed:
                        d = [code.shuffle(d[0], d[1], lanes) for lanes in (_EVEN, _ODD)]
                    for p in range(parts):
                        code.store(d[p], code.at(to, place(k, p)))

    name = f"pyramid_weights_{int(packed)}{int(with_coarse)}_{channels}_{kept}"
    return Kernel(name, write)


@functools.lru_cache(maxsize=4)
def _own_kernel(channels: int) -> Kernel:
    """(2)"""

    def write(code: Code) -> None:
        grad, planes, out = (_Image.of(code, first) for first in (0, 4, 8))
        width = code.param(12)
        with code.loop("%first", "%last") as row, code.loop(0, width, LANES) as x:
            sums = [code.number(0.0)] * channels
            for k in range(OWN):
                dy, dx = divmod(k, 5)
                y = code.integer("sub", row.i, dy - 2)
                at = code.integer("add", code.integer("mul", y, planes.stride), x.i)
                at = code.integer("add", at, code.integer("mul", planes.plane, k))
                weight = code.load(code.at(planes.base, at, 2 - dx))
                at = code.integer("add", code.integer("mul", y, grad.stride), x.i)
                for c in range(channels):
                    g = code.load(
                        code.at(grad.base, at, code.integer("mul", grad.plane, c), 2 - dx)
                    )
                    sums[c] = code.fma(weight, g, sums[c])
            to = code.integer("add", code.integer("mul", row.i, out.stride), x.i)
            for c in range(channels):
                code.store(sums[c], code.at(out.base, to, code.integer("mul", out.plane, c)))

    return Kernel(f"pyramid_own_{channels}", write)


@functools.lru_cache(maxsize=8)
def _coarse_kernel(channels: int, first: int) -> Kernel:
    """(3): rows are those of the coarser level; ``first``: plane of the first coarse weight."""

    def write(code: Code) -> None:
        grad, planes, out = (_Image.of(code, number) for number in (0, 4, 8))
        width = code.param(12)
        with code.loop("%first", "%last") as row, code.loop(0, width, LANES) as x:
            x2 = code.integer("mul", x.i, 2)
            up = code.integer("mul", row.i, 2)
            sums = [[code.number(0.0)] * 2 for _ in range(channels)]
            for k in range(COARSE):
                dy, dx = divmod(k, 3)
                for a in (0, 1):
                    y = code.integer("add", up, a - 2 * (dy - 1))
                    at = code.integer("add", code.integer("mul", y, planes.stride), x2)
                    at = code.integer("add", at, code.integer("mul", planes.plane, first + k))
                    shift = -2 * (dx - 1)
                    weights = [
                        code.load(code.at(planes.base, at, shift + LANES * p)) for p in (0, 1)
                    ]
                    at = code.integer("add", code.integer("mul", y, grad.stride), x2)
                    for c in range(channels):
                        here = code.integer("add", at, code.integer("mul", grad.plane, c))
                        for p in (0, 1):
                            g = code.load(code.at(grad.base, here, shift + LANES * p))
                            sums[c][p] = code.fma(weights[p], g, sums[c][p])
            to = code.integer("add", code.integer("mul", row.i, out.stride), x.i)
            for c in range(channels):
                even = code.shuffle(sums[c][0], sums[c][1], _EVEN)
                odd = code.shuffle(sums[c][0], sums[c][1], _ODD)
                code.store(
                    code.op("fadd", even, odd),
                    code.at(out.base, to, code.integer("mul", out.plane, c)),
                )

    return Kernel(f"pyramid_coarse_{channels}_{first}", write)
