"""Triangle meshes as plain arrays, and the solids that a modeller starts from.

Super-ellipsoids after "Superquadrics and Angle-Preserving Transformations", Alan Barr, IEEE CG&A
1981; tubes are swept with parallel-transported frames ("Computation of Rotation Minimizing Frames",
Wang, Jüttler, Zheng and Liu, TOG 2008, in its simplest form). Lengths are metres, z is up, faces
wind counter-clockwise seen from outside, texture coordinates are about metres where a texture
should keep its scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Geometry:
    """A mesh: ``positions (N, 3)``, unit ``normals (N, 3)``, ``uv (N, 2)``, ``faces (M, 3)``."""

    positions: Array
    normals: Array
    uv: Array
    faces: NDArray[np.int64]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The least and the greatest corner."""
        return self.positions.min(0), self.positions.max(0)

    def moved(self, matrix: Array) -> Geometry:
        """The mesh under an affine map ``(4, 4)``; a mirroring map turns the faces round."""
        linear = matrix[:3, :3]
        normals = self.normals @ np.linalg.inv(linear)
        faces = self.faces if np.linalg.det(linear) > 0 else self.faces[:, ::-1]
        return Geometry(self.positions @ linear.T + matrix[:3, 3], unit(normals), self.uv, faces)

    def with_uv(self, scale: float | tuple[float, float]) -> Geometry:
        """The mesh with its texture coordinates multiplied."""
        return Geometry(self.positions, self.normals, self.uv * scale, self.faces)


