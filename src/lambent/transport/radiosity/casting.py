"""Form factors by casting rays: for scenes of any size, with any shapes.

F_ij is the share of the light that leaves face i, spread evenly over its area and by the cosine
over directions, that arrives at face j first. So N rays, started like that, hit j about F_ij N
times, and visibility comes with it (Mitsuba's ray tracer answers). A row has at most N entries,
whatever the number of faces: memory and time are linear in the number of patches, where all pairs
would be its square.

The stated error: an entry of n hits is off by √n hits at random rays; the lattice
(`lambent.transport.radiosity.probe`) does better. Sums over rows, which is what the solution
consists of, average it further.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lambent.progress import Progress
from lambent.transport.jit import dr, mi
from lambent.transport.radiosity.patches import Index, Patches
from lambent.transport.radiosity.probe import Probe, faces_of, lattice
from lambent.transport.surfaces import NOWHERE, Array
from lambent.transport.warps import cosine_hemisphere

#: Rays in one launch.
LAUNCH = 1 << 24
#: Where a ray ended that hit no face with an unknown.
ESCAPED, BLACK = 0xFFFFFFFE, 0xFFFFFFFD


@dataclass(frozen=True, eq=False)
class Cast:
    """What the rays of some faces hit.

    ``shares`` ``(rows, 2 n)`` CSR: of each face's rays the share that ended on each face;
    ``escaped`` ``(rows,)``: the share that left the scene; the rest ended on something black.
    """

    shares: Any
    escaped: Array


def cast(
    scene: Any,
    patches: Patches,
    probe: Probe,
    faces: Index,
    reflecting: NDArray[np.bool_],
    rays: int,
    seed: int = 0,
    progress: Progress | None = None,
) -> Cast:
    """Cast ``rays`` from each of ``faces``; ``reflecting`` ``(2 n,)``: faces that are not black."""
    cell_patch = mi.Int32(patches.cell_patch)
    alive = mi.UInt32(reflecting.astype(np.uint32))
    step = max(1, LAUNCH // rays)
    parts, escaped = [], []
    for first in range(0, len(faces), step):
        some = faces[first : first + step]
        hits = _launch(scene, probe, cell_patch, alive, some, rays, seed)
        table = hits.reshape(len(some), rays)
        escaped.append((table == ESCAPED).mean(axis=1))
        good = table < BLACK
        row = np.broadcast_to(np.arange(len(some))[:, None], table.shape)[good]
        found = sparse.coo_matrix(
            (np.full(len(row), 1 / rays, np.float32), (row, table[good].astype(np.int64))),
            shape=(len(some), 2 * len(patches)),
        ).tocsr()
        parts.append(found)
        if progress is not None:
            progress(min(first + step, len(faces)), len(faces), "form factors by rays")
    if not parts:
        return Cast(sparse.csr_matrix((0, 2 * len(patches)), dtype=np.float32), np.zeros(0))
    return Cast(sparse.vstack(parts, format="csr"), np.concatenate(escaped))


def gathered(
    scene: Any,
    patches: Patches,
    probe: Probe,
    faces: Index,
    live: NDArray[np.bool_],
    x: Array,
    rays: int,
    seed: int = 0,
) -> Array:
    """F @ x ``(len(faces), C)`` without F: the mean of x over what the faces' rays hit."""
    full = np.zeros((2 * len(patches), x.shape[1]), np.float32)
    full[faces] = x
    columns = [mi.Float(np.ascontiguousarray(full[:, c])) for c in range(x.shape[1])]
    cell_patch = mi.Int32(patches.cell_patch)
    alive = mi.UInt32(live.astype(np.uint32))
    step = max(1, LAUNCH // rays)
    parts = []
    for first in range(0, len(faces), step):
        some = faces[first : first + step]
        with dr.suspend_grad():
            face = _hits(scene, probe, cell_patch, alive, some, rays, seed)
            good = face < BLACK
            sums = [
                dr.block_sum(dr.gather(mi.Float, column, face, good), rays).numpy()
                for column in columns
            ]
        parts.append(np.stack(sums, axis=1) / rays)
    return np.concatenate(parts) if parts else np.zeros((0, x.shape[1]))


def _launch(
    scene: Any, probe: Probe, cell_patch: Any, alive: Any, faces: Index, rays: int, seed: int
) -> NDArray[np.uint32]:
    """The face that each ray hits first, ``(len(faces) * rays,)``."""
    with dr.suspend_grad():
        return np.asarray(_hits(scene, probe, cell_patch, alive, faces, rays, seed).numpy())


def _hits(
    scene: Any, probe: Probe, cell_patch: Any, alive: Any, faces: Index, rays: int, seed: int
) -> Any:
    """The same in Dr.Jit's memory."""
    patch, side, shift = faces_of(faces, seed)
    lane = dr.arange(mi.UInt32, len(faces) * rays)
    row, k = lane // rays, lane % rays
    patch, side, shift = (dr.gather(mi.UInt32, x, row) for x in (patch, side, shift))
    u = [lattice(k, shift, d) for d in range(5)]
    _, _, _, p, n = probe.place(patch, u[0], u[1], u[2])
    up = dr.select(side == 0, n, -n)
    local = cosine_hemisphere(u[3], u[4])
    start = dr.zeros(mi.Interaction3f, len(faces) * rays)
    start.p, start.n = p, up
    ray = start.spawn_ray(mi.Frame3f(up).to_world(local))
    hit = scene.ray_intersect_preliminary(ray, False)
    valid = hit.is_valid()
    cell, _, _ = probe.tree.find(hit.shape, hit.prim_index, ray(hit.t), valid)
    known = valid & (cell != NOWHERE)
    there = dr.gather(mi.Int32, cell_patch, cell, known)
    known &= there >= 0
    prim = dr.gather(mi.UInt32, probe.prim, cell, known)
    normal = probe.tree.surfaces.normal(prim, ray(hit.t))
    behind = dr.dot(normal, ray.d) > 0
    face = 2 * mi.UInt32(there) + dr.select(behind, mi.UInt32(1), 0)
    known &= dr.gather(mi.UInt32, alive, face, known) != 0
    return dr.select(~valid, mi.UInt32(ESCAPED), dr.select(known, face, mi.UInt32(BLACK)))
