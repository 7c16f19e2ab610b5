"""What a surface looks like before light falls on it: albedos, roughness, normal, without noise.

A denoiser wants features that do not depend on random numbers. Mitsuba's BSDFs tell a diffuse
reflectance and little else, so `describe` walks through a BSDF's own children (textures and nested
BSDFs) and states four things for the point that is seen:

``diffuse``   reflectance of the Lambertian part, ρ_d; what Bako et al. 2017 divide diffuse light by
``specular``  what the rest reflects or lets through at this angle: Fresnel reflectance of metals
              (complex index), Schlick's for the principled BSDF, 1 for smooth glass
``roughness`` in [0, 1], perceptual: the square root of a microfacet α, 1 for diffuse surfaces,
              0 for mirrors and clear glass
``normal``    the one that the BSDF shades with, in the frame of the interpolated vertex normal

Wrappers (two-sided, mask, bump and normal map) are looked through, blends are blended. A class that
is not known here keeps its ``eval_diffuse_reflectance`` and is taken as rough without specular.

Bump and normal maps turn the shading frame before the BSDF inside them is asked. Mitsuba tells the
turned frame to C++ alone, and not through wrappers, so it is built here as Mitsuba 3.9 does, with
``flip_invalid_normals`` at its default: a normal that faces away from the viewer is turned about
the unperturbed one.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from lambent.kernels.extremes import greater, smaller


@dataclass
class Surface:
    """Albedos (colour, in [0, 1]), roughness (in [0, 1]) and normal of a point that is seen.

    ``normal``: unit length, in the coordinates of ``si.sh_frame`` of the interaction described,
    on either side; (0, 0, 1) unless a map or a two-sided material turns it.
    """

    diffuse: Any
    specular: Any
    roughness: Any
    normal: Any


def describe(bsdf: Any, si: Any, active: Any) -> Surface:
    """The surface at interaction ``si``; ``bsdf`` is a plain object, not a pointer array.

    Called once for each BSDF of the scene while a kernel is recorded (`drjit.dispatch`).
    """
    if bsdf is None:  # a scene without any surface
        return _plain(mi.Color3f(0), mi.Color3f(0), mi.Float(0))
    kind = bsdf.class_name()
    handler = _HANDLERS.get(kind)
    if handler is None:
        diffuse = _unit(bsdf.eval_diffuse_reflectance(si, active))
        return _plain(_colour(diffuse), mi.Color3f(0), mi.Float(1))
    return handler(bsdf, _children(bsdf), si, active)


# -------------------------------------------------------------------- leaves


def _smooth_diffuse(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    return _plain(_texture(parts["reflectance"], si, active), mi.Color3f(0), mi.Float(1))


def _conductor(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    tint = parts.get("specular_reflectance")
    eta, k = (_unbounded(parts[name], si, active) for name in ("eta", "k"))
    cosine = dr.abs(si.wi.z)
    index = dr.ones(mi.Complex2f)
    specular = mi.Color3f(0)
    for channel in range(3):
        index = mi.Complex2f(eta[channel], k[channel])
        specular[channel] = mi.fresnel_conductor(cosine, index)
    if tint is not None:
        specular *= _texture(tint, si, active)
    return _plain(mi.Color3f(0), _unit(specular), _alpha(parts, si, active))


def _plastic(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    eta = mi.Float(parts.get("eta", 1.5))
    reflected = mi.fresnel(dr.abs(si.wi.z), eta)[0]
    tint = parts.get("specular_reflectance")
    specular = mi.Color3f(reflected)
    if tint is not None:
        specular *= _texture(tint, si, active)
    diffuse = _texture(parts["diffuse_reflectance"], si, active)
    return _plain(diffuse, _unit(specular), _alpha(parts, si, active))


def _dielectric(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    return _plain(mi.Color3f(0), mi.Color3f(1), _alpha(parts, si, active))


def _principled(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    base = _texture(parts["base_color"], si, active)
    metallic, through, rough = (
        _unit(_texture_1(parts[name], si, active)) if name in parts else mi.Float(0)
        for name in ("metallic", "spec_trans", "roughness")
    )
    if "specular" in parts:
        f0 = 0.08 * mi.Float(parts["specular"])
    else:
        eta = _texture_1(parts["eta"], si, active) if "eta" in parts else mi.Float(1.5)
        f0 = dr.square((eta - 1) / (eta + 1))
    schlick = (1 - dr.abs(si.wi.z)) ** 5
    normal_incidence = dr.lerp(mi.Color3f(f0), base, metallic)
    reflected = normal_incidence + (1 - normal_incidence) * schlick * (1 - rough)
    lost = (1 - metallic) * (1 - f0)
    diffuse = base * ((1 - metallic) * (1 - through))
    specular = reflected + dr.sqrt(base) * (lost * through)
    return _plain(diffuse, _unit(specular), rough)


# ------------------------------------------------------------------ wrappers


def _two_sided(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    front = parts["brdf_0"]
    back = parts.get("brdf_1", front)
    # The side that is away is the mirror image of the front: the viewer is put in front of it.
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
    seen = describe(front, upright, active)
    if back is not front:
        behind = describe(back, upright, active)
        seen = _mixed(seen, behind, dr.select(si.wi.z > 0, 0.0, 1.0))
    seen.normal.z = dr.mulsign(seen.normal.z, si.wi.z)
    return seen


def _nested(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    return describe(_inner(parts), si, active)


def _bump_map(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    """The normal of the surface displaced by the texture: its tangents, tilted by the slope."""
    slope = mi.Float(parts["scale"]) * parts["nested_texture"].eval_1_grad(si, active)
    up = si.sh_frame.n
    along_u = dr.fma(up, slope.x - dr.dot(up, si.dp_du), si.dp_du)
    along_v = dr.fma(up, slope.y - dr.dot(up, si.dp_dv), si.dp_dv)
    normal = dr.cross(along_u, along_v)
    normal = dr.mulsign(normal, dr.dot(si.n, normal))
    # The tangent is not brought into local coordinates: no more does Mitsuba 3.9.
    return _turned(parts, si.to_local(normal), si.dp_du, si, active)


def _normal_map(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    local = dr.fma(mi.Vector3f(parts["normalmap"].eval_3(si, active)), 2, -1)
    return _turned(parts, local, mi.Vector3f(1, 0, 0), si, active)


def _turned(parts: dict[str, Any], normal: Any, tangent: Any, si: Any, active: Any) -> Surface:
    """What is inside a map, in a shading frame about ``normal`` (of any length, in that of ``si``).

    A normal that faces away from the viewer is turned about the plain one. One that is nought or
    not finite, as of an empty texel, is the plain one.
    """
    away = si.wi.z * dr.dot(si.wi, normal) <= 0
    normal = dr.select(away, mi.Vector3f(-normal.x, -normal.y, normal.z), mi.Vector3f(normal))
    normal = _unit_length(normal, mi.Vector3f(0, 0, 1))
    s = _unit_length(dr.fma(-normal, dr.dot(normal, tangent), tangent), mi.Vector3f(1, 0, 0))
    frame = mi.Frame3f(s, dr.cross(normal, s), normal)
    inside = mi.SurfaceInteraction3f(si)
    inside.sh_frame = mi.Frame3f(si.to_world(frame.s), si.to_world(frame.t), si.to_world(frame.n))
    inside.wi = frame.to_local(si.wi)
    seen = describe(_inner(parts), inside, active)
    seen.normal = frame.to_world(seen.normal)
    return seen


def _unit_length(vector: Any, otherwise: Any) -> Any:
    """The vector made a unit vector, where that can be done."""
    scale = dr.rsqrt(dr.squared_norm(vector))
    return dr.select((scale > 0) & dr.isfinite(scale), vector * scale, otherwise)


def _inner(parts: dict[str, Any]) -> Any:
    return next(part for name, part in parts.items() if "bsdf" in name)


def _blend(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    first, second = (describe(parts[name], si, active) for name in ("bsdf_0", "bsdf_1"))
    return _mixed(first, second, _unit(_texture_1(parts["weight"], si, active)))


_HANDLERS = {
    "SmoothDiffuse": _smooth_diffuse,
    "SmoothConductor": _conductor,
    "RoughConductor": _conductor,
    "SmoothPlastic": _plastic,
    "RoughPlastic": _plastic,
    "SmoothDielectric": _dielectric,
    "ThinDielectric": _dielectric,
    "RoughDielectric": _dielectric,
    "Principled": _principled,
    "PrincipledThin": _principled,
    "TwoSidedBRDF": _two_sided,
    "MaskBSDF": _nested,
    "BumpMap": _bump_map,
    "NormalMap": _normal_map,
    "BlendBSDF": _blend,
}


# ------------------------------------------------------------------- private


@functools.cache
def _collector() -> Any:
    """The class of a collector; Mitsuba's base classes exist once a variant is set."""

    class Parts(mi.TraversalCallback):  # type: ignore[misc]
        """Collects what a Mitsuba object tells of itself: one level, values and objects."""

        def __init__(self, thing: Any) -> None:
            super().__init__()
            self.thing = thing
            self.found: dict[str, Any] = {}

        def put(self, name: str, value: Any, flags: Any, cpptype: Any = None) -> None:
            """A texture, a nested BSDF, or a number (as a typed pointer)."""
            if not isinstance(value, mi.Object):
                value = mi.get_property(value, cpptype, self.thing)
            self.found[name] = value

    return Parts


