"""Where to cut finer: where the solution, seen as a picture, changes most within a patch.

The step of a leaf is how much its radiosity differs between its corners, relative to what the eye
would compare it with; squared and times the area it is the leaf's share of relMSE. Corners see only
what differs from patch to patch. What a patch hides, an edge of a shadow or a part that something
covers, shows where direct light is measured once more on its quarters (`hidden`). Of the two, the
larger counts. Patches with the largest shares are cut in four, or, where they are made of many
small triangles, gathered anew in cubes half as large; both let the step shrink to about half.

(Tried instead: how far a leaf's own value is from the mean of its corners, which is 0 on even
gradients. It cuts along the borders of every wall, where corners know one side only; relMSE of a
Cornell box of 4,000 patches came out 1.4 times as high.)
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.transport.radiosity import light
from lambent.transport.radiosity.patches import Cells, Index, Patches, cluster
from lambent.transport.radiosity.probe import Probe
from lambent.transport.radiosity.smooth import at_vertices, vertices_of
from lambent.transport.surfaces import Array

#: A leaf is never smaller than this share of the scene's whole area.
SMALLEST = 1e-8
#: Cubes of shared patches are halved at most so often.
MOST_HALVED = 8
#: (Step between corners)² over the variance of quarters, on an even gradient.
GRADIENT = 16.0


def shares(patches: Patches, radiosity: Array, there: Array, variance: Array) -> Array:
    """Each patch's share of the picture's error ``(n,)``.

    ``radiosity`` ``(2 n, 3)`` of all faces, ``there`` ``(2 n,)``: faces that have any;
    ``variance`` ``(2 n,)``: of the radiosity within each, as far as it is known, else 0.
    """
    vertices = vertices_of(patches)
    grey = radiosity.mean(axis=1)
    usual = float(np.average(grey, weights=np.repeat(patches.area, 2) * (there + 1e-12)))
    index = vertices.leaf_corners
    first = patches.start[:-1]
    found = np.zeros(len(patches))
    for side in (0, 1):
        value = at_vertices(vertices, patches, grey[side::2, None], there[side::2])[:, 0]
        corners = np.where(index >= 0, value[index], np.nan)
        # of a patch of many leaves, from its lowest corner to its highest
        low, high = np.nanmin(corners, axis=1), np.nanmax(corners, axis=1)
        step = np.maximum.reduceat(high, first) - np.minimum.reduceat(low, first)
        mean = np.add.reduceat(np.nanmean(corners, axis=1), first) / np.diff(patches.start)
        seen = (step / (mean + 0.1 * usual + 1e-30)) ** 2
        within = variance[side::2] / (grey[side::2] + 0.1 * usual + 1e-30) ** 2
        both = np.maximum(seen, GRADIENT * within)
        found += np.where(there[side::2] > 0, both, 0) * patches.area
    return found


def hidden(
    scene: Any, patches: Patches, live: NDArray[np.bool_], samples: int, seed: int = 0
) -> Array:
    """Variance of direct irradiance (mean of the channels) within faces ``(2 n,)``, W²/m⁴.

    Between the quarters of a patch, or the leaves of one that has several; 0 where not ``live``
    ``(2 n,)``. Each is measured twice by ``samples`` points; the mean product of the two deviations
    has no bias from their noise (and may be a little below 0).
    """
    count = np.diff(patches.start)
    patch = np.repeat(np.arange(len(patches)), count)
    single = (count == 1)[patch]
    cells = patches.cells.split(patches.leaf[single])
    owner = np.full(len(cells.child), -1, np.int64)
    owner[patches.leaf] = patch
    owner[len(patches.cells.child) :] = np.repeat(patch[single], 4)
    parts = cluster(cells)
    face = 2 * np.repeat(owner[parts.leaf], 2) + np.tile([0, 1], len(parts))
    at: Index = np.flatnonzero(live[face])
    probe = Probe.of(parts)
    area, face, size = np.repeat(parts.area, 2)[at], face[at], 2 * len(patches)
    whole = np.maximum(np.bincount(face, area, minlength=size), 1e-300)
    product = area.copy()
    for k in (1, 2):
        value = light.direct(scene, probe, at, samples, seed + 0x51ED * k).mean(axis=1)
        mean = np.bincount(face, area * value, minlength=size) / whole
        product *= value - mean[face]
    return np.asarray(np.bincount(face, product, minlength=size) / whole)


def refined(
    patches: Patches, share: Array, more: int, halved: NDArray[np.int8]
) -> tuple[Cells, NDArray[np.int8]]:
    """The cells with about ``more`` new patches where the shares ``(n,)`` are largest.

    ``halved`` ``(T,)``: how often the cube was halved in which a cell shares a patch (`cluster`);
    it comes back for the new cells.
    """
    smallest = SMALLEST * float(patches.area.sum())
    several = np.diff(patches.start) > 1
    first = patches.leaf[patches.start[:-1]]
    can = np.where(several, halved[first] < MOST_HALVED, patches.area > smallest)
    worth = np.where(can, share, 0.0)
    count = min(max(1, more // 3), int((worth > 0).sum()))
    worst = np.zeros(len(patches), bool)
    worst[np.argsort(-worth, kind="stable")[:count]] = True
    cells = patches.cells.split(np.sort(first[worst & ~several]))
    found = np.zeros(len(cells.child), np.int8)
    found[: len(halved)] = halved
    found[patches.leaf[np.repeat(worst & several, np.diff(patches.start))]] += 1
    return cells, found
