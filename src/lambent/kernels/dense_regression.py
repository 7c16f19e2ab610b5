"""First-order regression with a centre at every pixel: `lambent.kernels.regression` for stride 1.

The same equations (1) and (2) with the same rounding, up to the order of sums, in loops of our own
(`lambent.kernels.machine`). The image goes by in bands of rows: weights (`WeightRows`), equations
of the centres, their solution (by Dr.Jit), and the prediction of the rows that then have all their
centres. What later rows need stays in rings, so that 361 weights a pixel are never in memory for
the whole image. For 16 neighbouring centres at a time:

- one row of the window is read at once: weights, and features and images less those of the centre,
  go to the scratch memory of the thread (14 KB, the first cache);
- the Gram matrix is summed tile by tile, so that the sums of a tile stay in registers along the
  row: two loads for five multiply-adds;
- the position in y is the same along a row. Sums with it are those of the constant, times it;
- all bandwidths share what they read.

What it earns: with `dense_nlm`, `nfor` takes 3.2 s of processor time at 640x360 in place of 17.6 s
with Dr.Jit's kernels alone (docs/results/kernels.md).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lambent.kernels.arrays import FloatImage, Layout, Planes, aligned, backend
from lambent.kernels.machine import LANES, Code, Kernel
from lambent.kernels.regression import OWN_WEIGHT, solve

#: Sums of a tile: they and what is multiplied fit into 32 registers.
_TILE = 26
#: Images in one kernel.
_IMAGES = 6


@dataclass(frozen=True, eq=False)
class WeightRows:
    """Weights w_cq at bandwidth k = 1 of the windows of all pixels of some rows.

    ``memory`` is a ring, ``(rows, O, stride)`` flat: image row y lies at y modulo ``rows``. 16
    floats in front and behind are readable, since lanes outside the image look there.
    ``fill(first, last)`` computes these rows. Outside the image weights are 0.
    """

    memory: FloatImage
    rows: int
    layout: Layout
    radius: int
    device: str
    fill: Callable[[int, int], None]

    def image(self) -> FloatImage:
        """``(H, O, W)``: all weights, offset by offset; for a ring that holds every row."""
        assert self.rows >= self.layout.height
        self.fill(0, self.layout.height)
        shape = (self.rows, (2 * self.radius + 1) ** 2, self.layout.stride)
        return self.memory.reshape(shape)[: self.layout.height, :, : self.layout.width]


def band_rows() -> int:
    """Rows of a band: work for every thread."""
    import drjit as dr

    return 32 * max(2, dr.thread_count())


def dense_first_order(
    weights: WeightRows,
    features: FloatImage,
    images: FloatImage,
    powers: tuple[int, ...],
    ridge: float,
) -> list[FloatImage]:
    """As `regression.first_order`. The ring holds at least a band and ``2·radius`` rows more."""
    layout, R, band = weights.layout, weights.radius, band_rows()
    assert weights.rows >= min(layout.height, band + 2 * R)
    jit = backend(weights.device)
    seen = Planes.of(features, layout, jit).memory
    fits = []
    for c in range(0, images.shape[2], _IMAGES):
        some = Planes.of(images[:, :, c : c + _IMAGES], layout, jit).memory
        stack = aligned((len(seen) + len(some), *seen.shape[1:]))
        stack[: len(seen)], stack[len(seen) :] = seen, some
        fits.append(_Fit(weights, stack, len(seen), powers, jit))
    most = max(fit.equations for fit in fits)
    sums = aligned((len(powers) * most * band * layout.stride,))  # of whichever fit is at work
    done = 0
    for first in range(0, layout.height, band):
        last = min(first + band, layout.height)
        weights.fill(first, last)
        ready = last if last == layout.height else max(done, last - R)
        for fit in fits:
            fit.solve(first, last, ridge, sums)
            fit.predict(done, ready)
        done = ready
    return [np.concatenate([fit.image(i) for fit in fits], axis=2) for i in range(len(powers))]


class _Fit:
    """The regression of some images: equations of a band, and the planes found for a ring."""

    def __init__(
        self,
        weights: WeightRows,
        stack: FloatImage,
        F: int,
        powers: tuple[int, ...],
        jit: Any,
    ) -> None:
        """``stack``: planes of ``F`` features and of the images."""
        self.weights, self.layout, self.jit = weights, weights.layout, jit
        self.powers = powers
        self.F, self.C, self.n = F, len(stack) - F, F + 3
        self.inside = stack.reshape(len(stack), -1)
        self.pairs = [(i, j) for i in range(self.n) for j in range(i, self.n)]
        stride = self.layout.stride
        R = weights.radius
        self.steps = (np.arange(-R, R + 1) / R).astype(np.float32)
        self.equations = len(self.pairs) + self.n * self.C
        self.ring = weights.rows * stride
        whole = aligned((len(powers) * self.n * self.C * self.ring + 2 * LANES,))
        self.beta = whole[LANES:-LANES].reshape(len(powers), self.n * self.C, self.ring)
        self.result = aligned((len(powers), self.C, self.layout.height, stride))
        self.kernels = _kernels(F, self.C, powers)

    def solve(self, first: int, last: int, ridge: float, memory: FloatImage) -> None:
        """β of the centres of these rows (1). ``memory``: for the equations, of a band."""
        layout, weights, P = self.layout, self.weights, len(self.powers)
        count = (last - first) * layout.stride
        sums = memory[: P * self.equations * count].reshape(P, self.equations, count)
        side = 2 * weights.radius + 1
        self.kernels[0].rows(
            [self.inside, weights.memory, sums, self.steps, layout.stride,
             self.inside.shape[1], layout.margin_rows, weights.radius, first,
             count, _blocks(layout), weights.rows],
            first, last, side * (self.F + self.C + P) * LANES,
        )  # fmt: skip
        for found, beta in zip(sums, self.beta, strict=True):
            self._solve(found, beta, first, last, ridge)

    def _solve(
        self, sums: FloatImage, beta: FloatImage, first: int, last: int, ridge: float
    ) -> None:
        import drjit as dr

        n, F, C, stride = self.n, self.F, self.C, self.layout.stride
        count = (last - first) * stride
        found = [self.jit.Float(row) for row in sums]
        begin = (first + self.layout.margin_rows) * stride
        centre = [self.jit.Float(plane[begin : begin + count]) for plane in self.inside]
        gram = {pair: found[m] for m, pair in enumerate(self.pairs)}
        right = [[found[len(self.pairs) + i * C + c] for c in range(C)] for i in range(n)]
        coefficients = solve(gram, right, n, C, ridge)
        # From differences to the centre, to absolute features.
        for c in range(C):
            constant = coefficients[0][c] + centre[F + c]
            for i in range(F):
                constant = constant - coefficients[3 + i][c] * centre[i]
            coefficients[0][c] = constant
        dr.eval(coefficients)
        rows = np.arange(first, last) % self.weights.rows
        for c in range(C):
            for i in range(n):
                ring = beta[c * n + i].reshape(-1, stride)
                ring[rows] = coefficients[i][c].numpy().reshape(-1, stride)

    def predict(self, first: int, last: int) -> None:
        """ŷ of these rows (2)."""
        layout, weights = self.layout, self.weights
        self.kernels[1].rows(
            [self.inside, weights.memory, self.beta, self.steps, layout.stride,
             self.inside.shape[1], layout.margin_rows, weights.radius, layout.height,
             self.ring, self.result, _blocks(layout), weights.rows],
            first, last,
        )  # fmt: skip

    def image(self, number: int) -> FloatImage:
        """What came of one power ``(H, W, C)``."""
        found = self.result[number, :, :, : self.layout.width]
        return np.ascontiguousarray(found.transpose(1, 2, 0))


def _blocks(layout: Layout) -> int:
    """Columns to compute, in whole vectors."""
    return -(-layout.width // LANES) * LANES


@functools.lru_cache(maxsize=32)
def _kernels(F: int, C: int, powers: tuple[int, ...]) -> tuple[Kernel, Kernel]:
    return (
        Kernel("accumulate", lambda code: _write_sums(code, F, C, powers)),
        Kernel("predict", lambda code: _write_prediction(code, F, C, powers)),
    )


def _power(code: Code, w: str, power: int) -> str:
    while power > 1:
        w, power = code.op("fmul", w, w), power // 2
    return w


def _tiles(rows: int, columns: int) -> Iterator[list[tuple[int, int]]]:
    """The pairs (a, b) with a < rows and a <= b < columns, at most `_TILE` at a time, by rows."""
    tile: list[tuple[int, int]] = []
    for a in range(rows):
        row = [(a, b) for b in range(a, columns)]
        if tile and len(tile) + len(row) > _TILE:
            yield tile
            tile = []
        tile += row
    yield tile


def _write_sums(code: Code, F: int, C: int, powers: tuple[int, ...]) -> None:
    """Σ w x xᵀ and Σ w x yᵀ of every centre of a row (1).

    Here u is (1, dx, f, y): without dy. Pairs go to their places in (1, dx, dy, f) and y.
    """
    planes, weights, sums, steps = (code.address(i) for i in range(4))
    stride, plane, top, R, first, band, columns, ring = (code.param(i) for i in range(4, 12))
    n, K, P = F + 3, F + C + 2, len(powers)
    place = {pair: m for m, pair in enumerate((i, j) for i in range(n) for j in range(i, n))}
    unknown = [0, 1, *range(3, n)]  # of u's entries that are unknowns

    def spot(a: int, b: int) -> int:
        """Where the sum of u_a u_b goes."""
        if b >= F + 2:
            return len(place) + unknown[a] * C + b - F - 2
        return place[unknown[a], unknown[b]]

    side = code.integer("add", code.integer("mul", R, 2), 1)
    offsets = code.integer("mul", side, side)
    images = len(place) + n * C  # of sums, for each power
    entry, zero = (F + C + P) * LANES, "zeroinitializer"
    with code.loop("%first", "%last") as line:
        begin = code.integer("mul", code.integer("add", line.i, top), stride)
        w_row = code.integer("mul", code.integer("srem", line.i, ring), offsets)
        w_row = code.integer("mul", w_row, stride)
        out_row = code.integer("mul", code.integer("sub", line.i, first), stride)
        with code.loop(0, columns, LANES) as column:
            here = code.integer("add", begin, column.i)
            out = [
                code.at(sums, code.integer("mul", band, m), out_row, column.i)
                for m in range(images * P)
            ]
            for address in out:
                code.store(zero, address)
            with code.loop(0, side) as j:
                dy = code.integer("sub", j.i, R)
                ey = code.everywhere(code.at(steps, j.i))
                near = code.integer("add", here, code.integer("mul", dy, stride))
                # ---- u, and w for each power, to the scratch memory: (side, F + C + P, 16)
                w_at = code.integer("mul", code.integer("mul", j.i, side), stride)
                w_at = code.integer("add", code.integer("add", w_row, w_at), column.i)
                bases = [code.integer("mul", plane, k) for k in range(F + C)]
                centre = [code.load(code.at(planes, b, here)) for b in bases]
                with code.loop(0, side) as i:
                    at_w = code.at(weights, w_at, code.integer("mul", i.i, stride))
                    code.prefetch(code.at(at_w, 4 * LANES))
                    q = code.integer("add", code.integer("sub", near, R), i.i)
                    to = code.integer("mul", i.i, entry)
                    w = code.load(at_w)
                    for k, power in enumerate(powers):
                        to_w = code.at("%scratch", to, (F + C + k) * LANES)
                        code.store(_power(code, w, power), to_w)
                    for k, (b, c) in enumerate(zip(bases, centre, strict=True)):
                        u = code.op("fsub", code.load(code.at(planes, b, q)), c)
                        code.store(u, code.at("%scratch", to, k * LANES))
                # ---- the sums, tile by tile
                for k, tile in itertools.product(range(P), _tiles(F + 2, K)):
                    to_k = out[k * images : (k + 1) * images]
                    old = [zero if a == 0 else code.load(to_k[spot(a, b)]) for a, b in tile]
                    with code.loop(0, side, 1, old) as i:
                        from_ = code.at("%scratch", code.integer("mul", i.i, entry))
                        w = code.load(code.at(from_, (F + C + k) * LANES))
                        u_of = {
                            b: code.load(code.at(from_, (b - 2) * LANES))
                            if b > 1
                            else code.everywhere(code.at(steps, i.i))
                            for b in sorted({b for _, b in tile if b})
                        }
                        wu = {a: code.op("fmul", w, u_of[a]) if a else w for a, _ in tile}
                        i.carry = [
                            code.op("fadd", s, wu[a]) if b == 0 else code.fma(wu[a], u_of[b], s)
                            for s, (a, b) in zip(i.carry, tile, strict=True)
                        ]
                    for (a, e), value in zip(tile, i.after, strict=True):
                        address = to_k[spot(a, e)]
                        if a > 0:
                            code.store(value, address)
                            continue
                        # with the constant: the row's own sums, from which those with dy follow
                        code.store(code.op("fadd", code.load(address), value), address)
                        with_y = code.op("fmul", ey, value)
                        if e >= F + 2:
                            m = len(place) + 2 * C + e - F - 2
                        else:
                            m = place[min(2, unknown[e]), max(2, unknown[e])]
                        code.store(code.op("fadd", code.load(to_k[m]), with_y), to_k[m])
                        if e == 0:
                            square = to_k[place[2, 2]]
                            code.store(code.fma(ey, with_y, code.load(square)), square)


def _write_prediction(code: Code, F: int, C: int, powers: tuple[int, ...]) -> None:
    """ŷ of every pixel of a row (2)."""
    planes, weights, beta, steps = (code.address(i) for i in range(4))
    stride, plane, top, R, height, size = (code.param(i) for i in range(4, 10))
    result, columns, ring = code.address(10), code.param(11), code.param(12)
    n, per = F + 3, C + 1
    side = code.integer("add", code.integer("mul", R, 2), 1)
    offsets = code.integer("mul", side, side)
    tables = [code.integer("mul", size, k) for k in range(n * C * len(powers))]
    own = code.number(OWN_WEIGHT)
    with code.loop("%first", "%last") as line:
        begin = code.integer("mul", code.integer("add", line.i, top), stride)
        above = code.integer("add", code.integer("sub", line.i, height), 1)
        low = code.most(code.integer("sub", 0, R), above)
        high = code.least(R, line.i)
        with code.loop(0, columns, LANES) as column:
            here = code.integer("add", begin, column.i)
            bases = [code.integer("mul", plane, k) for k in range(F + C)]
            f = [code.load(code.at(planes, b, here)) for b in bases[:F]]
            y = [code.load(code.at(planes, b, here)) for b in bases[F:]]
            start = [own, *(code.op("fmul", own, v) for v in y)] * len(powers)
            with code.loop(low, code.integer("add", high, 1), 1, start) as j:
                # the centre is at p - (dx, dy)
                row = code.integer("srem", code.integer("sub", line.i, j.i), ring)
                j_at = code.integer("add", j.i, R)
                ey = code.everywhere(code.at(steps, j_at))
                centre = code.integer("mul", row, stride)
                centre = code.integer("add", centre, code.integer("add", column.i, R))
                o = code.integer("mul", row, offsets)
                o = code.integer("add", o, code.integer("mul", j_at, side))
                w_at = code.integer("mul", o, stride)
                w_at = code.integer("add", w_at, code.integer("add", column.i, R))
                with code.loop(0, side, 1, j.carry) as i:
                    at_w = code.integer("add", w_at, code.integer("mul", i.i, stride))
                    address = code.at(weights, code.integer("sub", at_w, i.i))
                    code.prefetch(code.at(address, 4 * LANES))
                    w = code.load(address)
                    c_at = code.integer("sub", centre, i.i)
                    x = [code.everywhere(code.at(steps, i.i)), ey, *f]
                    new = []
                    for k, power in enumerate(powers):
                        sums = i.carry[k * per : (k + 1) * per]
                        w_k = _power(code, w, power)
                        new.append(code.op("fadd", sums[0], w_k))
                        for c in range(C):
                            base = (k * C + c) * n
                            b = [code.load(code.at(beta, t, c_at)) for t in tables[base : base + n]]
                            value = b[0]
                            for slope, along in zip(b[1:], x, strict=True):
                                value = code.fma(slope, along, value)
                            new.append(code.fma(w_k, value, sums[1 + c]))
                    i.carry = new
                j.carry = i.after
            for k in range(len(powers)):
                total, *values = j.after[k * per : (k + 1) * per]
                for c, value in enumerate(values):
                    to = code.integer("mul", code.integer("mul", height, k * C + c), stride)
                    to = code.integer("add", to, code.integer("mul", line.i, stride))
                    code.store(code.op("fdiv", value, total), code.at(result, to, column.i))
