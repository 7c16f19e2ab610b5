"""What reaches and leaves a patch without bouncing: reflectance, emission, light of the emitters.

Light that comes straight from emitters is measured by sampling them, as a path tracer does
(next-event estimation), not through form factors: a small lamp would be hit by few rays, and this
way area lights with textures, environment maps, the sun, spots and points are all one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lambent.kernels.extremes import greater
from lambent.transport.diffuse import lit_side, reflectance
from lambent.transport.jit import dr, mi
from lambent.transport.radiosity.patches import Index
from lambent.transport.radiosity.probe import Probe, faces_of, lattice
from lambent.transport.surfaces import Array

#: Lanes of one launch.
LAUNCH = 1 << 21


@dataclass(frozen=True)
class Look:
    """Means over faces, ``(n, 3)``: reflectance in [0, 1), emitted radiosity (W/m²)."""

    reflectance: Array
    emission: Array


def look(scene: Any, probe: Probe, faces: Index, points: int = 16, seed: int = 0) -> Look:
    """Reflectance and emission of faces, each the mean of so many points of it.

    Which side reflects is Mitsuba's affair: that of the shading normal. Faces are counted by the
    geometric normal of `Surfaces`; the two may point apart (mirrored shapes, vertex normals).
    """

    def one(patch: Any, side: Any, shift: Any, k: Any) -> list[Any]:
        u = [lattice(k, shift, d) for d in range(3)]
        si = probe.interaction(*probe.place(patch, *u), side)
        si.wi = mi.Vector3f(0, 0, dr.select(si.wi.z >= 0, mi.Float(1), mi.Float(-1)))
        emitted = si.emitter(scene).eval(si) * dr.pi
        rho = dr.select(lit_side(si), reflectance(si, mi.Bool(True)), mi.Color3f(0))
        return [*rho, *emitted]

    means = _means(one, 6, faces, points, seed)
    # a material or texture that is not a number is black rather than everywhere
    means = np.nan_to_num(means, nan=0.0, posinf=0.0, neginf=0.0)
    return Look(means[:, :3], np.maximum(means[:, 3:], 0))


def direct(scene: Any, probe: Probe, faces: Index, samples: int = 64, seed: int = 0) -> Array:
    """Irradiance ``(n, 3)`` of faces straight from all emitters, in W/m².

    The mean over ``samples`` points of each face, at each one sample of the emitters.
    """

    def one(patch: Any, side: Any, shift: Any, k: Any) -> list[Any]:
        u = [lattice(k, shift, d) for d in range(5)]
        _, _, _, p, n = probe.place(patch, u[0], u[1], u[2])
        at = dr.zeros(mi.Interaction3f, dr.width(p))
        at.p, at.n = p, dr.select(side == 0, n, -n)
        return list(arriving(scene, at, mi.Point2f(u[3], u[4])))

    return _means(one, 3, faces, samples, seed)


def arriving(scene: Any, at: Any, u: Any, active: Any = True, beside_ray: bool = False) -> Any:
    """Irradiance at interactions whose normal is that of the lit side: one sample of it, W/m².

    ``beside_ray``: only the share of it that `met_by_ray` does not give.
    """
    ds, light = scene.sample_emitter_direction(at, u, True, active)
    cosine = greater(dr.dot(ds.d, mi.Vector3f(at.n)), mi.Float(0))
    value = light * cosine
    if beside_ray:
        value *= dr.select(ds.delta, mi.Float(1), _share(ds.pdf, cosine * dr.inv_pi))
    good = (ds.pdf > 0) & dr.isfinite(value.x + value.y + value.z)
    return dr.select(good & active, value, mi.Color3f(0))


def met_by_ray(scene: Any, at: Any, met: Any, cosine: Any, active: Any = True) -> Any:
    """Irradiance at ``at`` by one cosine-weighted ray: its share of what shines where it ended.

    ``met``: the surface interaction there, or none; ``cosine`` of the ray with the normal. Together
    with `arriving` (``beside_ray``) it is all direct light, weighted by the power heuristic (Veach
    and Guibas 1995): samples of a wide sky miss the windows of a room, rays miss small lamps.
    """
    emitter = met.emitter(scene, active)
    chance = scene.pdf_emitter_direction(at, mi.DirectionSample3f(scene, met, at), active)
    value = dr.pi * emitter.eval(met, active) * _share(cosine * dr.inv_pi, chance)
    good = (cosine > 0) & dr.isfinite(value.x + value.y + value.z)
    return dr.select(good & active, value, mi.Color3f(0))


# ------------------------------------------------------------------- private


def _share(mine: Any, other: Any) -> Any:
    """The weight of a sample of density ``mine`` by the power heuristic."""
    ratio = other / mine  # squares of both could overflow
    return dr.select(mine > 0, 1 / (1 + ratio * ratio), mi.Float(0))


def _means(one: Any, channels: int, faces: Index, count: int, seed: int) -> Array:
    """Means over ``count`` points of what ``one`` gives at each, ``(n, channels)``."""
    found = np.zeros((len(faces), channels))
    for first in range(0, len(faces), LAUNCH):
        some = faces[first : first + LAUNCH]
        with dr.suspend_grad():
            patch, side, shift = faces_of(some, seed)
            limit = dr.opaque(mi.UInt32, count)

            def step(k: Any, patch: Any, side: Any, shift: Any, sums: Any) -> Any:
                values = one(patch, side, shift, k)
                total = [s + v for s, v in zip(sums, values, strict=True)]
                return k + 1, patch, side, shift, total

            done = dr.while_loop(
                (mi.UInt32(0), patch, side, shift, [mi.Float(0)] * channels),
                lambda k, patch, side, shift, sums, limit=limit: k < limit,
                step,
                label="points of a face",
            )
            sums = [dr.zeros(mi.Float, len(some)) + total for total in done[4]]
            dr.eval(sums)
            for channel, total in enumerate(sums):
                found[first : first + len(some), channel] = total.numpy()
    return found / count
