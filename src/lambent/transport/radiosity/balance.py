"""Form factors as physics has them: reciprocal, and rows that sum to what a face sees.

With A_i F_ij = A_j F_ji = G_ij, the rays of i and those of j are two estimates of one number. Of
the same number of rays, that of the smaller face has the smaller variance (it grows with the area),
so they are put together with weights by the other's area:

    G_ij = (A_j · A_i s_ij + A_i · A_j s_ji) / (A_i + A_j),     s: shares of rays

Then rows and columns are scaled together, G ← D G D, until the row of every face whose rays all met
other faces sums to A_i: the symmetric form of Sinkhorn and Knopp 1967. So a closed white furnace is
exactly white, and no light is lost or made. What the row of a face sums to that also sees the sky,
or something black, two know: its own rays, with the share s of them that met faces, and the row of
G, with the rays of all others. (A large ground may miss a small box with every one of its rays,
while half of the box's meet the ground.) They are put together by their variances,

    A_i² max(s (1 - s), 1/N) / N     and     Σ_j A_i A_j / (A_i + A_j) G_ij / N.
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
    g: Any,
    area: Array,
    seen: Array,
    rays: int | None = None,
    tolerance: float = 1e-8,
    most: int = 300,
) -> tuple[Any, float]:
    """F ``(n, n)`` CSR, and how far the row of a closed face is from 1 at most.

    A_i F_ij stays symmetric. ``seen`` ``(n,)``: the share of a face's ``rays`` that met other
    faces; 1 means that it sees nothing else. ``rays`` None: G is better than rays.
    """
    full = np.asarray(g.sum(axis=1)).ravel()
    closed = seen >= 1 - 1e-9
    target = full
    if rays is not None:
        row = np.repeat(np.arange(len(area)), np.diff(g.indptr))
        smaller = area[row] * area[g.indices] / (area[row] + area[g.indices])
        theirs = np.bincount(row, smaller * g.data, minlength=len(area)) / rays
        own = area**2 * np.maximum(seen * (1 - seen), 1 / rays) / rays
        weight = theirs / np.maximum(own + theirs, 1e-300)
        target = weight * area * seen + (1 - weight) * full
    target = np.where(closed, area, np.minimum(target, area))
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
