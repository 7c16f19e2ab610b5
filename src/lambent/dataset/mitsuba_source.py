"""Scenes rendered by Mitsuba: random ones (`ProceduralSource`), and files with variations.

A scene is built once; what differs from crop to crop, from camera to camera and from frame to frame
(crop window, camera, places of shapes) is data of the same compiled kernel, set through
``mi.traverse``. Building, the first pass of a scene (tracing, and compiling unless a kernel of its
structure is known) and the later ones are counted apart.
"""

from __future__ import annotations

import copy
import dataclasses
import gc
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lambent.dataset.recipe import Recipe
from lambent.dataset.source import Draw, UnfitSceneError
from lambent.errors import OptionError
from lambent.frame.frame import Frame
from lambent.phases import Phases
from lambent.render.variant import mitsuba

if TYPE_CHECKING:
    from lambent.render.animation import Animation, Pose
    from lambent.render.moments import Moments
    from lambent.render.sampling import Request
    from lambent.scenes.mitsuba.plan import ScenePlan

#: What is kept beside the colour (`lambent.render.channels`).
FEATURES = "light,features"


class MitsubaSource:
    """What both sources share: the renderer, started when it is first needed."""

    licences: Sequence[str] = ()
    notes: Sequence[str] = ()

    def __init__(self, recipe: Recipe, device: str, phases: Phases) -> None:
        self.recipe, self.device, self.phases = recipe, device, phases
        self._mi: Any = None

    @property
    def mi(self) -> Any:
        """Mitsuba, with its variant and its number of threads."""
        if self._mi is None:
            self._mi = mitsuba(self.device)
            import drjit as dr

            # Mitsuba reads an EXR with other threads, and with none would wait for ever.
            threads = int(os.environ.get("LAMBENT_THREADS") or dr.thread_count())
            dr.set_thread_count(max(threads, 2))
        return self._mi

    def versions(self) -> Mapping[str, str]:
        """Of Mitsuba and Dr.Jit; neither is loaded for it."""
        from importlib.metadata import PackageNotFoundError, version

        found = {}
        for name in ("mitsuba", "drjit"):
            try:
                found[name] = version(name)
            except PackageNotFoundError:
                found[name] = "missing"
        return found


class ProceduralSource(MitsubaSource):
    """Random scenes (`lambent.scenes.mitsuba`); the recipe's kinds, or all in their shares."""

    licences = ("procedural scenes: made by Lambent, CC0-1.0",)

    def __init__(self, recipe: Recipe, device: str, phases: Phases) -> None:
        super().__init__(recipe, device, phases)
        if recipe.kinds:
            from lambent.errors import UnknownNameError
            from lambent.scenes.mitsuba import KINDS

            for kind in recipe.kinds:
                if kind not in KINDS:
                    raise UnknownNameError("kind of scene", kind, KINDS)

    def scene(self, seed: int, job: int, frames: int) -> MitsubaScene:
        """The scene of a seed; the recipe's kinds take turns."""
        from lambent.scenes.mitsuba import random_scene
        from lambent.scenes.mitsuba.build import build
        from lambent.scenes.mitsuba.motion import animate

        kinds = self.recipe.kinds
        with self.phases("plan"):
            plan = random_scene(seed, kinds[job % len(kinds)] if kinds else None)
            if frames > 1:
                # One frame more at the start: the first still of a clip has motion, too.
                plan = animate(plan, frames + 1, seed)
        gc.collect()  # the scene before this one: Dr.Jit numbers objects, kernels know the numbers
        with self.phases("build"):
            size = self.recipe.view
            scene = build(plan, self.mi, 0, size)
        about = {"kind": plan.kind, "seed": seed, "triangles": plan.triangles}
        return MitsubaScene(self, scene, about, len(plan.cameras), frames, Places(plan))


@dataclass(frozen=True)
class Places:
    """Cameras of a plan: lens of each, and an animation that starts with the frame before."""

    plan: ScenePlan

    def animation(self, camera: int) -> Animation:
        """Where things are in each frame of the plan."""
        from lambent.render.animation import Pose

        first = {s.id: np.linalg.inv(s.at(0)) for s in self.plan.shapes if s.path is not None}

        def pose(frame: float) -> Pose:
            time = int(frame)
            shapes = {s.id: s.at(time) @ first[s.id] for s in self.plan.shapes if s.id in first}
            return Pose(self.plan.camera_transform(camera, time), None, shapes)

        return pose

    def lens(self, camera: int) -> Mapping[str, float]:
        """Parameters of the sensor that differ from camera to camera."""
        chosen = self.plan.cameras[camera]
        return {
            "aperture_radius": chosen.aperture_radius or 1e-5,
            "focus_distance": chosen.focus_distance,
        }

    def fov(self, camera: int) -> float:
        """Degrees across the wider side."""
        return self.plan.cameras[camera].fov

    def medium(self, camera: int) -> int | None:
        """The medium that a camera stands in."""
        return self.plan.cameras[camera].medium


