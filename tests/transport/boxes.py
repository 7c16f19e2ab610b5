"""Small scenes with known answers."""

import numpy as np

from lambent.render.variant import mitsuba

mi = mitsuba()  # before anything imports Dr.Jit: it finds LLVM

T = mi.ScalarTransform4f


def grey(value):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def walls(rho=0.5, radiance=None, extra=None):
    """A cube of edge 2 seen from within: normals go inwards."""
    box = {"type": "cube", "flip_normals": True, "bsdf": grey(rho)}
    if radiance is not None:
        box["light"] = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    scene = {"type": "scene", "box": box, "sensor": camera()}
    return {**scene, **(extra or {})}


def camera(size=32):
    return {
        "type": "perspective",
        "fov": 70,
        "to_world": T().look_at([0, 0, 0.95], [0, 0, -1], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
    }


def room(size=32):
    """Coloured walls, a lamp, and a block that stands off the floor and the walls."""
    scene = {"type": "scene", "sensor": camera(size)}
    sides = {
        "floor": ([1, 0, 0], -90, [0, -1, 0], 0.7),
        "ceiling": ([1, 0, 0], 90, [0, 1, 0], 0.7),
        "back": ([0, 1, 0], 0, [0, 0, -1], [0.7, 0.6, 0.5]),
        "front": ([0, 1, 0], 180, [0, 0, 1], 0.5),
        "left": ([0, 1, 0], 90, [-1, 0, 0], [0.6, 0.1, 0.1]),
        "right": ([0, 1, 0], -90, [1, 0, 0], [0.1, 0.6, 0.1]),
    }
    for name, (axis, angle, place, rho) in sides.items():
        scene[name] = {
            "type": "rectangle",
            "to_world": T().translate(place).rotate(axis, angle),
            "bsdf": grey(rho),
        }
    scene["lamp"] = {
        "type": "rectangle",
        "to_world": T().translate([0, 0.9, 0]).rotate([1, 0, 0], 90).scale(0.4),
        "bsdf": grey(0.0),
        "light": {"type": "area", "radiance": {"type": "rgb", "value": [8, 7, 5]}},
    }
    scene["block"] = {
        "type": "cube",
        "to_world": T().translate([0.2, -0.4, -0.3]).rotate([0, 1, 0], 30).scale(0.25),
        "bsdf": grey(0.6),
    }
    return scene


def square(height=0.0, side=1.0, shift=(0, 0)):
    """Corners of a square at z = height, counter-clockwise seen from above."""
    x, y = shift
    corners = [[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
    return np.array([[a, b, height] for a, b in corners], float)
