"""Random numbers to directions, and angles, without LLVM's fmaximum.

Mitsuba's own warps and Dr.Jit's ``atan2`` stand on it, and LLVM gives up on it in some kernels
(`lambent.kernels.extremes`). These do the same with comparisons.
"""

from __future__ import annotations

from typing import Any

from lambent.kernels.extremes import greater
from lambent.transport.jit import dr, mi


def cosine_hemisphere(u: Any, v: Any) -> Any:
    """Directions around +z with density cos θ / π, for u and v uniform in [0, 1)."""
    radius = dr.sqrt(u)
    s, c = dr.sincos(2 * dr.pi * v)
    return mi.Vector3f(radius * c, radius * s, dr.sqrt(greater(1 - u, mi.Float(0))))


def root(x: Any) -> Any:
    """√x, and 0 where rounding has made x negative."""
    return dr.sqrt(greater(x, mi.Float(0)))


def turn(y: Any, x: Any) -> Any:
    """The angle of (x, y) as a share of a whole turn, in [0, 1)."""
    radius = dr.sqrt(x * x + y * y)
    t = y / greater(radius + dr.abs(x), mi.Float(1e-30))  # tan of half the angle to the x-axis
    angle = 2 * arctan(mi.Float(t)) * dr.inv_two_pi
    angle = dr.select(x < 0, 0.5 - angle, angle)
    return dr.select(angle < 0, angle + 1, angle)


def arctan(x: Any) -> Any:
    """The arc tangent, by halving the angle three times and then its series (any precision)."""
    for _ in range(3):
        x = x / (1 + dr.sqrt(1 + x * x))
    square = x * x
    series = type(x)(0)
    for k in range(19, 0, -2):
        series = series * -square + 1.0 / k
    return 8 * x * series
