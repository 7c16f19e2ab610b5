"""The books that a path keeps: its light by kind, and what its pixel shows.

    first rough vertex   the first one whose BSDF is not purely specular: what is seen in mirrors
                         and through clear glass belongs to the pixel as much as what is seen
                         directly. Scattering in a medium counts as rough and diffuse
    emission             light that arrives there without any rough vertex
    diffuse              of the light scattered at the first rough vertex, the share
                         min(f, ρ_d cos θ / π) / f of the BSDF f: its Lambertian part, from which
                         ρ_d divides out exactly (Bako et al. 2017), whatever the BSDF's own lobes
    specular             the rest, emission included: colour = diffuse + specular
    direct               emission, and light that comes to the first rough vertex straight from an
                         emitter; indirect is the rest
    light groups         the same light by the group of the emitter that it left

Features (albedos, normal, depth, position, roughness) are those of the first rough vertex, or of
the last mirror where there is none; albedos carry the throughput up to there, depth is the length
of the way. Normals are those that the BSDF shades with (bump and normal maps applied), towards the
viewer. Those of the very first hit are kept, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from lambent.kernels.extremes import smaller
from lambent.render.surface import Surface, describe


@dataclass(frozen=True)
class PathOptions:
    """How paths are traced and which books are kept.

    ``depth``: most vertices of a path, emitter included (Mitsuba's ``max_depth``); ``rr_depth``:
    vertices before Russian roulette; ``lighting``: split the light; ``features``: look at surfaces;
    ``first``: features of the first hit, too; ``groups``: for every emitter (by Dr.Jit's registry)
    its light group, as an array to gather from, or None; ``group_count``: how many groups.
    """

    depth: int = 12
    rr_depth: int = 5
    lighting: bool = True
    features: bool = True
    first: bool = True
    groups: Any = None
    group_count: int = 0


@dataclass
class Books:
    """What one path tells. Colours in radiance; see the module for each."""

    colour: Any
    diffuse: Any
    direct: Any
    emission: Any
    groups: list[Any]
    alpha: Any
    diffuse_albedo: Any
    specular_albedo: Any
    normal: Any
    depth: Any
    position: Any
    roughness: Any
    first_albedo: Any
    first_normal: Any
    first_depth: Any
    first_position: Any
    #: Registry index of the shape of the first hit, and its instance: what moved it is looked up.
    first_shape: Any
    #: Entered by the sampler, which knows the camera (`lambent.render.motion`).
    motion: Any = None
    previous_depth: Any = None


def empty_books(options: PathOptions) -> Books:
    """No light, nothing hit."""
    black, zero = mi.Color3f(0), mi.Float(0)
    return Books(
        colour=mi.Color3f(black),
        diffuse=mi.Color3f(black),
        direct=mi.Color3f(black),
        emission=mi.Color3f(black),
        groups=[mi.Color3f(black) for _ in range(options.group_count)],
        alpha=mi.Float(zero),
        diffuse_albedo=mi.Color3f(black),
        specular_albedo=mi.Color3f(black),
        normal=mi.Normal3f(0),
        depth=mi.Float(zero),
        position=mi.Point3f(0),
        roughness=mi.Float(zero),
        first_albedo=mi.Color3f(black),
        first_normal=mi.Normal3f(0),
        first_depth=mi.Float(zero),
        first_position=mi.Point3f(0),
        first_shape=mi.UInt32(0),
    )


def book(
    s: Any,
    light: Any,
    share: Any,
    direct: Any,
    emission: Any,
    emitter: Any,
    options: PathOptions,
) -> None:
    """Enter light that a path found: ``direct`` and ``emission`` say which it is."""
    books = s.books
    books.colour += light
    if not options.lighting:
        return
    books.diffuse += light * share
    books.direct += dr.select(direct, light, 0)
    books.emission += dr.select(emission, light, 0)
    if options.group_count:
        index = dr.reinterpret_array(mi.UInt32, emitter)
        group = dr.gather(mi.UInt32, options.groups, index, s.active)
        for number in range(options.group_count):
            books.groups[number] += dr.select(group == number, light, 0)


def look(bsdf: Any, si: Any, active: Any, options: PathOptions) -> Surface:
    """What surfaces look like where ``active``; nothing if no book wants to know it."""
    if not (options.features or options.lighting):
        return Surface(mi.Color3f(0), mi.Color3f(0), mi.Float(0), mi.Vector3f(0, 0, 1))
    found: Surface = dr.dispatch(bsdf, describe, si, active)
    return found


def diffuse_share(seen: Surface, si: Any, wo: Any, value: Any) -> Any:
    """Share of the Lambertian part ρ_d |cos θ| / π in ``value`` = f |cos θ|, each channel.

    θ is the angle to the normal that the BSDF shades with.
    """
    same_side = si.wi.z * wo.z > 0
    cosine = dr.abs(dr.dot(seen.normal, wo))
    lambert = seen.diffuse * dr.select(same_side, cosine * dr.inv_pi, 0)
    return dr.select(value > lambert, lambert / value, dr.select(value > 0, 1.0, 0.0))


def note_features(s: Any, seen: Surface, si: Any, here: Any, options: PathOptions) -> None:
    """Enter what a pixel shows of a surface, where ``here``; later entries replace earlier ones."""
    if not options.features:
        return
    books = s.books
    normal = si.to_world(seen.normal)
    normal = dr.mulsign(normal, dr.dot(normal, -s.ray.d))
    now = {
        "diffuse_albedo": s.throughput * seen.diffuse,
        "specular_albedo": s.throughput * seen.specular,
        "normal": mi.Normal3f(normal),
        "depth": s.length,
        "position": si.p,
        "roughness": seen.roughness,
        "alpha": mi.Float(1),
    }
    for name, value in now.items():
        setattr(books, name, dr.select(here, value, getattr(books, name)))
    if options.first:
        at_first = here & (s.depth == 0)
        now = {
            "first_albedo": smaller(seen.diffuse + seen.specular, mi.Color3f(1)),
            "first_normal": mi.Normal3f(normal),
            "first_depth": s.length,
            "first_position": si.p,
            "first_shape": dr.select(
                si.instance != None,  # noqa: E711  (an array of pointers)
                dr.reinterpret_array(mi.UInt32, si.instance),
                dr.reinterpret_array(mi.UInt32, si.shape),
            ),
        }
        for name, value in now.items():
            setattr(books, name, dr.select(at_first, value, getattr(books, name)))


def note_scattering(s: Any, place: Any, here: Any, options: PathOptions) -> None:
    """Enter what a pixel shows of a medium: light scattered at ``place``, where ``here``."""
    if not options.features:
        return
    books = s.books
    now = {
        "diffuse_albedo": s.throughput,
        "specular_albedo": mi.Color3f(0),
        "normal": mi.Normal3f(-s.ray.d),
        "depth": s.length,
        "position": mi.Point3f(place),
        "roughness": mi.Float(1),
        "alpha": mi.Float(1),
    }
    for name, value in now.items():
        setattr(books, name, dr.select(here, value, getattr(books, name)))


def power(a: Any, b: Any) -> Any:
    """Power heuristic with exponent 2 (Veach 1997, equation 9.14); 0 where both are."""
    a, b = dr.square(a), dr.square(b)
    weight = a / (a + b)
    return dr.select(dr.isfinite(weight), weight, 0)
