"""Animation: a camera path and moving shapes, from keyframes or from a function.

A frame's `Pose` is where things are: the camera's ``to_world``, its field of view, and for shapes
that move a transform of world space, applied to the place the scene file gives them. An animation
is any function ``frame -> Pose``. `Keyframes` is one made of a TOML file::

    frames = [1, 48]                          # first and last

    [camera]
    at = [1, 24, 48]                          # keyframes
    origin = [[0, 1, 5], [2, 1, 4], [3, 1, 2]]
    target = [[0, 1, 0]]                      # one value: the same everywhere
    fov = [45, 45, 35]                        # degrees, across the picture

    [[object]]
    shape = "ball*"                           # ids of shapes; * stands for anything
    at = [1, 48]
    translate = [[0, 0, 0], [1, 0, 0]]
    axis = [0, 1, 0]
    angle = [0, 180]                          # degrees, around the axis through the pivot
    pivot = [0, 0, 0]

Between keyframes values go smoothly (cubic Hermite, slopes as Catmull and Rom 1974, flat at both
ends) or with ``interpolation = "linear"`` in straight lines.

Motion vectors follow from the poses of a frame and of the one before (`lambent.render.motion`).
"""

from __future__ import annotations

import fnmatch
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError, UnknownNameError
from lambent.frame.frame import Frame
from lambent.frame.role import Role
from lambent.settings import fits, read_toml, shortened

if TYPE_CHECKING:
    from lambent.render.motion import Motion

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """Where things are in one frame. ``camera``: 4x4, looks along +z, y up; None as in the scene.

    ``fov``: degrees across the picture, or None. ``shapes``: id or pattern -> 4x4 in world space.
    """

    camera: Matrix | None = None
    fov: float | None = None
    shapes: Mapping[str, Matrix] = field(default_factory=dict)


Animation = Callable[[float], Pose]