class MitsubaScene:
    """A built scene with its cameras. Only one view is set up at a time."""

    def __init__(
        self,
        source: MitsubaSource,
        scene: Any,
        about: Mapping[str, Any],
        cameras: int,
        frames: int,
        places: Any,
    ) -> None:
        self.source, self.scene, self.about = source, scene, about
        self.cameras, self.frames, self.places = cameras, frames, places
        self.sensor = scene.sensors()[0]
        self.params = source.mi.traverse(self.sensor)
        self._now: tuple[Any, ...] = ()
        self._camera = 0
        self._stage: Any = None
        self._sampler: Any = None
        self._fresh = True

    def views(self, camera: int) -> Sequence[MitsubaView]:
        """One view, or one for each frame of a clip."""
        if self.places.medium(camera) != self.places.medium(0):
            raise UnfitSceneError("its cameras stand in different media")
        return [MitsubaView(self, camera, k) for k in range(self.frames)]

    def sample(
        self, camera: int, frame: int, size: tuple[int, int], requests: Sequence[Request]
    ) -> list[Moments]:
        """Moments of windows of the picture of ``size``, by one launch of one kernel."""
        wanted = (camera, frame, size)
        if wanted != self._now:
            with self.source.phases("set up"):
                self._set_up(*wanted)
            self._now = wanted
        if not self._fresh:
            return self._sampler.sample_windows(requests)
        with self.source.phases("first pass of a scene"):
            self._fresh = False
            return self._sampler.sample_windows(requests)

    def _set_up(self, camera: int, frame: int, size: tuple[int, int]) -> None:
        import drjit as dr

        from lambent.render.animation import Stage
        from lambent.render.sampling import FrameSampler

        mi, params = self.source.mi, self.params
        if self._stage is None:
            # One stage for all cameras: it remembers where things were when the scene was built.
            self._stage = Stage(mi, self.scene, self.sensor, self._pose)
        self._camera = camera
        for name, value in self.places.lens(camera).items():
            if name in params:
                params[name] = dr.opaque(mi.Float, value)
        params["film.size"] = mi.ScalarVector2u(*size)
        params["film.crop_size"] = mi.ScalarVector2u(*size)
        params["film.crop_offset"] = mi.ScalarPoint2u(0, 0)
        params.update()
        motion = None
        if self.frames > 1:
            motion = self._stage.motion(frame + 1, frame)
        elif self._now[:1] != (camera,):
            self._stage.pose(0)
        if self._sampler is None or motion is not None:
            self._sampler = FrameSampler(
                self.scene,
                self.sensor,
                features=FEATURES,
                depth=self.source.recipe.depth,
                rr_depth=self.source.recipe.rr_depth,
                motion=motion,
                file=f"the scene '{self.about['kind']}' of seed {self.about['seed']}",
            )

    def _pose(self, frame: float) -> Pose:
        pose: Pose = self.places.animation(self._camera)(frame)
        return dataclasses.replace(pose, fov=self.places.fov(self._camera))


@dataclass(frozen=True)
class MitsubaView:
    """A camera of a scene in one frame."""

    scene: MitsubaScene
    camera: int
    number: int

    def pilot(self, size: tuple[int, int], spp: int, seed: int) -> Frame:
        """The whole picture, small."""
        from lambent.render.sampling import Request

        whole = [Request(0, 0, *size, spp, seed)]
        (moments,) = self.scene.sample(self.camera, self.number, size, whole)
        return moments.frame()

    def sample(self, draws: Sequence[Draw]) -> list[Moments]:
        """Moments of windows of the view."""
        from lambent.render.sampling import Request

        view = self.scene.source.recipe.view
        requests = [
            Request(d.window.x, d.window.y, d.window.edge, d.window.edge, d.spp, d.seed)
            for d in draws
        ]
        return self.scene.sample(self.camera, self.number, view, requests)


# ---------------------------------------------------------------- scenes from files


class FileSource(MitsubaSource):
    """Scene files (XML), with cameras moved, and colours, roughness and lights changed.

    A seed chooses the variation; ``vary = false`` in the recipe moves the camera only.
    """

    def __init__(self, recipe: Recipe, device: str, phases: Phases) -> None:
        super().__init__(recipe, device, phases)
        if not recipe.scenes:
            raise OptionError(
                "the recipe names no scene", remedy='add a line: scenes = ["kitchen/scene.xml"]'
            )
        self._open: tuple[str, Any, dict[str, Any], Tripod] | None = None

    def scene(self, seed: int, job: int, frames: int) -> MitsubaScene:
        """A variation of one of the files; they take turns."""
        path = self.recipe.scenes[job % len(self.recipe.scenes)]
        with self.phases("build"):
            scene, original, tripod = self._loaded(path)
            random = np.random.Generator(np.random.PCG64(seed))
            params = self.mi.traverse(scene)
            for key, value in original.items():
                params[key] = type(params[key])(value)
            if self.recipe.vary:
                for key, value in original.items():
                    params[key] = type(params[key])(varied(key, value, random))
            params.update()
        file = Path(path)
        name = file.parent.name if file.stem == "scene" else file.stem
        about = {"kind": name, "scene": name, "seed": seed}
        count = self.recipe.cameras_per_scene
        return MitsubaScene(self, scene, about, count, frames, tripod.at(seed))

    def _loaded(self, path: str) -> tuple[Any, dict[str, Any], Tripod]:
        """The scene of a file, and what varies as the file has it: values, and the camera."""
        from lambent.render.scene import load

        if self._open is None or self._open[0] != path:
            self._open = None
            gc.collect()
            scene = load(path, size=self.recipe.view, device=self.device).scene
            params = self.mi.traverse(scene)
            original = {k: np.array(params[k]).copy() for k, _ in params if varies(k)}
            self._open = (path, scene, original, Tripod(self.mi, scene))
        return self._open[1:]


