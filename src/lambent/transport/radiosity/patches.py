"""Patches: the surfaces cut into cells, each cell halved in both parameters until it is small.

A primitive (`lambent.transport.surfaces`) is the root of a tree; a cell has four children or none.
A triangle falls into four similar ones at the middles of its sides, other primitives into quarters
of their parameter square, which are equal in area. Cells without children are the leaves. A leaf is
a patch, or, where a mesh is finer than the wish, one of several neighbours that share one
(`cluster`): the unknowns are the patches.

A patch has two faces, front (along Mitsuba's normal) and back: face 2 p and 2 p + 1. A face that
reflects nothing is black and has no unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError
from lambent.transport.jit import dr, mi
from lambent.transport.surfaces import NOWHERE, TRIANGLE, Array, Surfaces, Table

Index = NDArray[np.int64]
#: A primitive is halved at most so often: 4^12 cells.
DEEPEST = 12


@dataclass(frozen=True, eq=False)
class Cells:
    """The trees of all primitives and their leaves.

    ``child`` ``(T,)``: the first of four children, -1 for leaves; the roots come first, one for
    each primitive. ``prim`` ``(T,)``. ``corner`` ``(T, 3, 2)``: parameters; of a triangle its three
    corners, of others the low corner, the one across in a, the one across in b.
    """

    surfaces: Surfaces
    child: NDArray[np.int32]
    prim: NDArray[np.int32]
    corner: NDArray[np.float32]

    @property
    def leaves(self) -> Index:
        """Numbers of the cells without children, of primitives with an area."""
        return np.flatnonzero((self.child < 0) & (self.surfaces.area[self.prim] > 0))

    def areas(self, cells: Index) -> Array:
        """Areas of cells, in the scene's unit squared."""
        e = self.corner[cells, 1:].astype(np.float64) - self.corner[cells, :1]
        share = np.abs(e[:, 0, 0] * e[:, 1, 1] - e[:, 0, 1] * e[:, 1, 0])
        return np.asarray(self.surfaces.area[self.prim[cells]] * share)

    def split(self, cells: Index) -> Cells:
        """With four children for each of these leaves."""
        if len(cells) == 0:
            return self
        child = np.concatenate([self.child, np.full(4 * len(cells), -1, np.int32)])
        child[cells] = len(self.child) + 4 * np.arange(len(cells), dtype=np.int32)
        c = self.corner[cells]
        triangle = (self.surfaces.kind[self.prim[cells]] == TRIANGLE)[:, None, None, None]
        corners = np.where(triangle, _split_triangle(c), _split_square(c))
        return Cells(
            self.surfaces,
            child,
            np.concatenate([self.prim, np.repeat(self.prim[cells], 4)]),
            np.concatenate([self.corner, corners.reshape(-1, 3, 2)]),
        )

    def table(self) -> TreeTable:
        """The trees in Dr.Jit's memory."""
        return TreeTable(self.surfaces.table(), mi.Int32(self.child))


@dataclass
class TreeTable:
    """`Cells` in a kernel."""

    surfaces: Table
    child: Any

    def find(self, shape: Any, prim_index: Any, p: Any, active: Any) -> tuple[Any, Any, Any]:
        """The leaf at a point of a shape, and its own parameters there.

        For a triangle these are barycentric in the leaf (a + b <= 1). The leaf is `NOWHERE` on
        shapes that were left out.
        """
        prim, a, b = self.surfaces.locate(shape, prim_index, p, active)
        return self.descend(prim, a, b)

    def descend(self, prim: Any, a: Any, b: Any) -> tuple[Any, Any, Any]:
        """The leaf at parameters of a primitive (`NOWHERE`: none), and the leaf's own there."""
        known = prim != NOWHERE
        node = dr.select(known, prim, 0)
        triangle = dr.gather(mi.UInt32, self.surfaces.kind, node, known) == TRIANGLE
        child = dr.gather(mi.Int32, self.child, node, known)
        child = dr.select(known, child, -1)

        def step(node: Any, child: Any, a: Any, b: Any) -> tuple[Any, Any, Any, Any]:
            at, new_a, new_b = _descend(triangle, a, b)
            node = mi.UInt32(child) + at
            return node, dr.gather(mi.Int32, self.child, node), new_a, new_b

        node, child, a, b = dr.while_loop(
            (node, child, a, b), lambda node, child, a, b: child >= 0, step, label="cell"
        )
        return dr.select(known, node, NOWHERE), a, b


