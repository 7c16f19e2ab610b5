"""How bright a scene will be, by radiometry on the back of an envelope, and making it right.

In a room the mean reflected radiance of a flux Φ is ``Φ ρ / (π A (1 − ρ))`` (the integrating
sphere); on a table it is ``ρ E / π`` for the irradiance E. All lights of a scene are scaled so that
this estimate meets a wish, which varies by some stops from scene to scene.
"""

from __future__ import annotations

import numpy as np

from lambent.scenes.mitsuba.geometry import Array
from lambent.scenes.mitsuba.plan import EmitterPlan, ShapePlan
from lambent.scenes.mitsuba.stage import Stage

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def wish(rng: np.random.Generator) -> float:
    """A mean radiance to expose for: 0.2, give or take a stop; rarely much darker."""
    stops = rng.normal(0, 0.8) - (rng.uniform(1.5, 3) if rng.random() < 0.04 else 0)
    return 0.2 * float(2 ** np.clip(stops, -4, 2))


def flux(emitter: EmitterPlan, shape: ShapePlan | None) -> float:
    """The luminous power of a light that is not the environment."""
    power = float(np.asarray(emitter.values["radiance"]) @ _LUMINANCE)
    if emitter.kind == "point":
        return 4 * np.pi * power
    if emitter.kind == "spot":
        outer = np.radians(float(emitter.values.get("cutoff", 30)))
        return 2 * np.pi * (1 - np.cos(outer * 0.85)) * power
    if shape is None:
        return 0.0
    g = shape.geometry
    corners = g.positions[g.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(cross, axis=1).sum() / 2)
    return np.pi * area * power * (0.3 if emitter.kind == "picture" else 1.0)


def lamps_flux(stage: Stage) -> float:
    """The power of all lights but the environment."""
    lit = {s.emitter: s for s in stage.shining}
    total = 0.0
    for i, e in enumerate(stage.emitters):
        if e.kind not in ("envmap", "sunsky"):
            total += flux(e, lit.get(i))
    return total


def irradiance(stage: Stage, at: Array) -> float:
    """The light of the lamps on a level surface at a point, as if all were small and unshaded."""
    lit = {s.emitter: s for s in stage.shining}
    total = 0.0
    for i, e in enumerate(stage.emitters):
        if e.kind in ("envmap", "sunsky"):
            continue
        shape = lit.get(i)
        pose = shape.to_world if shape else np.asarray(e.values["to_world"])
        way = pose[:3, 3] - at
        distance = float(np.linalg.norm(way))
        level = max(way[2] / distance, 0.15)
        share = 4 * np.pi if e.kind in ("point", "bulb", "string") else np.pi
        if e.kind == "spot":
            share = 2 * np.pi * (1 - np.cos(np.radians(float(e.values.get("cutoff", 30)) * 0.85)))  # type: ignore[arg-type]
        total += flux(e, shape) / share * level / max(distance, 0.05) ** 2
    return total