#: Ends of the names of parameters that are colours of surfaces.
COLOURS = ("reflectance.value", "base_color.value", "specular_transmittance.value")
_ROUGHNESS = ("alpha.value", "alpha_u.value", "alpha_v.value", "roughness.value")
_LIGHTS = ("radiance.value", "intensity.value", "irradiance.value")
_SCALES = (".scale", ".sun_scale", ".sky_scale")


def varies(key: str) -> bool:
    """Whether `varied` has another value for a parameter of this name."""
    return key.endswith((*COLOURS, *_ROUGHNESS, *_LIGHTS)) or (
        key.lower().endswith(_SCALES) and "emitter" in key.lower()
    )


def varied(key: str, value: Any, random: np.random.Generator) -> Any:
    """Another value for a parameter: a colour, a roughness, the strength and tint of a light."""
    value = np.asarray(value, np.float64)
    if key.endswith(COLOURS):
        if random.random() < 0.4 or value.max() > 1:
            return value
        tint = random.dirichlet((2, 2, 2)) * 3 if value.size == 3 else np.ones(value.shape)
        grey = float(np.clip(value.mean() * 2 ** random.normal(0, 0.5), 0.02, 0.85))
        return np.clip(grey * tint.reshape(value.shape), 0, 0.9)
    if key.endswith(_ROUGHNESS):
        return np.clip(value * 2 ** random.normal(0, 1), 0.02, 0.8)
    strength = 2 ** random.normal(0, 1)
    if key.endswith(_LIGHTS) and value.size == 3:
        tint = np.exp(random.normal(0, 0.25, 3))
        return value * strength * (tint / tint.mean()).reshape(value.shape)
    return value * strength


class Tripod:
    """Random cameras around a file's own: turned, moved, with other focal lengths."""

    def __init__(self, mi: Any, scene: Any) -> None:
        params = mi.traverse(scene.sensors()[0])
        self.home = np.array(params["to_world"].matrix, float).reshape(4, 4)
        if "x_fov" not in params:
            raise UnfitSceneError("its sensor is not a perspective camera")
        self.home_fov = float(np.array(params["x_fov"]).ravel()[0])
        self.seed = 0
        self.reach = self._reach(mi, scene)

    def at(self, seed: int) -> Tripod:
        """The cameras of a variation."""
        other = copy.copy(self)
        other.seed = seed
        return other

    def animation(self, camera: int) -> Animation:
        """The camera drifts and turns steadily."""
        from lambent.render.animation import Pose

        random = np.random.Generator(np.random.PCG64([self.seed, camera]))
        start = (
            self.home
            @ _moved(random.normal(0, 0.1, 3) * self.reach)
            @ _turned(random.normal(0, [8, 14, 2]))
        )
        drift = random.normal(0, 0.012, 3) * self.reach
        turn = random.normal(0, [0.3, 0.7, 0.1])

        def pose(frame: float) -> Pose:
            return Pose(start @ _moved(drift * frame) @ _turned(turn * frame))

        return pose

    def lens(self, camera: int) -> Mapping[str, float]:
        """The file's own."""
        return {}

    def fov(self, camera: int) -> float:
        """Another field of view for each camera, in degrees across the picture."""
        random = np.random.Generator(np.random.PCG64([self.seed, camera, 1]))
        half = np.tan(np.radians(self.home_fov) / 2) * 2 ** random.uniform(-0.8, 0.3)
        return float(np.degrees(2 * np.arctan(half)))

    def medium(self, camera: int) -> None:
        """All cameras stand where the file's does."""
        return None

    def _reach(self, mi: Any, scene: Any) -> float:
        """How far the home camera sees, straight ahead."""
        ray = mi.Ray3f(
            mi.Point3f(self.home[:3, 3].tolist()), mi.Vector3f(self.home[:3, 2].tolist())
        )
        far = float(np.array(scene.ray_intersect_preliminary(ray).t).ravel()[0])
        return far if np.isfinite(far) else 1.0


def _moved(by: Any) -> Any:
    made = np.eye(4)
    made[:3, 3] = by
    return made


def _turned(degrees: Any) -> Any:
    """Rotation about x, y and z, in this order."""
    made = np.eye(4)
    for axis, angle in enumerate(np.radians(degrees)):
        turn, a, b = np.eye(4), (axis + 1) % 3, (axis + 2) % 3
        turn[a, a] = turn[b, b] = np.cos(angle)
        turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
        made = turn @ made
    return made