def unit(v: Array) -> Array:
    """Vectors along the last axis at length one (zero stays zero)."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def merge(parts: Sequence[Geometry]) -> Geometry:
    """Several meshes as one."""
    if len(parts) == 1:
        return parts[0]
    first = np.cumsum([0] + [len(p.positions) for p in parts[:-1]])
    return Geometry(
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.uv for p in parts]),
        np.concatenate([p.faces + f for p, f in zip(parts, first, strict=True)]),
    )


def copies(one: Geometry, matrices: Array) -> Geometry:
    """Copies of one mesh under ``matrices (K, 4, 4)``, merged."""
    linear = matrices[:, :3, :3]
    positions = np.einsum("kij,nj->kni", linear, one.positions) + matrices[:, None, :3, 3]
    normals = unit(np.einsum("nj,kji->kni", one.normals, np.linalg.inv(linear)))
    first = np.arange(len(matrices))[:, None, None] * len(one.positions)
    return Geometry(
        positions.reshape(-1, 3),
        normals.reshape(-1, 3),
        np.tile(one.uv, (len(matrices), 1)),
        (one.faces[None] + first).reshape(-1, 3),
    )


# --- transforms ------------------------------------------------------------------------------


def translate(x: float, y: float, z: float) -> Array:
    """A translation ``(4, 4)``."""
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


def scale(x: float, y: float | None = None, z: float | None = None) -> Array:
    """A scaling ``(4, 4)``, even if one factor is given."""
    return np.diag([x, x if y is None else y, x if z is None else z, 1.0])


def rotate(axis: str | Array, angle: float) -> Array:
    """A rotation ``(4, 4)`` about "x", "y", "z" or a vector, by ``angle`` in radians."""
    named = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    v = np.asarray(named[axis] if isinstance(axis, str) else axis, float)
    x, y, z = v / np.linalg.norm(v)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    m = np.eye(4)
    m[:3, :3] += np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    return m


def frame_to(direction: Array) -> Array:
    """A rotation ``(4, 4)`` that takes z to ``direction``."""
    w = direction / np.linalg.norm(direction)
    helper = np.array([1.0, 0, 0]) if abs(w[0]) < 0.8 else np.array([0, 1.0, 0])
    u = np.cross(helper, w)
    u /= np.linalg.norm(u)
    m = np.eye(4)
    m[:3, 0], m[:3, 1], m[:3, 2] = u, np.cross(w, u), w
    return m


# --- surfaces --------------------------------------------------------------------------------


def grid(points: Array, uv: Array, *, around: bool = False, flip: bool = False) -> Geometry:
    """A surface through ``points (R, C, 3)`` with smooth normals.

    ``around`` says that the first and the last column coincide, so that the seam is smooth.
    """
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 0).reshape(-1, 3)
    across = np.gradient(points, axis=1) if columns > 1 else np.zeros_like(points)
    if around:
        closed = np.concatenate([points[:, -2:-1], points, points[:, 1:2]], 1)
        across = (closed[:, 2:] - closed[:, :-2]) / 2
    normals = np.cross(across, np.gradient(points, axis=0))
    flat = np.linalg.norm(normals, axis=-1) < 1e-12
    if flat.any() and not flat.any(1).all():  # poles, and where a profile runs along the axis
        good = np.flatnonzero(~flat.any(1))
        for row in np.flatnonzero(flat.any(1)):
            ring = unit(normals[good[np.abs(good - row).argmin()]])
            middle = ring.mean(0)
            normals[row] = middle if np.linalg.norm(middle) > 1e-6 else ring
    normals = unit(normals)
    if flip:
        faces, normals = faces[:, ::-1], -normals
    return Geometry(points.reshape(-1, 3), normals.reshape(-1, 3), uv.reshape(-1, 2), faces)


def quad(width: float, depth: float, repeat: tuple[float, float] | None = None) -> Geometry:
    """A rectangle in the xy plane that looks up; ``repeat`` is how often the texture fits."""
    x, y = width / 2, depth / 2
    p = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], float)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float) * (repeat or (width, depth))
    return Geometry(p, np.tile([0.0, 0, 1], (4, 1)), uv, np.array([[0, 1, 2], [0, 2, 3]]))


def box(x: float, y: float, z: float, bevel: float = 0.0) -> Geometry:
    """A box with its base at z = 0, centred in x and y, its edges cut at 45° by ``bevel``."""
    size = np.array([x, y, z], float)
    half = size / 2
    b = min(bevel, half.min() * 0.6)
    parts = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (1.0, -1.0):
            corners = np.zeros((4, 3))
            corners[:, u] = np.array([-1, 1, 1, -1]) * (half[u] - b)
            corners[:, v] = np.array([-1, -1, 1, 1]) * (half[v] - b)
            corners[:, axis] = sign * half[axis]
            normal = np.zeros(3)
            normal[axis] = sign
            uv = corners[:, [u, v]] if axis != 1 else corners[:, [v, u]]
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            parts.append(
                Geometry(
                    corners, np.tile(normal, (4, 1)), uv, faces if sign > 0 else faces[:, ::-1]
                )
            )
    solid = merge(parts)
    if b > 0:
        solid = merge([solid, _bevels(half, b)])
    return solid.moved(translate(0, 0, half[2]))


def _bevels(half: Array, b: float) -> Geometry:
    """Edge strips and corner triangles of a bevelled box, with the smooth normals of a round."""
    positions: list[Array] = []
    normals: list[Array] = []
    uv: list[Array] = []
    faces: list[NDArray[np.int64]] = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for su in (1.0, -1.0):
            for sv in (1.0, -1.0):
                n = len(positions) * 4
                p, m = np.zeros((4, 3)), np.zeros((4, 3))
                along = half[axis] - b
                p[:, axis] = [-along, along, along, -along]
                p[:, u] = su * np.array([half[u], half[u], half[u] - b, half[u] - b])
                p[:, v] = sv * np.array([half[v] - b, half[v] - b, half[v], half[v]])
                m[:2, u], m[2:, v] = su, sv
                positions.append(p)
                normals.append(m)
                uv.append(p[:, [axis, v]])
                turn = np.array([[0, 1, 2], [0, 2, 3]]) + n
                faces.append(turn if su * sv < 0 else turn[:, ::-1])
    strips = np.concatenate(positions), np.concatenate(normals), np.concatenate(uv)
    start = len(strips[0])
    corner_p, corner_n, corner_f = [], [], []
    for k in range(8):
        s = np.array([1.0 if k >> a & 1 else -1.0 for a in range(3)])
        p = np.tile(s * (half - b), (3, 1))
        p[np.arange(3), np.arange(3)] = s * half
        corner_p.append(p)
        corner_n.append(np.eye(3) * s)
        turn = np.array([[0, 1, 2]]) + start + 3 * k
        corner_f.append(turn if s.prod() > 0 else turn[:, ::-1])
    p = np.concatenate(corner_p)
    return Geometry(
        np.concatenate([strips[0], p]),
        np.concatenate([strips[1], np.concatenate(corner_n)]),
        np.concatenate([strips[2], p[:, :2]]),
        np.concatenate(faces + corner_f),
    )


def super_ellipsoid(
    radii: tuple[float, float, float], e1: float = 1.0, e2: float = 1.0, n: int = 24
) -> Geometry:
    """Barr's super-ellipsoid about the origin; exponents 1 are round, 0.2 boxy, 2 an octahedron."""

    def power(x: Array, e: float) -> Array:
        return np.sign(x) * np.abs(x) ** e

    v = np.linspace(-np.pi / 2, np.pi / 2, n + 1)[:, None]
    u = np.linspace(-np.pi, np.pi, 2 * n + 1)[None, :]
    ones = np.ones_like(u)
    unit_points = np.stack(
        [
            power(np.cos(v), e1) * power(np.cos(u), e2),
            power(np.cos(v), e1) * power(np.sin(u), e2),
            power(np.sin(v), e1) * ones,
        ],
        -1,
    )
    unit_points[0, :, :2] = unit_points[-1, :, :2] = 0
    a, b, c = radii
    uv = np.stack(
        [(u / (2 * np.pi) + 0.5) * ones * (a + b) * 3 + 0 * v, (v / np.pi + 0.5) * 3 * c * ones], -1
    )
    return grid(unit_points * np.array(radii), uv, around=True)


