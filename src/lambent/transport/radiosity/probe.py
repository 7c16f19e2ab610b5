"""Points on patches, in kernels: where rays start, where textures and direct light are measured.

A lane is a face of a patch and a number k. Its place on the patch and its direction come from a
rank-1 lattice, the generalised golden ratio in five dimensions, shifted at random from face to
face: points fill a patch evenly with any number of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.transport.jit import dr, mi
from lambent.transport.radiosity.patches import Patches, TreeTable
from lambent.transport.surfaces import TRIANGLE

#: The real root of x^6 = x + 1, whose powers make the lattice.
_ROOT = 1.1347241384015194
_STEPS = [round(((1 / _ROOT) ** (j + 1) % 1.0) * 2**32) for j in range(5)]


@dataclass
class Probe:
    """`Patches` in a kernel: leaves and where a patch's begin."""

    tree: TreeTable
    start: Any
    leaf: Any
    prim: Any
    corner: Any
    share: Any
    shape: Any
    index: Any
    single: bool

    @classmethod
    def of(cls, patches: Patches) -> Probe:
        """Of these patches."""
        cells = patches.cells
        leaf = patches.leaf
        # the part of a patch's area that its leaves up to and with this one have
        total = np.cumsum(patches.leaf_area)
        before = np.concatenate([[0.0], total])[patches.start]
        patch = np.repeat(np.arange(len(patches)), np.diff(patches.start))
        share = (total - before[patch]) / patches.area[patch]
        surfaces = cells.surfaces
        pointers = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(list(surfaces.shapes)))
        return cls(
            cells.table(),
            mi.UInt32(patches.start.astype(np.uint32)),
            mi.UInt32(leaf.astype(np.uint32)),
            mi.UInt32(cells.prim.astype(np.uint32)),
            mi.Float(cells.corner.astype(np.float32).ravel()),
            mi.Float(share.astype(np.float32)),
            mi.UInt32(np.asarray(pointers)[surfaces.shape]),
            mi.UInt32(surfaces.index.astype(np.uint32)),
            len(leaf) == len(patches),
        )

    def place(self, patch: Any, u: Any, v: Any, w: Any) -> tuple[Any, Any, Any, Any, Any]:
        """(primitive, a, b, point, normal) on a patch, uniform in area for uniform u, v, w."""
        low = dr.gather(mi.UInt32, self.start, patch)
        if not self.single:
            high = dr.gather(mi.UInt32, self.start, patch + 1)

            def halve(low: Any, high: Any, u: Any) -> tuple[Any, Any, Any]:
                middle = (low + high) >> 1
                right = dr.gather(mi.Float, self.share, middle - 1) <= u
                return dr.select(right, middle, low), dr.select(right, high, middle), u

            low, _, _ = dr.while_loop(
                (low, high, u), lambda low, high, u: high - low > 1, halve, label="leaf"
            )
        cell = dr.gather(mi.UInt32, self.leaf, low)
        prim = dr.gather(mi.UInt32, self.prim, cell)
        triangle = dr.gather(mi.UInt32, self.tree.surfaces.kind, prim) == TRIANGLE
        over = triangle & (v + w > 1)
        v, w = dr.select(over, 1 - v, v), dr.select(over, 1 - w, w)
        c = [dr.gather(mi.Point2f, self.corner, 3 * cell + k) for k in range(3)]
        ab = c[0] + v * (c[1] - c[0]) + w * (c[2] - c[0])
        p, n = self.tree.surfaces.point(prim, ab.x, ab.y)
        return prim, ab.x, ab.y, p, n

    def interaction(self, prim: Any, a: Any, b: Any, p: Any, n: Any, side: Any) -> Any:
        """The surface interaction there, seen from straight above (``side`` 0) or below (1)."""
        up = dr.select(side == 0, n, -n)
        length = 1e-3 * (1 + dr.norm(p))
        found = dr.zeros(mi.PreliminaryIntersection3f, dr.width(prim))
        found.valid = dr.full(mi.Bool, True, dr.width(prim))
        found.t = length
        found.prim_uv = self.tree.surfaces.mitsubas(prim, a, b)
        found.prim_index = dr.gather(mi.UInt32, self.index, prim)
        found.shape = dr.reinterpret_array(mi.ShapePtr, dr.gather(mi.UInt32, self.shape, prim))
        ray = mi.Ray3f(p + up * length, -up)
        return found.compute_surface_interaction(ray, +mi.RayFlags.All)


def lattice(k: Any, shift: Any, dimension: int) -> Any:
    """The k-th number in [0, 1) of a dimension, shifted by ``shift`` (any integers)."""
    fixed = k * mi.UInt32(_STEPS[dimension]) + mi.sample_tea_32(shift, mi.UInt32(dimension))[0]
    return mi.Float(fixed >> 8) * mi.Float(2.0**-24)


def faces_of(rows: NDArray[np.int64], seed: int) -> tuple[Any, Any, Any]:
    """(patch, side, shift) of faces, for kernels; the shift goes by the face, not by its row."""
    face = mi.UInt32(rows.astype(np.uint32))
    shift = mi.sample_tea_32(face, mi.UInt32(seed & 0xFFFFFFFF))[0]
    return face >> 1, face & 1, shift
