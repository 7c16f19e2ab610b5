"""Small scenes for the tests: one with everything, one that moves."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def everything(
    mi: Any, size: int = 24, medium: str = "", lens: bool = False, glossy: bool = True
) -> Any:
    """Glass, mirror, metal, plastic, an area light in view, an environment; fog and lens at wish.

    ``medium``: "", "homogeneous" or "heterogeneous".
    """
    transform = mi.ScalarTransform4f
    camera: dict[str, Any] = {
        "type": "thinlens" if lens else "perspective",
        "fov": 45,
        "to_world": transform().look_at([0, 2, 7], [0, 1.3, 0], [0, 1, 0]),
        "film": film(size),
    }
    if lens:
        camera.update(aperture_radius=0.1, focus_distance=7.0)
    scene = {
        "type": "scene",
        "sensor": camera,
        "sky": {"type": "constant", "radiance": 0.3},
        "lamp": {
            "type": "rectangle",
            "to_world": transform().translate([0, 3.2, -1]).rotate([1, 0, 0], 60),
            "light": {"type": "area", "radiance": colour(8, 7, 5)},
        },
        "floor": {
            "type": "rectangle",
            "to_world": transform().rotate([1, 0, 0], -90).scale(6),
            "bsdf": {"type": "principled", "base_color": colour(0.6, 0.4, 0.3), "roughness": 0.4},
        },
        "glass": {
            "type": "sphere",
            "center": [-1.5, 1, 1],
            "radius": 0.8,
            "bsdf": {"type": "dielectric"},
        },
        "box": {
            "type": "cube",
            "to_world": transform().translate([0, 0.5, 2]).scale(0.5),
            "bsdf": {"type": "roughplastic", "diffuse_reflectance": colour(0.1, 0.3, 0.6)},
        },
    }
    if glossy:
        scene["mirror"] = {
            "type": "sphere",
            "center": [1.5, 1, 0],
            "radius": 1,
            "bsdf": {"type": "conductor", "material": "Au"},
        }
    if medium:
        scene["fog"] = {
            "type": "cube",
            "to_world": transform().translate([0, 1.2, -1]),
            "bsdf": {"type": "null"},
            "interior": fog(mi, medium),
        }
    return mi.load_dict(scene)


def fog(mi: Any, kind: str) -> dict[str, Any]:
    """A medium inside the cube of `everything`."""
    albedo = colour(0.9, 0.8, 0.7)
    if kind == "homogeneous":
        phase = {"type": "hg", "g": 0.3}
        return {"type": kind, "albedo": albedo, "sigma_t": 0.7, "phase": phase}
    cells = np.random.default_rng(1).random((4, 4, 4, 1)).astype(np.float32)
    place = mi.ScalarTransform4f().translate([-1, 0.2, -2]).scale(2)
    return {
        "type": kind,
        "albedo": {"type": "constvolume", "value": albedo},
        "sigma_t": {"type": "gridvolume", "grid": mi.VolumeGrid(cells), "to_world": place},
        "scale": 2.0,
    }


def film(size: int, height: int | None = None) -> dict[str, Any]:
    """A box-filtered film."""
    return {
        "type": "hdrfilm",
        "width": size,
        "height": size if height is None else height,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
    }


def colour(r: float, g: float, b: float) -> dict[str, Any]:
    """An RGB value."""
    return {"type": "rgb", "value": [r, g, b]}


def noise_texture(mi: Any, seed: int, size: int = 32) -> dict[str, Any]:
    """A smooth random texture, different everywhere."""
    rng = np.random.default_rng(seed)
    image: NDArray[Any] = rng.random((size, size, 3)).astype(np.float32) * 0.8 + 0.1
    return {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True}


def moving(mi: Any, size: int = 96) -> Any:
    """A textured ball and a textured box before a textured wall."""
    transform = mi.ScalarTransform4f
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": transform().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]),
                "film": film(size),
            },
            "light": {"type": "constant"},
            "wall": {
                "type": "rectangle",
                "to_world": transform().translate([0, 0, -2]).scale(6),
                "bsdf": {"type": "diffuse", "reflectance": noise_texture(mi, 1)},
            },
            "ball": {
                "type": "sphere",
                "radius": 0.8,
                "center": [-0.8, 0.2, 0],
                "bsdf": {"type": "diffuse", "reflectance": noise_texture(mi, 2)},
            },
            "box": {
                "type": "cube",
                "to_world": transform().translate([1, -0.3, 0.5]).scale(0.5),
                "bsdf": {"type": "diffuse", "reflectance": noise_texture(mi, 3, 8)},
            },
        }
    )
