"""A fast exponential for weights.

Dr.Jit's own ``exp`` is exact to an ulp and costs more than the rest of a bilateral tap. A weight
needs no more than a few parts in a million: a minimax polynomial for 2^f on [0, 1) and the integer
part put into the exponent of the float.
"""

from __future__ import annotations

from typing import Any

from lambent.kernels.extremes import greater

#: 2^f on [0, 1), degree 5; relative error 4e-6 after rounding, together with the range reduction.
_POLYNOMIAL = (
    1.8775767e-3,
    8.9893397e-3,
    5.5826318e-2,
    2.4015361e-1,
    6.9315308e-1,
    9.9999994e-1,
)
_LOG2_E = 1.4426950408889634


def exp_weight(x: Any) -> Any:
    """exp(x) for x <= 80 as a weight: relative error below 5e-6, never below 2^-126 (1.2e-38).

    ``x``: a Dr.Jit ``Float`` of any backend. Not for NaN.
    """
    import drjit as dr

    kind = type(x)
    integer = dr.int32_array_t(kind)
    y = greater(x * _LOG2_E, -126.0)
    whole = dr.floor(y)
    fraction = y - whole
    power = kind(_POLYNOMIAL[0])
    for coefficient in _POLYNOMIAL[1:]:
        power = dr.fma(power, fraction, coefficient)
    exponent = (integer(whole) + 127) << 23
    return power * dr.reinterpret_array(kind, exponent)