def sphere(radius: float, n: int = 16) -> Geometry:
    """A ball about the origin."""
    return super_ellipsoid((radius, radius, radius), n=n)


def lathe(profile: Array, n: int = 32, *, smooth: int = 4) -> Geometry:
    """The profile ``(K, 2)`` of radius and height turned about z, outside on the right of its path.

    A closed vessel goes from its foot up the outside and, if it is hollow, down the inside.
    Corners are rounded by ``smooth`` points a segment (Catmull-Rom); 1 keeps them sharp.
    """
    p = catmull_rom(profile, smooth) if smooth > 1 else np.repeat(profile, 2, 0)
    p = p.copy()
    p[:, 0] = np.maximum(p[:, 0], 0)
    angle = np.linspace(0, 2 * np.pi, n + 1)
    r, z = p[:, :1], p[:, 1:]
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z + 0 * angle], -1)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    girth = 2 * np.pi * max(p[:, 0].max(), 1e-3)
    uv = np.stack(np.broadcast_arrays(angle / (2 * np.pi) * girth, along[:, None]), -1)
    if smooth > 1:
        return grid(points, uv, around=True)
    # Sharp profile: each segment on its own, with its own normals.
    rows = range(1, len(p) - 1, 2)
    return merge([grid(points[i : i + 2], uv[i : i + 2], around=True) for i in rows])


def catmull_rom(points: Array, per_segment: int) -> Array:
    """A smooth curve through ``points (K, D)``, with ``per_segment`` points a segment."""
    p = np.concatenate([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])
    t = (np.arange(per_segment) / per_segment)[None, :, None]
    a, b, c, d = (p[i : len(p) - 3 + i, None] for i in range(4))
    curve = 0.5 * (
        2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3
    )
    return np.concatenate([curve.reshape(-1, points.shape[1]), points[-1:]])


