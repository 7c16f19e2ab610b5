"""The shapes of a scene as primitives with two parameters (a, b), so that a point has a name.

A primitive is a triangle of a mesh, or a whole sphere, disk or cylinder. Each is an affine image of
a canonical piece, p = M · local(a, b), whose parameters are uniform in area:

========== ============================================= =====================================
triangle   (a, b, 0), a + b <= 1: barycentric            corners 0, e1, e2
disk       (√a cos 2πb, √a sin 2πb, 0)                   a, b in [0, 1]
sphere     z = 1 - 2b, azimuth 2πa (Archimedes)          a, b in [0, 1]
cylinder   (cos 2πa, sin 2πa, b)                         a, b in [0, 1]
========== ============================================= =====================================

`Surfaces.locate` goes back from a point on a shape to (primitive, a, b), inside a kernel. Instances
must have been unfolded (`lambent.transport.scene`). Curves, SDF grids and splats are left out and
named: they cast shadows and are black.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.extremes import greater, smaller
from lambent.transport.jit import dr, mi
from lambent.transport.warps import root, turn

Array = NDArray[np.float64]

TRIANGLE, SPHERE, DISK, CYLINDER = range(4)
_KINDS = {"Sphere": SPHERE, "Disk": DISK, "Cylinder": CYLINDER}
#: Lanes that are not on any primitive.
NOWHERE = 0xFFFFFFFF


@dataclass(frozen=True, eq=False)
class Surfaces:
    """All primitives of a scene, sorted by what they are.

    Mitsuba merges meshes as it loads, in an order that changes from run to run; sorted by their
    geometry, primitives have the same numbers every time.

    ``kind`` ``(P,)``; ``matrix`` ``(P, 3, 4)``: M above; ``area`` ``(P,)`` in the scene's unit
    squared; ``flip`` ``(P,)``: -1 where the scene turns the normal round; ``shape`` ``(P,)``:
    index into ``shapes``; ``index`` ``(P,)``: number within the shape. ``degenerate``: how many
    triangles have no area; they are kept, so that numbers match.
    ``left_out``: shapes that are black, by class name and how many.
    """

    shapes: tuple[Any, ...]
    kind: NDArray[np.int32]
    matrix: Array
    area: Array
    flip: Array
    shape: NDArray[np.int32]
    index: NDArray[np.int32]
    degenerate: int
    left_out: dict[str, int]

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def normal(self) -> Array:
        """``(P, 3)``: geometric unit normals of triangles and disks, along which Mitsuba's go."""
        third = self.matrix[:, :, 2]
        length = np.linalg.norm(third, axis=1, keepdims=True)
        return np.asarray(third / np.where(length > 0, length, 1) * self.flip[:, None])

    def points(self, prim: NDArray[Any], ab: Array) -> tuple[Array, Array]:
        """Points and unit normals ``(N, 3)`` at parameters ``ab`` ``(N, 2)``, in NumPy."""
        local, normal = _local(self.kind[prim], ab[:, 0], ab[:, 1])
        m = self.matrix[prim]
        p = np.einsum("nij,nj->ni", m[:, :, :3], local) + m[:, :, 3]
        n = np.einsum("nij,nj->ni", _cofactor(m[:, :, :3]), normal)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        return p, n / np.where(length > 0, length, 1) * self.flip[prim][:, None]

    def table(self) -> Table:
        """The same in Dr.Jit's memory, for kernels."""
        bound = 1 + max((_number(s) for s in self.shapes), default=0)
        first = np.full(bound, NOWHERE, np.uint32)
        counts = np.bincount(self.shape, minlength=len(self.shapes))
        starts = np.concatenate([[0], np.cumsum(counts)])
        for number, shape in enumerate(self.shapes):
            if counts[number]:
                first[_number(shape)] = starts[number]
        rank = np.empty(len(self), np.uint32)
        rank[starts[self.shape] + self.index] = np.arange(len(self), dtype=np.uint32)
        inverse = np.zeros((len(self), 3, 4))
        good = self.area > 0
        back = np.linalg.inv(self.matrix[good][:, :, :3])
        inverse[good, :, :3] = back
        inverse[good, :, 3] = self.matrix[good][:, :, 3]  # subtracted before: float32 keeps more
        return Table(
            mi.UInt32(first),
            mi.UInt32(rank),
            mi.UInt32(self.kind.astype(np.uint32)),
            mi.Float(self.matrix.astype(np.float32).ravel()),
            mi.Float(inverse.astype(np.float32).ravel()),
            mi.Float(self.flip.astype(np.float32)),
            bool((self.kind != TRIANGLE).any()),
        )


