"""Nonlinearly weighted first-order regression over windows, solved for all pixels at once.

At every *centre* c the colours of the window are fitted by a plane in feature space (NFOR, Bitterli
et al. 2016, eq. 6-8, see `lambent.filters.nfor`):

    β_c = argmin_β Σ_q w_cq (y_q − x_cqᵀ β)²,   x_cq = (1, x_q − x_c, y_q − y_c, f_q − f_c)      (1)

and the planes of all windows that hold a pixel p are averaged ("collaborative"):

    ŷ_p = Σ_c w_cp x_cpᵀ β_c / Σ_c w_cp                                                        (2)

Both are linear in y: any number of images is fitted with the one factorisation of the weighted
Gram matrix.

How it runs, and why. The weights come from 7x7 patch distances, which are cheap only offset by
offset (box filter), while the Gram matrix wants all offsets of a pixel together in registers. So
the weights are written out once (one plane an offset, neighbours in x side by side), and the
regression reads them back: 361 floats a centre, next to the 85 multiply-adds a pair that the Gram
matrix costs. The narrow bandwidth k/2 needs no second set of distances: with w = exp(−D/k²) it is
w⁴. Everything is written as a loop *inside* the kernel: unrolled, LLVM needs longer than the image.
``stride`` places centres on every ``stride``-th pixel only; every pixel is still predicted by all
the centres around it, and the cost falls with its square.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import backend

Image = NDArray[np.float32]

#: Below this share of its own energy a feature is explained by those before it (rank test).
RANK = 1e-6
#: A feature that varies by less than this within a window says nothing: its slope is held down
#: (Tikhonov). Slopes stay below 1/(2·QUIET) of the image, so that single precision suffices.
QUIET = 1e-3
#: Keeps 0/0 out of patch distances where there is no variance (radiance²).
TINY = 1e-10
#: A pixel unlike every centre keeps its own value: weight of that value (the least weight of a
#: centre in the authors' implementation).
OWN_WEIGHT = 1e-4
#: Largest normalised distance of one pixel: one wild pixel must not decide over a whole patch.
FARTHEST = 1e4


@dataclass(frozen=True)
class Window:
    """Sizes: ``radius`` of the window, ``patch`` of the compared patches, ``stride`` of centres."""

    radius: int = 9
    patch: int = 3
    stride: int = 2

    def offsets(self) -> int:
        """Pixels in the window."""
        return (2 * self.radius + 1) ** 2

    def centres(self, size: int) -> int:
        """Centres along an axis of ``size`` pixels."""
        return (size - 1) // self.stride + 1


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights w_cq at bandwidth k = 1, one plane an offset, on the device: ``(O, Hc, Wc)`` flat."""

    planes: Any
    height: int
    width: int
    window: Window
    device: str


