"""Form factors as physics has them: reciprocal, and rows that sum to what a face sees.

With A_i F_ij = A_j F_ji = G_ij, the rays of i and those of j are two estimates of one number. Of
the same number of rays, that of the smaller face has the smaller variance (it grows with the area),
so they are put together with weights by the other's area:

    G_ij = (A_j · A_i s_ij + A_i · A_j s_ji) / (A_i + A_j),     s: shares of rays

Then rows and columns are scaled together, G ← D G D, until every row sums to A_i (1 - what leaves
the scene or ends on something black): the symmetric form of Sinkhorn and Knopp 1967. So a closed
white furnace is exactly white, and no light is lost or made.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from lambent.transport.surfaces import Array


def symmetric(shares: Any, area: Array) -> Any:
    """G ``(n, n)`` CSR from the shares of rays ``(n, n)`` and the faces' areas."""
    own = shares.tocoo()
    a_i, a_j = area[own.row], area[own.col]
    weighed = (own.data * a_i * a_j / (a_i + a_j)).astype(np.float32)
    half = sparse.csr_matrix((weighed, (own.row, own.col)), shape=own.shape)
    return (half + half.T).tocsr()


def balanced(
    g: Any, area: Array, seen: Array, tolerance: float = 1e-8, most: int = 300
) -> tuple[Any, float]:
    """F ``(n, n)`` CSR whose rows sum to ``seen``, and the largest deviation that is left.

    A_i F_ij stays symmetric. ``seen`` ``(n,)`` in [0, 1].
    """
    target = area * seen
    full = np.asarray(g.sum(axis=1)).ravel()
    alive = (full > 0) & (target > 0)
    scale = np.where(alive, 1.0, 0.0)
    g64 = g.astype(np.float64)
    off = np.inf
    for _ in range(most):
        sums = scale * (g64 @ scale)
        off = float(np.max(np.abs(sums[alive] - target[alive]) / area[alive], initial=0.0))
        if off <= tolerance:
            break
        ratio = np.divide(target, sums, out=np.ones_like(sums), where=sums > 0)
        # halfway in the logarithm: the symmetric iteration would swing
        scale *= np.sqrt(ratio)
    left = sparse.diags(scale / area)
    return (left @ g64 @ sparse.diags(scale)).tocsr(), off
