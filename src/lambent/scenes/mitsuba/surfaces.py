"""Surfaces that no lathe makes: displaced, fractured, in relief, of wire, of cards.

Fracture cuts a convex solid by the bisectors of random points, which are the cells of their Voronoi
diagram ("Voronoi diagrams: a survey", Aurenhammer 1991), and moves the cells apart.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.scenes.mitsuba.geometry import (
    Array,
    Geometry,
    box,
    copies,
    faceted,
    grid,
    merge,
    rotate,
    smooth_normals,
    super_ellipsoid,
    translate,
    tube,
    unit,
)
from lambent.scenes.mitsuba.noise import fbm, solid_noise


@functools.lru_cache(maxsize=8)
def icosphere(level: int) -> tuple[Array, NDArray[np.int64]]:
    """Points of the unit sphere ``(N, 3)`` and ``20·4**level`` faces."""
    g = (1 + 5**0.5) / 2
    p: list[tuple[float, float, float]]
    p = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    p += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    f = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4)]
    f += [(11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8)]
    f += [(3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    points, faces = unit(np.array(p, float)), np.array(f)
    for _ in range(level):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middle = inverse.reshape(3, -1) + len(points)
        points = np.concatenate([points, unit(points[unique].mean(1))])
        a, b, c = faces.T
        ab, bc, ca = middle
        triangles = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = np.concatenate([np.stack(t, -1) for t in triangles])
    return points, faces


def displaced(
    rng: np.random.Generator,
    radii: tuple[float, float, float],
    amount: float = 0.25,
    frequency: float = 1.5,
    *,
    octaves: int = 4,
    ridged: bool = False,
    level: int = 4,
) -> Geometry:
    """A ball with its surface moved along the normal by solid noise: stone, fruit, coral."""
    points, faces = icosphere(level)
    noise = solid_noise(rng, points * frequency, octaves)
    if ridged:
        noise = 1 - 2 * np.abs(noise)
    p = points * (1 + amount * noise)[:, None] * np.array(radii)
    uv = np.stack([np.arctan2(points[:, 1], points[:, 0]) / np.pi, points[:, 2]], -1)
    return Geometry(p, smooth_normals(p, faces), uv * max(radii) * 2, faces)


def stone(rng: np.random.Generator, size: float) -> Geometry:
    """A boulder with flat facets: a displaced ball whose low bumps are cut by random planes."""
    points, faces = icosphere(3)
    p = points * (1 + 0.18 * solid_noise(rng, points * 1.3, 4))[:, None]
    for _ in range(9):
        n = unit(rng.normal(size=3))
        over = np.maximum(p @ n - rng.uniform(0.55, 0.85), 0)
        p = p - over[:, None] * n * 0.9
    p = p * size * rng.uniform([0.8, 0.7, 0.5], [1.2, 1, 0.9])
    uv = np.stack([np.arctan2(points[:, 1], points[:, 0]) / np.pi, points[:, 2]], -1) * size * 2
    return Geometry(p, smooth_normals(p, faces), uv, faces)


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground up to ``reach`` metres around the origin, fine in the middle and coarse far away.

    Row and column k of ``heights (N, N)`` lie at ``reach · sign(t) t²`` for t from −1 to 1.
    """

    reach: float
    heights: Array

    def geometry(self) -> Geometry:
        """The mesh; texture coordinates are metres."""
        t = np.linspace(-1, 1, len(self.heights))
        at = self.reach * np.sign(t) * t * t
        x, y = (
            np.broadcast_to(at, self.heights.shape),
            np.broadcast_to(at[:, None], self.heights.shape),
        )
        points = np.stack([x, y, self.heights], -1)
        return grid(points, points[..., :2])

    def __call__(self, x: float, y: float) -> float:
        """The height at a place, in metres."""
        n = len(self.heights)
        t = np.array([y, x]) / self.reach
        p = (np.sign(t) * np.sqrt(np.abs(t)) * 0.5 + 0.5) * (n - 1)
        i = np.clip(np.floor(p).astype(int), 0, n - 2)
        f = p - i
        h = self.heights[i[0] : i[0] + 2, i[1] : i[1] + 2]
        rows = h[:, 0] * (1 - f[1]) + h[:, 1] * f[1]
        return float(rows[0] * (1 - f[0]) + rows[1] * f[0])


