"""The shapes of the still life, computed: turned bodies, wire solids, a twig, folded cloth.

A mesh is ``(vertices (V, 3), faces (F, 3), uv (V, 2))``; y is up. CC0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]
Rod = tuple[NDArray[np.float64], NDArray[np.float64]]


def smooth_profile(points: list[tuple[float, float]], steps: int = 12) -> NDArray[np.float64]:
    """A Catmull-Rom curve through (radius, height) points."""
    p = np.asarray([points[0], *points, points[-1]], np.float64)
    t = np.linspace(0, 1, steps, endpoint=False)[:, None]
    parts = []
    for a, b, c, d in zip(p, p[1:], p[2:], p[3:], strict=False):
        parts.append(
            0.5
            * (
                2 * b
                + (c - a) * t
                + (2 * a - 5 * b + 4 * c - d) * t**2
                + (3 * b - a - 3 * c + d) * t**3
            )
        )
    return np.concatenate([*parts, p[-1:]])


def turned(
    profile: NDArray[np.float64], around: int = 128, flutes: int = 0, depth: float = 0.0
) -> Mesh:
    """A body turned on a lathe; ``flutes`` grooves of relative ``depth`` run up its side."""
    angle = np.linspace(0, 2 * np.pi, around + 1)
    radius, height = profile[:, :1], profile[:, 1:]
    wave = 1 - depth * np.abs(np.sin(angle * flutes / 2)) if flutes else np.ones_like(angle)
    x, z = radius * wave * np.cos(angle), radius * wave * np.sin(angle)
    vertices = np.stack([x, np.broadcast_to(height, x.shape), z], -1).reshape(-1, 3)
    rows = len(profile)
    u, v = np.meshgrid(np.linspace(0, 1, around + 1), np.linspace(0, 1, rows))
    return vertices.astype(np.float32), grid_faces(rows, around + 1), uv_of(u, v)


def grid_faces(rows: int, columns: int) -> NDArray[np.uint32]:
    """Two triangles for every cell of a grid of vertices."""
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]
    faces = np.stack([a, c, b, b, c, d], -1).reshape(-1, 3)
    return faces.astype(np.uint32)


def uv_of(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float32]:
    """Two grids to a list of texture coordinates."""
    return np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)


def runner(width: float, length: float, drop: float, bend: float = 0.12, n: int = 160) -> Mesh:
    """A cloth along z that lies flat and falls over the front edge (z = 0) with soft waves."""
    s = np.linspace(-length, drop, n)[:, None]
    x = np.linspace(-0.5, 0.5, n)[None, :] * width
    s, x = np.broadcast_arrays(s, x)
    turn = np.clip((s + bend) / (2 * bend), 0, 1) * np.pi / 2
    z = np.where(s < -bend, s, np.where(s > bend, 0.0, -bend + bend * np.sin(turn)))
    y = np.where(s < -bend, 0.0, np.where(s > bend, -s, -bend + bend * np.cos(turn)))
    hanging = np.clip(s / drop, 0, 1)
    z = z + 0.10 * hanging * np.sin(x * 4.2 + 0.6)
    y = y + 0.012 * (1 - hanging) * (1 + np.sin(s * 5 + x * 3) * np.sin(x * 2 - s))
    vertices = np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32)
    return vertices, grid_faces(n, n), uv_of(x / width + 0.5, s / width)


def dodecahedron() -> tuple[NDArray[np.float64], list[tuple[int, int]]]:
    """The 20 corners, at distance 1 and standing on a face, and the 30 edges."""
    g = (1 + 5**0.5) / 2
    signs = [-1.0, 1.0]
    corners = [(x, y, z) for x in signs for y in signs for z in signs]
    for a in signs:
        for b in signs:
            corners += [(0, a / g, b * g), (a / g, b * g, 0), (a * g, 0, b / g)]
    p = np.array(corners) / 3**0.5
    tilt = np.arctan2(1 / g, 1.0)  # takes a face's normal to the vertical
    c, s = np.cos(tilt), np.sin(tilt)
    p = p @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    gaps = np.linalg.norm(p[:, None] - p[None], axis=-1)
    side = gaps[gaps > 1e-6].min()
    edges = [(i, j) for i in range(20) for j in range(i) if gaps[i, j] < side * 1.01]
    return p, edges


def twig(
    start: tuple[float, float, float], heading: tuple[float, float, float], length: float, seed: int
) -> tuple[list[Rod], list[NDArray[np.float64]]]:
    """A bent stem with side shoots: thin rods, and where the berries sit."""
    rng = np.random.default_rng(seed)
    at, way = np.array(start, float), np.array(heading, float)
    way /= np.linalg.norm(way)
    steps = 9
    rods: list[Rod] = []
    berries: list[NDArray[np.float64]] = []
    for k in range(steps):
        way = way + rng.normal(0, 0.13, 3)
        way /= np.linalg.norm(way)
        to = at + way * length / steps
        rods.append((at, to))
        if k > 2:
            side = np.cross(way, rng.normal(0, 1, 3))
            side = side / np.linalg.norm(side) * 0.8 + way * 0.7
            end = to + side * length * (0.10 + 0.09 * rng.random())
            rods.append((to, end))
            berries.append(end)
        at = to
    return rods, [*berries, at]
