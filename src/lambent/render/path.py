"""One sample of a pixel on surfaces: a path with everything a denoiser wants to know about it.

The estimator is the textbook's: paths from the camera, at every vertex one sample of the emitters
and one of the BSDF, joined by the power heuristic (Veach 1997, chapters 9 and 10), Russian roulette
after a few bounces. It uses the random numbers of Mitsuba's ``path`` in the same order and computes
the same radiance. What is noted on the way is in `lambent.render.books`; scenes with participating
media have paths of their own (`lambent.render.volume`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi

from lambent.kernels.extremes import greater, smaller
from lambent.render.books import (
    Books,
    PathOptions,
    book,
    diffuse_share,
    empty_books,
    look,
    note_features,
    power,
)


@dataclass
class _State:
    """The state of the loop over vertices."""

    books: Books
    ray: Any
    throughput: Any
    eta: Any
    length: Any
    depth: Any
    active: Any
    #: No rough vertex yet.
    through: Any
    #: The vertex before this one was the first rough one.
    fresh: Any
    #: Diffuse share of the light that the rest of the path brings.
    share: Any
    before: Any  # vertex before this one, with pdf and whether its scattering was specular
    before_pdf: Any
    before_delta: Any
    sampler: Any = field(repr=False)


def trace(scene: Any, sampler: Any, ray: Any, options: PathOptions) -> tuple[Books, Any]:
    """Trace one path a lane; returns the books and the sampler's state.

    ``ray``: camera rays (`Ray3f`). Symbolic: to be called while a kernel is recorded.
    """
    state = _start(sampler, ray, options)

    def step(state: _State) -> tuple[_State]:
        return (_vertex(scene, state, options),)

    (state,) = dr.while_loop((state,), lambda s: s.active, step, label="vertices of a path")
    return state.books, state.sampler


def _start(sampler: Any, ray: Any, options: PathOptions) -> _State:
    return _State(
        books=empty_books(options),
        ray=mi.Ray3f(ray),
        throughput=mi.Color3f(1),
        eta=mi.Float(1),
        length=mi.Float(0),
        depth=mi.UInt32(0),
        active=mi.Bool(True),
        through=mi.Bool(True),
        fresh=mi.Bool(False),
        share=mi.Color3f(0),
        before=dr.zeros(mi.Interaction3f),
        before_pdf=mi.Float(1),
        before_delta=mi.Bool(True),
        sampler=sampler,
    )


def _vertex(scene: Any, s: _State, options: PathOptions) -> _State:
    """One vertex: where the ray arrives, light from there, and where the path goes on."""
    si = scene.ray_intersect(s.ray, +mi.RayFlags.All, s.depth == 0)
    valid = si.is_valid()

    # ------------------------------------------------ emitted light, weighed against NEE
    emitter = si.emitter(scene)
    ds = mi.DirectionSample3f(scene, si, s.before)
    emitter_pdf = scene.pdf_emitter_direction(s.before, ds, ~s.before_delta)
    emitted = emitter.eval(si, s.before_pdf > 0)
    light = s.throughput * emitted * power(s.before_pdf, emitter_pdf)
    book(s, light, s.share, s.through | s.fresh, s.through, emitter, options)

    goes_on = valid & (s.depth + 1 < options.depth)

    # ---------------------------------------------------- what the surface looks like
    bsdf = si.bsdf(s.ray)
    rough = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    looked_at = s.through & valid
    seen = look(bsdf, si, looked_at, options)

    # --------------------------------------- one sample of the emitters, one of the BSDF
    at_emitter = goes_on & rough
    ds, emitted = scene.sample_emitter_direction(si, s.sampler.next_2d(), True, at_emitter)
    at_emitter &= ds.pdf != 0
    wo = si.to_local(ds.d)
    value, pdf, sampled, weight = bsdf.eval_pdf_sample(
        mi.BSDFContext(), si, wo, s.sampler.next_1d(), s.sampler.next_2d()
    )
    first_rough = s.through & rough
    weighed = emitted * dr.select(ds.delta, 1, power(ds.pdf, pdf))
    light = dr.select(at_emitter, s.throughput * value * weighed, 0)
    if options.lighting:
        share = dr.select(first_rough, diffuse_share(seen, si, wo, value), s.share)
        book(s, light, share, first_rough, mi.Bool(False), ds.emitter, options)
        ahead = diffuse_share(seen, si, sampled.wo, weight * sampled.pdf)
        specular = mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Delta)
        s.share = dr.select(first_rough, dr.select(specular, mi.Color3f(0), ahead), s.share)
    else:
        s.books.colour += light

    # --------------------------------------------------------------- features, alpha
    passed = goes_on & mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Null)
    s.length += dr.select(valid, si.t, 0)
    note_features(s, seen, si, looked_at & ~passed, options)

    # ------------------------------------------------------------------ to the next one
    s.fresh = first_rough & ~passed
    s.through &= ~rough | passed
    s.throughput *= weight
    s.eta *= sampled.eta
    s.ray = si.spawn_ray(si.to_world(sampled.wo))
    s.before = mi.Interaction3f(si)
    s.before_pdf = sampled.pdf
    s.before_delta = mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Delta)
    s.depth = dr.select(valid, s.depth + 1, s.depth)
    most = greater(greater(s.throughput.x, s.throughput.y), s.throughput.z)
    survival = smaller(most * dr.square(s.eta), mi.Float(0.95))
    roulette = s.depth >= options.rr_depth
    lucky = s.sampler.next_1d() < survival
    s.throughput = dr.select(roulette, s.throughput * dr.rcp(survival), s.throughput)
    s.active &= goes_on & (~roulette | lucky) & (most != 0)
    return s


def look_ahead(scene: Any, sampler: Any, ray: Any, options: PathOptions) -> tuple[Books, Any]:
    """Features only: as far as the first rough vertex, without any light."""
    state = _start(sampler, ray, options)

    def step(s: _State) -> tuple[_State]:
        si = scene.ray_intersect(s.ray, +mi.RayFlags.All, s.depth == 0)
        bsdf = si.bsdf(s.ray)
        looked_at = si.is_valid()
        seen = look(bsdf, si, looked_at, options)
        rough = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        sampled, weight = bsdf.sample(
            mi.BSDFContext(), si, s.sampler.next_1d(), s.sampler.next_2d()
        )
        passed = mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Null)
        s.length += dr.select(looked_at, si.t, 0)
        note_features(s, seen, si, looked_at & ~passed, options)
        s.throughput *= weight
        s.ray = si.spawn_ray(si.to_world(sampled.wo))
        s.depth = s.depth + 1
        s.active &= looked_at & (~rough | passed) & (s.depth < options.depth)
        return (s,)

    (state,) = dr.while_loop((state,), lambda s: s.active, step, label="way to a rough vertex")
    return state.books, state.sampler