@dataclass(frozen=True, eq=False)
class Patches:
    """Leaves put together to patches. ``leaf`` ``(L,)``: cells, sorted by patch.

    ``start`` ``(n + 1,)``: where a patch's leaves begin. ``cell_patch`` ``(T,)``: a cell's patch,
    -1 for those that are no leaf. ``leaf_area`` ``(L,)``, ``area`` ``(n,)``.
    """

    cells: Cells
    leaf: Index
    start: Index
    cell_patch: NDArray[np.int32]
    leaf_area: Array
    area: Array

    def __len__(self) -> int:
        return len(self.area)


def uniform(surfaces: Surfaces, size: float) -> Cells:
    """Cells of at most ``size``² area that are not longer than twice ``size``.

    Slivers with next to no area are left as long as they are. Raises `OptionError`.
    """
    if not size > 0:
        raise OptionError(f"patches cannot have size {size:g}", remedy="give a length above 0")
    count = len(surfaces)
    square = np.zeros((count, 3, 2), np.float32)
    square[:, 1, 0] = square[:, 2, 1] = 1
    cells = Cells(
        surfaces,
        np.full(count, -1, np.int32),
        np.arange(count, dtype=np.int32),
        square,
    )
    for _ in range(DEEPEST):
        leaves = cells.leaves
        area = cells.areas(leaves) / (size * size)
        leaves, area = leaves[area > 0.1], area[area > 0.1]
        long = (area > 1) | (_longest(cells, leaves) > 2 * size)
        if not long.any():
            break
        cells = cells.split(leaves[long])
    return cells


def size_for(surfaces: Surfaces, count: int) -> float:
    """The size with which `uniform` and `cluster` give about ``count`` patches."""
    area = float(surfaces.area.sum())
    if area <= 0:
        raise OptionError(
            "the scene has no surface to solve for", remedy="give a scene with shapes"
        )
    # patches are near a square of this size; halves in area only come as powers of four, and
    # clusters are coarser than squares
    low, high = (float(np.sqrt(area / count)) * share for share in (0.25, 2.0))
    best = (np.inf, high)
    for _ in range(5):
        middle = float(np.sqrt(low * high))
        found = len(cluster(uniform(surfaces, middle), middle))
        best = min(best, (abs(np.log(found / count)), middle))
        if best[0] < 0.05:
            break
        low, high = (middle, high) if found > count else (low, middle)
    return best[1]


def cluster(
    cells: Cells,
    size: float = 0.0,
    among: int | None = None,
    halved: NDArray[np.int8] | None = None,
) -> Patches:
    """Leaves to patches; leaves well below ``size`` share one with their neighbours.

    Neighbours are leaves of the same shape in the same cube of edge ``size`` whose normals go the
    same way (the nearest of 26 directions). ``size`` 0: every leaf for itself. ``among``: only the
    first so many cells may share; those that were cut later were cut on purpose.
    """
    leaves = cells.leaves
    areas = cells.areas(leaves)
    key = np.arange(len(leaves), dtype=np.int64)
    small = areas < 0.25 * size * size
    if among is not None:
        small &= leaves < among
    if small.any():
        prim = cells.prim[leaves[small]]
        middle = cells.corner[leaves[small]].astype(np.float64).mean(axis=1)
        p, n = cells.surfaces.points(prim, middle)
        low = p.min(axis=0)
        cube = np.floor((p - low) / size).astype(np.int64)
        span = cube.max(axis=0) + 1
        place = (cube[:, 0] * span[1] + cube[:, 1]) * span[2] + cube[:, 2]
        normed = n / np.abs(n).max(axis=1, keepdims=True)
        turn = np.rint(normed).astype(np.int64) + 1
        way = (turn[:, 0] * 3 + turn[:, 1]) * 3 + turn[:, 2]
        whole = (cells.surfaces.shape[prim].astype(np.int64) * int(span.prod()) + place) * 27 + way
        _, group = np.unique(whole, return_inverse=True)
        if halved is not None and halved.any():  # the halves of a cube lie in it
            level = halved[leaves[small]].astype(np.int64)[:, None]
            deepest = int(level.max())
            along = np.floor(((p - low) / size - cube) * 0.5**-level).astype(np.int64)
            along = np.clip(along, 0, (1 << level) - 1)
            inside = level[:, 0]
            for axis in along.T:
                inside = inside << deepest | axis
            _, group = np.unique(group.ravel() << (3 * deepest + 4) | inside, return_inverse=True)
        _, first = np.unique(group, return_index=True)
        key[small] = np.flatnonzero(small)[first][group.ravel()]
    _, patch = np.unique(key, return_inverse=True)
    patch = patch.ravel()
    order = np.argsort(patch, kind="stable")
    count = int(patch.max()) + 1 if len(patch) else 0
    start = np.searchsorted(patch[order], np.arange(count + 1))
    cell_patch = np.full(len(cells.child), -1, np.int32)
    cell_patch[leaves] = patch
    return Patches(
        cells,
        leaves[order],
        start,
        cell_patch,
        areas[order],
        np.bincount(patch, areas, minlength=count).astype(np.float64),
    )


