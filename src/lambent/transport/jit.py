"""Mitsuba and Dr.Jit with a variant set, for modules that name what only a variant has.

Whoever wants another device than "auto" says so to `lambent.render.variant.mitsuba` first: a
variant that is set stays. Dr.Jit must not look for LLVM by itself.
"""

from __future__ import annotations

from lambent.render.variant import mitsuba

mi = mitsuba("auto")

import drjit as dr  # noqa: E402

__all__ = ["dr", "mi"]
