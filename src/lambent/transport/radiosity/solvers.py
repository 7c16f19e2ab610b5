"""Solvers of B = b + ρ F B, one colour channel a column: each a generator of ever better solutions.

``b`` ``(n, 3)`` is the light that leaves a face for the first time, ρ ``(n, 3)``, F ``(n, n)``. A
solver yields B after every step, so that whoever drives it can watch, stop by time or residual, or
be interrupted and keep what is there (`run`).

`direct`        LU of I - ρF (LAPACK); dense, for some thousand faces
`jacobi`        B ← b + ρ F B: each step is one more bounce of light
`gauss_seidel`  the same with new values as soon as they are there; half the steps
`cg`            conjugate gradients (Hestenes and Stiefel 1952): with reciprocity the equation
                becomes symmetric, S y = c with S = I - √ρ A^½ F A^-½ √ρ and B = √(ρ/A) y
`southwell`     progressive refinement (Cohen et al. 1988): the face with the most light not yet
                sent sends it; to be watched
`least_squares` min ‖b - (I - ρF) B‖, by CGLS: the form that neural radiosity minimises with a
                network in place of the vector
`matrix_free`   Jacobi without F: every step gathers along rays cast anew; memory is linear in n
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError, by_interrupt
from lambent.memory import available

Array = NDArray[np.float64]
Steps = Iterator[Array]


@dataclass(frozen=True, eq=False)
class Equation:
    """B = b + ρ F B. ``area`` ``(n,)``. ``gather``: F @ x by rays, if there is no ``factors``."""

    first: Array
    reflectance: Array
    factors: Any
    area: Array
    gather: Callable[[Array], Array] | None = None

    def apply(self, x: Array) -> Array:
        """F @ x ``(n, 3)``."""
        if self.factors is None:
            assert self.gather is not None
            return self.gather(x)
        return np.asarray(self.factors @ x)

    def residual(self, x: Array) -> Array:
        """b + ρ F x - x ``(n, 3)``: where the solution does not yet agree with itself."""
        return np.asarray(self.first + self.reflectance * self.apply(x) - x)

    def norm(self, x: Array) -> float:
        """The power of a radiosity over all faces, root mean square."""
        return float(np.sqrt(np.einsum("i,ij->", self.area, x * x) / max(self.area.sum(), 1e-300)))


@dataclass
class History:
    """What a solver went through: step, seconds, relative residual, mean radiosity."""

    steps: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    residuals: list[float] = field(default_factory=list)
    power: list[float] = field(default_factory=list)


def direct(eq: Equation) -> Steps:
    """Solve by LU, channel by channel. Raises `OptionError` where the memory is not enough."""
    from scipy import linalg

    n = len(eq.first)
    need, there = 3 * n * n * 8, available()
    if there is not None and need > there:
        raise OptionError(
            f"the direct solver needs {need / 2**30:.1f} GiB for {n:,} faces, and "
            f"{there / 2**30:.1f} GiB are free",
            remedy="take --solver cg, or larger patches",
        )
    dense = np.asarray(eq.factors.toarray())
    x = np.empty_like(eq.first)
    for channel in range(3):
        matrix = -eq.reflectance[:, channel, None] * dense
        matrix[np.diag_indices(n)] += 1
        x[:, channel] = linalg.solve(
            matrix, eq.first[:, channel], overwrite_a=True, check_finite=False
        )
    yield x


def jacobi(eq: Equation, start: Array | None = None) -> Steps:
    """Bounce after bounce."""
    x = eq.first.copy() if start is None else start.copy()
    while True:
        x = eq.first + eq.reflectance * eq.apply(x)
        yield x


def gauss_seidel(eq: Equation, start: Array | None = None) -> Steps:
    """New values as soon as they are there: (I - ρL) B' = b + ρ U B."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve_triangular

    lower = sparse.tril(eq.factors, k=0, format="csr")
    upper = sparse.triu(eq.factors, k=1, format="csr")
    one = sparse.identity(len(eq.first), format="csr")
    lefts = [
        (one - sparse.diags(eq.reflectance[:, c]) @ lower).tocsr() for c in range(3)
    ]  # fmt: skip
    x = eq.first.copy() if start is None else start.copy()
    while True:
        right = eq.first + eq.reflectance * (upper @ x)
        x = np.stack(
            [spsolve_triangular(lefts[c], right[:, c], lower=True) for c in range(3)], axis=1
        )
        yield x