def terrain(rng: np.random.Generator, relief_m: float, rough: float) -> Terrain:
    """Hills, nearly flat in the middle so that things can stand there, higher far away."""
    n = 160
    h = fbm(rng, (n, n), (4, 4), 6, rough)
    t = np.linspace(-1, 1, n)
    away = np.maximum(np.abs(t)[:, None], np.abs(t)[None, :])
    near = np.clip((away - 0.05) / 0.5, 0.02, 1)
    far = np.maximum(away - 0.35, 0) ** 2 * rng.uniform(5, 90)
    return Terrain(320.0, h * (relief_m * near) + far * (0.35 + np.abs(h)))


def cut(polygons: list[Array], normal: Array, offset: float) -> list[Array]:
    """What of a convex solid (its faces as polygons ``(K, 3)``) lies where ``n·x <= offset``."""
    kept: list[Array] = []
    rim: list[Array] = []
    for polygon in polygons:
        side = polygon @ normal - offset
        if (side <= 0).all():
            kept.append(polygon)
            continue
        if (side >= 0).all():
            continue
        following, after = np.roll(polygon, -1, 0), np.roll(side, -1)
        points: list[Array] = []
        for p, q, s, t in zip(polygon, following, side, after, strict=True):
            if s <= 0:
                points.append(p)
            if (s <= 0) != (t <= 0):
                crossing = p + (q - p) * (s / (s - t))
                points.append(crossing)
                rim.append(crossing)
        if len(points) >= 3:
            kept.append(np.array(points))
    if len(rim) >= 3:
        p = np.array(rim)
        centre = p.mean(0)
        u = unit(p[0] - centre)
        angle = np.arctan2((p - centre) @ np.cross(normal, u), (p - centre) @ u)
        kept.append(p[np.argsort(angle)])
    return kept


def _cube(half: Array) -> list[Array]:
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            p = np.zeros((4, 3))
            p[:, axis] = sign * half[axis]
            p[:, u] = np.array([-1, 1, 1, -1]) * half[u]
            p[:, v] = np.array([-1, -1, 1, 1]) * half[v] * sign
            faces.append(p)
    return faces


def _solid(polygons: list[Array]) -> Geometry:
    points, faces = [], []
    start = 0
    for p in polygons:
        points.append(p)
        k = len(p)
        i = np.arange(1, k - 1)
        faces.append(np.stack([np.full(k - 2, start), start + i, start + i + 1], -1))
        start += k
    return faceted(np.concatenate(points), np.concatenate(faces))


def fractured(
    rng: np.random.Generator,
    half: tuple[float, float, float],
    pieces: int = 12,
    gap: float = 0.02,
    scatter: float = 0.15,
) -> list[Geometry]:
    """A block broken into Voronoi cells, drawn apart by ``gap``; some lie ``scatter`` away."""
    h = np.array(half)
    seeds = rng.uniform(-h, h, (pieces, 3))
    parts = []
    for i, own in enumerate(seeds):
        polygons = _cube(h)
        for j in np.argsort(((seeds - own) ** 2).sum(1))[1:14]:
            other = seeds[j]
            normal = unit(other - own)
            polygons = cut(polygons, normal, float(normal @ (own + other) / 2))
        if len(polygons) < 4:
            continue
        centre = np.concatenate(polygons).mean(0)
        away = unit(centre) * gap
        turn = np.eye(4)
        if rng.random() < 0.3:
            away = away + unit(centre) * rng.random() * scatter
            turn = rotate(rng.normal(size=3), rng.uniform(-0.5, 0.5))
        place = translate(*(centre + away)) @ turn @ translate(*-centre)
        if i % 3 == 0:  # chipped corner
            polygons = cut(polygons, unit(centre), float(centre @ unit(centre)) + 0.4 * h.min())
        parts.append(_solid(polygons).moved(place))
    return parts


