"""Motion vectors: where the point that a pixel shows was one frame ago.

Rigidly moving shapes have two transforms, T now and T' one frame ago. A point p that a pixel sees
was at p' = T' T⁻¹ p, and the previous camera projected it to a pixel; motion is that pixel minus
the one where the camera of now projects p. So it is added to a pixel of this frame to land on the
same point in the previous one (x right, y down). Where nothing is hit the background moves as at
infinity. What is seen in a mirror moves with the mirror.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError

#: How far the background is, in scene units.
_FAR = 1e7


@dataclass(frozen=True)
class Motion:
    """World to pixel coordinates of the crop, now and one frame ago, and what moved.

    ``now``, ``previous``: 4x4 matrices to homogeneous coordinates in [0, 1] of the crop window.
    ``moved``: rows of T' T⁻¹ (12 numbers a shape) by registry index, or None if nothing moved.
    """

    now: Any
    previous: Any
    #: Where the previous camera stood (`Point3f`).
    stood: Any
    moved: Any = None


def projection(sensor: Any) -> NDArray[np.float64]:
    """World to crop coordinates in [0, 1] of a perspective sensor, 4x4.

    Raises `OptionError` for sensors without a pinhole projection.
    """
    params = mi.traverse(sensor)
    if "x_fov" not in params or "to_world" not in params:
        raise OptionError(
            f"motion vectors need a perspective camera, not {sensor.class_name()}",
            remedy="leave out the feature 'motion'",
        )
    film = sensor.film()
    fov = np.array(params["x_fov"]).ravel()[0]
    clip = mi.perspective_projection(
        mi.ScalarVector2i(film.size()),
        mi.ScalarVector2i(film.crop_size()),
        mi.ScalarVector2i(film.crop_offset()),
        float(fov),
        float(sensor.near_clip()),
        float(sensor.far_clip()),
    )
    to_world = np.array(params["to_world"].matrix, np.float64).reshape(4, 4)
    camera = np.array(clip.matrix, np.float64).reshape(4, 4)
    shift = np.eye(4)
    for axis, name in enumerate(("principal_point_offset_x", "principal_point_offset_y")):
        if name in params:
            shift[axis, 3] = float(np.array(params[name]).ravel()[0])
    return shift @ camera @ np.linalg.inv(to_world)


def moved_table(scene: Any, moves: Mapping[str, NDArray[Any]]) -> Any:
    """The table for `Motion.moved` from ``{shape id: T' T⁻¹}`` (4x4); None if there is none."""
    if not moves:
        return None
    shapes = scene.shapes()
    pointers = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
    table = np.tile(np.eye(4)[:3].ravel(), (int(pointers.max()) + 1, 1))
    for pointer, shape in zip(pointers, shapes, strict=True):
        if shape.id() in moves:
            table[pointer] = np.asarray(moves[shape.id()], np.float64)[:3].ravel()
    return mi.Float(table.astype(np.float32).ravel())


def motion_between(
    scene: Any,
    now: NDArray[Any],
    previous: NDArray[Any],
    stood: NDArray[Any],
    moves: Mapping[str, NDArray[Any]],
) -> Motion:
    """`Motion` from two projections (see `projection`), the previous camera's place, what moved."""
    return Motion(
        _opaque(now),
        _opaque(previous),
        dr.opaque(mi.Float, 0) + mi.Point3f(np.asarray(stood, np.float32)),
        moved_table(scene, moves),
    )


def _opaque(matrix: NDArray[Any]) -> Any:
    """Numbers as data of the kernel, not as its code: the next frame is the same kernel."""
    made = mi.Matrix4f(np.asarray(matrix, np.float32))
    dr.make_opaque(made)
    return made


def pixel_motion(motion: Motion, books: Any, ray: Any, size: Any) -> tuple[Any, Any]:
    """Motion of one sample in pixels (`Vector2f`), from the first hit in its books.

    Beside it how far from the previous camera the point was (`Float`; 0 where nothing is hit):
    what the previous picture shows there, if it shows the same point, has that depth.
    """
    hit = books.first_depth > 0
    here = dr.select(hit, books.first_position, ray.o + ray.d * _FAR)
    there = mi.Point3f(here)
    if motion.moved is not None:
        row = [
            dr.gather(mi.Float, motion.moved, books.first_shape * 12 + k, hit) for k in range(12)
        ]
        x, y, z = here
        moved = [
            row[4 * r] * x + row[4 * r + 1] * y + row[4 * r + 2] * z + row[4 * r + 3]
            for r in range(3)
        ]
        there = dr.select(hit, mi.Point3f(*moved), there)
    step = _project(motion.previous, there) - _project(motion.now, here)
    depth = dr.select(hit, dr.norm(there - motion.stood), 0)
    return mi.Vector2f(step.x * size.x, step.y * size.y), depth


def _project(matrix: Any, point: Any) -> Any:
    p = matrix @ mi.Vector4f(point.x, point.y, point.z, 1)
    # Behind the camera there is no pixel: the division is kept from zero, sign and all.
    w = dr.select(dr.abs(p.w) > 1e-6, p.w, 1e-6)
    return mi.Point2f(p.x / w, p.y / w)
