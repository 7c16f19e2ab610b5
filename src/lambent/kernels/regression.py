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
regression reads them back: 361 floats a centre, next to the 95 multiply-adds a pair that the Gram
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
from lambent.kernels.exponential import exp_weight
from lambent.kernels.extremes import smaller
from lambent.kernels.nlm import PatchSearch, mean_along, variance_difference

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

    height, width, _ = guide.shape
    R, F, s = window.radius, window.patch, window.stride
    rows_c, cols_c = window.centres(height), window.centres(width)
    both = _packets(jit, np.concatenate([guide, variance], axis=2), R + F)
    planes = dr.empty(jit.Float, window.offsets() * rows_c * cols_c)
    span = width + 2 * F
    # Stripes keep the column sums, (O, rows of centres, W + 2F), near 50 MB.
    stripe = max(1, int(12e6 / (window.offsets() * span)))
    for first in range(0, rows_c, stripe):
        count = min(stripe, rows_c - first)
        columns = _column_sums(jit, both, guide.shape, window, k, first * s, count)
        _row_weights(jit, columns, planes, guide.shape, window, first, count)
    return Weights(planes, height, width, window, device)


def least_weights(
    guide: Image, variance: Image, window: Window, device: str = "auto", k: float = 1.0
) -> Weights:
    """As `patch_weights`, with the least weight of the channels instead of their mean distance.

    Patches at the borders count what is inside the image. Offset by offset on whole images
    (`lambent.kernels.nlm`): centres that a stride leaves out save nothing here.
    """
    import drjit as dr

    jit = backend(device)
    height, width, channels = guide.shape
    R, s = window.radius, window.stride
    numbers = (k * k, 1.0, TINY)
    searches = [
        PatchSearch.of(
            guide[:, :, c : c + 1],
            variance[:, :, c : c + 1],
            R,
            window.patch,
            _bounded_difference,
            numbers,
            device=device,
        )
        for c in range(channels)
    ]
    rows_c, cols_c = window.centres(height), window.centres(width)
    planes = np.empty((window.offsets(), rows_c, cols_c), np.float32)
    layout = searches[0].layout
    waiting: list[tuple[int, Any]] = []

    def store() -> None:
        for number, w in waiting:
            image = w.numpy().reshape(layout.height, layout.stride)
            planes[number] = image[::s, :width:s]

    for batch in searches[0].batches():
        rows = [search.row_means(batch) for search in searches]
        weights = []
        for i, (dx, dy) in enumerate(batch):
            farthest = jit.Float(0)
            for search, found in zip(searches, rows, strict=True):
                (views,) = search.column_views([found[i]])
                distance = mean_along(views, search.rows.view(), search.column_ends(dy))
                farthest = dr.select(distance > farthest, distance, farthest)
            w = exp_weight(-farthest) * searches[0].mask.view(0, dx, dy)
            weights.append(((dy + R) * (2 * R + 1) + dx + R, w))
        dr.eval([w for _, w in weights])
        store()  # of the batch before, while this one is computed
        waiting = weights
    store()
    return Weights(jit.Float(planes.ravel()), height, width, window, device)


def _bounded_difference(
    p: list[Any], q: list[Any], vp: list[Any], vq: list[Any], k: list[Any]
) -> Any:
    return smaller(variance_difference(p, q, vp, vq, k), FARTHEST)