# ------------------------------------------------------------------- private


def _longest(cells: Cells, leaves: Index) -> Array:
    """The longest side of a triangle; of others the sides of the cell, along the surface."""
    prim = cells.prim[leaves]
    c = cells.corner[leaves].astype(np.float64)
    points = [cells.surfaces.points(prim, c[:, k])[0] for k in range(3)]
    sides = [(0, 1), (0, 2), (1, 2)]
    length = np.stack([np.linalg.norm(points[i] - points[j], axis=1) for i, j in sides])
    triangle = cells.surfaces.kind[prim] == TRIANGLE
    # a chord across a whole turn is 0: let the area decide there
    return np.where(triangle, length.max(axis=0), np.minimum(length[:2].max(axis=0), 1e30))


def _split_triangle(c: NDArray[Any]) -> NDArray[Any]:
    """Children ``(N, 4, 3, 2)``: at the corners 0, 1, 2, then the middle one."""
    p0, p1, p2 = c[:, 0], c[:, 1], c[:, 2]
    m01, m02, m12 = (p0 + p1) / 2, (p0 + p2) / 2, (p1 + p2) / 2
    corners = [(p0, m01, m02), (m01, p1, m12), (m02, m12, p2), (m12, m02, m01)]
    return np.stack([np.stack(corner, axis=1) for corner in corners], axis=1)


def _split_square(c: NDArray[Any]) -> NDArray[Any]:
    """Children ``(N, 4, 3, 2)``: low, across in a, across in b, across in both."""
    low, da, db = c[:, 0], (c[:, 1] - c[:, 0]) / 2, (c[:, 2] - c[:, 0]) / 2
    starts = [low, low + da, low + db, low + da + db]
    return np.stack([np.stack([s, s + da, s + db], axis=1) for s in starts], axis=1)


def _descend(triangle: Any, a: Any, b: Any) -> tuple[Any, Any, Any]:
    """Which child (a, b) is in, and the parameters there; the order is that of the splits."""
    # barycentric: corner 0 has 1 - a - b, corner 1 has a, corner 2 has b
    c = 1 - a - b
    in0, in1, in2 = c >= 0.5, a >= 0.5, b >= 0.5
    child = dr.select(in0, mi.UInt32(0), dr.select(in1, 1, dr.select(in2, 2, 3)))
    # the middle one has its corners at m12, m02, m01: its weights are 1 - 2 (c, a, b)
    tri_a = dr.select(in0, 2 * a, dr.select(in1, 2 * a - 1, dr.select(in2, 2 * a, 1 - 2 * a)))
    tri_b = dr.select(in0, 2 * b, dr.select(in1, 2 * b, dr.select(in2, 2 * b - 1, 1 - 2 * b)))
    right, upper = a >= 0.5, b >= 0.5
    quarter = dr.select(right, mi.UInt32(1), 0) + dr.select(upper, mi.UInt32(2), 0)
    sq_a = 2 * a - dr.select(right, mi.Float(1), 0)
    sq_b = 2 * b - dr.select(upper, mi.Float(1), 0)
    return (
        dr.select(triangle, child, quarter),
        dr.select(triangle, tri_a, sq_a),
        dr.select(triangle, tri_b, sq_b),
    )