@dataclass
class Table:
    """`Surfaces` in a kernel: flat arrays of Dr.Jit."""

    first: Any
    rank: Any
    kind: Any
    matrix: Any
    inverse: Any
    flip: Any
    curved: bool

    def point(self, prim: Any, a: Any, b: Any) -> tuple[Any, Any]:
        """Point and unit normal at parameters (a, b) of a primitive."""
        rows = [dr.gather(mi.Vector4f, self.matrix, 3 * prim + k) for k in range(3)]
        local, normal = mi.Vector3f(a, b, 0), mi.Vector3f(0, 0, 1)
        if self.curved:
            kind = dr.gather(mi.UInt32, self.kind, prim)
            other, turned = _local_in_kernel(kind, a, b)
            flat = kind == TRIANGLE
            local = dr.select(flat, local, other)
            normal = dr.select(flat, normal, turned)
        p = mi.Point3f(*[dr.dot(r.xyz, local) + r.w for r in rows])
        x, y, z = (mi.Vector3f(*[r[k] for r in rows]) for k in range(3))
        n = dr.cross(y, z) * normal.x + dr.cross(z, x) * normal.y + dr.cross(x, y) * normal.z
        flip = dr.gather(mi.Float, self.flip, prim)
        return p, dr.normalize(n) * flip

    def mitsubas(self, prim: Any, a: Any, b: Any) -> Any:
        """What Mitsuba's ray tracer would have said of the point: of a disk, its place in it."""
        if not self.curved:
            return mi.Point2f(a, b)
        kind = dr.gather(mi.UInt32, self.kind, prim)
        place, _ = _local_in_kernel(kind, a, b)
        return dr.select(kind == DISK, mi.Point2f(place.x, place.y), mi.Point2f(a, b))

    def parameters(self, kind: Any, local: Any) -> tuple[Any, Any]:
        """(a, b) of a point in a primitive's own space, of any kind."""
        a, b = _unit(local.x), _unit(local.y)
        if self.curved:
            other_a, other_b = _parameters_in_kernel(kind, local)
            a = dr.select(kind == TRIANGLE, a, other_a)
            b = dr.select(kind == TRIANGLE, b, other_b)
        return a, b

    def local(self, prim: Any, p: Any) -> Any:
        """A point in a primitive's own space."""
        rows = [dr.gather(mi.Vector4f, self.inverse, 3 * prim + k) for k in range(3)]
        off = mi.Vector3f(p.x - rows[0].w, p.y - rows[1].w, p.z - rows[2].w)
        return mi.Vector3f(*[dr.dot(r.xyz, off) for r in rows])

    def normal(self, prim: Any, p: Any) -> Any:
        """The geometric unit normal of a primitive at a point on it."""
        a, b = mi.Float(0.25), mi.Float(0.25)
        if self.curved:
            kind = dr.gather(mi.UInt32, self.kind, prim)
            a, b = self.parameters(kind, self.local(prim, p))
        return self.point(prim, a, b)[1]

    def locate(self, shape: Any, prim_index: Any, p: Any, active: Any) -> tuple[Any, Any, Any]:
        """(primitive, a, b) of a point on a shape; primitive `NOWHERE` for shapes left out."""
        number = dr.reinterpret_array(mi.UInt32, shape)
        first = dr.gather(mi.UInt32, self.first, number, active)
        known = active & (first != NOWHERE)
        prim = dr.gather(mi.UInt32, self.rank, first + prim_index, known)
        kind = dr.gather(mi.UInt32, self.kind, prim)
        a, b = self.parameters(kind, self.local(prim, p))
        return dr.select(known, prim, NOWHERE), a, b


def surfaces_of(scene: Any) -> Surfaces:
    """The primitives of a scene, shape after shape."""
    shapes = tuple(scene.shapes())
    kinds, matrices, areas, flips, owners, indices = [], [], [], [], [], []
    degenerate = 0
    left_out: dict[str, int] = {}
    for number, shape in enumerate(shapes):
        if shape.is_mesh():
            m, size = _triangles(shape)
            degenerate += int((size <= 0).sum())
            kind = np.full(len(m), TRIANGLE, np.int32)
        elif shape.class_name() in _KINDS:
            kind = np.array([_KINDS[shape.class_name()]], np.int32)
            m = _affine(shape)[None]
            size = np.array([_whole_area(int(kind[0]), m[0])])
        else:
            left_out[shape.class_name()] = left_out.get(shape.class_name(), 0) + 1
            continue
        kinds.append(kind)
        matrices.append(m)
        areas.append(size)
        flips.append(np.full(len(m), -1.0 if shape.has_flipped_normals() else 1.0))
        owners.append(np.full(len(m), number, np.int32))
        indices.append(np.arange(len(m), dtype=np.int32))

    def joined(parts: list[Any], shape: tuple[int, ...], kind: Any) -> Any:
        return np.concatenate(parts) if parts else np.zeros(shape, kind)

    kind = joined(kinds, (0,), np.int32)
    matrix = joined(matrices, (0, 3, 4), np.float64)
    rows = np.c_[matrix.reshape(-1, 12).astype(np.float32), kind]
    order = np.lexsort(rows.T[::-1])
    return Surfaces(
        shapes,
        kind[order],
        matrix[order],
        joined(areas, (0,), np.float64)[order],
        joined(flips, (0,), np.float64)[order],
        joined(owners, (0,), np.int32)[order],
        joined(indices, (0,), np.int32)[order],
        degenerate,
        left_out,
    )