def _column_sums(
    jit: Any,
    both: list[Any],
    shape: tuple[int, ...],
    window: Window,
    k: float,
    top: int,
    count: int,
) -> Any:
    """Distances (3) summed down the columns of patches, for ``count`` rows of centres.

    A thread has one offset and one column and walks down: the distances of the rows that two
    patches share stay in registers, so that no plane of distances is ever written.
    ``(O, count, W + 2F)``, flat.
    """
    import drjit as dr

    width, channels = shape[1:3]
    R, F, s = window.radius, window.patch, window.stride
    side, tall = 2 * R + 1, 2 * F + 1
    span = dr.opaque(jit.UInt32, width + 2 * F)
    pitch = dr.opaque(jit.UInt32, width + 2 * (R + F))
    index = dr.arange(jit.UInt32, side * side * (width + 2 * F))
    offset = index // span
    x = index - offset * span
    oy = offset // side
    ox = offset - oy * side
    first = dr.opaque(jit.UInt32, top + R) * pitch + x + R
    shift = oy * pitch + ox - (R * pitch + R)

    def distance(p: Any) -> Any:
        here, there = _packet(jit, both, p), _packet(jit, both, p + shift)
        total = jit.Float(0)
        for c in range(channels):
            vp, vq = here[channels + c], there[channels + c]
            d = here[c] - there[c]
            above = d * d - (vp + dr.select(vp < vq, vp, vq))
            one = above / (TINY + (k * k) * (vp + vq))
            total += dr.select(one < FARTHEST, one, FARTHEST)
        return total

    kept = max(0, tall - s)
    sums = dr.empty(jit.Float, side * side * count * (width + 2 * F))
    last = dr.opaque(jit.UInt32, count)

    def walk(row: Any, p: Any, to: Any, *old: Any) -> tuple[Any, ...]:
        new = [*old, *(distance(p + j * pitch) for j in range(kept, tall))]
        total = new[0]
        for value in new[1:]:
            total = total + value
        dr.scatter(sums, total * (1.0 / (channels * tall * tall)), to)
        return (row + 1, p + s * pitch, to + span, *new[len(new) - kept :])

    start = [distance(first + j * pitch) for j in range(kept)]
    dr.while_loop(
        (jit.UInt32(0), first, offset * (last * span) + x, *start),
        lambda row, *_: row < last,
        walk,
    )
    dr.eval(sums)
    return sums


def _row_weights(
    jit: Any,
    columns: Any,
    planes: Any,
    shape: tuple[int, ...],
    window: Window,
    first: int,
    count: int,
) -> None:
    """Column sums to weights, along the rows; written into ``planes``."""
    import drjit as dr

    height, width = shape[:2]
    R, F, s = window.radius, window.patch, window.stride
    rows_c, cols_c = window.centres(height), window.centres(width)
    across, high, wide = (dr.opaque(jit.UInt32, n) for n in (cols_c, height, width))
    index = dr.arange(jit.UInt32, count * cols_c)
    y = index // across
    x = index - y * across
    row = y + dr.opaque(jit.UInt32, first)
    span = wide + 2 * F
    step = dr.opaque(jit.UInt32, count) * span
    n_centres = dr.opaque(jit.UInt32, rows_c * cols_c)

    def along(o: Any, dx: Any, qx: Any, qy: Any, at: Any, to: Any) -> tuple[Any, ...]:
        total = dr.gather(jit.Float, columns, at)
        for i in range(1, 2 * F + 1):
            total += dr.gather(jit.Float, columns, at + i)
        w = exp_weight(-dr.select(total > 0, total, 0))
        # Unsigned: what lies left of the image or above it is very large.
        dr.scatter(planes, dr.select((qx < wide) & (qy < high), w, 0), to)
        wrap = dx == 2 * R
        return (
            o + 1,
            dr.select(wrap, 0, dx + 1),
            dr.select(wrap, qx - 2 * R, qx + 1),
            dr.select(wrap, qy + 1, qy),
            at + step,
            to + n_centres,
        )

    dr.while_loop(
        (
            jit.UInt32(0),
            jit.UInt32(0),
            x * s - R,
            row * s - R,
            y * span + x * s,
            row * across + x,
        ),
        lambda o, *_: o < window.offsets(),
        along,
    )
    dr.eval(planes)


def _packets(jit: Any, image: Image, pad: int) -> list[Any]:
    """The channels four at a time, side by side: one load of a vector reads four of a pixel."""
    padded = np.pad(image, ((pad, pad), (pad, pad), (0, -image.shape[2] % 4)), mode="constant")
    padded[:, :, : image.shape[2]] = np.pad(
        image, ((pad, pad), (pad, pad), (0, 0)), mode="symmetric"
    )
    return [
        jit.Float(np.ascontiguousarray(padded[:, :, c : c + 4], np.float32).ravel())
        for c in range(0, padded.shape[2], 4)
    ]