def tube(path: Array, radius: float | Array, n: int = 8) -> Geometry:
    """A tube of ``radius`` (a number, or one a point) along ``path (K, 3)``, open at both ends."""
    tangent = unit(np.gradient(path, axis=0))
    helper = np.array([0.0, 0, 1]) if abs(tangent[0, 2]) < 0.9 else np.array([1.0, 0, 0])
    side = unit(np.cross(helper, tangent[0]))
    sides = np.empty_like(path)
    for i, t in enumerate(tangent):
        side = unit(side - t * (side @ t))
        sides[i] = side
    up = np.cross(tangent, sides)
    angle = np.linspace(0, 2 * np.pi, n + 1)
    ring = (
        np.cos(angle)[None, :, None] * sides[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    )
    r = np.broadcast_to(np.asarray(radius, float), len(path))
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(angle / (2 * np.pi) * 0.2, along[:, None]), -1)
    return grid(path[:, None] + r[:, None, None] * ring, uv, around=True)


def extrude(outline: Array, height: float, *, taper: float = 1.0, twist: float = 0.0) -> Geometry:
    """A star-shaped outline ``(K, 2)``, counter-clockwise, pulled up along z, with its two caps."""
    steps = 1 if twist == 0 else 16
    k = len(outline)
    ring = np.concatenate([outline, outline[:1]])
    t = np.linspace(0, 1, steps + 1)
    factor = 1 + (taper - 1) * t
    c, s = np.cos(twist * t) * factor, np.sin(twist * t) * factor
    x = ring[None, :, 0] * c[:, None] - ring[None, :, 1] * s[:, None]
    y = ring[None, :, 0] * s[:, None] + ring[None, :, 1] * c[:, None]
    points = np.stack([x, y, np.broadcast_to(t[:, None] * height, x.shape)], -1)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))])
    walls = []
    for i in range(k):  # each wall with its own normals: edges stay sharp
        uv = np.stack(np.broadcast_arrays(along[None, i : i + 2], t[:, None] * height), -1)
        walls.append(grid(points[:, i : i + 2], uv))
    caps = [_fan(points[-1, :k], 1.0), _fan(points[0, :k], -1.0)]
    return merge(walls + caps)


def _fan(ring: Array, sign: float) -> Geometry:
    """A cap over a ring of points, as a fan from their centre."""
    k = len(ring)
    p = np.concatenate([ring, ring.mean(0, keepdims=True)])
    i = np.arange(k)
    faces = np.stack([i, (i + 1) % k, np.full(k, k)], -1)
    normals = np.tile([0, 0, sign], (k + 1, 1))
    return Geometry(p, normals, p[:, :2].copy(), faces if sign > 0 else faces[:, ::-1])


def faceted(positions: Array, faces: NDArray[np.int64]) -> Geometry:
    """A mesh with one flat normal a face (vertices are not shared)."""
    corners = positions[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept = np.linalg.norm(area, axis=1) > 1e-10
    p = corners[kept].reshape(-1, 3)
    n = np.repeat(unit(area[kept]), 3, 0)
    major = np.argmax(np.abs(n), -1)
    uv = np.where(
        major[:, None] == 0, p[:, [1, 2]], np.where(major[:, None] == 1, p[:, ::2], p[:, :2])
    )
    return Geometry(p, n, uv, np.arange(len(p)).reshape(-1, 3))


def smooth_normals(positions: Array, faces: NDArray[np.int64]) -> Array:
    """Vertex normals ``(N, 3)``: the sum of the area vectors of the faces around."""
    corners = positions[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(positions)
    for axis in range(3):
        weights = np.repeat(area[:, axis], 3)
        total[:, axis] = np.bincount(faces.reshape(-1), weights, len(positions))
    return unit(total)
