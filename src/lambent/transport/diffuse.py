"""What a surface is to a world in which all reflection is diffuse.

Radiosity knows a reflectance ρ and an emitted radiosity E for each side of a surface. Both are read
off the scene's own materials: ρ(x) is what `lambent.render.surface` sees, the diffuse plus the
specular albedo at normal incidence, held to at most `HIGHEST`, and light that a glass would let
through counts as reflected. What is taken for something it is not is reported (`assumptions`).

A one-sided material reflects in front and is black behind; ``twosided`` ones have two sides. The
other sides of glass count as two-sided, too.

`DiffusePath` is a path tracer for this world: the reference that solutions are held against.
"""

from __future__ import annotations

from typing import Any

from lambent.kernels.extremes import greater, smaller
from lambent.render.surface import describe
from lambent.transport.jit import dr, mi
from lambent.transport.warps import cosine_hemisphere

#: With a reflectance of 1 all around, light would never end; more than this counts as this.
HIGHEST = 0.99
#: Materials that are diffuse already, possibly behind a wrapper.
_DIFFUSE = ("SmoothDiffuse", "TwoSidedBRDF", "BumpMap", "NormalMap")
#: Those that show something on both sides, alone or inside a wrapper (as they print themselves).
_TWO_SIDED = ("TwoSided", "SmoothDielectric", "ThinDielectric", "RoughDielectric", "PrincipledThin")


def assumptions(scene: Any, left_out: dict[str, int], degenerate: int) -> list[str]:
    """What the diffuse world takes for what, in a scene: a sentence each, for a person."""
    kinds: dict[str, int] = {}
    masks = maps = hulls = media = 0
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if bsdf is None:
            continue
        name = bsdf.class_name()
        text = str(bsdf)
        media += shape.interior_medium() is not None or shape.exterior_medium() is not None
        if name == "Null":
            hulls += 1
            continue
        masks += name == "MaskBSDF"
        maps += "BumpMap" in text or "NormalMap" in text
        inner = "SmoothDiffuse" in text and not _others(text)
        if name not in _DIFFUSE or not inner:
            shown = _others(text) or [name]
            for other in shown[:1]:
                kinds[other] = kinds.get(other, 0) + 1
    said: list[str] = []
    if kinds:
        listed = ", ".join(f"{name} ({n})" for name, n in sorted(kinds.items()))
        said.append(f"taken as diffuse with their albedo: {listed}")
    if masks:
        said.append(f"opacity masks are taken as solid: {masks} shapes")
    if maps:
        said.append(f"bump and normal maps are left out, their surfaces flat: {maps} shapes")
    if hulls:
        said.append(
            f"hulls without a surface are solid and black, and hide what is in them: {hulls}"
        )
    if media:
        said.append(f"participating media are left out: {media} shapes bound one")
    if left_out:
        listed = ", ".join(f"{name} ({n})" for name, n in sorted(left_out.items()))
        said.append(f"black, though they cast shadows: {listed}")
    if degenerate:
        said.append(f"{degenerate:,} triangles without an area were passed over")
    return said


def is_two_sided(shape: Any) -> bool:
    """Whether a shape reflects on both sides."""
    bsdf = shape.bsdf()
    if bsdf is None:
        return False
    if bsdf.class_name() == "BlendBSDF":
        return str(bsdf).count("TwoSided") >= 2 or "Dielectric" in str(bsdf)
    return any(kind in str(bsdf) for kind in _TWO_SIDED)


def reflectance(si: Any, active: Any) -> Any:
    """ρ at surface interactions (colour), seen from straight above the side that `si.wi` is on."""
    upright = dr.copy(si)
    upright.wi = mi.Vector3f(0, 0, dr.select(si.wi.z >= 0, mi.Float(1), mi.Float(-1)))
    seen = dr.dispatch(upright.shape.bsdf(), _describe, upright, active)
    return _capped(seen)


