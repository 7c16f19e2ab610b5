"""A plan as a Mitsuba scene, padded to the fixed palette so that compiled kernels are shared.

Objects are made one after the other in a fixed order, because Dr.Jit numbers them as they come and
lays out its call tables by number. Some numbers are compiled in by Mitsuba: those of the lens are
set again through the parameters of the scene, as data; indices of refraction, the scale of a map
and the size of some textures are the same in all scenes, and analytic skies have two strengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lambent.scenes.mitsuba.geometry import Geometry, scale
from lambent.scenes.mitsuba.lamps import light_mesh
from lambent.scenes.mitsuba.metals import METALS
from lambent.scenes.mitsuba.palette import AREA, LIGHTS, SHAPES, TEXTURE
from lambent.scenes.mitsuba.plan import CameraPlan, EmitterPlan, ScenePlan, as_float32

#: A lens radius in metres that is as good as a pinhole.
_PINHOLE = 1e-5


def build(
    plan: ScenePlan, mi: Any, camera: int = 0, size: tuple[int, int] = (128, 128), time: int = 0
) -> Any:
    """The ``mi.Scene`` of ``plan`` with one sensor, a box filter, pictures of ``size`` (width,
    height).

    ``mi`` is the module with its variant set (`lambent.render.variant.mitsuba`). Raises
    `OptionError` for a camera or a frame that is not there.
    """
    plan.check_time(time)
    lens = plan.camera(camera)
    media = [_medium(mi, m) for m in plan.media]
    bsdfs = _bsdfs(plan, mi)
    scene: dict[str, Any] = {"type": "scene"}
    lit = {s.emitter: s for s in plan.shapes if s.emitter is not None}
    corner = np.min([s.at(time)[:3, 3] for s in plan.shapes], 0)
    speck = scale(1e-5)
    speck[:3, 3] = corner
    for kind, slots in LIGHTS.items():
        own = [i for i, e in enumerate(plan.emitters) if e.kind == kind]
        if len(own) > slots:
            raise AssertionError(f"{len(own)} emitters of kind {kind}")
        for slot in range(slots):
            emitter = plan.emitters[own[slot]] if slot < len(own) else None
            name = emitter.id if emitter else f"pad_{kind}_{slot}"
            light = mi.load_dict(_light(mi, kind, emitter, name), parallel=False)
            if kind not in AREA:
                scene[name] = light
                continue
            if emitter is None:
                mesh, bsdf, shape_name = _dummy(kind).moved(speck), bsdfs["diffuse"][-1], name
            else:
                shape = lit[own[slot]]
                mesh, shape_name = shape.geometry.moved(shape.at(time)), shape.id
                bsdf = bsdfs["by number"][shape.material]
            scene[shape_name] = _mesh(mi, shape_name, mesh, {"bsdf": bsdf, "emitter": light})
    plain = [s for s in plan.shapes if s.emitter is None]
    for shape in plain:
        extra = {"bsdf": bsdfs["by number"][shape.material]}
        if shape.medium is not None:
            extra["interior"] = media[shape.medium]
        scene[shape.id] = _mesh(mi, shape.id, shape.geometry.moved(shape.at(time)), extra)
    for k in range(-len(plain) % SHAPES):
        name = f"pad_shape_{k}"
        scene[name] = _mesh(mi, name, _dummy("panel").moved(speck), {"bsdf": bsdfs["diffuse"][-1]})
    # A scene keeps what it is given: dummies that no shape has live as long as it does.
    for structure, members in bsdfs.items():
        if structure != "by number":
            scene.update({f"{structure}_slot_{k}": bsdf for k, bsdf in enumerate(members)})
    scene["environment"] = mi.load_dict(_environment(plan, mi), parallel=False)
    scene["sensor"] = _sensor(mi, lens, size, time, media)
    result = mi.load_dict(scene, parallel=False)
    _set_lens(mi, result, lens)
    return result


def _set_lens(mi: Any, scene: Any, camera: CameraPlan) -> None:
    import drjit as dr

    parameters = mi.traverse(scene)
    parameters["sensor.aperture_radius"] = dr.opaque(mi.Float, camera.aperture_radius or _PINHOLE)
    parameters["sensor.focus_distance"] = dr.opaque(mi.Float, camera.focus_distance)
    parameters.update()


def _dummy(kind: str) -> Geometry:
    return light_mesh(kind, 1.0)


def _mesh(mi: Any, name: str, g: Geometry, extra: Mapping[str, Any]) -> Any:
    properties = mi.Properties()
    for key, value in extra.items():
        properties[key] = value
    mesh = mi.Mesh(
        name,
        vertex_count=len(g.positions),
        face_count=len(g.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = as_float32(g.positions)
    parameters["vertex_normals"] = as_float32(g.normals)
    parameters["vertex_texcoords"] = as_float32(g.uv)
    parameters["faces"] = np.ascontiguousarray(g.faces, np.uint32).reshape(-1)
    parameters.update()
    return mesh


def _sensor(
    mi: Any, camera: CameraPlan, size: tuple[int, int], time: int, media: list[Any]
) -> dict[str, Any]:
    sensor = {
        "type": "thinlens",
        "to_world": mi.ScalarTransform4f(camera.at(time)),
        "fov": camera.fov,
        "fov_axis": "larger",
        "near_clip": 0.01,
        "far_clip": 10000.0,
        "aperture_radius": _PINHOLE,
        "focus_distance": camera.focus_distance,
        "film": {
            "type": "hdrfilm",
            "width": size[0],
            "height": size[1],
            "pixel_format": "rgba",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }
    if camera.medium is not None:
        sensor["medium"] = media[camera.medium]
    return sensor


def _medium(mi: Any, medium: Any) -> Any:
    return mi.load_dict(
        {
            "type": "homogeneous",
            "albedo": {"type": "rgb", "value": list(medium.albedo)},
            "sigma_t": float(medium.sigma_t),
            "phase": {"type": "hg", "g": float(medium.g)},
        },
        parallel=False,
    )


# --- lights ----------------------------------------------------------------------------------


def _rgb(value: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in value]}


def _light(mi: Any, kind: str, emitter: EmitterPlan | None, name: str) -> dict[str, Any]:
    values: Mapping[str, Any] = emitter.values if emitter else {}
    chosen = {"id": name, "sampling_weight": 1.0 if emitter else 0.0}
    power = values.get("radiance", (0.0, 0.0, 0.0))
    if kind == "picture":
        image = _sized(values.get("image", np.zeros((1, 1, 3), np.uint8)))
        linear = (image.astype(np.float32) / 255) ** 2.2 * np.asarray(power, np.float32)
        texture = {"type": "bitmap", "bitmap": mi.Bitmap(linear), "raw": True}
        return {"type": "area", "radiance": texture, **chosen}
    if kind in AREA:
        return {"type": "area", "radiance": _rgb(power), **chosen}
    to_world = mi.ScalarTransform4f(values.get("to_world", np.eye(4)))
    light = {"to_world": to_world, "intensity": _rgb(power), **chosen}
    if kind == "spot":
        outer = float(values.get("cutoff", 30.0))
        return {"type": "spot", "cutoff_angle": outer, "beam_width": outer * 0.7, **light}
    return {"type": "point", **light}


def _environment(plan: ScenePlan, mi: Any) -> dict[str, Any]:
    own = [e for e in plan.emitters if e.kind in ("envmap", "sunsky")]
    if len(own) != 1:
        raise AssertionError("a plan has exactly one environment")
    values = own[0].values
    # Mitsuba's maps have y up: a quarter turn about x makes it z.
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    weight = float(values.get("weight", 1.0))
    if own[0].kind == "sunsky":
        return {
            "type": "sunsky",
            "id": own[0].id,
            "sun_direction": [float(v) for v in values["sun"]],
            "turbidity": float(values["turbidity"]),
            "albedo": float(values["albedo"]),
            "sun_scale": float(values["scale"]),
            "sky_scale": float(values["scale"]),
            "sampling_weight": weight,
        }
    # The plug-in's own scale would be compiled into the kernel.
    image = np.ascontiguousarray(values["image"] * np.float32(values["scale"]), np.float32)
    return {
        "type": "envmap",
        "id": own[0].id,
        "bitmap": mi.Bitmap(image),
        "to_world": upright,
        "sampling_weight": weight,
    }


# --- BSDFs -----------------------------------------------------------------------------------


def _bsdfs(plan: ScenePlan, mi: Any) -> dict[Any, Any]:
    """All slots of the palette: lists by structure, and by the plan's numbers."""
    numbered: dict[int, Any] = {}
    result: dict[Any, Any] = {"by number": numbered}
    for structure, slots in plan.slots.items():
        own = [i for i, m in enumerate(plan.materials) if m.structure == structure]
        if len(own) > slots:
            raise AssertionError(f"{len(own)} materials of structure {structure}")
        result[structure] = []
        for slot in range(slots):
            values = plan.materials[own[slot]].values if slot < len(own) else {}
            name = plan.materials[own[slot]].name if slot < len(own) else f"pad_{structure}_{slot}"
            bsdf = mi.load_dict({**_bsdf(mi, structure, values), "id": name}, parallel=False)
            result[structure].append(bsdf)
            if slot < len(own):
                numbered[own[slot]] = bsdf
    return result