@dataclass(frozen=True, eq=False)
class Keyframes:
    """An animation from a table of keyframes; see the module for its form."""

    table: Mapping[str, Any]
    path: Path | None = None

    def __call__(self, frame: float) -> Pose:
        """The pose in a frame; before the first key and after the last nothing moves."""
        camera, fov = None, None
        section = self.table.get("camera")
        if section is not None:
            fov_values = self._value(section, "camera", "fov", frame)
            fov = None if fov_values is None else float(fov_values)
            origin = self._value(section, "camera", "origin", frame)
            if origin is not None:
                target = self._value(section, "camera", "target", frame)
                up = self._value(section, "camera", "up", frame)
                camera = look_at(origin, target, (0, 1, 0) if up is None else up)
        shapes = {}
        for number, moving in enumerate(self.table.get("object", [])):
            name = f"object {number + 1}"
            shapes[moving["shape"]] = self._transform(moving, name, frame)
        return Pose(camera, fov, shapes)

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames that the file speaks of, first to last."""
        first, last = self.table["frames"]
        return tuple(range(int(first), int(last) + 1))

    def _transform(self, moving: Mapping[str, Any], name: str, frame: float) -> Matrix:
        pivot = self._value(moving, name, "pivot", frame)
        pivot = np.zeros(3) if pivot is None else pivot
        matrix = _translation(-pivot)
        scale = self._value(moving, name, "scale", frame)
        if scale is not None:
            matrix = np.diag([*np.broadcast_to(scale, 3), 1.0]) @ matrix
        angle = self._value(moving, name, "angle", frame)
        if angle is not None:
            axis = self._value(moving, name, "axis", frame)
            matrix = _rotation(np.array((0, 1, 0)) if axis is None else axis, float(angle)) @ matrix
        shift = self._value(moving, name, "translate", frame)
        return _translation(pivot + (0 if shift is None else shift)) @ matrix

    def _value(self, section: Mapping[str, Any], name: str, key: str, frame: float) -> Any:
        if key not in section:
            return None
        at = np.atleast_1d(np.asarray(section.get("at", [self.table["frames"][0]]), float))
        values = np.asarray(section[key], float)
        single = {"fov": 0, "angle": 0}.get(key, 1)
        if values.ndim < single:  # scale = 2
            values = values[None]
        if values.ndim == single:
            values = values[None]
        if len(values) == 1:
            return values[0]
        if len(values) != len(at):
            raise OptionError(
                f"[{name}] has {len(at)} keyframes and {len(values)} values of '{key}'",
                file=self.path,
                remedy="give one value a keyframe, or one for all",
            )
        return _between(at, values, frame, section.get("interpolation", "smooth") == "linear")


_KEYS = {
    "": {"frames", "camera", "object"},
    "camera": {"at", "origin", "target", "up", "fov", "interpolation"},
    "object": {"shape", "at", "translate", "axis", "angle", "scale", "pivot", "interpolation"},
}


#: Key -> numbers of one value (0: a number by itself), and what they are.
_VALUES = {
    "origin": (3, "a point [x, y, z]"),
    "target": (3, "a point [x, y, z]"),
    "up": (3, "a direction [x, y, z]"),
    "fov": (0, "degrees between 0 and 180"),
    "translate": (3, "a shift [x, y, z]"),
    "axis": (3, "a direction [x, y, z]"),
    "angle": (0, "degrees"),
    "scale": (3, "a factor that is not 0, or three"),
    "pivot": (3, "a point [x, y, z]"),
}
#: Frames that a file may speak of.
_MOST_FRAMES = 1_000_000


def read_keyframes(path: str | Path) -> Keyframes:
    """The animation in a TOML file. Raises `FileError`, `OptionError`, `UnknownNameError`."""
    path = Path(path)
    table = read_toml(path, "file of keyframes")
    _check_sections(table, path)
    frames = table.get("frames")
    if not (
        isinstance(frames, list)
        and fits(frames, list[int])
        and len(frames) == 2
        and frames[0] <= frames[1]
    ):
        raise OptionError("needs frames = [first, last]", file=path, remedy="frames = [1, 48]")
    if frames[1] - frames[0] >= _MOST_FRAMES or max(map(abs, frames)) > 10**9:
        raise OptionError(
            f"frames = {shortened(frames)} are more than {_MOST_FRAMES:,}",
            file=path,
            remedy="name fewer",
        )
    camera = table.get("camera", {})
    _check_section(camera, "camera", path)
    for number, moving in enumerate(table.get("object", []), 1):
        if not isinstance(moving.get("shape"), str):
            raise OptionError("an [[object]] has no 'shape'", file=path, remedy='shape = "ball"')
        _check_section(moving, f"object {number}", path)
    if ("origin" in camera) != ("target" in camera):
        raise OptionError(
            "[camera] needs both origin and target", file=path, remedy="add the other"
        )
    return Keyframes(table, path)


def _check_sections(table: dict[str, Any], path: Path) -> None:
    """Whether the file has the sections and keys that there are, each in its form."""
    camera, objects = table.get("camera", {}), table.get("object", [])
    if not isinstance(camera, dict) or not fits(objects, list[dict[str, Any]]):
        raise OptionError(
            "has a section in another form", file=path, remedy="write [camera] and [[object]]"
        )
    for name, section in [("", table), ("camera", camera), *(("object", o) for o in objects)]:
        for key in section:
            if key not in _KEYS[name]:
                raise UnknownNameError(f"key in [{name or 'file'}]", key, _KEYS[name], file=path)


def _check_section(section: dict[str, Any], name: str, path: Path) -> None:
    """Whether the values of a section are numbers in the shape that their keys want."""
    if section.get("interpolation", "smooth") not in ("smooth", "linear"):
        known = ("smooth", "linear")
        raise UnknownNameError("interpolation", str(section["interpolation"]), known, file=path)
    at = section.get("at", 0.0)
    times = at if isinstance(at, list) else [at]
    if not times or not fits(times, list[float]) or max(map(abs, times)) > 1e9:
        raise OptionError(
            f"[{name}] 'at' is not a list of frames", file=path, remedy="at = [1, 24]"
        )
    if any(b <= a for a, b in itertools.pairwise(times)):
        raise OptionError(
            f"[{name}] keyframes ('at') must rise", file=path, remedy="put them in order"
        )
    for key, (width, words) in _VALUES.items():
        if key in section and not _is_value(key, section[key], width):
            raise OptionError(
                f"[{name}] {key} = {shortened(section[key])} should be {words}, or a list of them",
                file=path,
                remedy="one value a keyframe, or one for all",
            )


def _is_value(key: str, value: Any, width: int) -> bool:
    """Whether it is one value of a key or a list of them, with which a picture can be made."""
    if key == "scale" and fits(value, float):
        value = [value] * width
    if fits(value, list[float] if width else float):
        value = [value]
    if not value or not fits(value, list[list[float]] if width else list[float]):
        return False
    if width and any(len(v) != width for v in value):
        return False
    values = np.abs(np.asarray(value, float))
    if key == "fov":
        return bool((np.asarray(value) > 0).all() and (values < 180).all())
    if key == "scale":
        return bool((values > 1e-9).all() and (values < 1e9).all())
    if key in ("axis", "up"):
        return bool((values.max(axis=1) > 1e-9).all() and (values < 1e9).all())
    return bool((values < 1e12).all())


class Stage:
    """A loaded scene whose camera and shapes an animation moves.

    The scene is changed in place: `pose` puts everything where a frame has it.
    """

    def __init__(self, mi: Any, scene: Any, sensor: Any, animation: Animation) -> None:
        self.mi, self.scene, self.sensor, self.animation = mi, scene, sensor, animation
        self._sensor_params = mi.traverse(sensor)
        self._camera = np.array(self._sensor_params["to_world"].matrix, float).reshape(4, 4)
        self._fov = None
        if "x_fov" in self._sensor_params:  # Mitsuba's own mapping has no get
            self._fov = self._sensor_params["x_fov"]
        self._params = mi.traverse(scene)
        self._rest: dict[str, Any] = {}
        self._ids = [shape.id() for shape in scene.shapes()]

    def pose(self, frame: float) -> None:
        """Put camera and shapes where the frame has them."""
        pose = self.animation(frame)
        mi, params = self.mi, self._sensor_params
        params["to_world"] = mi.Transform4f(self._camera if pose.camera is None else pose.camera)
        if self._fov is not None:
            params["x_fov"] = self._fov if pose.fov is None else mi.Float(pose.fov)
        params.update()
        for name, matrix in self._moves(pose).items():
            self._place(name, matrix)
        self._params.update()

    def motion(self, frame: float, previous: float) -> Motion:
        """Motion from ``previous`` to ``frame``; leaves the stage in ``frame``."""
        from lambent.render.motion import motion_between, projection

        self.pose(previous)
        before = projection(self.sensor)
        stood = np.array(self._sensor_params["to_world"].matrix, float).reshape(4, 4)[:3, 3]
        self.pose(frame)
        then, now = (self._moves(self.animation(f)) for f in (previous, frame))
        moved = {
            name: then[name] @ np.linalg.inv(now[name])
            for name in now
            if name in then and not np.allclose(then[name], now[name], atol=1e-12)
        }
        return motion_between(self.scene, projection(self.sensor), before, stood, moved)

    def _moves(self, pose: Pose) -> dict[str, Matrix]:
        """Transform by id of every shape that the pose names."""
        moves: dict[str, Matrix] = {}
        for pattern, matrix in pose.shapes.items():
            found = [i for i in self._ids if fnmatch.fnmatchcase(i, pattern)]
            if not found:
                raise UnknownNameError("shape", pattern, [i for i in self._ids if i])
            for name in found:
                moves[name] = np.asarray(matrix, float) @ moves.get(name, np.eye(4))
        return moves

    def _place(self, name: str, matrix: Matrix) -> None:
        import drjit as dr

        mi, params = self.mi, self._params
        transform = mi.Transform4f(matrix)
        for key in (f"{name}.vertex_positions", f"{name}.vertex_normals", f"{name}.to_world"):
            if key not in params:
                continue
            if key not in self._rest:
                self._rest[key] = type(params[key])(params[key])
            rest = self._rest[key]
            if key.endswith("to_world"):
                params[key] = transform @ rest
            elif len(rest):
                kind = mi.Point3f if key.endswith("positions") else mi.Normal3f
                params[key] = dr.ravel(transform @ dr.unravel(kind, rest))


def look_at(origin: Sequence[float], target: Sequence[float], up: Sequence[float]) -> Matrix:
    """``to_world`` of a camera at ``origin`` that looks at ``target`` (Mitsuba: along +z)."""
    o, t, u = (np.asarray(v, float) for v in (origin, target, up))
    forward = t - o
    if not np.linalg.norm(forward) > 0:
        raise OptionError(f"the camera looks at where it stands: {tuple(o.tolist())}")
    forward /= np.linalg.norm(forward)
    left = np.cross(u, forward)
    if np.linalg.norm(left) < 1e-9:
        raise OptionError(f"the camera looks along its up vector: {tuple(u.tolist())}")
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = left, np.cross(forward, left), forward
    matrix[:3, 3] = o
    return matrix


def disoccluded(frame: Frame, before: Frame) -> NDArray[np.bool_]:
    """Which pixels ``(H, W)`` of a frame show what the one before did not.

    A pixel's way back (``motion``) ends outside the picture, or at another distance than the point
    had (``previous_depth`` against ``first_depth``, more than 3 % and more than what the slope
    across a pixel explains), or at a surface that faces elsewhere (more than 37 degrees).
    Raises `LayerError` where a layer is missing.
    """
    from lambent.kernels.warp import warp

    motion = frame[Role.MOTION]
    expected = frame.extras["previous_depth"].data
    seen = np.concatenate(
        [before.extras["first_depth"].data, before.extras["first_normal"].data], axis=2
    )
    there, inside = warp(seen, motion)
    slope = np.zeros_like(expected[:, :, 0])
    for axis in (0, 1):
        if expected.shape[axis] > 1:
            slope += np.abs(np.gradient(expected[:, :, 0], axis=axis))
    near = np.abs(there[:, :, 0] - expected[:, :, 0]) <= 0.03 * expected[:, :, 0] + slope
    normal = frame.extras["first_normal"].data
    agree = np.sum(there[:, :, 1:] * normal, axis=2)
    scale = np.linalg.norm(there[:, :, 1:], axis=2) * np.linalg.norm(normal, axis=2)
    background = (expected[:, :, 0] == 0) & (there[:, :, 0] == 0)
    same = near & (agree >= 0.8 * scale) & ((expected[:, :, 0] > 0) == (there[:, :, 0] > 0))
    result: NDArray[np.bool_] = ~(inside & (same | background))
    return result


# ------------------------------------------------------------------- private


def _between(at: Matrix, values: Matrix, frame: float, linear: bool) -> Any:
    """Cubic Hermite (or linear) interpolation of ``values`` (K, ...) at keys ``at`` (K,)."""
    frame = float(np.clip(frame, at[0], at[-1]))
    k = int(np.clip(np.searchsorted(at, frame, side="right") - 1, 0, len(at) - 2))
    step = at[k + 1] - at[k]
    t = (frame - at[k]) / step
    if linear:
        return values[k] + t * (values[k + 1] - values[k])
    slopes = np.zeros_like(values)
    for i in range(1, len(at) - 1):
        slopes[i] = (values[i + 1] - values[i - 1]) / (at[i + 1] - at[i - 1])
    a, b = values[k], values[k + 1]
    ma, mb = slopes[k] * step, slopes[k + 1] * step
    return (
        (2 * t**3 - 3 * t**2 + 1) * a
        + (t**3 - 2 * t**2 + t) * ma
        + (3 * t**2 - 2 * t**3) * b
        + (t**3 - t**2) * mb
    )


def _translation(shift: Any) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, 3] = shift
    return matrix


def _rotation(axis: Any, degrees: float) -> Matrix:
    """Rotation around an axis through the origin (Rodrigues' formula)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix
