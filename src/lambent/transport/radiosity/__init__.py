"""Radiosity (Goral et al. 1984): B = E + ρ F B on patches, on any Mitsuba scene.

In the order in which they are used: `patches` cuts the surfaces, `factors` (pairs of polygons) and
`casting` (rays) find the form factors F, `balance` makes them reciprocal and their rows complete,
`solvers` solve, `adaptive` decides where to cut finer, `smooth` interpolates, `integrator` shows
the result in Mitsuba, `export` writes it for others. `solution` holds it all together.
"""

from __future__ import annotations

from lambent.render.variant import mitsuba as _mitsuba

# The modules here name what a variant has. Whoever wants another device says so to
# `lambent.render.variant.mitsuba` first; Dr.Jit must not look for LLVM by itself.
_mitsuba("auto")
