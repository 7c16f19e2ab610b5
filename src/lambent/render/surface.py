"""What a surface looks like before light falls on it: albedos and roughness, without noise.

A denoiser wants features that do not depend on random numbers. Mitsuba's BSDFs tell a diffuse
reflectance and little else, so `describe` walks through a BSDF's own children (textures and nested
BSDFs) and states three things for the point that is seen:

``diffuse``   reflectance of the Lambertian part, ρ_d; what Bako et al. 2017 divide diffuse light by
``specular``  what the rest reflects or lets through at this angle: Fresnel reflectance of metals
              (complex index), Schlick's for the principled BSDF, 1 for smooth glass
``roughness`` in [0, 1], perceptual: the square root of a microfacet α, 1 for diffuse surfaces,
              0 for mirrors and clear glass

Wrappers (two-sided, mask, bump and normal map) are looked through, blends are blended. A class that
is not known here keeps its ``eval_diffuse_reflectance`` and is taken as rough without specular.
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
    """Albedos (colour, in [0, 1]) and roughness (in [0, 1]) of a point that is seen."""

    diffuse: Any
    specular: Any
    roughness: Any


def describe(bsdf: Any, si: Any, active: Any) -> Surface:
    """The surface at interaction ``si``; ``bsdf`` is a plain object, not a pointer array.

    Called once for each BSDF of the scene while a kernel is recorded (`drjit.dispatch`).
    """
    if bsdf is None:  # a scene without any surface
        return Surface(mi.Color3f(0), mi.Color3f(0), mi.Float(0))
    kind = bsdf.class_name()
    handler = _HANDLERS.get(kind)
    if handler is None:
        diffuse = _unit(bsdf.eval_diffuse_reflectance(si, active))
        return Surface(_colour(diffuse), mi.Color3f(0), mi.Float(1))
    return handler(bsdf, _children(bsdf), si, active)


# -------------------------------------------------------------------- leaves


def _smooth_diffuse(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    return Surface(_texture(parts["reflectance"], si, active), mi.Color3f(0), mi.Float(1))


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
    return Surface(mi.Color3f(0), _unit(specular), _alpha(parts, si, active))


def _plastic(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    eta = mi.Float(parts.get("eta", 1.5))
    reflected = mi.fresnel(dr.abs(si.wi.z), eta)[0]
    tint = parts.get("specular_reflectance")
    specular = mi.Color3f(reflected)
    if tint is not None:
        specular *= _texture(tint, si, active)
    diffuse = _texture(parts["diffuse_reflectance"], si, active)
    return Surface(diffuse, _unit(specular), _alpha(parts, si, active))


def _dielectric(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    return Surface(mi.Color3f(0), mi.Color3f(1), _alpha(parts, si, active))


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
    return Surface(diffuse, _unit(specular), rough)


# ------------------------------------------------------------------ wrappers


def _two_sided(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    front = parts["brdf_0"]
    back = parts.get("brdf_1", front)
    seen = describe(front, si, active)
    if back is front:
        return seen
    return _mixed(seen, describe(back, si, active), dr.select(si.wi.z > 0, 0.0, 1.0))


def _nested(bsdf: Any, parts: dict[str, Any], si: Any, active: Any) -> Surface:
    inner = next(part for name, part in parts.items() if "bsdf" in name)
    return describe(inner, si, active)


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
    "BumpMap": _nested,
    "NormalMap": _nested,
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


def _mixed(a: Surface, b: Surface, weight: Any) -> Surface:
    return Surface(
        dr.lerp(a.diffuse, b.diffuse, weight),
        dr.lerp(a.specular, b.specular, weight),
        dr.lerp(a.roughness, b.roughness, weight),
    )
