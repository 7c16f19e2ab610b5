"""The textures of the still life, computed: wood, plaid cloth, an engraving, plaster, covers.

Each function returns linear RGB reflectance ``(H, W, 3)`` float32 in [0, 1]; the same seed gives
the same texture. CC0, like everything in this folder.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Texture = NDArray[np.float32]


def smooth_noise(shape: tuple[int, int], cells: tuple[int, int], seed: int) -> Texture:
    """Value noise ``(H, W)`` in [0, 1]: random values on a grid of ``cells``, smoothly joined."""
    rng = np.random.default_rng(seed)
    grid = rng.random((cells[0] + 1, cells[1] + 1))
    y = np.linspace(0, cells[0], shape[0], endpoint=False)[:, None]
    x = np.linspace(0, cells[1], shape[1], endpoint=False)[None, :]
    j, i = y.astype(int), x.astype(int)
    v, u = y - j, x - i
    v, u = v * v * (3 - 2 * v), u * u * (3 - 2 * u)
    top = grid[j, i] * (1 - u) + grid[j, i + 1] * u
    low = grid[j + 1, i] * (1 - u) + grid[j + 1, i + 1] * u
    return (top * (1 - v) + low * v).astype(np.float32)


def fractal(shape: tuple[int, int], cells: tuple[int, int], seed: int, octaves: int = 5) -> Texture:
    """Sum of value noises, each twice as fine and half as strong; about [0, 1]."""
    total = np.zeros(shape, np.float32)
    for k in range(octaves):
        total += smooth_noise(shape, (cells[0] << k, cells[1] << k), seed + k) / 2 ** (k + 1)
    return total / (1 - 0.5**octaves)


def mix(a: tuple[float, ...], b: tuple[float, ...], t: Texture) -> Texture:
    """Between two colours by ``t`` ``(H, W)``."""
    t = np.clip(t, 0, 1)[..., None]
    return (np.asarray(a, np.float32) * (1 - t) + np.asarray(b, np.float32) * t).astype(np.float32)


def wood(height: int = 1024, width: int = 2048, planks: int = 6, seed: int = 7) -> Texture:
    """Planks along the width: bent year rings, fine pores, a dark groove between planks."""
    rng = np.random.default_rng(seed)
    rows = height // planks
    strips = []
    for k in range(planks):
        size = (rows, width)
        bend = fractal(size, (2, 3), seed + 31 * k, 4)
        across = np.linspace(0, 1, rows, dtype=np.float32)[:, None]
        rings = 0.5 + 0.5 * np.sin(2 * np.pi * (across * 5 + bend * 6 + rng.random()))
        fibre = smooth_noise(size, (rows // 2, 24), seed + 31 * k + 7)
        pores = smooth_noise(size, (rows // 2, 90), seed + 31 * k + 9) ** 8
        tone = 0.55 * rings**2 + 0.3 * fibre + 0.15 * bend
        plank = mix((0.36, 0.19, 0.085), (0.13, 0.055, 0.022), tone)
        plank *= (1 - 0.6 * pores[..., None]) * (0.82 + 0.36 * rng.random())
        edge = np.minimum(across, 1 - across)
        strips.append(plank * np.clip(edge * rows / 2.5, 0.12, 1)[..., None])
    return np.concatenate(strips).astype(np.float32)


def plaid(size: int = 1024, threads: int = 256) -> Texture:
    """A woven cloth: coloured warp and weft, twill binding, so detail down to single threads."""
    cream, blue, red = (0.70, 0.64, 0.52), (0.045, 0.10, 0.22), (0.42, 0.035, 0.03)
    number = np.arange(threads) % 64
    colours = np.empty((threads, 3), np.float32)
    colours[:] = cream
    colours[(number >= 8) & (number < 24)] = blue
    colours[(number >= 28) & (number < 30)] = red
    colours[(number >= 34) & (number < 36)] = red
    step = np.arange(size) * threads // size
    warp, weft = colours[step][None, :, :], colours[step][:, None, :]
    over = ((step[None, :] + step[:, None]) % 4 < 2)[..., None]
    phase = (np.arange(size) * threads / size) % 1
    bulge = (1 - 0.45 * (2 * phase - 1) ** 2).astype(np.float32)
    shade = np.where(over[..., 0], bulge[None, :], bulge[:, None])[..., None]
    return (np.where(over, warp, weft) * shade).astype(np.float32)


def engraving(height: int = 512, width: int = 400) -> Texture:
    """A print for the wall: a moon over hills, in lines whose weight makes the tone."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    y, x = y / height, x / width
    tone = 0.35 + 0.25 * y
    moon = (x - 0.64) ** 2 + ((y - 0.27) * height / width) ** 2 < 0.17**2
    tone = np.where(moon, 0.02, tone)
    for k, (base, depth) in enumerate(((0.55, 0.45), (0.66, 0.62), (0.79, 0.82))):
        ridge = base + 0.07 * np.sin(7 * x + 2.1 * k) + 0.03 * np.sin(17 * x + 5 * k)
        tone = np.where(y > ridge, depth + 0.12 * np.sin(30 * (y - ridge)), tone)
    lines = 0.5 + 0.5 * np.sin(2 * np.pi * (y * 42 + 0.6 * np.sin(5 * x + 3 * tone)))
    ink = 1 / (1 + np.exp(-18 * (tone - lines)))
    print_ = mix((0.78, 0.73, 0.62), (0.035, 0.045, 0.07), ink)
    inside = (np.abs(x - 0.5) < 0.4) & (np.abs(y - 0.5) < 0.42)
    return np.where(inside[..., None], print_, np.float32([0.80, 0.77, 0.70])).astype(np.float32)


def plaster(size: int = 512, seed: int = 3) -> Texture:
    """The wall: grey-green with brush marks and blotches."""
    blotch = fractal((size, size), (4, 4), seed, 6)
    brush = smooth_noise((size, size), (16, 128), seed + 40)
    return mix((0.25, 0.34, 0.33), (0.42, 0.50, 0.46), 0.8 * blotch + 0.25 * brush)


def pages(height: int = 64, width: int = 256, seed: int = 5) -> Texture:
    """The cut of a book: thin sheets."""
    sheet = np.random.default_rng(seed).random((height, 1)).astype(np.float32)
    return mix((0.48, 0.42, 0.31), (0.78, 0.73, 0.61), np.repeat(sheet, width, 1))


def peel(size: int = 512, seed: int = 11) -> Texture:
    """The skin of an orange: pores and a blush."""
    pores = smooth_noise((size, size), (64, 96), seed) ** 3
    blush = fractal((size, size), (3, 4), seed + 5, 3)
    return mix((0.80, 0.27, 0.022), (0.62, 0.13, 0.012), 0.55 * blush + 0.7 * pores)