class DiffusePath(mi.SamplingIntegrator):  # type: ignore[misc]
    """A path tracer that takes every surface as diffuse: the same world, without patches.

    Next-event estimation at every vertex and cosine-weighted bounces; emitters that a bounce hits
    are counted by the vertex before, so only the camera sees them (``hide_emitters`` aside).
    Properties: ``max_depth`` (-1, endless).
    """

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        depth = int(props.get("max_depth", -1))
        self.depth = 2**31 - 1 if depth < 0 else depth

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> Any:
        """Radiance along rays."""
        result, throughput = mi.Color3f(0), mi.Color3f(1)
        ray = mi.Ray3f(ray)
        hit = mi.Bool(active)
        depth = mi.UInt32(0)
        going = mi.Bool(active)

        def step(
            result: Any, throughput: Any, ray: Any, depth: Any, going: Any, hit: Any, sampler: Any
        ) -> Any:
            si = scene.ray_intersect(ray, +mi.RayFlags.All, mi.Bool(False), going)
            first = depth == 0
            result += dr.select(first & going, si.emitter(scene).eval(si, going & first), 0)
            hit = dr.select(first, si.is_valid(), hit)
            going &= si.is_valid() & (depth + 1 < self.depth)
            rho = dr.select(lit_side(si), reflectance(si, going), 0)
            side = dr.sign(si.wi.z)
            ds, light = scene.sample_emitter_direction(si, sampler.next_2d(), True, going)
            cosine = greater(mi.Frame3f.cos_theta(si.to_local(ds.d)) * side, mi.Float(0))
            result += dr.select(
                going & (ds.pdf > 0), throughput * rho * dr.inv_pi * light * cosine, 0
            )
            wo = cosine_hemisphere(*sampler.next_2d())
            throughput = throughput * rho
            wo.z *= side
            ray = si.spawn_ray(si.to_world(wo))
            depth += 1
            most = greater(greater(throughput.x, throughput.y), throughput.z)
            survival = smaller(most, mi.Float(0.95))
            lucky = (depth < 6) | (sampler.next_1d() < survival)
            throughput = dr.select(depth < 6, throughput, throughput * dr.rcp(survival))
            going &= lucky & (most > 0)
            return result, throughput, ray, depth, going, hit, sampler

        state = dr.while_loop(
            (result, throughput, ray, depth, going, hit, sampler),
            lambda result, throughput, ray, depth, going, hit, sampler: going,
            step,
            label="vertices of a diffuse path",
        )
        return state[0], state[5], []

    def to_string(self) -> str:
        """For ``print``."""
        return f"DiffusePath[max_depth = {self.depth}]"


def lit_side(si: Any) -> Any:
    """Whether the side that is seen reflects at all: the front, or any of a two-sided material."""
    return (si.wi.z > 0) | dr.dispatch(si.shape, _two_sided_here, si)


# ------------------------------------------------------------------- private


def _two_sided_here(shape: Any, si: Any) -> Any:
    return mi.Bool(shape is not None and is_two_sided(shape))


def _describe(bsdf: Any, si: Any, active: Any) -> Any:
    seen = describe(bsdf, si, active)
    return seen.diffuse + seen.specular


def _capped(colour: Any) -> Any:
    return mi.Color3f(*[greater(smaller(c, mi.Float(HIGHEST)), mi.Float(0)) for c in colour])


def _others(text: str) -> list[str]:
    """Reflecting materials other than the diffuse one in a BSDF's description."""
    known = (
        "SmoothConductor", "RoughConductor", "SmoothPlastic", "RoughPlastic", "SmoothDielectric",
        "ThinDielectric", "RoughDielectric", "PrincipledThin", "Principled", "Hair", "MeasuredBSDF",
        "MeasuredPolarized", "PolarizedPlastic", "BlendBSDF",
    )  # fmt: skip
    return [name for name in known if name in text]


mi.register_integrator("lambent_diffuse", lambda props: DiffusePath(props))