def patch_weights(
    guide: Image, variance: Image, window: Window, device: str = "auto", k: float = 1.0
) -> Weights:
    """Non-local-means weights of every centre's window, from patches of ``guide``.

    ``guide`` ``(H, W, C)`` and ``variance`` ``(H, W, C)`` of its pixels. The distance of two pixels
    is that of Rousselle et al. 2012 (eq. 3 and 4), with the variance cancelled:

        Δ²(p, q) = ((u_p − u_q)² − (v_p + min(v_p, v_q))) / (ε + k² (v_p + v_q))                (3)

    averaged over channels and the patch; w = exp(−max(0, Δ²)). Zero outside the image.
    """
    jit = backend(device)
    import drjit as dr

    height, width, channels = guide.shape
    R, F, s = window.radius, window.patch, window.stride
    pad = R + F
    pitch = width + 2 * pad
    u = [_plane(jit, guide[:, :, c], pad) for c in range(channels)]
    v = [_plane(jit, variance[:, :, c], pad) for c in range(channels)]
    rows_c, cols_c = window.centres(height), window.centres(width)
    n_centres = rows_c * cols_c
    side = 2 * R + 1
    planes = dr.zeros(jit.Float, window.offsets() * n_centres)

    # Stripes keep the distance planes, (O, rows, W + 2F), near 100 MB.
    span = width + 2 * F
    stripe = max(1, min(rows_c, int(24e6 / (window.offsets() * span * s)) or 1))
    for first in range(0, rows_c, stripe):
        count = min(stripe, rows_c - first)
        top = first * s  # first image row of centres; distances start F rows above
        rows = (count - 1) * s + 1 + 2 * F
        cells = rows * span
        index = dr.arange(jit.UInt32, cells)
        y = index // span
        x = index - y * span
        here = (y + top + R) * pitch + x + R  # in the padded planes
        up = [dr.gather(jit.Float, p, here) for p in u]
        vp = [dr.gather(jit.Float, p, here) for p in v]
        distance = dr.empty(jit.Float, cells * window.offsets())

        def step(
            o: Any,
            dx: Any,
            q: Any,
            at: Any,
            here: Any = here,
            up: list = up,
            vp: list = vp,
            distance: Any = distance,
            cells: int = cells,
        ) -> tuple[Any, Any, Any, Any]:
            total = jit.Float(0)
            for c in range(channels):
                uq = dr.gather(jit.Float, u[c], q)
                vq = dr.gather(jit.Float, v[c], q)
                d = up[c] - uq
                least = dr.select(vp[c] < vq, vp[c], vq)
                top_ = d * d - (vp[c] + least)
                bottom = TINY + (k * k) * (vp[c] + vq)
                one = top_ / bottom
                total += dr.select(one < FARTHEST, one, FARTHEST)
            dr.scatter(distance, total * (1.0 / channels), at)
            wrap = dx == 2 * R
            return (
                o + 1,
                dr.select(wrap, 0, dx + 1),
                q + dr.select(wrap, jit.UInt32(pitch - 2 * R), jit.UInt32(1)),
                at + cells,
            )

        dr.while_loop(
            (jit.UInt32(0), jit.UInt32(0), here - (R * pitch + R), jit.UInt32(index)),
            lambda o, dx, q, at: o < window.offsets(),
            step,
            labels=("o", "dx", "q", "at"),
        )
        dr.eval(distance)

        # Box filter down the columns, at rows of centres only.
        index = dr.arange(jit.UInt32, count * span)
        y = index // span
        x = index - y * span
        columns = dr.empty(jit.Float, count * span * window.offsets())
        start = (y * s) * span + x

        def down(
            o: Any,
            at: Any,
            to: Any,
            distance: Any = distance,
            columns: Any = columns,
            cells: int = cells,
            count: int = count,
        ) -> tuple[Any, Any, Any]:
            total = jit.Float(0)
            for j in range(2 * F + 1):
                total += dr.gather(jit.Float, distance, at + j * span)
            dr.scatter(columns, total, to)
            return o + 1, at + cells, to + count * span

        dr.while_loop(
            (jit.UInt32(0), start, jit.UInt32(index)),
            lambda o, at, to: o < window.offsets(),
            down,
            labels=("o", "at", "to"),
        )
        dr.eval(columns)

        # Along the rows, and the exponential.
        index = dr.arange(jit.UInt32, count * cols_c)
        y = index // cols_c
        x = index - y * cols_c
        py = jit.Int32(y + first) * s
        px = jit.Int32(x) * s
        start = y * span + x * s
        to = (y + first) * cols_c + x

        def along(
            o: Any,
            dx: Any,
            qx: Any,
            qy: Any,
            at: Any,
            to: Any,
            columns: Any = columns,
            count: int = count,
        ) -> tuple[Any, ...]:
            total = jit.Float(0)
            for i in range(2 * F + 1):
                total += dr.gather(jit.Float, columns, at + i)
            total *= 1.0 / (2 * F + 1) ** 2
            w = dr.exp(-dr.select(total > 0, total, 0))
            inside = (qx >= 0) & (qx < width) & (qy >= 0) & (qy < height)
            dr.scatter(planes, dr.select(inside, w, 0), to)
            wrap = dx == 2 * R
            return (
                o + 1,
                dr.select(wrap, 0, dx + 1),
                dr.select(wrap, qx - 2 * R, qx + 1),
                dr.select(wrap, qy + 1, qy),
                at + count * span,
                to + n_centres,
            )

        dr.while_loop(
            (jit.UInt32(0), jit.UInt32(0), px - R, py - R, start, to),
            lambda o, dx, qx, qy, at, to: o < window.offsets(),
            along,
            labels=("o", "dx", "qx", "qy", "at", "to"),
        )
        dr.eval(planes)
    assert side * side == window.offsets()
    return Weights(planes, height, width, window, device)