def _children(thing: Any) -> dict[str, Any]:
    parts = _collector()(thing)
    thing.traverse(parts)
    return parts.found


def _unit(value: Any) -> Any:
    """Into [0, 1], without LLVM's fmaximum (see `lambent.kernels.extremes`)."""
    return greater(smaller(value, type(value)(1)), type(value)(0))


def _texture(part: Any, si: Any, active: Any) -> Any:
    return _unit(_unbounded(part, si, active))


def _unbounded(part: Any, si: Any, active: Any) -> Any:
    return _colour(part.eval(si, active)) if hasattr(part, "eval") else mi.Color3f(part)


def _texture_1(part: Any, si: Any, active: Any) -> Any:
    return part.eval_1(si, active) if hasattr(part, "eval_1") else mi.Float(part)


def _alpha(parts: dict[str, Any], si: Any, active: Any) -> Any:
    if "alpha" in parts:
        return dr.sqrt(_unit(_texture_1(parts["alpha"], si, active)))
    if "alpha_u" in parts:
        u, v = (_texture_1(parts[name], si, active) for name in ("alpha_u", "alpha_v"))
        return dr.sqrt(_unit((u + v) / 2))
    return mi.Float(0)


def _colour(value: Any) -> Any:
    return mi.Color3f(value[0], value[1], value[2]) if len(value) == 3 else mi.Color3f(value[0])


def _plain(diffuse: Any, specular: Any, roughness: Any) -> Surface:
    """A surface whose normal is the interpolated one."""
    return Surface(diffuse, specular, roughness, mi.Vector3f(0, 0, 1))


def _mixed(a: Surface, b: Surface, weight: Any) -> Surface:
    normal = dr.lerp(a.normal, b.normal, weight)
    return Surface(
        dr.lerp(a.diffuse, b.diffuse, weight),
        dr.lerp(a.specular, b.specular, weight),
        dr.lerp(a.roughness, b.roughness, weight),
        _unit_length(normal, mi.Vector3f(0, 0, 1)),
    )
