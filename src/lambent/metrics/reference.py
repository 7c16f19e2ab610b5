"""The noise of a reference, which every error measured against it holds, too.

A reference r = R + n is a render with noise of its own; the squared error of x against it has the
expectation (x − R)² + Var n, so noise of the reference pulls ratios of errors to 1. `relmse` takes
Var n off. It is known from the samples (a layer ``colour.variance``), or from two independent
halves a and b of them, of which r is the mean:

    V = (a − b)² / 4,      E V = Var n                                                     (1)

since E (a − b)² = 2 Var a and Var n = Var a / 2. One pixel's V is as uncertain as a square of one
normal number is; the mean over a picture is not. A trimmed mean, which drops pixels by what is left
of their error, drops some for their V: where there is a variance of many samples, it is taken.
"""

from __future__ import annotations

import numpy as np

from lambent.errors import LayerError
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role, Stat


def reference_variance(reference: Frame) -> FloatImage | None:
    """The variance ``(H, W, 3)`` of a reference's pixel means, for ``reference_variance=``.

    From its variance, else by (1) from its half buffers; None where it has neither.
    """
    variance = reference.get(Role.COLOUR, Stat.VARIANCE)
    if variance is not None:
        return variance
    a, b = reference.get(Role.COLOUR, Stat.HALF_A), reference.get(Role.COLOUR, Stat.HALF_B)
    return None if a is None or b is None else _of_halves(a, b)


def reference_of(a: Frame, b: Frame) -> tuple[FloatImage, FloatImage]:
    """A reference and its variance from two independent renders of as many samples.

    The mean of both colours, and (1). Raises `LayerError` for sizes that differ.
    """
    if a.colour.shape != b.colour.shape:
        raise LayerError(
            f"the two renders have the shapes {a.colour.shape} and {b.colour.shape}",
            file=b.path,
            remedy="render both at one size, with different seeds",
        )
    return (a.colour + b.colour) * np.float32(0.5), _of_halves(a.colour, b.colour)


def _of_halves(a: FloatImage, b: FloatImage) -> FloatImage:
    return np.asarray(np.square((a - b) * np.float32(0.5)))
