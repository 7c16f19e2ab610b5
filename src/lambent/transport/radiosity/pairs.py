"""Form factors of pairs of polygons: contour integrals, and rays for what stands in between.

For polygons P and Q that see each other whole, Stokes' theorem turns the double area integral into
one over both outlines (Goral et al. 1984, after Sparrow 1963):

    A_P F_PQ = 1/(2π) Σ_edges p Σ_edges q  (p̂ · q̂) ∫_p ∫_q ln |x - y| dy dx

The inner integral has a closed form (Mitalas and Stephenson 1966),

    ∫ ½ ln(t² + d²) dt = ½ t ln(t² + d²) - t + d atan(t / d),

the outer one is Gauss-Legendre's, with points drawn towards the ends (s = 3u² - 2u³), where the
integrand of edges that touch has its logarithmic kink. Where a polygon lies astride the other's
plane, it is cut there first: what is behind sees nothing.

What stands in between is found by rays between points of the two: F is multiplied by the share of
the kernel cos θ cos θ' / (π r²) that gets through, which is exactly 1 for pairs that see each other
whole. Two rectangles have closed forms of their own: `facing_squares` and `joined_squares`, the
yardsticks of the tests.

All pairs cost n²: for up to a few thousand patches. Beyond that, `casting`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lambent.errors import OptionError
from lambent.kernels.extremes import greater
from lambent.progress import Progress
from lambent.transport.jit import dr, mi
from lambent.transport.radiosity.patches import Index, Patches
from lambent.transport.radiosity.probe import Probe, lattice
from lambent.transport.surfaces import TRIANGLE, Array
from lambent.transport.warps import arctan

#: Points of the outer integral for pairs at least so many radii (of both together) apart.
POINTS = ((8.0, 2), (3.0, 3), (1.5, 6), (0.0, 16))
#: Triangles at least so many radii apart: the area integral by points of both.
DISTANT = 2.5
#: The rule of degree 4 with six points on a triangle (Dunavant 1985): weight, a, b.
_RULE = np.array(
    [
        (w, *ab)
        for w, s in ((0.223381589678011, 0.445948490915965), (0.109951743655322, 0.091576213509771))
        for ab in ((s, s), (s, 1 - 2 * s), (1 - 2 * s, s))
    ]
)
#: Rays between two patches at first, and more where some are blocked and some are not. Sums of
#: rows of a furnished room of 1,000 triangles are then 0.4 % off, single blocked pairs some
#: percent.
RAYS = (8, 40)
#: Pairs in one launch.
LAUNCH = 1 << 20
#: Most faces that all pairs of are formed.
MOST = 12_000


def exchange(p: Array, q: Array) -> Array:
    """A_P F_PQ ``(N,)`` of pairs of flat polygons ``(N, K, 3)`` each, with nothing in between.

    Corners go round counter-clockwise, seen from the side that radiates; a corner may repeat.
    Units: length squared. After the module's equations.
    """
    p, q = np.asarray(p, np.float64), np.asarray(q, np.float64)
    return _integrals(_in_front_of(p, q), _in_front_of(q, p))


def form_factor(p: Array, q: Array) -> float:
    """F_PQ of two flat polygons ``(K, 3)`` and ``(M, 3)``: the share of P's light that meets Q.

    Corners counter-clockwise, seen from the side that radiates or receives; nothing in between.
    Raises `OptionError` for a polygon without an area.
    """
    p, q = np.asarray(p, np.float64), np.asarray(q, np.float64)
    area = polygon_area(p[None])[0]
    if not area > 0 or not polygon_area(q[None])[0] > 0:
        raise OptionError("a polygon without an area has no form factor")
    size = max(len(p), len(q))
    return float(exchange(_padded(p, size)[None], _padded(q, size)[None])[0] / area)


def polygon_area(p: Array) -> Array:
    """Areas ``(N,)`` of flat polygons ``(N, K, 3)``."""
    return np.asarray(np.linalg.norm(_vector_area(p), axis=1))


def facing_squares(distance: float, side: float = 1.0) -> float:
    """F between two equal, directly opposed squares (Howell's catalogue C-11)."""
    x = side / distance
    root = np.sqrt(1 + x * x)
    return float(
        2 / (np.pi * x * x) * (np.log(np.sqrt((1 + x * x) ** 2 / (1 + 2 * x * x)))
        + 2 * x * root * np.arctan(x / root) - 2 * x * np.arctan(x))
    )  # fmt: skip


def joined_squares() -> float:
    """F between two equal squares at right angles with a side in common (Howell's C-14)."""
    w = h = 1.0
    a = (1 + w * w) * (1 + h * h) / (1 + w * w + h * h)
    b = w * w * (1 + w * w + h * h) / ((1 + w * w) * (w * w + h * h))
    c = h * h * (1 + h * h + w * w) / ((1 + h * h) * (h * h + w * w))
    s = np.sqrt(h * h + w * w)
    return float(
        (w * np.arctan(1 / w) + h * np.arctan(1 / h) - s * np.arctan(1 / s)
        + 0.25 * np.log(a * b ** (w * w) * c ** (h * h))) / (np.pi * w)
    )  # fmt: skip


def exchange_matrix(
    scene: Any,
    patches: Patches,
    probe: Probe,
    faces: Index,
    live: NDArray[np.bool_],
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[Any, Array]:
    """G = A_i F_ij ``(n, n)`` CSR of these faces, and what each sees of them ``(n,)``.

    Raises `OptionError` for curved primitives, shared patches, and too many faces.
    """
    from lambent.transport.radiosity.casting import cast

    if not probe.single or (patches.cells.surfaces.kind[patches.cells.prim] != TRIANGLE).any():
        raise OptionError(
            "form factors by pairs need flat patches of one triangle each; this scene has curved "
            "shapes, or triangles that are smaller than the patches",
            remedy="take --factors rays",
        )
    if len(faces) > MOST:
        raise OptionError(
            f"{len(faces):,} faces have {len(faces) ** 2 / 2e6:,.0f} million pairs",
            remedy=f"take --factors rays, or larger patches (up to {MOST:,} faces)",
        )
    corners = face_corners(patches, faces)
    normal = _vector_area(corners)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / size
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    flat = mi.Float(corners.astype(np.float32).ravel())
    up = mi.Float((normal * size).astype(np.float32).ravel())
    rows, columns, values = [], [], []
    block = max(1, LAUNCH // max(1, len(faces)))
    for first in range(0, len(faces), block):
        i = np.arange(first, min(first + block, len(faces)))
        # who is before whose plane, wholly or in part
        some, whole = _ahead(corners[i], normal, corners)
        back_some, back_whole = _ahead(corners, normal[i], corners[i])
        seen = some & back_some.T
        seen &= i[:, None] < np.arange(len(faces))[None, :]
        a, b = np.nonzero(seen)
        clear = (whole & back_whole.T)[a, b]
        a = i[a]
        g = np.zeros(len(a))
        c, d = a[clear], b[clear]
        apart = np.linalg.norm(middle[c] - middle[d], axis=1) / (radius[c] + radius[d])
        g[clear] = np.where(apart >= DISTANT, _by_points(flat, up, c, d, apart), 0)
        near = apart < DISTANT
        at = np.flatnonzero(clear)[near]
        g[at] = _integrals(corners, corners, c[near], d[near], apart[near])
        g[~clear] = exchange(corners[a[~clear]], corners[b[~clear]])
        good = g > 1e-12 * np.sqrt(size[a, 0] * size[b, 0])
        a, b, g = a[good], b[good], g[good]
        g = g * visible(scene, corners, normal, a, b, seed)
        good = g > 0
        rows.append(a[good])
        columns.append(b[good])
        values.append(g[good])
        if progress is not None:
            progress(min(first + block, len(faces)), len(faces), "form factors by pairs")
    n = len(faces)
    if not values:
        return sparse.csr_matrix((n, n)), np.zeros(n)
    half = sparse.coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    )
    g = (half + half.T).tocsr()
    # in a closed scene rows sum to one; what is missing is light that leaves, or an error. Rays
    # tell the one from the other
    found = cast(scene, patches, probe, faces, live, 256, seed)
    return g, np.asarray(found.shares[:, faces].sum(axis=1)).ravel()


def face_corners(patches: Patches, faces: Index) -> Array:
    """Corners ``(n, 3, 3)`` of triangular faces, counter-clockwise seen from their own side."""
    leaf = patches.leaf[patches.start[faces >> 1]]
    cells = patches.cells
    prim = np.repeat(cells.prim[leaf], 3)
    ab = cells.corner[leaf].astype(np.float64).reshape(-1, 2)
    corners = cells.surfaces.points(prim, ab)[0].reshape(-1, 3, 3)
    own = _vector_area(corners)
    along = (own * cells.surfaces.normal[cells.prim[leaf]]).sum(axis=1) < 0
    turn = along ^ ((faces & 1) == 1)
    corners[turn] = corners[turn][:, ::-1]
    return np.asarray(corners)


def visible(
    scene: Any,
    corners: Array,
    normal: Array,
    a: Index,
    b: Index,
    seed: int = 0,
    rays: tuple[int, int] = RAYS,
) -> Array:
    """The share ``(N,)`` of the light between faces ``a`` and ``b`` that nothing blocks.

    Points on both, weighed by cos cos / r²; ``rays[0]`` first, ``rays[1]`` more where
    they disagree.
    """
    if len(a) == 0:
        return np.zeros(0)
    flat = mi.Float(corners.astype(np.float32).ravel())
    up = mi.Float(normal.astype(np.float32).ravel())
    blocked, total = _through(scene, flat, up, a, b, rays[0], 0, seed)
    mixed = np.flatnonzero((blocked > 0) & (blocked < total))
    if len(mixed):
        more, sums = _through(scene, flat, up, a[mixed], b[mixed], rays[1], rays[0], seed)
        blocked[mixed] += more
        total[mixed] += sums
    return np.asarray(1 - np.divide(blocked, total, out=np.zeros_like(total), where=total > 0))


# ------------------------------------------------------------------- private


def _integrals(
    p: Array,
    q: Array,
    a: Index | None = None,
    b: Index | None = None,
    apart: Array | None = None,
) -> Array:
    """The module's sum for pairs ``p[a]``, ``q[b]`` that are wholly before one another."""
    if a is None or b is None:
        a = b = np.arange(len(p))
    if apart is None:
        middle_p, middle_q = p.mean(axis=1), q.mean(axis=1)
        reach = np.linalg.norm(p - middle_p[:, None], axis=2).max(axis=1) + np.linalg.norm(
            q - middle_q[:, None], axis=2
        ).max(axis=1)
        apart = np.linalg.norm(middle_p - middle_q, axis=1) / np.maximum(reach, 1e-300)
    found = np.zeros(len(a))
    flat_p = mi.Float64(np.ascontiguousarray(p).ravel())
    flat_q = flat_p if q is p else mi.Float64(np.ascontiguousarray(q).ravel())
    high = np.inf
    for low, points in POINTS:
        at = np.flatnonzero((apart >= low) & (apart < high))
        high = low
        for first in range(0, len(at), LAUNCH):
            part = at[first : first + LAUNCH]
            found[part] = _contour(flat_p, flat_q, p.shape[1], q.shape[1], a[part], b[part], points)
    return np.maximum(found, 0.0)


def _by_points(flat: Any, up: Any, a: Index, b: Index, apart: Array) -> Array:
    """A_a F_ab of distant triangles: Σ w w' (n · r) (n' · -r) / (π r⁴), n as long as the areas.

    Its error falls with the fifth power of size over distance: below 1e-5 of the factor here.
    """
    far = np.flatnonzero(apart >= DISTANT)
    found = np.zeros(len(a))
    weights, first, second = (mi.Float(_RULE[:, k].astype(np.float32)) for k in range(3))
    count = len(_RULE)
    for start in range(0, len(far), LAUNCH):
        part = far[start : start + LAUNCH]
        i, j = (mi.UInt32(x[part].astype(np.uint32)) for x in (a, b))
        n_i, n_j = (dr.gather(mi.Vector3f, up, k) for k in (i, j))
        p = [dr.gather(mi.Point3f, flat, 3 * i + k) for k in range(3)]
        q = [dr.gather(mi.Point3f, flat, 3 * j + k) for k in range(3)]

        def step(k: Any, total: Any, p: Any = p, q: Any = q, n_i: Any = n_i, n_j: Any = n_j) -> Any:
            at, to = k % count, k // count
            s, t = dr.gather(mi.Float, first, at), dr.gather(mi.Float, second, at)
            x = p[0] + s * (p[1] - p[0]) + t * (p[2] - p[0])
            s, t = dr.gather(mi.Float, first, to), dr.gather(mi.Float, second, to)
            y = q[0] + s * (q[1] - q[0]) + t * (q[2] - q[0])
            way = y - x
            square = dr.squared_norm(way)
            weight = dr.gather(mi.Float, weights, at) * dr.gather(mi.Float, weights, to)
            kernel = dr.dot(n_i, way) * -dr.dot(n_j, way) / (square * square)
            return k + 1, total + weight * kernel

        _, total = dr.while_loop(
            (mi.UInt32(0), dr.zeros(mi.Float, len(part))),
            lambda k, total: k < count * count,
            step,
            label="points of two triangles",
        )
        found[part] = total.numpy()
    return found / np.pi


def _contour(
    flat_p: Any, flat_q: Any, edges_p: int, edges_q: int, a: Index, b: Index, points: int
) -> Array:
    """In double precision: small numbers are differences of large ones."""
    u, w = np.polynomial.legendre.leggauss(points)
    u, w = (u + 1) / 2, w / 2
    if points > 6:  # near enough to touch: towards the ends
        u, w = u * u * (3 - 2 * u), w * 6 * u * (1 - u)
    places, weights = mi.Float64(u), mi.Float64(w)
    first_p = mi.UInt32((a * edges_p).astype(np.uint32))
    first_q = mi.UInt32((b * edges_q).astype(np.uint32))

    def corner(flat: Any, first: Any, k: Any) -> Any:
        base = 3 * (first + k)
        return [dr.gather(mi.Float64, flat, base + c) for c in range(3)]

    def side(i: Any, j: Any, total: Any) -> Any:
        p0, p1 = corner(flat_p, first_p, i), corner(flat_p, first_p, (i + 1) % edges_p)
        q0, q1 = corner(flat_q, first_q, j), corner(flat_q, first_q, (j + 1) % edges_q)
        edge_p = [x - y for x, y in zip(p1, p0, strict=True)]
        edge_q = [x - y for x, y in zip(q1, q0, strict=True)]
        square = _dot(edge_q, edge_q)
        length = dr.sqrt(square)
        unit = [e / dr.select(length > 0, length, 1) for e in edge_q]
        cosine = _dot(edge_p, unit)
        start = [x - y for x, y in zip(p0, q0, strict=True)]

        def point(g: Any, sums: Any) -> Any:
            s = dr.gather(mi.Float64, places, g)
            off = [x + s * e for x, e in zip(start, edge_p, strict=True)]
            along = _dot(off, unit)
            d = dr.sqrt(greater(_dot(off, off) - along * along, mi.Float64(0)))
            inner = _inner(-along, length - along, d)
            return g + 1, sums + dr.gather(mi.Float64, weights, g) * inner

        _, sums = dr.while_loop(
            (mi.UInt32(0), mi.Float64(0)), lambda g, sums: g < points, point, label="points"
        )
        return total + dr.select(length > 0, cosine * sums, 0)

    def step(n: Any, total: Any) -> Any:
        return n + 1, side(n % edges_p, n // edges_p, total)

    rounds = mi.UInt32(edges_p * edges_q)
    _, total = dr.while_loop(
        (mi.UInt32(0), dr.zeros(mi.Float64, len(a))),
        lambda n, total: n < rounds,
        step,
        label="edges",
    )
    return np.asarray(total.numpy()) / (2 * np.pi)


def _inner(low: Any, high: Any, d: Any) -> Any:
    """∫ ½ ln(t² + d²) dt from ``low`` to ``high``, with one arc tangent for both ends."""
    square = d * d
    at_low, at_high = low * low + square, high * high + square
    logs = 0.5 * (
        high * dr.log(dr.select(at_high > 0, at_high, 1))
        - low * dr.log(dr.select(at_low > 0, at_low, 1))
    )
    # the angle under which the side is seen from the point, by its half
    across, along = d * (high - low), square + low * high
    whole = dr.sqrt(across * across + along * along) + along
    angle = dr.select(whole > 0, 2 * arctan(across / dr.select(whole > 0, whole, 1)), dr.pi)
    return logs - (high - low) + d * angle


def _dot(a: list[Any], b: list[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _vector_area(p: Array) -> Array:
    """Half the sum of the edges' cross products ``(N, 3)``: the normal, as long as the area."""
    return np.asarray(np.cross(p - p[:, :1], np.roll(p, -1, axis=1) - p[:, :1]).sum(axis=1) / 2)


def _padded(p: Array, size: int) -> Array:
    return np.concatenate([p, np.repeat(p[-1:], size - len(p), axis=0)])


def _in_front_of(p: Array, q: Array) -> Array:
    """The part of each polygon that is before the other's plane, with one corner more.

    Sutherland and Hodgman 1974, for one plane; a polygon that is wholly behind becomes a point.
    """
    normal = _vector_area(q)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, 1)
    height = np.einsum("nkc,nc->nk", p - q[:, :1], normal)
    scale = np.abs(p - q[:, :1]).max(axis=(1, 2))[:, None] + 1e-300
    height = np.where(np.abs(height) < 1e-9 * scale, 0.0, height)
    out = np.concatenate([p, p[:, -1:]], axis=1)
    astride = (height < 0).any(axis=1) & (height > 0).any(axis=1)
    behind = ~(height > 0).any(axis=1)
    out[behind] = p[behind][:, :1]
    at = np.flatnonzero(astride)
    if len(at) == 0:
        return np.asarray(out)
    k = p.shape[1]
    found = np.zeros((len(at), k + 1, 3))
    fill = np.zeros(len(at), np.int64)

    def put(which: NDArray[np.bool_], points: Array) -> None:
        rows = np.flatnonzero(which & (fill <= k))
        found[rows, fill[rows]] = points[rows]
        fill[rows] += 1

    pa, ha = p[at], height[at]
    for i in range(k):
        j = (i + 1) % k
        put(ha[:, i] >= 0, pa[:, i])
        crosses = ((ha[:, i] > 0) & (ha[:, j] < 0)) | ((ha[:, i] < 0) & (ha[:, j] > 0))
        t = ha[:, i] / np.where(crosses, ha[:, i] - ha[:, j], 1)
        put(crosses, pa[:, i] + t[:, None] * (pa[:, j] - pa[:, i]))
    last = found[np.arange(len(at)), fill - 1]
    for i in range(k + 1):
        late = i >= fill
        found[late, i] = last[late]
    out[at] = found
    return np.asarray(out)


def _ahead(
    corners: Array, normals: Array, others: Array
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """``(N, M)``: whether any, and whether all corners of ``corners[i]`` are before face ``j``."""
    offset = (normals * others[:, 0]).sum(axis=1)
    scale = 1e-7 * (np.abs(others).max() + 1e-300)
    some = np.zeros((len(corners), len(others)), bool)
    whole = np.ones_like(some)
    for k in range(corners.shape[1]):
        height = corners[:, k] @ normals.T - offset
        some |= height > scale
        whole &= height > -scale
    return some, whole


def _through(
    scene: Any, flat: Any, up: Any, a: Index, b: Index, rays: int, skip: int, seed: int
) -> tuple[Array, Array]:
    """Blocked and whole kernel ``(N,)`` over so many pairs of points."""
    blocked, total = np.zeros(len(a)), np.zeros(len(a))
    for first in range(0, len(a), LAUNCH):
        some = slice(first, first + LAUNCH)
        with dr.suspend_grad():
            i = mi.UInt32(a[some].astype(np.uint32))
            j = mi.UInt32(b[some].astype(np.uint32))
            shift = mi.sample_tea_32(i * 2654435761 + mi.UInt32(seed & 0xFFFFFFFF), j)[0]
            limit = dr.opaque(mi.UInt32, rays + skip)

            def step(
                k: Any, hidden: Any, whole: Any, i: Any = i, j: Any = j, shift: Any = shift
            ) -> Any:
                u = [lattice(k, shift, d) for d in range(4)]
                x, y = _inside(flat, i, u[0], u[1]), _inside(flat, j, u[2], u[3])
                n_x = dr.gather(mi.Normal3f, up, i)
                n_y = dr.gather(mi.Normal3f, up, j)
                way = y - x
                square = dr.squared_norm(way)
                cosines = dr.dot(n_x, way) * -dr.dot(n_y, way)
                facing = (dr.dot(n_x, way) > 0) & (dr.dot(n_y, way) < 0) & (square > 0)
                kernel = dr.select(facing, cosines / dr.square(square), 0)
                start = dr.zeros(mi.Interaction3f, dr.width(i))
                start.p, start.n = x, n_x
                end = y + n_y * (1e-4 * dr.sqrt(square))
                hit = scene.ray_test(start.spawn_ray_to(end), facing)
                return k + 1, hidden + dr.select(hit, kernel, 0), whole + kernel

            _, hidden, whole = dr.while_loop(
                (mi.UInt32(skip), dr.zeros(mi.Float, dr.width(i)), dr.zeros(mi.Float, dr.width(i))),
                lambda k, hidden, whole, limit=limit: k < limit,
                step,
                label="rays between patches",
            )
            dr.eval(hidden, whole)
        blocked[some], total[some] = hidden.numpy(), whole.numpy()
    return blocked, total


def _inside(flat: Any, face: Any, u: Any, v: Any) -> Any:
    """A point of a triangle, uniform."""
    over = u + v > 1
    u, v = dr.select(over, 1 - u, u), dr.select(over, 1 - v, v)
    c = [dr.gather(mi.Point3f, flat, 3 * face + k) for k in range(3)]
    return c[0] + u * (c[1] - c[0]) + v * (c[2] - c[0])
