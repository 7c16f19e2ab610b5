"""A fast exponential for weights.

Dr.Jit's own ``exp`` is exact to an ulp and costs more than the rest of a bilateral tap. A weight
needs no more than a few parts in a million: x / ln 2 is split into the nearest integer and a
fraction in [-1/2, 1/2]; a polynomial gives 2^fraction, and the integer is added to its exponent.
"""

from __future__ import annotations

from typing import Any

from lambent.kernels.extremes import greater

#: 2^f on [-1/2, 1/2], degree 4, least relative error (3e-6).
POLYNOMIAL = (9.57010145e-3, 5.59178603e-2, 2.40247448e-1, 6.93121815e-1, 9.99999261e-1)
LOG2_E = 1.4426950408889634
#: 1.5·2^23: adding it rounds a float to the nearest integer, which then is its low bits.
ROUND = 12582912.0
#: No weight is less than 2^-100 (8e-31): enough above the least normal float, 2^-126, that sums of
#: weighted values keep their digits where every pixel that counts has the least weight.
LEAST_POWER = -100.0
#: The same as an exponent of e.
LEAST = LEAST_POWER / LOG2_E


def exp_weight(x: Any) -> Any:
    """exp(x) for x <= 80 as a weight: relative error below 5e-6, never below 2^`LEAST_POWER`.

    ``x``: a Dr.Jit ``Float`` of any backend. Not for NaN.
    """
    import drjit as dr

    kind = type(x)
    integer = dr.int32_array_t(kind)
    y = greater(x * LOG2_E, LEAST_POWER)
    rounded = y + ROUND
    fraction = y - (rounded - ROUND)
    power: Any = kind(POLYNOMIAL[0])
    for coefficient in POLYNOMIAL[1:]:
        power = dr.fma(power, fraction, coefficient)
    bits: Any = dr.reinterpret_array(integer, power)
    exponent: Any = dr.reinterpret_array(integer, rounded)
    return dr.reinterpret_array(kind, bits + (exponent << 23))