def _texture(mi: Any, values: Mapping[str, Any], key: str, channels: int) -> dict[str, Any]:
    image = values.get(key)
    if image is None:
        image = np.full((4, 4, channels), 128, np.uint8)
    if image.shape[2] != channels:
        raise AssertionError(f"{key} has {image.shape[2]} channels, not {channels}")
    raw = channels == 1 or key == "normals"
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image)), "raw": raw}


def _sized(image: Any) -> Any:
    """A picture at the one size that plug-ins which compile in the size are given."""
    index = np.arange(TEXTURE) * len(image) // TEXTURE
    return np.ascontiguousarray(image[index][:, index])


def _heights(mi: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """A bump map. Its size and scale are compiled in: so one size, and the scale is in the map."""
    height = _sized(values.get("height", np.zeros((1, 1, 1), np.uint8)))
    image = height.astype(np.float32) * np.float32(values.get("strength", 0.01) / 255)
    return {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True}


def _principled(mi: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Flags of this plug-in are off where a value is exactly zero: hence the small ones."""

    def number(key: str, default: float) -> float:
        value = values.get(key, default)
        return max(float(value), 1e-4) if np.ndim(value) == 0 else default

    return {
        "type": "principled",
        "base_color": _texture(mi, values, "base_color", 3),
        "roughness": _texture(mi, values, "roughness", 1),
        "metallic": number("metallic", 0),
        "specular": number("specular", 0.5),
        "anisotropic": number("anisotropic", 0),
        "clearcoat": number("clearcoat", 0),
        "clearcoat_gloss": number("clearcoat_gloss", 0.9),
        "sheen": number("sheen", 0),
        "sheen_tint": number("sheen_tint", 0.5),
    }


def _conductor(values: Mapping[str, Any]) -> dict[str, Any]:
    eta, k = METALS[values.get("metal", "aluminium")]
    return {
        "eta": _rgb(eta),
        "k": _rgb(k),
        "specular_reflectance": _rgb(values.get("tint", (1, 1, 1))),
    }


def _two_sided(bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "twosided", "inner": bsdf}


def _bsdf(mi: Any, structure: str, values: Mapping[str, Any]) -> dict[str, Any]:
    def colour(key: str = "base_color") -> dict[str, Any]:
        return _texture(mi, values, key, 3)

    def number(key: str, default: float) -> float:
        return float(values.get(key, default))

    ior = {"int_ior": 1.33 if structure == "water" else 1.5, "ext_ior": 1.0}
    if structure == "principled":
        return _two_sided(_principled(mi, values))
    if structure == "bump":
        bump = {
            "type": "bumpmap",
            "texture": _heights(mi, values),
            "scale": 1.0,
            "inner": _principled(mi, values),
        }
        return _two_sided(bump)
    if structure in ("normalmap", "pbr"):
        normals = values.get("normals")
        if normals is None:
            normals = np.full((4, 4, 3), (128, 128, 255), np.uint8)
        inner = _principled(mi, values)
        if structure == "pbr":
            inner["metallic"] = _texture(mi, values, "metallic", 1)
        mapped = {
            "type": "normalmap",
            "normalmap": _texture(mi, {"normals": normals}, "normals", 3),
            "inner": inner,
        }
        return _two_sided(mapped)
    if structure == "diffuse":
        return _two_sided({"type": "diffuse", "reflectance": colour()})
    if structure in ("plastic", "roughplastic"):
        picture = _sized(values.get("base_color", np.zeros((1, 1, 3), np.uint8)))
        texture = _texture(mi, {"base_color": picture}, "base_color", 3)  # its mean is taken
        bsdf = {"type": structure, "diffuse_reflectance": texture, "nonlinear": True, **ior}
        if structure == "roughplastic":
            bsdf["alpha"] = number("alpha", 0.1)
        return _two_sided(bsdf)
    if structure == "conductor":
        return _two_sided({"type": "conductor", **_conductor(values)})
    if structure == "roughconductor":
        alpha = {"alpha_u": number("alpha_u", 0.1), "alpha_v": number("alpha_v", 0.1)}
        return _two_sided({"type": "roughconductor", **alpha, **_conductor(values)})
    if structure in ("dielectric", "water", "thindielectric", "roughdielectric"):
        bsdf = {"type": "dielectric" if structure == "water" else structure, **ior}
        bsdf["specular_transmittance"] = _rgb(values.get("tint", (1, 1, 1)))
        if structure == "roughdielectric":
            bsdf["alpha"] = number("alpha", 0.1)
        return bsdf
    if structure == "transmissive":
        return {
            "type": "principled",
            "base_color": colour(),
            "roughness": _texture(mi, values, "roughness", 1),
            "spec_trans": max(number("spec_trans", 0.9), 1e-4),
            "eta": 1.45,
        }
    if structure == "translucent":
        return {
            "type": "principledthin",
            "base_color": colour(),
            "roughness": number("rough", 0.6),
            "diff_trans": number("diff_trans", 1.0),
            "spec_trans": 1e-4,
            "eta": 1.4,
        }
    if structure == "cards":
        surface = _two_sided({"type": "diffuse", "reflectance": colour()})
        return {"type": "mask", "opacity": _texture(mi, values, "opacity", 1), "inner": surface}
    if structure == "blend":
        return _two_sided(
            {
                "type": "blendbsdf",
                "weight": _texture(mi, values, "weight", 1),
                "first": {
                    "type": "roughconductor",
                    "alpha": number("alpha", 0.2),
                    **_conductor(values),
                },
                "second": {"type": "diffuse", "reflectance": colour()},
            }
        )
    return {"type": "null"}