def chunk(rng: np.random.Generator, size: float, cuts: int = 14) -> Geometry:
    """A crystal or a flint: a cube with random planes cut off."""
    polygons = _cube(np.full(3, size))
    for _ in range(cuts):
        polygons = cut(polygons, unit(rng.normal(size=3)), size * rng.uniform(0.65, 1.0))
    return _solid(polygons)


#: Strokes of letter-like signs on a 2x4 lattice: (x0, y0, x1, y1).
_STROKES = [
    (0, 0, 0, 4), (2, 0, 2, 4), (0, 4, 2, 4), (0, 2, 2, 2), (0, 0, 2, 0), (0, 4, 2, 0),
    (0, 0, 2, 4), (1, 0, 1, 4), (0, 2, 0, 4), (2, 0, 2, 2), (0, 2, 2, 0), (0, 2, 2, 4),
]  # fmt: skip


def relief(
    rng: np.random.Generator, letters: int, height: float, depth: float, *, rows: int = 1
) -> Geometry:
    """Raised signs like letters, standing in xz with their front towards −y; base line at z = 0."""
    alphabet = []
    for _ in range(9):
        strokes = []
        for k in rng.choice(len(_STROKES), 3, replace=False):
            x0, y0, x1, y1 = np.array(_STROKES[k], float) * height / 5
            length, angle = np.hypot(x1 - x0, y1 - y0), np.arctan2(y1 - y0, x1 - x0)
            bar = box(length + height * 0.12, depth, height * 0.12)
            bar = bar.moved(translate(0, 0, -height * 0.06))
            middle = translate((x0 + x1) / 2, -depth / 2, (y0 + y1) / 2)
            strokes.append(bar.moved(middle @ rotate("y", -angle)))
        alphabet.append(merge(strokes))
    parts: list[Geometry] = []
    for row in range(rows):
        x = 0.0
        for _ in range(letters):
            if not parts or rng.random() < 0.85:
                sign = alphabet[int(rng.integers(9))]
                parts.append(sign.moved(translate(x, 0, (rows - 1 - row) * height * 1.25)))
            x += height * 0.62
    whole = merge(parts)
    return whole.moved(translate(-letters * height * 0.31, 0, 0))


def wires(
    rng: np.random.Generator, count: int, reach: float, radius: float, *, n: int = 5
) -> Geometry:
    """Hair-thin wires that wander from the origin upwards through a ball of radius ``reach``."""
    tubes = []
    t = np.linspace(0, 1, 24)[:, None]
    for _ in range(count):
        lean = rng.normal(size=3) * [0.5, 0.5, 0.2] + [0, 0, 1]
        curl = rng.normal(size=(2, 3)) * 0.35
        turns = rng.uniform(2, 9, 2)
        path = t * unit(lean) + t * (
            np.sin(turns[0] * t) * curl[0] + np.cos(turns[1] * t) * curl[1]
        )
        tubes.append(tube(path * reach * 0.7, radius * (1.05 - t[:, 0]), n))
    return merge(tubes)


def cage(rng: np.random.Generator, radius: float, wire: float) -> Geometry:
    """A sculpture of closed wire loops about a centre at height ``radius``."""
    t = np.linspace(0, 2 * np.pi, 97)
    loops = []
    for _ in range(int(rng.integers(4, 9))):
        a, b = rng.integers(1, 5, 2)
        path = np.stack([np.cos(t * a), np.sin(t * a), np.sin(t * b + rng.uniform(0, 6))], -1)
        path = unit(path + 0.2 * rng.normal(size=3)) * radius * rng.uniform(0.8, 1)
        loops.append(tube(path @ rotate("x", rng.uniform(0, 3))[:3, :3], wire, 6))
    return merge(loops).moved(translate(0, 0, radius))


