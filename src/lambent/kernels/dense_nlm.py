"""Patch distances in bands of rows that stay in the cache: `lambent.kernels.nlm` for NFOR.

The distance of Rousselle et al. 2012 (`nlm.variance_difference`), each channel by itself:

    D_o(p) = mean over t in the patch of δ(p + t, p + t + o)

Only pairs inside the image count. For a band of rows and one offset at a time, δ of a row and its
sums along the row go to the scratch memory of the thread, then the sums down the columns, and what
is wanted of the weight follows at once: nothing but that leaves the second cache. Two
kernels in loops of our own (`lambent.kernels.machine`): `least_weight_rows`, the least weight of
the channels, is written out for a regression; `channel_mean` is a weighted mean. What they earn is
told in `lambent.kernels.dense_regression`.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import FloatImage, Layout, Planes, aligned, backend, valid_pixels
from lambent.kernels.dense_regression import WeightRows, band_rows
from lambent.kernels.machine import LANES, Code, Kernel
from lambent.kernels.regression import FARTHEST, TINY
from lambent.kernels.window import keep_untouched

#: Rows of a band.
_BAND = 32


def least_weight_rows(
    guide: FloatImage,
    variance: FloatImage,
    radius: int,
    patch: int,
    k: float,
    device: str,
    rows: int | None = None,
) -> WeightRows:
    """As `regression.least_weights` at stride 1, row by row into a ring.

    ``rows`` of the ring: by default what `dense_first_order` needs.
    """
    work = _Work.of(guide, variance, radius, patch, (k * k, 1.0, TINY), device)
    layout = work.layout
    rows = rows or min(layout.height, band_rows() + 2 * radius)
    memory = aligned((rows * (2 * radius + 1) ** 2 * layout.stride + 2 * LANES,))[LANES:-LANES]
    kernel = _kernel(guide.shape[2], patch, FARTHEST, 0)

    def fill(first: int, last: int) -> None:
        work.run(kernel, first, last, work.mask, work.planes, 0, memory, rows)

    return WeightRows(memory, rows, layout, radius, device, fill)


def channel_mean(
    targets: NDArray[np.float32],
    guide: NDArray[np.float32],
    variance: NDArray[np.float32],
    radius: int,
    patch: int,
    numbers: Sequence[float],
    device: str,
) -> FloatImage:
    """As `nlm.nlm_mean` of ``targets`` ``(H, W, T)`` with a ``guide`` of one channel.

    ``numbers``: k², α, ε of `nlm.variance_difference`.
    """
    work = _Work.of(guide, variance, radius, patch, numbers, device)
    layout, module = work.layout, backend(device)
    valid = Planes.of(valid_pixels(guide, variance, targets), layout, module).memory
    images = Planes.of(targets, layout, module).memory
    count = targets.shape[2]
    result = aligned((count, layout.height, layout.stride))
    kernel = _kernel(1, patch, None, count)
    work.run(kernel, 0, layout.height, valid, images, count, result, layout.height)
    mean = np.ascontiguousarray(result[:, :, : layout.width].transpose(1, 2, 0))
    return keep_untouched(mean, targets)


@dataclass(frozen=True, eq=False)
class _Work:
    """What the kernels read.

    ``tables`` ``(2, 2·radius + 1, longest side)``: one over the pairs of a patch that are inside
    the image, along x and along y, by step and place. ``numbers``: k², α, ε.
    """

    layout: Layout
    planes: FloatImage
    mask: FloatImage
    tables: FloatImage
    numbers: FloatImage
    radius: int
    patch: int

    @classmethod
    def of(
        cls,
        guide: FloatImage,
        variance: FloatImage,
        radius: int,
        patch: int,
        numbers: Sequence[float],
        device: str,
    ) -> _Work:
        height, width = guide.shape[:2]
        module = backend(device)
        layout = Layout(height, width, 2 * radius + patch + 2)
        planes = Planes.stacked([guide, variance], layout, module).memory
        mask = Planes.of(valid_pixels(guide, variance), layout, module).memory
        tables = aligned((2, 2 * radius + 1, max(layout.stride, height)))
        for table, size in zip(tables, (width, height), strict=True):
            place = np.arange(table.shape[1])
            for step in range(-radius, radius + 1):
                first, last = max(0, -step), min(size - 1, size - 1 - step)
                pairs = np.minimum(place + patch, last) - np.maximum(place - patch, first) + 1
                table[step + radius] = 1 / np.maximum(pairs, 1)
        knobs = np.array(numbers, np.float32)
        return cls(layout, planes, mask, tables, knobs, radius, patch)

    def run(
        self,
        kernel: Kernel,
        first: int,
        last: int,
        valid: FloatImage,
        targets: FloatImage,
        count: int,
        result: FloatImage,
        rows: int,
    ) -> None:
        """``valid``: 1 at pixels that get weight; ``targets``: ``count`` planes to average;
        ``result`` has room for ``rows`` rows of the image.
        """
        layout = self.layout
        columns = -(-layout.width // LANES) * LANES
        margin = -(-self.patch // LANES) * LANES
        scratch = columns + 2 * margin + (_BAND + 2 * self.patch) * columns
        scratch += (1 + (count + 1 if count else 0)) * _BAND * columns
        kernel.rows(
            [self.planes, self.mask, valid, self.tables, self.numbers, result, targets,
             layout.stride, self.planes[0].size, layout.margin_rows, self.radius, columns,
             self.tables.shape[2], rows],
            first, last, scratch, _BAND,
        )  # fmt: skip


@functools.lru_cache(maxsize=32)
def _kernel(channels: int, patch: int, bound: float | None, targets: int) -> Kernel:
    return Kernel("patches", lambda code: _write(code, channels, patch, bound, targets))


def _write(code: Code, channels: int, patch: int, bound: float | None, targets: int) -> None:
    """The kernel; ``targets``: how many images to average, 0 to write the weights out."""
    guide, mask, valid, tables, numbers, result, images = (code.address(i) for i in range(7))
    stride, plane, top, R, columns, table, ring = (code.param(i) for i in range(7, 14))
    margin = -(-patch // LANES) * LANES
    rows_in = 2 * patch
    k2, alpha, epsilon = (code.everywhere(code.at(numbers, i)) for i in range(3))
    side = code.integer("add", code.integer("mul", R, 2), 1)
    offsets = code.integer("mul", side, side)
    count = code.integer("sub", "%last", "%first")
    zero = "zeroinitializer"
    # scratch: one row of δ with empty ends; sums along rows; the greatest distance; sums
    raw = code.at("%scratch", margin)
    sums = code.at(raw, columns, margin)
    far = code.at(sums, code.integer("mul", columns, code.integer("add", count, rows_in)))
    band = code.integer("mul", columns, count)
    totals = code.at(far, band)
    if targets:
        everything = code.integer("mul", band, targets + 1)
        with code.loop(0, everything, LANES) as i:
            code.store(zero, code.at(totals, i.i))
    planes = [code.integer("mul", plane, c) for c in range(max(2 * channels, targets))]
    start = code.integer("mul", code.integer("add", "%first", top), stride)
    with code.loop(0, side) as j, code.loop(0, side) as i:
        dy, dx = code.integer("sub", j.i, R), code.integer("sub", i.i, R)
        shift = code.integer("add", code.integer("mul", dy, stride), dx)
        o = code.integer("add", code.integer("mul", j.i, side), i.i)
        x_table = code.at(tables, code.integer("mul", i.i, table))
        y_table = code.at(tables, code.integer("mul", code.integer("add", j.i, side), table))
        y_table = code.at(y_table, "%first")
        for c in range(channels):
            # ---- δ, and its sums along the rows
            with code.loop(0, code.integer("add", count, rows_in)) as r:
                row = code.integer("mul", code.integer("sub", r.i, patch), stride)
                row = code.integer("add", start, row)
                with code.loop(0, columns, LANES) as x:
                    p = code.integer("add", row, x.i)
                    q = code.integer("add", p, shift)
                    up, uq = (code.load(code.at(guide, planes[c], at)) for at in (p, q))
                    vp, vq = (code.load(code.at(guide, planes[channels + c], at)) for at in (p, q))
                    both = code.op("fmul", *(code.load(code.at(mask, at)) for at in (p, q)))
                    step = code.op("fsub", up, uq)
                    noise = code.op("fadd", vp, code.smaller(vp, vq))
                    above = code.op(
                        "fsub", code.op("fmul", step, step), code.op("fmul", alpha, noise)
                    )
                    below = code.fma(k2, code.op("fadd", vp, vq), epsilon)
                    delta = code.ratio(above, below)
                    if bound is not None:
                        delta = code.smaller(delta, code.number(bound))
                    code.store(code.op("fmul", delta, both), code.at(raw, x.i))
                to = code.integer("mul", r.i, columns)
                with code.loop(0, columns, LANES) as x:
                    total = code.load(code.at(raw, x.i, -patch))
                    for t in range(-patch + 1, patch + 1):
                        total = code.op("fadd", total, code.load(code.at(raw, x.i, t)))
                    total = code.op("fmul", total, code.load(code.at(x_table, x.i)))
                    code.store(total, code.at(sums, to, x.i))
            # ---- down the columns, and what comes of it
            with code.loop(0, count) as r:
                share = code.everywhere(code.at(y_table, r.i))
                from_ = code.integer("mul", r.i, columns)
                here = code.integer("add", start, code.integer("mul", r.i, stride))
                out = code.integer("srem", code.integer("add", "%first", r.i), ring)
                out = code.integer("mul", out, offsets)
                out = code.integer("mul", code.integer("add", out, o), stride)
                with code.loop(0, columns, LANES) as x:
                    at = code.at(sums, from_, x.i)
                    total = code.load(at)
                    for t in range(1, 2 * patch + 1):
                        more = code.load(code.at(at, code.integer("mul", columns, t)))
                        total = code.op("fadd", total, more)
                    distance = code.greater(code.op("fmul", total, share), zero)
                    spot = code.at(far, from_, x.i)
                    if c > 0:
                        distance = code.greater(distance, code.load(spot))
                    if c < channels - 1:
                        code.store(distance, spot)
                        continue
                    w = code.exp(code.op("fsub", zero, distance))
                    p = code.integer("add", here, x.i)
                    q = code.integer("add", p, shift)
                    w = code.op("fmul", w, code.load(code.at(valid, q)))
                    if not targets:
                        w = code.op("fmul", w, code.load(code.at(valid, p)))
                        code.store(w, code.at(result, out, x.i))
                        continue
                    place = code.at(totals, from_, x.i)
                    code.store(code.op("fadd", code.load(place), w), place)
                    for t in range(targets):
                        place = code.at(place, band)
                        value = code.load(code.at(images, planes[t], q))
                        code.store(code.fma(w, value, code.load(place)), place)
    if targets:
        with code.loop(0, count) as r, code.loop(0, columns, LANES) as x:
            place = code.at(totals, code.integer("mul", r.i, columns), x.i)
            total = code.load(place)
            to = code.integer("mul", code.integer("add", "%first", r.i), stride)
            for t in range(targets):
                place = code.at(place, band)
                to_t = code.integer("mul", code.integer("mul", ring, t), stride)
                mean = code.op("fdiv", code.load(place), total)
                code.store(mean, code.at(result, to_t, to, x.i))
