"""The greater and the smaller of two values, by comparison and selection.

Not ``dr.maximum`` and ``dr.minimum``: those stand for LLVM's fmaximum and fminimum, which order NaN
and signed zeros as IEEE 754-2019 wants and so take several instructions where x86 has one that
compares and selects; and on AVX2, LLVM 23 aborts the process on some of them ("Cannot select:
f32 = fmaximum"), depending on what stands around.
"""

from __future__ import annotations

from typing import Any


def greater(a: Any, b: Any) -> Any:
    """a where a > b, else b (so b where either is NaN). Dr.Jit arrays or numbers."""
    import drjit as dr

    return dr.select(a > b, a, b)


def smaller(a: Any, b: Any) -> Any:
    """a where a < b, else b (so b where either is NaN). Dr.Jit arrays or numbers."""
    import drjit as dr

    return dr.select(a < b, a, b)
