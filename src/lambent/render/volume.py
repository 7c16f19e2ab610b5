"""One sample of a pixel where there are participating media: the radiative transfer equation.

Free paths are sampled by the extinction of one colour channel, chosen at random; in heterogeneous
media by delta tracking against a majorant, whose null collisions change nothing (Woodcock 1965;
weights after Miller, Georgiev and Jarosz, "A null-scattering path integral formulation of light
transport", 2019). At every real vertex, on a surface or in a medium, one sample of the emitters and
one of the BSDF or phase function are joined by the power heuristic. Shadow rays pass through
surfaces that transmit straight on, such as the borders of media; along them transmittance is exact
in homogeneous media and estimated by ratio tracking (Novák et al. 2014) in others.

This computes the radiance of Mitsuba's ``volpath``. The books are those of `lambent.render.books`:
scattering in a medium is a rough vertex without specular share, whose albedo is the weight of the
path up to there and whose normal faces the viewer.
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
    note_scattering,
    power,
)


def has_media(scene: Any) -> bool:
    """Whether any shape of a scene bounds a participating medium."""
    return any(
        shape.interior_medium() is not None or shape.exterior_medium() is not None
        for shape in scene.shapes()
    )


@dataclass
class _State:
    """The state of the loop over vertices; as in `lambent.render.path`, with a medium."""

    books: Books
    ray: Any
    throughput: Any
    eta: Any
    length: Any
    depth: Any
    active: Any
    through: Any
    fresh: Any
    share: Any
    before: Any
    before_pdf: Any
    before_delta: Any
    medium: Any
    sampler: Any = field(repr=False)


def trace_media(
    scene: Any, sampler: Any, ray: Any, options: PathOptions, medium: Any = None
) -> tuple[Books, Any]:
    """Trace one path a lane; ``medium``: where the camera stands, or None.

    Returns the books and the sampler's state. Symbolic: to be called while a kernel is recorded.
    """
    hero = smaller(mi.UInt32(sampler.next_1d() * 3), mi.UInt32(2))
    state = _State(
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
        medium=dr.zeros(mi.MediumPtr) if medium is None else mi.MediumPtr(medium),
        sampler=sampler,
    )

    def step(state: _State) -> tuple[_State]:
        return (_vertex(scene, state, hero, options),)

    (state,) = dr.while_loop((state,), lambda s: s.active, step, label="vertices in media")
    return state.books, state.sampler


def _vertex(scene: Any, s: _State, hero: Any, options: PathOptions) -> _State:
    """One event: a collision in the medium, or where the ray arrives beyond it."""
    # ---------------------------------------------------------------- Russian roulette
    most = greater(greater(s.throughput.x, s.throughput.y), s.throughput.z)
    survival = smaller(most * dr.square(s.eta), mi.Float(0.95))
    roulette = s.depth > options.rr_depth
    alive = (most > 0) & (~roulette | (s.sampler.next_1d() < survival))
    s.throughput = dr.select(roulette, s.throughput * dr.rcp(survival), s.throughput)

    # ------------------------------------------------ how far: collision or surface
    si = scene.ray_intersect(s.ray, +mi.RayFlags.All, s.depth == 0, active=alive)
    inside = alive & (s.medium != None)  # noqa: E711  (an array of pointers)
    mei = s.medium.sample_interaction(s.ray, s.sampler.next_1d(), hero, inside)
    mei.t = dr.select(si.t < mei.t, dr.inf, mei.t)
    passing, density = s.medium.transmittance_eval_pdf(mei, si, inside)
    density = _channel(density, hero)
    weight = dr.select(density > 0, mi.Color3f(passing) / density, 0)
    collided = inside & mei.is_valid()
    real = dr.mean(mi.Color3f(mei.sigma_t) / mi.Color3f(mei.combined_extinction))
    scattered = collided & (s.sampler.next_1d() < real)
    ignored = collided & ~scattered
    weight = dr.select(scattered, weight * mi.Color3f(mei.sigma_s) / real, weight)
    weight = dr.select(ignored, weight * mi.Color3f(mei.sigma_n) / (1 - real), weight)
    s.throughput = dr.select(inside, s.throughput * weight, s.throughput)
    s.depth += dr.select(scattered, mi.UInt32(1), 0)
    scattered &= s.depth < options.depth
    arrived = alive & ~collided

    # ------------------------------------------------ emitted light, weighed against NEE
    emitter = si.emitter(scene, arrived)
    ds = mi.DirectionSample3f(scene, si, s.before)
    emitter_pdf = scene.pdf_emitter_direction(s.before, ds, arrived & ~s.before_delta)
    emitted = emitter.eval(si, arrived & (s.before_pdf > 0))
    light = dr.select(arrived, s.throughput * emitted * power(s.before_pdf, emitter_pdf), 0)
    book(s, light, s.share, s.through | s.fresh, s.through, emitter, options)

    # ---------------------------------------------------- what the surface looks like
    on_surface = arrived & si.is_valid()
    bsdf = si.bsdf(s.ray)
    rough = on_surface & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    seen = look(bsdf, si, s.through & on_surface, options)

    # ------------------- one sample of the emitters, one of the BSDF or phase function
    at = dr.select(scattered, mi.Interaction3f(mei), mi.Interaction3f(si))
    at_emitter = scattered | (rough & (s.depth + 1 < options.depth))
    ds, emitted = scene.sample_emitter_direction(at, s.sampler.next_2d(), False, at_emitter)
    at_emitter &= ds.pdf != 0
    leaves = on_surface & si.is_medium_transition()
    beyond = dr.select(leaves, si.target_medium(ds.d), s.medium)
    shadow = dr.select(scattered, mei.spawn_ray_to(ds.p), si.spawn_ray_to(ds.p))
    visible, s.sampler = _transmittance(scene, s.sampler, shadow, beyond, hero, at_emitter)
    value, pdf, sampled, bsdf_weight = bsdf.eval_pdf_sample(
        mi.BSDFContext(),
        si,
        si.to_local(ds.d),
        s.sampler.next_1d(),
        s.sampler.next_2d(),
        on_surface,
    )
    phase = mei.medium.phase_function()
    context = mi.PhaseFunctionContext(None)
    phase_value, phase_pdf = phase.eval_pdf(context, mei, ds.d, scattered)
    value = dr.select(scattered, mi.Color3f(phase_value), value)
    pdf = dr.select(scattered, phase_pdf, pdf)
    weighed = emitted * visible * dr.select(ds.delta, 1, power(ds.pdf, pdf))
    light = dr.select(at_emitter, s.throughput * value * weighed, 0)
    first = s.through & (rough | scattered)
    share = dr.select(scattered, mi.Color3f(1), diffuse_share(seen, si, si.to_local(ds.d), value))
    share = dr.select(first, share, s.share)
    book(s, light, share, first, mi.Bool(False), ds.emitter, options)
    ahead = diffuse_share(seen, si, sampled.wo, bsdf_weight * sampled.pdf)
    specular = mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Delta)
    ahead = dr.select(scattered, mi.Color3f(1), dr.select(specular, mi.Color3f(0), ahead))
    s.share = dr.select(first, ahead, s.share)

    # --------------------------------------------------------------- features, alpha
    passed = on_surface & mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Null)
    s.length += dr.select(collided, mei.t, dr.select(on_surface, si.t, 0))
    note_features(s, seen, si, s.through & on_surface & ~passed, options)
    note_scattering(s, mei.p, s.through & scattered, options)

    # ------------------------------------------------------------------ to the next one
    wo, phase_weight, phase_pdf = phase.sample(
        context, mei, s.sampler.next_1d(), s.sampler.next_2d(), scattered
    )
    turned = on_surface & ~passed
    s.fresh = dr.select(passed | ignored, s.fresh, first)
    s.through &= passed | ignored | ~(rough | scattered)
    next_weight = dr.select(scattered, mi.Color3f(phase_weight), bsdf_weight)
    s.throughput = dr.select(scattered | on_surface, s.throughput * next_weight, s.throughput)
    s.eta = dr.select(on_surface, s.eta * sampled.eta, s.eta)
    straight = mi.Ray3f(s.ray)
    straight.o = mei.p
    new_ray = dr.select(
        scattered,
        mei.spawn_ray(wo),
        dr.select(ignored, straight, si.spawn_ray(si.to_world(sampled.wo))),
    )
    s.before = dr.select(scattered | turned, at, s.before)
    s.before_pdf = dr.select(scattered, phase_pdf, dr.select(turned, sampled.pdf, s.before_pdf))
    s.before_delta = dr.select(
        scattered, mi.Bool(False), dr.select(turned, specular, s.before_delta)
    )
    s.depth += dr.select(turned, mi.UInt32(1), 0)
    s.medium = dr.select(leaves, si.target_medium(new_ray.d), s.medium)
    s.ray = new_ray
    s.active &= (
        (scattered & (phase_pdf > 0))
        | ignored
        | (on_surface & (passed | (s.depth < options.depth)))
    )
    return s


@dataclass
class _Shadow:
    """The state of a shadow ray."""

    ray: Any
    left: Any
    medium: Any
    passing: Any
    active: Any
    sampler: Any = field(repr=False)


def _transmittance(
    scene: Any, sampler: Any, ray: Any, medium: Any, hero: Any, active: Any
) -> tuple[Any, Any]:
    """Share of light that comes along a ray as far as its end, each channel, and the sampler."""

    def step(s: _Shadow) -> tuple[_Shadow]:
        s.ray.maxt = s.left
        si = scene.ray_intersect(s.ray)
        far = dr.select(si.is_valid(), si.t, s.left)
        inside = s.medium != None  # noqa: E711  (an array of pointers)
        mei = s.medium.sample_interaction(s.ray, s.sampler.next_1d(), hero, inside)
        even = s.medium.is_homogeneous()
        exact = dr.exp(-far * mi.Color3f(mei.combined_extinction))
        collided = inside & ~even & mei.is_valid() & (mei.t < far)
        ratio = mi.Color3f(mei.sigma_n) / mi.Color3f(mei.combined_extinction)
        s.passing = dr.select(inside & even, s.passing * exact, s.passing)
        s.passing = dr.select(collided, s.passing * ratio, s.passing)
        arrived = si.is_valid() & ~collided
        through = si.bsdf().eval_null_transmission(si, arrived)
        s.passing = dr.select(arrived, s.passing * mi.Color3f(through), s.passing)
        border = arrived & si.is_medium_transition()
        s.medium = dr.select(border, si.target_medium(s.ray.d), s.medium)
        on = dr.select(collided, mei.p, si.spawn_ray(s.ray.d).o)
        s.left -= dr.select(collided, mei.t, dr.norm(on - s.ray.o))
        s.ray.o = on
        s.active &= (arrived | collided) & (s.left > 0) & dr.any(s.passing != 0)
        return (s,)

    start = _Shadow(
        mi.Ray3f(ray), mi.Float(ray.maxt), medium, mi.Color3f(1), mi.Bool(active), sampler
    )
    (end,) = dr.while_loop((start,), lambda s: s.active, step, label="a shadow ray through media")
    return end.passing, end.sampler


def _channel(colour: Any, number: Any) -> Any:
    return dr.select(number == 0, colour[0], dr.select(number == 1, colour[1], colour[2]))
