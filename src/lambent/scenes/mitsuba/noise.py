"""Smooth random fields: the raw matter of textures and displaced surfaces.

Value noise on a periodic lattice with a quintic fade ("Improving Noise", Ken Perlin, SIGGRAPH 2002,
for the fade) and sums of its octaves ("An Image Synthesizer", Perlin 1985). In two dimensions a
lattice is enlarged by two small matrix products, so that an image costs a millisecond; cells come
from a jittered grid ("A Cellular Texture Basis Function", Worley 1996).
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def generator(seed: int, *stream: int) -> np.random.Generator:
    """An independent stream of random numbers of a seed, the same on every machine."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, *stream])))


def fade(t: Array) -> Array:
    """The quintic ``6t⁵ − 15t⁴ + 10t³``, from 0 to 1 with two vanishing derivatives."""
    return t * t * t * (t * (t * 6 - 15) + 10)


@functools.lru_cache(maxsize=64)
def _rows(size: int, cells: int) -> Array:
    """The matrix ``(size, cells)`` that enlarges a periodic row of values."""
    x = (np.arange(size) + 0.5) * cells / size
    i = np.floor(x).astype(int)
    f = fade(x - i)
    rows = np.zeros((size, cells))
    np.add.at(rows, (np.arange(size), i % cells), 1 - f)
    np.add.at(rows, (np.arange(size), (i + 1) % cells), f)
    return rows


def value_noise(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[int, int], channels: int = 0
) -> Array:
    """Periodic noise in [-1, 1], ``(H, W)`` or ``(H, W, channels)``, ``cells`` down and across."""
    ny, nx = (max(1, min(c, s)) for c, s in zip(cells, shape, strict=True))
    up, across = _rows(shape[0], ny), _rows(shape[1], nx)
    if channels == 0:
        return up @ rng.uniform(-1, 1, (ny, nx)) @ across.T
    layers = [up @ rng.uniform(-1, 1, (ny, nx)) @ across.T for _ in range(channels)]
    return np.stack(layers, -1)


def fbm(
    rng: np.random.Generator,
    shape: tuple[int, int],
    cells: tuple[int, int] = (4, 4),
    octaves: int = 5,
    gain: float = 0.5,
) -> Array:
    """Octaves of `value_noise`, each twice as fine and ``gain`` as strong; about [-1, 1]."""
    total = np.zeros(shape)
    weight, norm = 1.0, 0.0
    for octave in range(octaves):
        fine = (cells[0] << octave, cells[1] << octave)
        total += weight * value_noise(rng, shape, fine)
        norm += weight * weight
        weight *= gain
    return total * (1.15 / np.sqrt(norm))


def warp(image: Array, dx: Array, dy: Array) -> Array:
    """``image`` looked up at pixels moved by ``dx`` and ``dy`` (in pixels), periodically."""
    h, w = image.shape[:2]
    y, x = np.mgrid[0:h, 0:w]
    rows = np.floor(y + dy).astype(int) % h
    columns = np.floor(x + dx).astype(int) % w
    return image[rows, columns]


def cells(
    rng: np.random.Generator, shape: tuple[int, int], count: tuple[int, int], jitter: float = 0.9
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Distance to the nearest and second nearest of jittered points, and the nearest one's number.

    Distances are in cells; all three are ``(H, W)`` and periodic.
    """
    ny, nx = count
    points = rng.uniform(0.5 - jitter / 2, 0.5 + jitter / 2, (ny, nx, 2))
    y = (np.arange(shape[0]) + 0.5) * ny / shape[0]
    x = (np.arange(shape[1]) + 0.5) * nx / shape[1]
    yi, xi = np.floor(y).astype(int), np.floor(x).astype(int)
    yf, xf = (y - yi)[:, None], (x - xi)[None, :]
    first = np.full(shape, 9.0)
    second = np.full(shape, 9.0)
    number = np.zeros(shape, np.int64)
    for oy in (-1, 0, 1):
        for ox in (-1, 0, 1):
            row, column = ((yi + oy) % ny)[:, None], ((xi + ox) % nx)[None, :]
            p = points[row, column]
            distance = np.hypot(p[..., 0] + oy - yf, p[..., 1] + ox - xf)
            nearer = distance < first
            second = np.where(nearer, first, np.minimum(second, distance))
            number = np.where(nearer, row * nx + column, number)
            first = np.where(nearer, distance, first)
    return first, second, number


def solid_noise(rng: np.random.Generator, points: Array, octaves: int = 4) -> Array:
    """Octaves of value noise at points ``(N, 3)``, one cell a unit in the first; about [-1, 1]."""
    lattice = rng.uniform(-1, 1, (16, 16, 16))
    total = np.zeros(len(points))
    weight, norm = 1.0, 0.0
    p = points + rng.uniform(0, 16, 3)
    for _ in range(octaves):
        i = np.floor(p).astype(int)
        f = fade(p - i)
        lo, hi = i & 15, (i + 1) & 15
        value = np.zeros(len(points))
        for corner in range(8):
            index = [np.where(corner >> a & 1, hi[:, a], lo[:, a]) for a in range(3)]
            factor = [f[:, a] if corner >> a & 1 else 1 - f[:, a] for a in range(3)]
            value += lattice[tuple(index)] * factor[0] * factor[1] * factor[2]
        total += weight * value
        norm += weight * weight
        weight *= 0.5
        p = p * 2.03 + 5.7
    return total * (1.3 / np.sqrt(norm))
