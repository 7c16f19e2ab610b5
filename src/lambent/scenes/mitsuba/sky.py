"""Environment maps: clear and cloudy skies with a sun, studios, rooms, cities at night.

A clear sky follows the gradation and indicatrix of the CIE ("Spatial distribution of daylight: CIE
standard general sky", ISO 15469:2004; the form of Perez, Seals and Michalsky, "All-weather model
for sky luminance distribution", 1993), with colour from the angle to the sun. The sun is drawn
into the map, a few pixels wide. Maps are latitude-longitude, row 0 at the zenith, with z up.
"""

from __future__ import annotations

import numpy as np

from lambent.scenes.mitsuba.lamps import neon, white
from lambent.scenes.mitsuba.noise import Array, fbm
from lambent.scenes.mitsuba.palette import ENVIRONMENT


def directions() -> Array:
    """The unit vectors ``(H, W, 3)`` of the map's pixels, z up, as `build` turns it."""
    h, w = ENVIRONMENT
    theta = (np.arange(h) + 0.5) / h * np.pi
    phi = (np.arange(w) + 0.5) / w * 2 * np.pi
    s, c = np.sin(theta)[:, None], np.cos(theta)[:, None]
    return np.stack(np.broadcast_arrays(s * np.sin(phi), s * np.cos(phi), c), -1)


def solid_angles() -> Array:
    """The solid angle ``(H, 1)`` of the map's pixels."""
    h, w = ENVIRONMENT
    return (np.sin((np.arange(h) + 0.5) / h * np.pi) * np.pi / h * 2 * np.pi / w)[:, None]


def sun_direction(rng: np.random.Generator, low: float = 8, high: float = 65) -> Array:
    """A unit vector ``(3,)`` to the sun at an elevation between ``low`` and ``high`` degrees."""
    up, phi = np.radians(rng.uniform(low, high)), rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(up) * np.cos(phi), np.cos(up) * np.sin(phi), np.sin(up)])


def daylight(
    rng: np.random.Generator,
    sun: Array,
    *,
    cloud: float | None = None,
    sun_share: float | None = None,
) -> Array:
    """A sky ``(H, W, 3)`` whose light on level ground is about π: mean radiance of order one.

    ``cloud`` is from 0 (clear) to 1 (overcast); ``sun_share`` the sun's share of the light.
    """
    d = directions()
    z = np.maximum(d[..., 2], 0.02)
    cos_sun = np.clip(d @ sun, -1, 1)
    gamma = np.arccos(cos_sun)
    cover = float(rng.beta(0.6, 0.9)) if cloud is None else cloud
    low = 1 - np.clip(sun[2] / 0.5, 0, 1)
    gradation = 1 - 0.7 * np.exp(-0.45 / z)
    indicatrix = 1 + 6 * np.exp(-3 * gamma) + 0.4 * cos_sun**2
    glow = np.exp(-2.2 * gamma) * low
    blue = np.stack([0.32 + 0.35 * (1 - z), 0.55 + 0.25 * (1 - z), np.ones_like(z)], -1)
    warm = np.array([1.3, 0.62, 0.26])
    tone = blue * (1 - glow[..., None]) + warm * (glow * 1.6)[..., None]
    haze = (low * np.exp(-6 * z))[..., None]
    tone = tone * (1 - 0.7 * haze) + np.array([1.2, 0.75, 0.5]) * 0.7 * haze
    sky = tone * (gradation * indicatrix * (0.35 + 0.5 * (1 - z)))[..., None]
    if cover > 0.03:
        sky = _clouds(rng, sky, d, z, gamma, cover, low)
    below = d[..., 2] < -0.02  # beyond the last hill
    earth = np.asarray(rng.uniform(0.08, 0.3)) * np.array([1, 0.93, 0.82])
    mean = float((sky * (np.maximum(d[..., 2:], 0) * solid_angles()[..., None])).sum() / np.pi / 3)
    sky = sky / max(mean, 1e-6)
    share = float(np.clip(rng.uniform(0.3, 0.85) * (1 - cover**1.5), 0, 0.9))
    if sun_share is not None:
        share = sun_share
    # A few pixels of sun: narrow enough for sharp shadows, wide enough for the map.
    disc = np.exp(np.minimum((cos_sun - 1) / 3.5e-5, 0)) * (cos_sun > 0.9994)
    power = (disc * np.maximum(d[..., 2], 0) * solid_angles()).sum()
    tint = np.array([1.0, 0.95, 0.88]) * (1 - low) + np.array([1.35, 0.85, 0.45]) * low
    sunlit = disc[..., None] * tint * (np.pi / max(float(power), 1e-9))
    whole = sky * (1 - share) + sunlit * share
    return np.where(below[..., None], earth, whole)