# ------------------------------------------------------------------- private


def _number(shape: Any) -> int:
    """Mitsuba's number of a shape, by which a ray's hit names it."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _triangles(mesh: Any) -> tuple[Array, Array]:
    """Matrices ``(P, 3, 4)`` with columns e1, e2, e1 x e2, corner; areas."""
    vertices = np.array(mesh.vertex_positions_buffer(), np.float64).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer(), np.int64).reshape(-1, 3)
    corner = vertices[faces[:, 0]]
    e1, e2 = vertices[faces[:, 1]] - corner, vertices[faces[:, 2]] - corner
    normal = np.cross(e1, e2)
    twice = np.linalg.norm(normal, axis=1)
    # next to nothing, seen from its own sides, is nothing: no direction is left in float32
    longest = np.maximum((e1**2).sum(1), (e2**2).sum(1))
    area = np.where(twice > 1e-9 * longest, twice / 2, 0)
    length = np.where(twice > 0, np.sqrt(np.maximum(twice, 1e-300)), 1)
    return np.stack([e1, e2, normal / length[:, None], corner], axis=2), area


def _affine(shape: Any) -> Array:
    return np.array(mi.traverse(shape)["to_world"].matrix, np.float64).reshape(4, 4)[:3]


def _whole_area(kind: int, m: Array) -> float:
    x, y, z = (m[:, k] for k in range(3))
    if kind == DISK:
        return float(np.pi * np.linalg.norm(np.cross(x, y)))
    if kind == SPHERE:
        return float(4 * np.pi * abs(np.linalg.det(m[:, :3])) ** (2 / 3))
    # a circular cylinder, which is all that Mitsuba has
    return float(2 * np.pi * np.linalg.norm(x) * np.linalg.norm(z))


def _cofactor(m: Array) -> Array:
    x, y, z = m[:, :, 0], m[:, :, 1], m[:, :, 2]
    return np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)


def _local(kind: NDArray[Any], a: Array, b: Array) -> tuple[Array, Array]:
    angle = 2 * np.pi * np.where(kind == DISK, b, a)
    c, s = np.cos(angle), np.sin(angle)
    z = 1 - 2 * b
    ring = np.sqrt(np.maximum(0, 1 - z * z))
    r = np.sqrt(a)
    o, i = np.zeros_like(a), np.ones_like(a)
    places = [
        np.stack([a, b, o], 1), np.stack([ring * c, ring * s, z], 1),
        np.stack([r * c, r * s, o], 1), np.stack([c, s, b], 1),
    ]  # fmt: skip
    normals = [np.stack([o, o, i], 1), places[1], np.stack([o, o, i], 1), np.stack([c, s, o], 1)]
    which = np.asarray(kind)[:, None]
    pick = [which == k for k in range(4)]
    return np.select(pick, places), np.select(pick, normals)


def _local_in_kernel(kind: Any, a: Any, b: Any) -> tuple[Any, Any]:
    s, c = dr.sincos(2 * dr.pi * dr.select(kind == DISK, b, a))
    z = 1 - 2 * b
    ring, r = root(1 - z * z), root(a)
    ball = mi.Vector3f(ring * c, ring * s, z)
    flat = mi.Vector3f(r * c, r * s, 0)
    tube, round_ = mi.Vector3f(c, s, b), mi.Vector3f(c, s, 0)
    up = mi.Vector3f(0, 0, 1)
    place = dr.select(kind == SPHERE, ball, dr.select(kind == DISK, flat, tube))
    normal = dr.select(kind == SPHERE, ball, dr.select(kind == DISK, up, round_))
    return place, normal


def _parameters_in_kernel(kind: Any, local: Any) -> tuple[Any, Any]:
    angle = turn(local.y, local.x)
    squared = local.x * local.x + local.y * local.y
    height = dr.select(kind == SPHERE, 0.5 * (1 - local.z), local.z)
    a = dr.select(kind == DISK, squared, angle)
    b = dr.select(kind == DISK, angle, height)
    return _unit(a), _unit(b)


def _unit(value: Any) -> Any:
    return greater(smaller(value, mi.Float(1)), mi.Float(0))
