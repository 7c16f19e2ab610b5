"""Lights that people put up: panels, bulbs under shades, strings, screens, spots.

Radiance follows from a wish in luminous terms: each maker takes the power in watts of all three
colours together, and spreads it over its area (a diffuse emitter of area A and radiance L emits
πAL). Colours are those of black bodies by eye.
"""

from __future__ import annotations

import numpy as np

from lambent.scenes.mitsuba.geometry import (
    Array,
    Geometry,
    copies,
    quad,
    sphere,
    super_ellipsoid,
)
from lambent.scenes.mitsuba.palette import BEADS

#: Linear colours of about 2200, 2700, 4000, 6500 and 9000 K at luminance one.
_WHITES = np.array(
    [[1.9, 0.83, 0.22], [1.62, 0.9, 0.42], [1.22, 0.97, 0.72], [1, 1, 1], [0.86, 1.0, 1.3]]
)


def white(rng: np.random.Generator, warm: float | None = None) -> Array:
    """A light's colour ``(3,)`` of luminance one; ``warm`` from 0 (bluish) to 1 (candle)."""
    w = rng.random() if warm is None else warm
    t = np.clip((1 - w) * 4, 0, 3.999)
    i = int(t)
    return _WHITES[i] * (1 - t + i) + _WHITES[i + 1] * (t - i)


def neon(rng: np.random.Generator) -> Array:
    """A saturated light colour of luminance about one."""
    c = rng.dirichlet([0.5, 0.5, 0.5]) + 0.03
    return c / (c @ [0.2126, 0.7152, 0.0722])


def light_mesh(kind: str, size: float) -> Geometry:
    """The mesh of a kind of area light; its face count belongs to the palette."""
    if kind == "bulb":
        return sphere(size, 8)
    if kind == "string":
        return beads(np.zeros((1, 3)), size)
    return quad(size, size, (1, 1))


def beads(spots: Array, size: float | Array) -> Geometry:
    """`BEADS` octahedra at ``spots (K, 3)``; the last one is repeated where K is less."""
    index = np.minimum(np.arange(BEADS), len(spots) - 1)
    one = super_ellipsoid((1, 1, 1), n=2)
    matrices = np.tile(np.eye(4), (BEADS, 1, 1))
    sizes = np.broadcast_to(np.asarray(size, float), len(spots))[index]
    matrices[:, 0, 0] = matrices[:, 1, 1] = matrices[:, 2, 2] = sizes
    matrices[:, :3, 3] = spots[index]
    matrices[len(spots) :, :3, :3] *= 1e-3  # unused ones hide in the last
    return copies(one, matrices)


def along(spots: Array, drop: float) -> Array:
    """Points ``(BEADS, 3)`` on a wire that hangs through ``spots (K, 3)``, sagging by ``drop``."""
    t = np.linspace(0, len(spots) - 1 - 1e-9, BEADS)
    i = np.floor(t).astype(int)
    f = (t - i)[:, None]
    points = spots[i] * (1 - f) + spots[i + 1] * f
    points[:, 2] -= 4 * drop * (f * (1 - f))[:, 0]
    return points
