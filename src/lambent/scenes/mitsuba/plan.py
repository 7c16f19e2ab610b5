"""What a procedural scene is: arrays and numbers, without a renderer.

`lambent.scenes.mitsuba.random_scene` makes a `ScenePlan`, `motion.animate` a clip of it, and
`build.build` the Mitsuba scene. Meshes are in object space; a shape's place in frame t is ``T_t``
of `ScenePlan.transforms`, so that a point p hit in frame t was at ``T_{t-1} T_t⁻¹ p`` before. A
scene that stands still has one frame.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError
from lambent.scenes.mitsuba.geometry import Array, Geometry
from lambent.scenes.mitsuba.palette import SLOTS

#: Half the width of a 35 mm frame, in millimetres: focal lengths are given for it.
HALF_FRAME = 18.0


@dataclass(frozen=True, eq=False)
class MaterialPlan:
    """A BSDF: a ``structure`` of `lambent.scenes.mitsuba.palette` and its values.

    Values are numbers, colours (linear, three numbers), or textures (uint8 ``(H, W, 1 or 3)``).
    """

    name: str
    structure: str
    values: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class EmitterPlan:
    """A light: ``kind`` of `lambent.scenes.mitsuba.palette`, ``id`` the name of its light group.

    ``values`` holds radiance (W/m²/sr) or intensity (W/sr), places and pictures.
    """

    id: str
    kind: str
    values: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class MediumPlan:
    """A homogeneous medium: ``sigma_t`` in 1/m, single-scattering albedo, Henyey-Greenstein g."""

    sigma_t: float
    albedo: tuple[float, float, float]
    g: float


@dataclass(frozen=True, eq=False)
class ShapePlan:
    """A mesh in object space at ``to_world (4, 4)``.

    ``material`` and ``emitter`` are numbers in the plan's lists; ``medium`` likewise is what fills
    the shape. ``path (T, 4, 4)`` are its places in the frames if it moves. ``movable`` says that
    it may: nothing rests on it and it is not a part of the house.
    """

    id: str
    geometry: Geometry
    to_world: Array
    material: int
    emitter: int | None = None
    medium: int | None = None
    movable: str | None = None
    path: Array | None = None

    def at(self, time: int) -> Array:
        """Its place ``(4, 4)`` in a frame."""
        return self.to_world if self.path is None else self.path[time]


@dataclass(frozen=True, eq=False)
class CameraPlan:
    """A viewpoint: ``to_world (4, 4)`` (x left, y up, z forward, as Mitsuba has it).

    ``focal_length`` is in mm for a frame 36 mm wide, ``aperture_radius`` and ``focus_distance`` in
    metres; the radius is 0 for a pinhole. ``medium`` is the number of the medium it stands in.
    """

    to_world: Array
    focal_length: float
    aperture_radius: float = 0.0
    focus_distance: float = 1.0
    medium: int | None = None
    path: Array | None = None

    @property
    def fov(self) -> float:
        """The angle of view across the wider side, in degrees."""
        return float(np.degrees(2 * np.arctan(HALF_FRAME / self.focal_length)))

    def at(self, time: int) -> Array:
        """Its place ``(4, 4)`` in a frame."""
        return self.to_world if self.path is None else self.path[time]


@dataclass(frozen=True, eq=False)
class ScenePlan:
    """A scene: see the module. ``tags`` say what it holds (``living``, ``night``, ``medium`` …).

    ``slots``: how many materials of each structure the palette has.
    """

    kind: str
    seed: int
    shapes: tuple[ShapePlan, ...]
    materials: tuple[MaterialPlan, ...]
    emitters: tuple[EmitterPlan, ...]
    cameras: tuple[CameraPlan, ...]
    media: tuple[MediumPlan, ...] = ()
    frames: int = 1
    tags: tuple[str, ...] = field(default=())
    slots: Mapping[str, int] = field(default_factory=lambda: SLOTS)

    @property
    def shape_ids(self) -> tuple[str, ...]:
        """The ids of the shapes, the same in every frame and in the Mitsuba scene."""
        return tuple(s.id for s in self.shapes)

    @property
    def light_groups(self) -> tuple[str, ...]:
        """The ids of the emitters."""
        return tuple(e.id for e in self.emitters)

    @property
    def integrator(self) -> str:
        """The Mitsuba integrator that the scene needs: ``path``, or ``volpath`` for media."""
        return "volpath" if self.media else "path"

    @property
    def triangles(self) -> int:
        """How many triangles all meshes have."""
        return sum(len(s.geometry.faces) for s in self.shapes)

    def transforms(self, time: int = 0) -> dict[str, Array]:
        """``to_world (4, 4)`` of every shape in frame ``time``. Raises `OptionError` outside."""
        self.check_time(time)
        return {s.id: s.at(time) for s in self.shapes}

    def camera_transform(self, camera: int = 0, time: int = 0) -> Array:
        """``to_world (4, 4)`` of a camera in frame ``time``. Raises `OptionError` outside."""
        self.check_time(time)
        return self.camera(camera).at(time)

    def camera(self, number: int) -> CameraPlan:
        """The camera of a number. Raises `OptionError` for one that is not there."""
        if not 0 <= number < len(self.cameras):
            raise OptionError(
                f"the plan has no camera {number}", remedy=f"it has 0 to {len(self.cameras) - 1}"
            )
        return self.cameras[number]

    def check_time(self, time: int) -> None:
        """Raise `OptionError` unless the plan has this frame."""
        if not 0 <= time < self.frames:
            raise OptionError(
                f"the plan has no frame {time}", remedy=f"it has frames 0 to {self.frames - 1}"
            )

    def digest(self) -> str:
        """A hash that is the same on every machine: numbers are rounded before they count.

        A mesh counts by its size, faces, bounds and mean, a picture by its size and mean colour,
        because sines of different processors differ in the last bit.
        """
        state = hashlib.sha256()
        rest = dataclasses.asdict(dataclasses.replace(self, shapes=(), cameras=()))
        del rest["slots"]
        for value in _flat(rest):
            state.update(value)
        for shape in self.shapes:
            g = shape.geometry
            state.update(f"{shape.id} {shape.material} {shape.emitter} {shape.movable}".encode())
            state.update(np.ascontiguousarray(g.faces[:64]).astype("<i8").tobytes())
            sizes = [len(g.positions), len(g.faces)]
            for value in _flat(
                [*sizes, *g.bounds, g.positions.mean(0), shape.to_world, shape.path]
            ):
                state.update(value)
        for camera in self.cameras:
            for value in _flat(dataclasses.asdict(camera)):
                state.update(value)
        return state.hexdigest()[:16]


def _flat(value: Any) -> list[bytes]:
    """Bytes of all that a structure holds, floats rounded to 1/1000 of their size."""
    if isinstance(value, Mapping):
        return [b for k in value for b in (str(k).encode(), *_flat(value[k]))]
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        means = np.rint(value.reshape(-1, value.shape[-1]).mean(0) / 4).astype(int)
        return [str(value.shape).encode(), str(means.tolist()).encode()]
    if isinstance(value, np.ndarray) and value.size > 64:
        value = [value.shape, value.mean()]
    if isinstance(value, (list, tuple, np.ndarray)):
        return [b for item in value for b in _flat(item)]
    if isinstance(value, (float, np.floating)):
        rounded = float(f"{float(value):.2e}") if abs(value) > 1e-3 else 0.0
        return [f"{rounded:.2e}".encode()]
    return [str(value).encode()]


def look_at(origin: Array, target: Array, roll: float = 0.0) -> Array:
    """A camera's ``to_world (4, 4)`` from ``origin`` towards ``target``, z up, rolled (radians)."""
    forward = np.asarray(target, float) - origin
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0, 1]) if abs(forward[2]) < 0.999 else np.array([0, 1.0, 0])
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    up = np.cross(forward, left)
    c, s = np.cos(roll), np.sin(roll)
    m = np.eye(4)
    m[:3, 0], m[:3, 1], m[:3, 2] = c * left + s * up, c * up - s * left, forward
    m[:3, 3] = origin
    return m


def as_float32(values: Array) -> NDArray[np.float32]:
    """Contiguous float32, flat, as Mitsuba's meshes take it."""
    return np.ascontiguousarray(values, np.float32).reshape(-1)
