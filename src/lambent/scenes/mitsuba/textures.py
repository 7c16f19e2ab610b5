"""Pictures on surfaces, made as NumPy bitmaps: wood, bricks, tiles, cloth, paper, posters.

All take a random generator and return values in [0, 1] that repeat without a seam: pictures
``(H, W, 3)`` in sRGB, heights and roughness ``(H, W)``. `to_bytes` makes them 8 bit. Wood is rings
seen through noise, marble is a warped stripe ("An Image Synthesizer", Perlin 1985).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.scenes.mitsuba.noise import Array, cells, fbm, value_noise, warp

Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Cover:
    """What a texture says of a surface: ``colour (H, W, 3)``, ``height (H, W)``, ``rough (H, W)``.

    Height is 0 to 1 (1 stands out); rough is a factor on the material's roughness, about 1.
    ``metres`` is the length of a side on the surface.
    """

    colour: Array
    height: Array
    rough: Array
    metres: float


def to_bytes(image: Array) -> NDArray[np.uint8]:
    """Values in [0, 1] as 8 bit, with a channel axis."""
    image = image[..., None] if image.ndim == 2 else image
    return np.clip(np.rint(image * 255), 0, 255).astype(np.uint8)


def mix(a: Array | Colour, b: Array | Colour, t: Array) -> Array:
    """Between two colours, by ``t (H, W)``."""
    t = np.clip(t, 0, 1)[..., None]
    return np.asarray(a) * (1 - t) + np.asarray(b) * t


def darker(colour: Colour, factor: float) -> Colour:
    """A colour times a factor, within [0, 1]."""
    r, g, b = (float(np.clip(c * factor, 0, 1)) for c in colour)
    return r, g, b


def plain(rng: np.random.Generator, colour: Colour, n: int = 64) -> Cover:
    """One colour with the faint unevenness of paint."""
    noise = fbm(rng, (n, n), (3, 3), 4)
    picture = np.clip(np.asarray(colour) * (1 + 0.04 * noise[..., None]), 0, 1)
    return Cover(picture, 0.5 + 0.3 * noise, 1 + 0.15 * noise, 1.0)


def wood(rng: np.random.Generator, colour: Colour, n: int = 256) -> Cover:
    """Grain along v: rings of a log cut lengthwise, with pores."""
    bend = fbm(rng, (n, n), (1, 3), 4)
    x = np.linspace(0, 1, n, endpoint=False)[None, :]
    rings = float(rng.integers(3, 10))
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * (rings * x + bend * rng.uniform(0.8, 2.2)))
    streak = value_noise(rng, (n, n), (4, n // 2)) * 0.5 + value_noise(rng, (n, n), (2, n // 8))
    t = 0.55 * wave**1.6 + 0.25 * streak
    picture = mix(darker(colour, 1.15), darker(colour, rng.uniform(0.35, 0.65)), t)
    return Cover(np.clip(picture, 0, 1), 1 - t, 0.8 + 0.5 * np.clip(t, 0, 1), 0.6)


def planks(rng: np.random.Generator, colour: Colour, n: int = 512) -> Cover:
    """A floor of boards along v, each cut from another place of the wood, with dark joints."""
    grain = wood(rng, colour, n)
    across, along = int(rng.integers(5, 10)), int(rng.integers(1, 4))
    x = np.arange(n)[None, :] * across / n
    board = np.floor(x).astype(int)
    offset = rng.random(across)[board]
    y = (np.arange(n)[:, None] / n + offset) % 1 * along
    row = np.floor(y).astype(int)
    number = board + across * row
    shift = rng.integers(0, n, (across * along, 2))
    tone = rng.uniform(0.72, 1.15, across * along)
    yy = (np.arange(n)[:, None] + shift[number, 0]) % n
    xx = (np.arange(n)[None, :] + shift[number, 1]) % n
    picture = grain.colour[yy, xx] * tone[number][..., None]
    fx, fy = x - board, y - row
    edge = np.minimum(np.minimum(fx, 1 - fx) / across, np.minimum(fy, 1 - fy) / along)
    joint = np.clip(edge * n / 1.5, 0, 1)
    picture = picture * (0.35 + 0.65 * joint[..., None])
    return Cover(
        np.clip(picture, 0, 1), joint * (0.85 + 0.15 * grain.height[yy, xx]),
        grain.rough[yy, xx], across * 0.13,
    )  # fmt: skip


def bricks(rng: np.random.Generator, colour: Colour, n: int = 512) -> Cover:
    """A running bond with mortar, each brick of its own tone."""
    rows, columns = 8, 4
    wobble = value_noise(rng, (n, n), (24, 24), 2) * 0.02
    y = np.arange(n)[:, None] * rows / n + wobble[..., 0] * 1.5
    row = np.floor(y).astype(int) % rows
    x = np.arange(n)[None, :] * columns / n + (row % 2) * 0.5 + wobble[..., 1]
    column = np.floor(x).astype(int) % columns
    fx, fy = x - np.floor(x), y - np.floor(y)
    edge = np.minimum(np.minimum(fx, 1 - fx) * 2, np.minimum(fy, 1 - fy))
    body = np.clip((edge - 0.06) / 0.05, 0, 1)
    tone = rng.uniform(0.65, 1.15, (rows, columns))[row, column]
    hue = rng.uniform(-0.03, 0.03, (rows, columns, 3))[row, column]
    grit = fbm(rng, (n, n), (32, 32), 3)
    brick = np.clip(np.asarray(colour) * tone[..., None] + hue, 0, 1)
    brick = brick * (1 + 0.18 * grit[..., None])
    mortar = float(rng.uniform(0.35, 0.75)) * (1 + 0.1 * grit)
    picture = np.clip(mix(mortar[..., None] * np.ones(3), brick, body), 0, 1)
    return Cover(picture, body * (0.85 + 0.15 * grit), 1 - 0.1 * body, 1.0)


def tiles(rng: np.random.Generator, colours: list[Colour], n: int = 512) -> Cover:
    """Square or hexagonal-looking tiles of two or three colours, in a pattern or at random."""
    k = int(rng.choice([2, 4, 6, 8]))
    y, x = np.arange(n)[:, None] * k / n, np.arange(n)[None, :] * k / n
    if rng.random() < 0.25:  # diamonds
        y, x = (y + x) % k, (y - x) % k
    i, j = np.floor(y).astype(int) % k, np.floor(x).astype(int) % k
    mode = rng.integers(3)
    choice = (i + j) % 2 if mode == 0 else rng.integers(0, len(colours), (k, k))[i, j]
    if mode == 2:
        choice = np.zeros_like(choice)
    fy, fx = y - np.floor(y), x - np.floor(x)
    edge = np.minimum(np.minimum(fx, 1 - fx), np.minimum(fy, 1 - fy))
    body = np.clip((edge - 0.012) * 40, 0, 1)
    cloud = fbm(rng, (n, n), (6, 6), 5)
    veins = np.clip(1 - np.abs(fbm(rng, (n, n), (3, 3), 5)) * 7, 0, 1) * rng.choice([0, 0.35])
    base = np.asarray(colours)[choice] * rng.uniform(0.88, 1.05, (k, k))[i, j][..., None]
    base = base * (1 + 0.06 * cloud - veins)[..., None]
    grout = float(rng.uniform(0.15, 0.6))
    picture = np.clip(mix((grout, grout, grout), base, body), 0, 1)
    return Cover(picture, body, 1.8 - 0.8 * body + 0.2 * cloud, k * float(rng.choice([0.15, 0.3])))


def checks(rng: np.random.Generator, colours: list[Colour], n: int = 256) -> Cover:
    """Tablecloth checks, tartan or stripes: bands of colours woven over each other."""
    k = int(rng.choice([4, 6, 8, 12]))
    bands = rng.integers(0, len(colours), k)
    width = np.sort(rng.integers(0, n, k - 1))
    position = np.searchsorted(width, np.arange(n))
    across = np.asarray(colours)[bands[position]][None, :]
    down = np.asarray(colours)[bands[position]][:, None]
    weave = ((np.arange(n)[:, None] + np.arange(n)[None, :]) // 2 % 2)[..., None]
    stripes = rng.random() < 0.35
    picture = across + 0 * down if stripes else np.where(weave == 0, across, down)
    thread = 0.5 + 0.5 * np.sin(np.arange(n) * np.pi / 2)
    height = thread[:, None] * weave[..., 0] + thread[None, :] * (1 - weave[..., 0])
    return Cover(np.clip(picture + 0 * weave, 0, 1), height, np.ones((n, n)), 0.5)


def fabric(rng: np.random.Generator, colour: Colour, n: int = 256) -> Cover:
    """Coarse weave with uneven threads, or knitting."""
    k = int(rng.choice([24, 32, 64]))
    y, x = np.arange(n)[:, None] * k / n, np.arange(n)[None, :] * k / n
    over = (np.floor(y) + np.floor(x)) % 2
    bump = np.where(over == 0, np.sin(np.pi * (x % 1)), np.sin(np.pi * (y % 1)))
    thread = np.where(over == 0, rng.normal(1, 0.12, k)[np.floor(x).astype(int) % k],
                      rng.normal(1, 0.12, k)[np.floor(y).astype(int) % k])  # fmt: skip
    shade = (0.6 + 0.4 * bump) * thread * (1 + 0.06 * fbm(rng, (n, n), (4, 4), 4))
    picture = np.clip(np.asarray(colour) * shade[..., None], 0, 1)
    return Cover(picture, bump, np.ones((n, n)), k * 0.004)


def rug(rng: np.random.Generator, colours: list[Colour], n: int = 512) -> Cover:
    """A carpet that fills its rectangle once: borders, medallions, fourfold symmetry."""
    h = n // 2
    y, x = np.mgrid[0:h, 0:h] / h
    to_edge = np.minimum(x, y)
    shapes = [np.abs(x - a) + np.abs(y - b) for a, b in rng.uniform(0.2, 1, (5, 2))]
    field = sum(np.floor(s * k) for s, k in zip(shapes, rng.integers(2, 7, 5), strict=True))
    ripple = np.sin(40 * to_edge) * np.sin(36 * x) * np.sin(36 * y)
    number = (field + (ripple > 0.3) * 2).astype(int) % len(colours)
    border = np.floor(to_edge * rng.uniform(18, 26)).astype(int)
    number = np.where(border < 4, (border * 2 + (np.floor(x * 30 + y * 30) % 2).astype(int))
                      % len(colours), number)  # fmt: skip
    quarter = np.asarray(colours)[number]
    half = np.concatenate([quarter, quarter[:, ::-1]], 1)
    whole = np.concatenate([half, half[::-1]], 0)
    pile = value_noise(rng, (n, n), (n // 2, n // 2))
    picture = whole * (0.85 + 0.15 * pile[..., None]) * (1 + 0.08 * fbm(rng, (n, n)))[..., None]
    return Cover(np.clip(picture, 0, 1), 0.5 + 0.5 * pile, np.ones((n, n)), 1.0)


def marble(rng: np.random.Generator, colours: list[Colour], n: int = 512) -> Cover:
    """Veins of several widths in clouded stone."""
    dx, dy = (fbm(rng, (n, n), (3, 3), 5) * n * 0.09 for _ in range(2))
    body = warp(fbm(rng, (n, n), (2, 3), 5), dx, dy)
    vein = np.exp(-np.abs(warp(fbm(rng, (n, n), (3, 4), 4), dx, dy)) * rng.uniform(14, 40))
    fine = np.exp(-np.abs(fbm(rng, (n, n), (6, 6), 4)) * 40) * 0.4
    picture = mix(colours[0], darker(colours[0], 0.75), 0.5 + 0.7 * body)
    picture = mix(picture, colours[1], vein * 0.9 + fine)
    return Cover(np.clip(picture, 0, 1), 1 - vein * 0.5, 1 + 0.3 * vein, 1.2)


def concrete(rng: np.random.Generator, colour: Colour, n: int = 256) -> Cover:
    """Clouds, streaks, pores."""
    cloud = fbm(rng, (n, n), (3, 3), 6, 0.6)
    first, _, _ = cells(rng, (n, n), (20, 20))
    pores = np.clip(first * 7 - 0.4, 0, 1) ** 0.5
    pores = np.where(value_noise(rng, (n, n), (9, 9)) > 0.1, pores, 1)
    stain = np.clip(value_noise(rng, (n, n), (2, 40)) * fbm(rng, (n, n), (2, 2)), 0, 1)
    shade = (1 + 0.14 * cloud - 0.25 * stain) * (0.6 + 0.4 * pores)
    picture = np.clip(np.asarray(colour) * shade[..., None], 0, 1)
    return Cover(picture, 0.4 * cloud + 0.6 * pores, 1 + 0.2 * cloud, 1.6)


def stones(rng: np.random.Generator, colour: Colour, n: int = 256) -> Cover:
    """Cobbles, or cracked earth: cells with dark gaps."""
    k = int(rng.choice([5, 8, 12]))
    first, second, number = cells(rng, (n, n), (k, k), 0.8)
    gap = np.clip((second - first) * rng.uniform(4, 9), 0, 1)
    tone = rng.uniform(0.6, 1.2, k * k)[number]
    hue = rng.normal(0, 0.012, (k * k, 3))[number]
    grit = fbm(rng, (n, n), (16, 16), 4)
    picture = (np.asarray(colour) * tone[..., None] + hue) * (1 + 0.15 * grit[..., None])
    picture = np.clip(picture * (0.25 + 0.75 * gap[..., None]), 0, 1)
    return Cover(picture, gap * (1 - 0.4 * first**2) + 0.1 * grit, 1 - 0.1 * gap, k * 0.12)


def ground(rng: np.random.Generator, colours: list[Colour], n: int = 384) -> Cover:
    """Earth, sand, grass, snow: colours mixed by noise of all scales."""
    a, b = fbm(rng, (n, n), (3, 3), 7, 0.6), fbm(rng, (n, n), (8, 8), 6, 0.7)
    speck = value_noise(rng, (n, n), (n // 2, n // 2))
    picture = mix(colours[0], colours[1], 0.5 + 0.8 * a)
    picture = mix(picture, colours[2 % len(colours)], np.clip(b, 0, 1))
    picture = picture * (1 + 0.16 * speck)[..., None]
    return Cover(np.clip(picture, 0, 1), 0.5 + 0.4 * b + 0.1 * speck, 1 + 0.1 * a, 3.0)


def rusted(rng: np.random.Generator, n: int = 256) -> tuple[Array, Array]:
    """Rust colours ``(H, W, 3)`` and where rust has eaten ``(H, W)``."""
    f = fbm(rng, (n, n), (4, 4), 6, 0.6)
    eaten = np.clip((f + rng.uniform(-0.4, 0.3)) * 5, 0, 1)
    colour = mix((0.36, 0.18, 0.1), (0.62, 0.33, 0.14), 0.5 + 0.6 * fbm(rng, (n, n), (8, 8), 5))
    return np.clip(colour, 0, 1), eaten


def ornament(rng: np.random.Generator, colours: list[Colour], n: int = 256) -> Cover:
    """Wallpaper: a motif in a half-drop repeat over faint stripes."""
    k = int(rng.choice([2, 3, 4]))
    y, x = np.mgrid[0:n, 0:n] * (k / n)
    y = y + 0.5 * (np.floor(x) % 2)
    fx, fy = (x % 1) - 0.5, (y % 1) - 0.5
    r, angle = np.hypot(fx, fy), np.arctan2(fy, fx)
    petals = int(rng.integers(3, 9))
    flower = 0.3 + 0.12 * np.cos(petals * angle) + 0.05 * np.cos(2 * petals * angle)
    inside = np.clip((flower - r) * n / k / 2, 0, 1)
    core = np.clip((flower * 0.45 - r) * n / k / 2, 0, 1)
    stripe = 0.04 * (np.floor(x * 4) % 2)
    picture = np.asarray(colours[0]) * (1 - stripe[..., None])
    picture = mix(mix(picture, colours[1], inside), colours[2 % len(colours)], core)
    return Cover(np.clip(picture, 0, 1), 0.5 + 0.5 * inside, 1 - 0.2 * inside, k * 0.25)


def page(rng: np.random.Generator, n: int = 256, dark: bool = False) -> Array:
    """A printed page ``(H, W, 3)``: a heading, columns of word-like marks, perhaps a picture."""
    paper = np.asarray((0.93, 0.91, 0.86)) * rng.uniform(0.9, 1.03)
    ink = np.zeros((n, n))
    lines = int(rng.integers(18, 44))
    pitch = n / lines
    columns = int(rng.integers(1, 4))
    strokes = rng.random((n, n)) < 0.62
    left = n // 12
    width = (n - 2 * left) // columns
    for line in range(2, lines - 2):
        y0, y1 = int(line * pitch), int(line * pitch + max(1, pitch * 0.55))
        for c in range(columns):
            x = left + c * width
            end = x + int((width - n // 24) * (1 if rng.random() < 0.85 else rng.random()))
            while x < end:
                w = int(rng.integers(2, max(4, n // 18)))
                ink[y0:y1, x : min(x + w, end)] = 1
                x += w + max(2, n // 100)
    ink *= strokes
    ink[int(pitch * 0.6) : int(pitch * 1.4), left : left + int(n * rng.uniform(0.3, 0.7))] = 0.9
    picture = mix(paper, (0.08, 0.08, 0.1), ink)
    if rng.random() < 0.5:
        m = n // 3
        y, x = rng.integers(n // 6, n // 2, 2)
        picture[y : y + m, x : x + m] = abstract(rng, m)
    return 1 - picture if dark else np.clip(picture, 0, 1)


def abstract(rng: np.random.Generator, n: int = 256) -> Array:
    """A random picture ``(n, n, 3)``: discs, bars, gradients, noise, landscapes of ridges."""
    y, x = np.mgrid[0:n, 0:n] / n
    pal = rng.random((6, 3)) ** rng.uniform(0.6, 1.6)
    style = rng.integers(5)
    if style == 0:  # circles and bars on a gradient
        picture = mix(pal[0], pal[1], y)
        for k in range(int(rng.integers(5, 16))):
            cx, cy = rng.random(2)
            r = rng.uniform(0.03, 0.3)
            inside = np.hypot(x - cx, y - cy) < r if k % 2 else (
                (np.abs(x - cx) < r) & (np.abs(y - cy) < r * rng.uniform(0.1, 1)))  # fmt: skip
            picture[inside] = pal[rng.integers(6)]
    elif style == 1:  # ridges of mountains under a sky
        picture = mix(pal[0], pal[1] * 0.5 + 0.5, y)
        for k in range(5):
            base = 0.75 - 0.14 * k
            crest = base + 0.12 * value_noise(rng, (1, n), (1, 4 + 3 * k))[0]
            crest = crest + 0.03 * value_noise(rng, (1, n), (1, 30))[0]
            below = (1 - y) < crest[None, :]
            picture[below] = pal[2] * (0.25 + 0.18 * k) + pal[1] * 0.08 * (4 - k)
    elif style == 2:  # marbled colour
        f = fbm(rng, (n, n), (2, 2), 5)
        f = warp(f, f * n * 0.3, -f * n * 0.2)
        index = np.clip((f * 0.5 + 0.5) * 5, 0, 4.999)
        low = np.floor(index).astype(int)
        picture = mix(pal[low], pal[low + 1], index - low)
    elif style == 3:  # a grid of blocks
        k = int(rng.integers(3, 12))
        block = rng.integers(0, 6, (k, k))
        i, j = np.minimum((y * k).astype(int), k - 1), np.minimum((x * k).astype(int), k - 1)
        picture = pal[block[i, j]].copy()
        fy, fx = y * k % 1, x * k % 1
        picture[(np.minimum(fy, fx) < 0.06)] = pal[5] * 0.3
    else:  # rays and rings
        cx, cy = rng.random(2)
        a = np.arctan2(y - cy, x - cx) * int(rng.integers(3, 12)) / np.pi
        r = np.hypot(x - cx, y - cy) * rng.uniform(4, 16)
        picture = pal[
            (np.floor(a + (rng.random() < 0.5) * r).astype(int) + np.floor(r).astype(int)) % 6
        ]
    picture = picture * (1 + 0.05 * value_noise(rng, (n, n), (n // 2, n // 2)))[..., None]
    return np.clip(picture, 0, 1)


def leaf(rng: np.random.Generator, n: int = 128) -> tuple[Array, Array]:
    """A leaf or a spray of leaves with stalk at the lower edge: colours and coverage ``(n, n)``."""
    y, x = np.mgrid[0:n, 0:n] / n
    green = np.asarray([rng.uniform(0.15, 0.5), rng.uniform(0.35, 0.62), rng.uniform(0.08, 0.25)])
    if rng.random() < 0.2:
        green = green[[1, 0, 2]]  # autumn
    coverage = np.zeros((n, n))
    shade = np.zeros((n, n))
    leaves = int(rng.choice([1, 1, 5, 9]))
    for k in range(leaves):
        if leaves == 1:
            cx, cy, length, angle = 0.5, 0.0, 0.98, np.pi / 2
        else:
            cy = k / leaves * 0.75
            cx, length = 0.5, 0.45
            angle = np.pi / 2 + (0.9 if k % 2 else -0.9) * (k < leaves - 1)
        u = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
        v = -(x - cx) * np.sin(angle) + (y - cy) * np.cos(angle)
        t = np.clip(u / length, 0, 1)
        half = length * rng.uniform(0.22, 0.38) * np.sqrt(np.clip(t * (1 - t), 0, 1)) * (1.5 - t)
        inside = (np.abs(v) < half) & (u > 0) & (u < length)
        coverage[inside] = 1
        vein = np.abs(v) < 0.012 + 0.02 * (np.abs((t * 9 + np.abs(v) * 6 / length) % 1) < 0.12)
        shade[inside] = np.where(vein, 0.3, rng.uniform(-0.2, 0.2))[inside]
    coverage[(np.abs(x - 0.5) < 0.012) & (y < 0.75 if leaves > 1 else y < 0.2)] = 1
    noise = fbm(rng, (n, n), (4, 4), 4) * 0.2
    return np.clip(green * (1 + shade + noise)[..., None], 0, 1), coverage


def screen(rng: np.random.Generator, n: int = 256) -> Array:
    """What glows on a screen or a shop sign ``(n, n, 3)``: a picture, windows, or neon signs."""
    if rng.random() < 0.5:
        return abstract(rng, n)
    picture = np.full((n, n, 3), rng.uniform(0.02, 0.25))
    for _ in range(int(rng.integers(2, 6))):
        y, x = rng.integers(0, n * 2 // 3, 2)
        h, w = rng.integers(n // 8, n // 2, 2)
        tile = page(rng, n, dark=bool(rng.random() < 0.5))[:h, :w]
        view = picture[y : y + h, x : x + w]
        view[:] = tile[: view.shape[0], : view.shape[1]]
    return picture


def normal_map(height: Array, strength: float) -> Array:
    """Tangent-space normals as a picture in [0, 1], from a periodic height ``(H, W)``."""
    dx = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) * strength
    dy = (np.roll(height, -1, 0) - np.roll(height, 1, 0)) * strength
    n = np.stack([-dx, -dy, np.ones_like(height)], -1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True) * 0.5 + 0.5