def _packet(jit: Any, packets: list[Any], index: Any) -> list[Any]:
    """All channels of the pixels ``index``."""
    import drjit as dr

    return [value for p in packets for value in dr.gather(jit.Array4f, p, index)]


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
    packets = _packets(jit, np.concatenate([features, images], axis=2), R)
    n, C = len(f) + 3, len(y)
    rows_c, cols_c = window.centres(height), window.centres(width)
    n_centres = rows_c * cols_c

    # -------------------------------------------- sums over the window of every centre
    index = dr.arange(jit.UInt32, n_centres)
    cy = index // cols_c
    cx = index - cy * cols_c
    here = (cy * s + R) * pitch + cx * s + R
    fc = [dr.gather(jit.Float, p, here) for p in f]
    # Relative to the centre's own value: a constant image is then exactly constant.
    yc = [dr.gather(jit.Float, p, here) for p in y]
    pairs = [(i, j) for i in range(n) for j in range(i, n)]

    def add(*state: Any) -> tuple[Any, ...]:
        o, dx, q, at, ex, ey, *sums = state
        w = _power(dr.gather(jit.Float, weights.planes, at), power)
        there = _packet(jit, packets, q)
        x = [None, ex, ey] + [there[i] - c for i, c in enumerate(fc)]
        v = [there[len(fc) + i] - c for i, c in enumerate(yc)]
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
    beta = solve(gram, right, n, C, ridge)
    # From differences to the centre, to absolute features: nothing of the centre is needed later.
    for c in range(C):
        beta[0][c] = beta[0][c] + yc[c]
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
    block = _Block(window, height, width)
    fp = [[dr.gather(jit.Float, p, at) for p in f] for at in block.padded(jit)]

    def load(centre: Any, ok: Any) -> list[Any]:
        found: list[Any] = []
        for g in range(per // 4):
            found += list(dr.gather(jit.Array4f, table, centre * (per // 4) + g, ok))
        return found

    def predict(coefficients: list[Any], pixel: int, dx: Any, dy: Any) -> list[Any]:
        x = [None, dx * (1.0 / R), dy * (1.0 / R), *fp[pixel]]
        values = []
        for c in range(C):
            value = coefficients[c * n]
            for k in range(1, n):
                value = dr.fma(coefficients[c * n + k], x[k], value)
            values.append(value)
        return values

    return _from_centres(jit, weights, power, y, load, predict)


def zeroth_order(weights: Weights, images: Image, power: int = 1) -> Image:
    """As `first_order`, with constants instead of planes: weighted means of weighted means.

    Within the range of ``images`` ``(H, W, C)``, whose shape comes back.
    """
    import drjit as dr

    jit = backend(weights.device)
    window, height, width = weights.window, weights.height, weights.width
    R, s = window.radius, window.stride
    pitch = width + 2 * R
    y = [_plane(jit, images[:, :, c], R) for c in range(images.shape[2])]
    cols_c = window.centres(width)
    n_centres = window.centres(height) * cols_c
    index = dr.arange(jit.UInt32, n_centres)
    cy = index // cols_c
    first = cy * s * pitch + (index - cy * cols_c) * s

    def add(o: Any, dx: Any, q: Any, at: Any, total: Any, *sums: Any) -> tuple[Any, ...]:
        w = _power(dr.gather(jit.Float, weights.planes, at), power)
        more = [dr.fma(w, dr.gather(jit.Float, p, q), t) for p, t in zip(y, sums, strict=True)]
        wrap = dx == 2 * R
        step = dr.select(wrap, jit.UInt32(pitch - 2 * R), jit.UInt32(1))
        return (o + 1, dr.select(wrap, 0, dx + 1), q + step, at + n_centres, total + w, *more)

    zeros = [dr.zeros(jit.Float, n_centres) for _ in range(len(y) + 1)]
    done = dr.while_loop(
        (jit.UInt32(0), jit.UInt32(0), first, jit.UInt32(index), *zeros),
        lambda o, *_: o < window.offsets(),
        add,
    )
    means = [value / done[4] for value in done[5:]]
    dr.eval(means)

    def load(centre: Any, ok: Any) -> list[Any]:
        return [dr.gather(jit.Float, m, centre, ok) for m in means]

    return _from_centres(jit, weights, power, y, load, lambda loaded, *_: loaded)


@dataclass(frozen=True)
class _Block:
    """The pixels of one thread: 2x2 where the stride is even, since they share their centres."""

    window: Window
    height: int
    width: int

    @property
    def side(self) -> int:
        return 1 + (self.window.stride + 1) % 2

    def corners(self, jit: Any) -> tuple[Any, Any]:
        """x and y of the first pixel of every block."""
        import drjit as dr

        across, down = -(-self.width // self.side), -(-self.height // self.side)
        index = dr.arange(jit.UInt32, across * down)
        row = index // across
        return (index - row * across) * self.side, row * self.side

    def pixels(self) -> list[tuple[int, int]]:
        """(x, y) of every pixel of a block."""
        return [(x, y) for y in range(self.side) for x in range(self.side)]

    def padded(self, jit: Any) -> list[Any]:
        """For every pixel of a block its index in a plane with a border of the radius."""
        R = self.window.radius
        x, y = self.corners(jit)
        return [(y + j + R) * (self.width + 2 * R) + x + i + R for i, j in self.pixels()]

    def image(self, values: list[list[Any]]) -> Image:
        """The image ``(H, W, C)`` of the values of every pixel of the blocks."""
        b = self.side
        across, down = -(-self.width // b), -(-self.height // b)
        whole = np.empty((down * b, across * b, len(values[0])), np.float32)
        for (i, j), here in zip(self.pixels(), values, strict=True):
            for c, value in enumerate(here):
                whole[j::b, i::b, c] = value.numpy().reshape(down, across)
        return whole[: self.height, : self.width]


def _from_centres(
    jit: Any,
    weights: Weights,
    power: int,
    own: list[Any],
    load: Callable[[Any, Any], list[Any]],
    predict: Callable[[list[Any], int, Any, Any], list[Any]],
) -> Image:
    """For every pixel the weighted mean of what each centre near it predicts.

    ``own``: padded planes of the pixels' own values, which count with `OWN_WEIGHT`. ``load``: what
    is known of a centre (index, mask); ``predict``: values from that, the number of the pixel in
    its block, and pixel − centre. Returns ``(H, W, len(own))``.
    """
    import drjit as dr

    window, height, width = weights.window, weights.height, weights.width
    R, s = window.radius, window.stride
    rows_c, cols_c = window.centres(height), window.centres(width)
    n_centres = rows_c * cols_c
    block = _Block(window, height, width)
    pixels = block.pixels()
    px, py = block.corners(jit)
    # The first centre at or after p − R, by a division of what is not negative.
    cy0 = jit.Int32((py + (R * s - R + s - 1)) // s) - R
    cx0 = jit.Int32((px + (R * s - R + s - 1)) // s) - R
    reach = (2 * R + block.side - 1) // s + 1
    per = len(own) + 1

    def step(*state: Any) -> tuple[Any, ...]:
        t, i, ccy, ccx, *out = state
        inside = (ccy >= 0) & (ccy < rows_c) & (ccx >= 0) & (ccx < cols_c)
        centre = jit.UInt32(ccy * cols_c + ccx)
        known = load(centre, inside)
        for number, (ox, oy) in enumerate(pixels):
            dx, dy = jit.Int32(px) + ox - ccx * s, jit.Int32(py) + oy - ccy * s
            ok = inside & (dx >= -R) & (dx <= R) & (dy >= -R) & (dy <= R)
            plane = jit.UInt32((dy + R) * (2 * R + 1) + dx + R)
            w = _power(dr.gather(jit.Float, weights.planes, plane * n_centres + centre, ok), power)
            values = [1.0, *predict(known, number, jit.Float(dx), jit.Float(dy))]
            for c, value in enumerate(values):
                out[number * per + c] = dr.fma(w, value, out[number * per + c])
        wrap = i == reach - 1
        return (
            t + 1,
            dr.select(wrap, 0, i + 1),
            dr.select(wrap, ccy + 1, ccy),
            dr.select(wrap, ccx - (reach - 1), ccx + 1),
            *out,
        )

    start: list[Any] = []
    for at in block.padded(jit):
        start += [jit.Float(OWN_WEIGHT)]
        start += [dr.gather(jit.Float, plane, at) * OWN_WEIGHT for plane in own]
    done = dr.while_loop(
        (jit.UInt32(0), jit.UInt32(0), cy0, cx0, *start), lambda t, *_: t < reach * reach, step
    )
    sums = [done[4 + k * per : 4 + (k + 1) * per] for k in range(len(pixels))]
    means = [[value * dr.rcp(here[0]) for value in here[1:]] for here in sums]
    dr.eval(means)
    return block.image(means)


def solve(
    gram: dict[tuple[int, int], Any],
    right: list[list[Any]],
    n: int,
    C: int,
    ridge: float,
) -> list[list[Any]]:
    """Cholesky LDLᵀ without square roots, in registers. A pivot that has lost all its energy
    belongs to a feature that others explain: its coefficient is 0.
    """
    import drjit as dr

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