def leaf_card(width: float, height: float, bend: float = 0.3) -> Geometry:
    """A card, its stalk at the origin, that rises along z and bends to +y; uv fill it once."""
    t = np.linspace(0, 1, 5)[:, None]
    x = np.array([-0.5, 0.5])[None, :] * width
    points = np.stack(
        np.broadcast_arrays(x, height * bend * t**2, height * t * (1 - 0.3 * bend * t)), -1
    )
    uv = np.stack(np.broadcast_arrays(np.array([[0.0, 1.0]]), t), -1)
    return grid(points, uv)


def foliage(
    rng: np.random.Generator, count: int, radius: float, size: float, *, upright: float = 0.4
) -> Geometry:
    """Cards on a ball: a bush or a crown about the origin."""
    card = leaf_card(size, size * rng.uniform(1.2, 2.2), rng.uniform(0.2, 0.7))
    directions = unit(rng.normal(size=(count, 3)))
    spots = directions * radius * rng.uniform(0.35, 1, (count, 1)) ** 0.6
    up = unit(directions + [0, 0, upright] + rng.normal(size=(count, 3)) * 0.5)
    # A random vector across each card's axis turns it about that axis.
    side = unit(np.cross(up, rng.normal(size=(count, 3))))
    matrices = np.zeros((count, 4, 4))
    matrices[:, :3, 0], matrices[:, :3, 1], matrices[:, :3, 2] = side, np.cross(up, side), up
    matrices[:, :3, 3], matrices[:, 3, 3] = spots, 1
    return copies(card, matrices)


def blades(
    rng: np.random.Generator, spots: Array, height: float, width: float, bend: float = 0.6
) -> Geometry:
    """Grass-like cards at ``spots (N, 3)``."""
    card = leaf_card(width, height, bend)
    matrices = np.zeros((len(spots), 4, 4))
    angle = rng.uniform(0, 2 * np.pi, len(spots))
    size = rng.uniform(0.5, 1.2, len(spots))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(angle) * size
    matrices[:, 0, 1], matrices[:, 1, 0] = -np.sin(angle) * size, np.sin(angle) * size
    matrices[:, 2, 2], matrices[:, 3, 3] = size, 1
    matrices[:, :3, 3] = spots
    return copies(card, matrices)


def cloth(
    rng: np.random.Generator, width: float, height: float, folds: int = 8, depth: float = 0.06
) -> Geometry:
    """A hanging curtain in xz, its top edge at z = 0, with folds along y that open downwards."""
    rows, columns = 14, folds * 10 + 1
    u, v = np.linspace(0, 1, columns)[None, :], np.linspace(0, 1, rows)[:, None]
    phase = 2 * np.pi * folds * (u + 0.06 * np.sin(5 * u + rng.uniform(0, 6)))
    y = depth * (0.6 + 0.4 * v) * np.sin(phase) + 0.3 * depth * v * np.sin(3 * phase / folds + 2)
    x = (u - 0.5) * width + 0.02 * v * np.sin(7 * u)
    points = np.stack(np.broadcast_arrays(x, y, -v * height), -1)
    uv = np.stack(np.broadcast_arrays(u * width * 1.6, (1 - v) * height), -1)
    return grid(points, uv, flip=True)


def cushion(rng: np.random.Generator, x: float, y: float, z: float, level: int = 24) -> Geometry:
    """A pillow: a flat super-ellipsoid with wrinkles."""
    g = super_ellipsoid((x / 2, y / 2, z / 2), rng.uniform(0.5, 0.9), rng.uniform(0.3, 0.5), level)
    noise = solid_noise(rng, g.positions * 9, 3)
    return Geometry(g.positions + g.normals * (0.03 * z * noise[:, None]), g.normals, g.uv, g.faces)