def _clouds(
    rng: np.random.Generator, sky: Array, d: Array, z: Array, gamma: Array, cover: float, low: float
) -> Array:
    n = 512
    field = fbm(rng, (n, n), (4, 4), 7, 0.58)
    # A flat layer above: far clouds crowd towards the horizon.
    scale = n / 7.0
    column = np.floor(d[..., 0] / (z + 0.12) * scale).astype(int) % n
    row = np.floor(d[..., 1] / (z + 0.12) * scale).astype(int) % n
    density = np.clip((field[row, column] + 2 * cover - 1.0) * 1.8, 0, 1)
    density = density * np.clip(z * 5, 0, 1) + cover**2 * (1 - np.clip(z * 5, 0, 1))
    lit = 1.1 + 2.5 * np.exp(-3.5 * gamma) - 0.75 * density
    colour = np.array([1, 1, 1.02]) * (1 - low) + np.array([1.15, 0.85, 0.72]) * low
    return sky * (1 - density[..., None]) + (colour * lit[..., None]) * density[..., None]


def studio(rng: np.random.Generator) -> Array:
    """A dark hall with soft boxes, strips and a faint floor: mean radiance of order one."""
    d = directions()
    wall = white(rng) * rng.uniform(0.02, 0.25)
    image = wall * (0.6 + 0.4 * d[..., 2:]) + np.zeros_like(d)
    for _ in range(int(rng.integers(1, 5))):
        up, phi = rng.uniform(0.05, 1.4), rng.uniform(0, 2 * np.pi)
        n = np.array([np.cos(up) * np.cos(phi), np.cos(up) * np.sin(phi), np.sin(up)])
        side = np.cross([0, 0, 1.0], n)
        side /= np.linalg.norm(side)
        facing = d @ n
        u, v = d @ side / np.maximum(facing, 1e-3), d @ np.cross(n, side) / np.maximum(facing, 1e-3)
        a, b = rng.uniform(0.05, 0.7), rng.uniform(0.05, 0.7)
        inside = np.clip((1 - np.maximum(np.abs(u) / a, np.abs(v) / b)) * 12, 0, 1) * (facing > 0)
        falloff = 1 - 0.4 * np.clip(np.hypot(u / a, v / b), 0, 1)
        strength = rng.uniform(4, 30) * (0.15 / (a * b)) ** 0.7
        colour = neon(rng) if rng.random() < 0.12 else white(rng, rng.uniform(0.1, 0.6))
        image += colour * (strength * inside * falloff)[..., None]
    return normalised(image)


def indoors(rng: np.random.Generator) -> Array:
    """The light of a room with windows around: a bright box seen from its middle."""
    d = directions()
    half = np.array([rng.uniform(2, 5), rng.uniform(2, 5), 1.5])
    t = np.min(half / np.maximum(np.abs(d), 1e-6), -1)
    p = d * t[..., None]
    image = np.where(p[..., 2:] > 1.49, 0.8, 0.5) * white(rng, 0.4) * np.ones_like(d)
    image = np.where(p[..., 2:] < -1.49, np.array([0.3, 0.2, 0.12]), image)
    for axis in (0, 1):
        for sign in (1, -1):
            if rng.random() < 0.45:
                continue
            k = int(rng.integers(1, 4))
            on = (p[..., axis] * sign > half[axis] - 0.01) & (p[..., 2] > -0.5) & (p[..., 2] < 1.0)
            across = (p[..., 1 - axis] / half[1 - axis] * 0.5 + 0.5) * k % 1
            pane = on & (np.abs(across - 0.5) < 0.35) & (np.abs(across - 0.5) > 0.015)
            image[pane] = white(rng, 0.2) * rng.uniform(8, 25)
    return normalised(image)


def night(rng: np.random.Generator) -> Array:
    """A dark sky over the lights of a town."""
    d = directions()
    image = np.array([0.02, 0.03, 0.06]) * (1 + 2 * np.exp(-6 * np.abs(d[..., 2:])))
    h, w = ENVIRONMENT
    count = 260
    rows = h // 2 + rng.integers(-10, 18, count)
    columns = rng.integers(0, w, count)
    for y, x in zip(rows, columns, strict=True):
        colour = neon(rng) if rng.random() < 0.25 else white(rng, rng.uniform(0.5, 1))
        image[y : y + 2, x : x + 2] += colour * rng.exponential(6)
    moon = sun_direction(rng, 20, 60)
    disc = np.clip((d @ moon - 0.9985) * 2000, 0, 1)
    image += disc[..., None] * np.array([0.9, 1, 1.15]) * 60
    return normalised(image)


def normalised(image: Array) -> Array:
    """The map at a mean luminance of one over the sphere."""
    weight = solid_angles()[..., None] / (4 * np.pi)
    mean = float((image * weight).sum((0, 1)) @ [0.2126, 0.7152, 0.0722])
    return image / max(mean, 1e-9)


def mean_radiance(image: Array) -> float:
    """The mean luminance over the sphere."""
    weight = solid_angles()[..., None] / (4 * np.pi)
    return float((image * weight).sum((0, 1)) @ [0.2126, 0.7152, 0.0722])
