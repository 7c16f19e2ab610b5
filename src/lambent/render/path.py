"""One sample of a pixel: a path with everything a denoiser wants to know about it.

The estimator is the textbook's: paths from the camera, at every vertex one sample of the emitters
and one of the BSDF, joined by the power heuristic (Veach 1997, chapters 9 and 10), Russian roulette
after a few bounces. It uses the random numbers of Mitsuba's ``path`` in the same order and computes
the same radiance. Beside it we keep the books:

    first rough vertex   the first one whose BSDF is not purely specular; what is seen in mirrors and
                         through clear glass belongs to the pixel as much as what is seen directly
    emission             light that arrives there without any rough vertex
    diffuse              of the light scattered at the first rough vertex, the share
                         min(f, ρ_d cos θ / π) / f of the BSDF f: its Lambertian part. ρ_d is divided
                         out exactly (Bako et al. 2017), whatever the BSDF's own lobes are
    specular             the rest, emission included: colour = diffuse + specular
    direct               emission, and light that comes to the first rough vertex straight from an
                         emitter; indirect is the rest
    light groups         the same light by the group of the emitter that it left

Features (albedos, normal, depth, position, roughness) are those of the first rough vertex, or of the
last mirror where there is none; albedos carry the throughput up to there, depth is the length of
the way. Those of the very first hit are kept, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi

from lambent.kernels.extremes import greater, smaller
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
    light = s.throughput * emitted * _power(s.before_pdf, emitter_pdf)
    _book(s, light, s.share, s.through | s.fresh, s.through, emitter, options)

    goes_on = valid & (s.depth + 1 < options.depth)

    # ---------------------------------------------------- what the surface looks like
    bsdf = si.bsdf(s.ray)
    rough = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    looked_at = s.through & valid
    seen = _look(bsdf, si, looked_at, options)

    # --------------------------------------- one sample of the emitters, one of the BSDF
    at_emitter = goes_on & rough
    ds, emitted = scene.sample_emitter_direction(si, s.sampler.next_2d(), True, at_emitter)
    at_emitter &= ds.pdf != 0
    wo = si.to_local(ds.d)
    value, pdf, sampled, weight = bsdf.eval_pdf_sample(
        mi.BSDFContext(), si, wo, s.sampler.next_1d(), s.sampler.next_2d()
    )
    first_rough = s.through & rough
    weighed = emitted * dr.select(ds.delta, 1, _power(ds.pdf, pdf))
    light = dr.select(at_emitter, s.throughput * value * weighed, 0)
    if options.lighting:
        share = dr.select(first_rough, _diffuse_share(seen, si, wo, value), s.share)
        _book(s, light, share, first_rough, mi.Bool(False), ds.emitter, options)
        ahead = _diffuse_share(seen, si, sampled.wo, weight * sampled.pdf)
        specular = mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Delta)
        s.share = dr.select(first_rough, dr.select(specular, mi.Color3f(0), ahead), s.share)
    else:
        s.books.colour += light

    # --------------------------------------------------------------- features, alpha
    passed = goes_on & mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Null)
    s.length += dr.select(valid, si.t, 0)
    _note_features(s, seen, si, looked_at & ~passed, options)

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
        seen = _look(bsdf, si, looked_at, options)
        rough = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        sampled, weight = bsdf.sample(
            mi.BSDFContext(), si, s.sampler.next_1d(), s.sampler.next_2d()
        )
        passed = mi.has_flag(sampled.sampled_type, mi.BSDFFlags.Null)
        s.length += dr.select(looked_at, si.t, 0)
        _note_features(s, seen, si, looked_at & ~passed, options)
        s.throughput *= weight
        s.ray = si.spawn_ray(si.to_world(sampled.wo))
        s.depth = s.depth + 1
        s.active &= looked_at & (~rough | passed) & (s.depth < options.depth)
        return (s,)

    (state,) = dr.while_loop((state,), lambda s: s.active, step, label="way to a rough vertex")
    return state.books, state.sampler


# ------------------------------------------------------------------- the books


def _book(
    s: _State,
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


def _look(bsdf: Any, si: Any, active: Any, options: PathOptions) -> Surface:
    if not (options.features or options.lighting):
        return Surface(mi.Color3f(0), mi.Color3f(0), mi.Float(0))
    found: Surface = dr.dispatch(bsdf, describe, si, active)
    return found


def _diffuse_share(seen: Surface, si: Any, wo: Any, value: Any) -> Any:
    """Share of the Lambertian part ρ_d |cos θ| / π in ``value`` = f |cos θ|, each channel."""
    same_side = si.wi.z * wo.z > 0
    lambert = seen.diffuse * dr.select(same_side, dr.abs(wo.z) * dr.inv_pi, 0)
    return dr.select(value > lambert, lambert / value, dr.select(value > 0, 1.0, 0.0))


def _note_features(s: _State, seen: Surface, si: Any, here: Any, options: PathOptions) -> None:
    if not options.features:
        return
    books = s.books
    normal = dr.mulsign(si.sh_frame.n, dr.dot(si.sh_frame.n, -s.ray.d))
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
            "first_albedo": seen.diffuse + seen.specular,
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


def _power(a: Any, b: Any) -> Any:
    """Power heuristic with exponent 2 (Veach 1997, equation 9.14); 0 where both are."""
    a, b = dr.square(a), dr.square(b)
    weight = a / (a + b)
    return dr.select(dr.isfinite(weight), weight, 0)
