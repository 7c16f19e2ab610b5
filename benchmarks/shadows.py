"""Renders a soft shadow with the distances that axis-aligned filtering needs.

    python benchmarks/shadows.py [--spp 4,16,64] [--reference-spp 1024] [--cache DIR]

No renderer writes the distances by itself (see `lambent.filters.aaf`), so this scene of our own
(CC0) does: a vase and a wire dodecahedron under one square light whose half width is one scene
unit, direct light only. Frames are those of ``benchmarks/frames.py`` with three layers more:
``light_distance``, ``occluder_min``, ``occluder_max``, measured from the light along as many shadow
rays as there are samples; 0 where none was blocked.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import frames

NAME = "soft-shadow"
SIZE = (480, 300)
#: The far end of a shadow ray, as a part of its length, that does not count as blocked.
END = 1e-3


def scene(mi: Any) -> dict[str, Any]:
    """The scene for ``mitsuba.load_dict``."""
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples" / "still_life"))
    import make_scene as still
    from shapes import dodecahedron, smooth_profile, turned

    light = still.panel(mi, (-2.5, 7, 1), (2.5, -7, -1), (2, 2), still.matte(still.colour(0, 0, 0)))
    light["emitter"] = {"type": "area", "radiance": still.colour(34, 31, 26)}
    grey = still.matte(still.colour(0.62, 0.6, 0.56))
    view = mi.ScalarTransform4f().look_at(
        origin=[0.2, 4.8, 10.5], target=[0.4, 1.25, 0], up=[0, 1, 0]
    )
    things: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": view,
            "film": {
                "type": "hdrfilm",
                "width": SIZE[0],
                "height": SIZE[1],
                "rfilter": {"type": "box"},
            },
        },
        "floor": still.panel(mi, (0, 0, 0), (0, 1, 0), (30, 30), grey, (0, 0, -1)),
        "light": light,
    }
    profile = smooth_profile(
        [(0.5, 0), (0.55, 0.1), (0.8, 0.7), (1.0, 1.3), (0.8, 2.0), (0.4, 2.6), (0.55, 3.0)]
    )
    clay = still.matte(still.colour(0.55, 0.22, 0.12))
    things["vase"] = still.mesh(mi, "vase", turned(profile, 192, 24, 0.07), clay, (-1.9, 0, -0.3))
    corners, edges = dodecahedron()
    corners = corners * 1.25
    corners = corners + np.array([1.6, 0.09 - corners[:, 1].min(), 0.4])
    blue = still.matte(still.colour(0.10, 0.22, 0.42))
    for k, (i, j) in enumerate(edges):
        things[f"rod{k}"] = still.rod(corners[i], corners[j], 0.07, blue)
    return things


def distances(mi: Any, built: Any, spp: int, seed: int) -> list[NDArray[np.float32]]:
    """Light distance (mean), and least and greatest occluder distance ``(H, W, 1)``."""
    import drjit as dr

    sensor = built.sensors()[0]
    width, height = (int(v) for v in sensor.film().size())
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, width * height)
    pixel = dr.arange(mi.UInt32, width * height)
    y = pixel // width
    corner = mi.Point2f(mi.Float(pixel - y * width), mi.Float(y))

    def step(i: Any, sampler: Any, light: Any, least: Any, most: Any) -> tuple[Any, ...]:
        at = (corner + sampler.next_2d()) / mi.ScalarVector2f(width, height)
        ray, _ = sensor.sample_ray(mi.Float(0), sampler.next_1d(), at, sampler.next_2d())
        hit = built.ray_intersect(ray)
        found, _ = built.sample_emitter_direction(hit, sampler.next_2d(), False, hit.is_valid())
        far = found.dist
        there = built.ray_intersect(hit.spawn_ray_to(found.p), hit.is_valid())
        blocked = hit.is_valid() & there.is_valid() & (there.t < far * (1 - END))
        back = mi.Ray3f(found.p - found.d * far * END, -found.d)
        near = built.ray_intersect(back, blocked).t + far * END
        least = dr.select(blocked & (near < least), near, least)
        last = far - there.t
        most = dr.select(blocked & (last > most), last, most)
        return i + 1, sampler, light + dr.select(hit.is_valid(), far / spp, 0), least, most

    start = (mi.UInt32(0), sampler, mi.Float(0), mi.Float(dr.inf), mi.Float(0))
    _, _, light, least, most = dr.while_loop(start, lambda i, *_: i < spp, step)
    least = dr.select(least < dr.inf, least, 0)
    return [np.array(v, np.float32).reshape(height, width, 1) for v in (light, least, most)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spp", default="4,16,64")
    parser.add_argument("--reference-spp", type=int, default=1024)
    parser.add_argument("--cache", type=Path, default=frames.default_cache())
    arguments = parser.parse_args()
    mi = frames.start_mitsuba()
    built = mi.load_dict(scene(mi))
    for spp in (int(v) for v in arguments.spp.split(",") if v):
        layers = frames.noisy_layers(frames.noisy(built, spp))
        names = ("light_distance", "occluder_min", "occluder_max")
        for name, image in zip(names, distances(mi, built, spp, spp), strict=True):
            layers[name] = "Y", image
        frames.write_exr(arguments.cache / f"{NAME}-{spp}spp.exr", layers, spp=spp)
    checkpoint = arguments.cache / f"{NAME}-reference.npz"
    found = frames.reference(built, arguments.reference_spp, checkpoint)
    frames.write_reference(arguments.cache / f"{NAME}-reference.exr", found)


if __name__ == "__main__":
    main()