def cg(eq: Equation, start: Array | None = None) -> Steps:
    """Conjugate gradients for the three channels side by side."""
    alive = eq.reflectance > 0
    up = np.sqrt(np.where(alive, eq.reflectance, 1) / eq.area[:, None])
    root = np.where(alive, np.sqrt(eq.reflectance), 0)
    half = np.sqrt(eq.area)[:, None]
    # F is used in its symmetric form A^½ F A^-½
    g = eq.factors

    def s(y: Array) -> Array:
        return np.asarray(y - root * half * (g @ (root * y / half)))

    # a face that reflects nothing keeps what it emits, and sends it once
    fixed = np.where(alive, 0.0, eq.first)
    c = np.where(alive, (eq.first + eq.reflectance * eq.apply(fixed)) / up, 0.0)
    y = c.copy() if start is None else np.where(alive, start / up, 0.0)
    r = c - s(y)
    p = r.copy()
    size = (r * r).sum(0)
    while True:
        q = s(p)
        below = (p * q).sum(0)
        step = np.divide(size, below, out=np.zeros(3), where=below > 0)
        y = y + step * p
        r = r - step * q
        new = (r * r).sum(0)
        p = r + np.divide(new, size, out=np.zeros(3), where=size > 0) * p
        size = new
        yield np.where(alive, up * y, fixed)


def southwell(eq: Equation, start: Array | None = None, every: int | None = None) -> Steps:
    """Progressive refinement: the face with the most unsent light sends it to all.

    Yields after ``every`` shots (None: as many as a fiftieth of the faces).
    """
    x = eq.first.copy() if start is None else start.copy()
    unsent = x.copy() if start is None else eq.residual(start)
    if start is not None:
        x = x + unsent
    g = eq.factors  # rows: F_ji = G_ji / A_j, and what i gets from j is F_ij = G_ji / A_i
    pointers, columns, values = g.indptr, g.indices, g.data
    every = every or max(1, len(x) // 50)
    count = 0
    power = eq.area * unsent.sum(1)
    while True:
        j = int(np.argmax(np.abs(power)))
        sent = unsent[j].copy()
        unsent[j] = 0
        row = slice(pointers[j], pointers[j + 1])
        to = columns[row]
        got = eq.reflectance[to] * (values[row] * eq.area[j] / eq.area[to])[:, None] * sent
        x[to] += got
        unsent[to] += got
        power[to] = eq.area[to] * unsent[to].sum(1)
        power[j] = eq.area[j] * unsent[j].sum()
        count += 1
        if count % every == 0:
            yield x.copy()


def least_squares(eq: Equation, start: Array | None = None) -> Steps:
    """CGLS on min ‖b - M B‖ with M = I - ρF: MᵀM is never formed."""
    back = eq.factors.T.tocsr()

    def m(x: Array) -> Array:
        return np.asarray(x - eq.reflectance * (eq.factors @ x))

    def mt(x: Array) -> Array:
        return np.asarray(x - back @ (eq.reflectance * x))

    x = eq.first.copy() if start is None else start.copy()
    r = eq.first - m(x)
    s = mt(r)
    p = s.copy()
    size = (s * s).sum(0)
    while True:
        q = m(p)
        below = (q * q).sum(0)
        step = np.divide(size, below, out=np.zeros(3), where=below > 0)
        x = x + step * p
        r = r - step * q
        s = mt(r)
        new = (s * s).sum(0)
        p = s + np.divide(new, size, out=np.zeros(3), where=size > 0) * p
        size = new
        yield x


#: Solver -> generator, and what it is good for.
SOLVERS: dict[str, tuple[Any, str]] = {
    "cg": (cg, "fastest; the default"),
    "direct": (direct, "exact to rounding; some thousand patches"),
    "jacobi": (jacobi, "a bounce a step"),
    "gauss-seidel": (gauss_seidel, "half of Jacobi's steps"),
    "southwell": (southwell, "progressive refinement, to be watched"),
    "least-squares": (least_squares, "min ‖B - (E + ρFB)‖"),
    "matrix-free": (jacobi, "Jacobi by rays, without a matrix: millions of patches"),
}


def run(
    eq: Equation,
    solver: str,
    *,
    start: Array | None = None,
    tolerance: float = 1e-6,
    steps: int = 1000,
    seconds: float | None = None,
    watch: Callable[[int, float, Array], None] | None = None,
    history: History | None = None,
) -> tuple[Array, History, bool]:
    """Drive a solver. Returns the solution, its history, and whether it was interrupted.

    Ends when the residual's norm is ``tolerance`` of the first light's, after ``steps`` or
    ``seconds``, or by Ctrl-C; what has been reached is kept. ``watch(step, residual, B)``.
    ``history``: is filled as it goes.
    """
    history = History() if history is None else history
    began = time.monotonic()
    x = eq.first.copy() if start is None else start
    size = eq.norm(eq.first) or 1.0
    if len(eq.first) == 0:
        return x, history, False
    make = SOLVERS[solver][0]
    try:
        made = make(eq) if solver == "direct" else make(eq, start)
        for step, x in enumerate(made, 1):
            residual = eq.norm(eq.residual(x)) / size
            history.steps.append(step)
            history.seconds.append(time.monotonic() - began)
            history.residuals.append(residual)
            history.power.append(float((eq.area[:, None] * x).sum()))
            if watch is not None:
                watching = time.monotonic()
                watch(step, residual, x)
                began += time.monotonic() - watching  # whoever watches does not use up the time
            over = seconds is not None and time.monotonic() - began > seconds
            if residual <= tolerance or step >= steps or over:
                break
    except BaseException as error:
        if not by_interrupt(error):
            raise
        return x, history, True
    return x, history, False