def _plane(jit: Any, image: Image, pad: int, mode: Any = "symmetric") -> Any:
    """One channel, padded, flat on the device."""
    return jit.Float(np.ascontiguousarray(np.pad(image, pad, mode=mode), np.float32).ravel())


def first_order(
    weights: Weights,
    features: Image,
    images: Image,
    powers: tuple[int, ...] = (1,),
    ridge: float = 1e-5,
) -> list[Image]:
    """Fit every window (1) and average the planes (2); one result for each power of the weights.

    ``features`` ``(H, W, F)`` in ranges near 1, ``images`` ``(H, W, C)``: any linear data.
    ``powers``: 1 is the bandwidth of ``weights``, 4 is half of it. ``ridge``: Tikhonov term as a
    share of each feature's own energy in its window; the constant is not shrunk.
    Returns images ``(H, W, C)`` float32.
    """
    results: list[Image] = []
    for power in powers:
        # At most 6 channels a kernel: more right-hand sides than that fall out of the L1 cache.
        parts = [
            _fit(weights, features, images[:, :, c : c + 6], power, ridge)
            for c in range(0, images.shape[2], 6)
        ]
        results.append(parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2))
    return results


def spread(weights: Weights, images: Image) -> Image:
    """Weighted means of the values *at the centres* near every pixel: Σ_c w_cp v_c / Σ_c w_cp.

    ``images`` ``(H, W, C)``; the same shape comes back. What smooths maps of errors.
    """
    import drjit as dr

    jit = backend(weights.device)
    s = weights.window.stride
    values = [
        jit.Float(np.ascontiguousarray(v[::s, ::s]).ravel()) for v in np.moveaxis(images, 2, 0)
    ]

    def visit(near: _Near, w: Any, out: list[Any]) -> list[Any]:
        here = [dr.gather(jit.Float, v, near.centre, near.ok) for v in values]
        return [dr.fma(w, v, o) for v, o in zip(here, out, strict=True)]

    own = [jit.Float(np.ascontiguousarray(images[:, :, c]).ravel()) for c in range(len(values))]
    return _from_centres(jit, weights, 1, own, visit)


def _power(w: Any, power: int) -> Any:
    """``w`` to a power of 1, 2 or 4."""
    while power > 1:
        w, power = w * w, power // 2
    return w


