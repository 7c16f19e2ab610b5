"""A furnished room as a Mitsuba dictionary: an example that needs no files."""

from __future__ import annotations

from typing import Any

from lambent.render.variant import mitsuba


def furnished_room(size: tuple[int, int] = (256, 256)) -> dict[str, Any]:
    """A closed room of edge 2: coloured walls, a lamp, two blocks that stand off the floor."""
    transform = mitsuba().ScalarTransform4f

    def paint(value: Any) -> dict[str, Any]:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}

    walls = {
        "floor": ([1, 0, 0], -90, [0, -1, 0], [0.7, 0.68, 0.64]),
        "ceiling": ([1, 0, 0], 90, [0, 1, 0], [0.75, 0.75, 0.75]),
        "back": ([0, 1, 0], 0, [0, 0, -1], [0.7, 0.68, 0.64]),
        "front": ([0, 1, 0], 180, [0, 0, 1], [0.5, 0.5, 0.5]),
        "left": ([0, 1, 0], 90, [-1, 0, 0], [0.62, 0.12, 0.09]),
        "right": ([0, 1, 0], -90, [1, 0, 0], [0.14, 0.42, 0.12]),
    }
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 80,
            "to_world": transform().look_at([0, 0, 0.97], [0, -0.1, -1], [0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": size[0],
                "height": size[1],
                "rfilter": {"type": "box"},
            },
        },
        "lamp": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0.93, -0.1]).rotate([1, 0, 0], 90).scale(0.3),
            "bsdf": {"type": "twosided", "bsdf": paint(0.4)},
            "light": {"type": "area", "radiance": {"type": "rgb", "value": [17, 14, 10]}},
        },
        "tall": {
            "type": "cube",
            "to_world": transform().translate([-0.4, -0.35, -0.4]).rotate([0, 1, 0], 20)
            .scale([0.25, 0.6, 0.25]),
            "bsdf": paint([0.7, 0.7, 0.7]),
        },
        "low": {
            "type": "cube",
            "to_world": transform().translate([0.4, -0.68, 0.1]).rotate([0, 1, 0], -18)
            .scale([0.28, 0.28, 0.28]),
            "bsdf": paint([0.7, 0.7, 0.7]),
        },
    }  # fmt: skip
    for name, (axis, angle, place, colour) in walls.items():
        scene[name] = {
            "type": "rectangle",
            "to_world": transform().translate(place).rotate(axis, angle),
            "bsdf": paint(colour),
        }
    return scene
