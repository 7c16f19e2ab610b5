"""From a value a patch to a function without steps: values at corners, interpolated in between.

Corners of leaves at the same place whose normals point alike are one vertex; its value is the mean
of the leaves around it, by area. Where a large leaf meets small ones, a vertex of theirs lies in
the middle of its side: that vertex takes the mean of the side's ends, or the picture would show a
crack (the constraint of "anchored" meshes, Baum et al. 1991).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.transport.radiosity.patches import Index, Patches
from lambent.transport.surfaces import TRIANGLE, Array

#: Normals that are closer than this (cosine) belong to one smooth surface.
ALIKE = 0.8
#: Corners that are closer than this share of the scene's extent are one.
NEAR = 1.2345e-6


@dataclass(frozen=True, eq=False)
class Vertices:
    """``corner`` ``(T, 4)``: vertices of every cell, -1 where there is none; ``count`` of them.

    ``leaf_corners`` ``(L, 4)``: the same of the leaves in the order of `Patches.leaf`.
    ``hanging`` ``(K, 3)``: a vertex, and the two between which it hangs, long sides first.
    ``position`` ``(count, 3)``.
    """

    corner: NDArray[np.int32]
    count: int
    leaf_corners: Index
    hanging: Index
    position: Array


def vertices_of(patches: Patches) -> Vertices:
    """The vertices of a set of patches."""
    cells, leaf = patches.cells, patches.leaf
    prim = cells.prim[leaf]
    c = cells.corner[leaf].astype(np.float64)
    fourth = c[:, 1] + c[:, 2] - c[:, 0]
    ab = np.concatenate([c, fourth[:, None]], axis=1)  # (L, 4, 2)
    flat = np.repeat(prim, 4)
    p, n = cells.surfaces.points(flat, ab.reshape(-1, 2))
    triangle = cells.surfaces.kind[prim] == TRIANGLE
    used = np.ones((len(leaf), 4), bool)
    used[triangle, 3] = False
    low = p.min(axis=0)
    grain = NEAR * float(np.linalg.norm(p.max(axis=0) - low)) or 1.0
    base = 4 * np.arange(len(leaf))[:, None]
    tri_sides = np.array([(0, 1), (1, 2), (2, 0), (0, 1)])
    square_sides = np.array([(0, 1), (1, 3), (3, 2), (2, 0)])
    which = np.where(triangle[:, None, None], tri_sides, square_sides)
    ends = (base[:, :, None] + which).reshape(-1, 2)
    # middles of sides, on the surface's chord: for flat ones exactly where a small corner is
    middle = (p[ends[:, 0]] + p[ends[:, 1]]) / 2
    keys = np.floor((np.concatenate([p, middle]) - low) / grain + 0.37).astype(np.int64)
    place = _number_rows(keys)
    corner_place, middle_place = place[: len(p)], place[len(p) :]
    vertex = _alike(corner_place, n)
    index = np.where(used.ravel(), vertex, -1).reshape(-1, 4)
    numbers, compact = np.unique(index[index >= 0], return_inverse=True)
    index[index >= 0] = compact.ravel()
    count = len(numbers)
    position = np.zeros((count, 3))
    position[index[index >= 0]] = p.reshape(-1, 4, 3)[index >= 0]
    corner = np.full((len(cells.child), 4), -1, np.int32)
    corner[leaf] = index
    hanging = _hanging(index, ends, corner_place, middle_place, p, n)
    return Vertices(corner, count, index, hanging, position)


def at_vertices(vertices: Vertices, patches: Patches, values: Array, there: Array) -> Array:
    """Values at vertices ``(count, C)`` from values at patches ``(n, C)``.

    ``there`` ``(n,)``: 0 for patches that have none.
    """
    patch = np.repeat(np.arange(len(patches)), np.diff(patches.start))
    weight = patches.leaf_area * there[patch]
    index = vertices.leaf_corners
    sums = np.zeros((vertices.count, values.shape[1]))
    total = np.zeros(vertices.count)
    for k in range(4):
        good = index[:, k] >= 0
        at = index[good, k]
        total += np.bincount(at, weight[good], minlength=vertices.count)
        for channel in range(values.shape[1]):
            carried = weight[good] * values[patch[good], channel]
            sums[:, channel] += np.bincount(at, carried, minlength=vertices.count)
    found = sums / np.where(total > 0, total, 1)[:, None]
    for vertex, one, other in vertices.hanging:
        found[vertex] = (found[one] + found[other]) / 2
    return np.asarray(found)


# ------------------------------------------------------------------- private


def _number_rows(keys: Index) -> Index:
    """The same number for the same row.

    Rows are hashed to 64 bits first: sorting numbers is several times faster than sorting rows,
    and among a million rows two fall together once in ten million times.
    """
    mixed = np.zeros(len(keys), np.uint64)
    for column in keys.T.astype(np.uint64):
        mixed = (mixed ^ column) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    _, number = np.unique(mixed, return_inverse=True)
    return np.asarray(number.ravel())


def _alike(place: Index, normal: Array) -> Index:
    """Vertex numbers: corners at one place, taken apart by their normals.

    At each place the first corner that is left takes all whose normals are like its own.
    """
    order = np.argsort(place, kind="stable")
    vertex = np.full(len(place), -1, np.int64)
    left = order
    next_number = 0
    while len(left):
        at = place[left]
        first = np.r_[True, at[1:] != at[:-1]]
        seed = left[first][np.cumsum(first) - 1]
        same = (normal[left] * normal[seed]).sum(axis=1) >= ALIKE
        same |= left == seed
        number = np.cumsum(first) - 1 + next_number
        vertex[left[same]] = number[same]
        next_number += int(first.sum())
        left = left[~same]
    return vertex


def _hanging(
    index: Index, ends: Index, corner_place: Index, middle_place: Index, p: Array, n: Array
) -> Index:
    """Vertices in the middle of another leaf's side, and that side's ends."""
    flat = index.reshape(-1)
    order = np.argsort(corner_place, kind="stable")
    sorted_place = corner_place[order]
    first = np.searchsorted(sorted_place, middle_place, "left")
    last = np.searchsorted(sorted_place, middle_place, "right")
    good = last > first
    found = []
    for offset in range(int((last - first).max(initial=0))):
        here = good & (first + offset < last)
        corner = order[np.where(here, first + offset, 0)]
        one, other = ends[:, 0], ends[:, 1]
        alike = (n[corner] * n[one]).sum(axis=1) >= ALIKE
        real = here & alike & (flat[corner] >= 0) & (flat[one] >= 0) & (flat[other] >= 0)
        length = np.linalg.norm(p[one] - p[other], axis=1)
        rows = np.stack([flat[corner], flat[one], flat[other]], axis=1)[real]
        found.append(np.c_[rows, np.argsort(np.argsort(-length[real]))])
        if offset > 32:
            break
    if not found:
        return np.zeros((0, 3), np.int64)
    rows = np.concatenate(found)
    rows = rows[(rows[:, 0] != rows[:, 1]) & (rows[:, 0] != rows[:, 2])]
    _, keep = np.unique(rows[:, :3], axis=0, return_index=True)
    rows = rows[keep]
    return np.asarray(rows[np.argsort(rows[:, 3], kind="stable"), :3])