def _fit(weights: Weights, features: Image, images: Image, power: int, ridge: float) -> Image:
    import drjit as dr

    jit = backend(weights.device)
    window, height, width = weights.window, weights.height, weights.width
    R, s = window.radius, window.stride
    pitch = width + 2 * R
    f = [_plane(jit, features[:, :, i], R) for i in range(features.shape[2])]
    y = [_plane(jit, images[:, :, c], R) for c in range(images.shape[2])]
    n, C = len(f) + 3, len(y)
    rows_c, cols_c = window.centres(height), window.centres(width)
    n_centres = rows_c * cols_c

    # -------------------------------------------- sums over the window of every centre
    index = dr.arange(jit.UInt32, n_centres)
    cy = index // cols_c
    cx = index - cy * cols_c
    here = (cy * s + R) * pitch + cx * s + R
    fc = [dr.gather(jit.Float, p, here) for p in f]
    pairs = [(i, j) for i in range(n) for j in range(i, n)]

    def add(*state: Any) -> tuple[Any, ...]:
        o, dx, q, at, ex, ey, *sums = state
        w = _power(dr.gather(jit.Float, weights.planes, at), power)
        x = [None, ex, ey] + [dr.gather(jit.Float, p, q) - c for p, c in zip(f, fc, strict=True)]
        v = [dr.gather(jit.Float, p, q) for p in y]
        wx = [w] + [w * xi for xi in x[1:]]
        for m, (i, j) in enumerate(pairs):
            sums[m] = sums[m] + wx[j] if i == 0 else dr.fma(wx[i], x[j], sums[m])
        m = len(pairs)
        for i in range(n):
            for c in range(C):
                sums[m] = dr.fma(wx[i], v[c], sums[m])
                m += 1
        wrap = dx == 2 * R
        return (
            o + 1,
            dr.select(wrap, 0, dx + 1),
            q + dr.select(wrap, jit.UInt32(pitch - 2 * R), jit.UInt32(1)),
            at + n_centres,
            dr.select(wrap, -1.0, ex + 1.0 / R),
            dr.select(wrap, ey + 1.0 / R, ey),
            *sums,
        )

    zeros = [dr.zeros(jit.Float, n_centres) for _ in range(len(pairs) + n * C)]
    start = (
        jit.UInt32(0),
        jit.UInt32(0),
        here - (R * pitch + R),
        jit.UInt32(index),
        jit.Float(-1.0),
        jit.Float(-1.0),
        *zeros,
    )
    done = dr.while_loop(start, lambda o, *_: o < window.offsets(), add)
    sums = list(done[6:])
    gram = {pair: sums[m] for m, pair in enumerate(pairs)}
    right = [[sums[len(pairs) + i * C + c] for c in range(C)] for i in range(n)]
    beta = _solve(dr, gram, right, n, C, ridge)
    # From differences to the centre, to absolute features: nothing of the centre is needed later.
    for c in range(C):
        for i, centre in enumerate(fc):
            beta[0][c] = beta[0][c] - beta[3 + i][c] * centre
    per = -(-(n * C) // 4) * 4  # floats a centre, in packets of four
    flat = [beta[i][c] for c in range(C) for i in range(n)]
    flat += [jit.Float(0)] * (per - n * C)
    dr.eval(flat)  # all at once: every scatter below would run the loop again
    table = dr.empty(jit.Float, n_centres * per)
    for g in range(0, per, 4):
        dr.scatter(table, jit.Array4f(*flat[g : g + 4]), index * (per // 4) + g // 4)
    dr.eval(table)

    # ------------------------------------------------ every pixel, from all centres near
    index = dr.arange(jit.UInt32, height * width)
    py = index // width
    here = (py + R) * pitch + (index - py * width) + R
    fp = [dr.gather(jit.Float, p, here) for p in f]

    def visit(near: _Near, w: Any, out: list[Any]) -> list[Any]:
        coefficients: list[Any] = []
        for g in range(per // 4):
            coefficients += list(
                dr.gather(jit.Array4f, table, near.centre * (per // 4) + g, near.ok)
            )
        x = [None, near.dx * (1.0 / R), near.dy * (1.0 / R), *fp]
        for c in range(C):
            value = coefficients[c * n]
            for k in range(1, n):
                value = dr.fma(coefficients[c * n + k], x[k], value)
            out[c] = dr.fma(w, value, out[c])
        return out

    own = [dr.gather(jit.Float, p, here) for p in y]
    return _from_centres(jit, weights, power, own, visit)


@dataclass
class _Near:
    """A centre near a pixel, inside a kernel: its index, whether it is one, and pixel − centre."""

    centre: Any
    ok: Any
    dx: Any
    dy: Any


def _from_centres(
    jit: Any,
    weights: Weights,
    power: int,
    own: list[Any],
    visit: Callable[[_Near, Any, list[Any]], list[Any]],
) -> Image:
    """For every pixel the weighted mean of what ``visit`` adds for each centre near it.

    ``own``: the pixels' own values, which count with `OWN_WEIGHT`. Returns ``(H, W, len(own))``.
    """
    import drjit as dr

    window, height, width = weights.window, weights.height, weights.width
    R, s = window.radius, window.stride
    rows_c, cols_c = window.centres(height), window.centres(width)
    n_centres = rows_c * cols_c
    index = dr.arange(jit.UInt32, height * width)
    py = index // width
    px = index - py * width
    # The first centre at or after p − R, by a division of what is not negative.
    cy0 = jit.Int32((py + (R * s - R + s - 1)) // s) - R
    cx0 = jit.Int32((px + (R * s - R + s - 1)) // s) - R
    reach = 2 * R // s + 1

    def step(*state: Any) -> tuple[Any, ...]:
        t, i, ccy, ccx, total, *out = state
        dy = jit.Int32(py) - ccy * s
        dx = jit.Int32(px) - ccx * s
        ok = (ccy >= 0) & (ccy < rows_c) & (ccx >= 0) & (ccx < cols_c) & (dy >= -R) & (dx >= -R)
        centre = jit.UInt32(ccy * cols_c + ccx)
        plane = jit.UInt32((dy + R) * (2 * R + 1) + dx + R)
        w = _power(dr.gather(jit.Float, weights.planes, plane * n_centres + centre, ok), power)
        out = visit(_Near(centre, ok, jit.Float(dx), jit.Float(dy)), w, out)
        wrap = i == reach - 1
        return (
            t + 1,
            dr.select(wrap, 0, i + 1),
            dr.select(wrap, ccy + 1, ccy),
            dr.select(wrap, ccx - (reach - 1), ccx + 1),
            total + w,
            *out,
        )

    start = [value * OWN_WEIGHT for value in own]
    done = dr.while_loop(
        (jit.UInt32(0), jit.UInt32(0), cy0, cx0, jit.Float(OWN_WEIGHT), *start),
        lambda t, *_: t < reach * reach,
        step,
    )
    scale = dr.rcp(done[4])
    means = [value * scale for value in done[5:]]
    dr.eval(means)
    return np.stack([value.numpy().reshape(height, width) for value in means], axis=2)


def _solve(
    dr: Any,
    gram: dict[tuple[int, int], Any],
    right: list[list[Any]],
    n: int,
    C: int,
    ridge: float,
) -> list[list[Any]]:
    """Cholesky LDLᵀ without square roots, in registers. A pivot that has lost all its energy
    belongs to a feature that others explain: its coefficient is 0.
    """
    energy = [gram[(i, i)] for i in range(n)]
    lower: dict[tuple[int, int], Any] = {}
    inverse: list[Any] = []
    for j in range(n):
        pivot = gram[(j, j)]
        if j > 0:
            pivot = dr.fma(energy[0], QUIET**2, dr.fma(energy[j], ridge, pivot))
        for k in range(j):
            pivot = pivot - lower[(j, k)] * scaled[k][j]  # noqa: F821
        sound = pivot > energy[j] * RANK
        inverse.append(dr.select(sound & (pivot > 0), dr.rcp(pivot), 0))
        if j == 0:
            scaled: dict[int, dict[int, Any]] = {}
        scaled[j] = {}
        for i in range(j + 1, n):
            value = gram[(j, i)]
            for k in range(j):
                value = value - lower[(i, k)] * scaled[k][j]
            scaled[j][i] = value  # L_ij d_j
            lower[(i, j)] = value * inverse[j]
    beta: list[list[Any]] = [[None] * C for _ in range(n)]
    for c in range(C):
        z: list[Any] = []
        for i in range(n):
            value = right[i][c]
            for k in range(i):
                value = value - lower[(i, k)] * z[k]
            z.append(value)
        for i in reversed(range(n)):
            value = z[i] * inverse[i]
            for k in range(i + 1, n):
                value = value - lower[(k, i)] * beta[k][c]
            beta[i][c] = value
    return beta
