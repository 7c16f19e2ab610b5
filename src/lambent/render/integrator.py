"""The plug-in ``lambent_frames``: Lambent's frames from any Mitsuba script or scene file.

After ``import lambent.render.integrator`` (with a variant set) a scene may say::

    <integrator type="lambent_frames">
        <integer name="max_depth" value="12"/>
        <string name="features" value="all"/>
    </integrator>

and ``mi.render(scene, spp=64)`` returns a tensor ``(H, W, C)``: the channels are those of
``integrator.aov_names()``, ``R G B`` first, variances after all means. A nested integrator is
wrapped: its radiance is taken in place of our paths, and light is not split.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from lambent.frame.exr.new import planes_of
from lambent.frame.frame import Frame
from lambent.render.sampling import FrameSampler
from lambent.render.scene import film_windows

NAME = "lambent_frames"


class LambentFrames(mi.SamplingIntegrator):  # type: ignore[misc]
    """Colour, light split in several ways, features, variances and half buffers in one pass.

    Properties: ``max_depth`` (12; -1 is endless), ``rr_depth`` (5), ``features`` ("all"),
    ``hide_emitters`` is not supported; a nested integrator, if any, gives the radiance.
    """

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.max_depth = int(props.get("max_depth", 12))
        self.rr_depth = int(props.get("rr_depth", 5))
        self.features = str(props.get("features", "all"))
        self.nested = None
        for name in props.unqueried():
            value = props[name]
            if isinstance(value, mi.Integrator):
                self.nested = value
        self._path = self.nested or mi.load_dict(
            {"type": "path", "max_depth": self.max_depth, "rr_depth": self.rr_depth}
        )
        self._names: list[str] = []

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> Any:
        """Radiance along a ray alone, as of the path tracer, for those who wrap this."""
        return self._path.sample(scene, sampler, ray, medium, active)

    def aov_names(self) -> list[str]:
        """The channels of the last `render` after ``R G B``."""
        return self._names[3:]

    def frame(self, scene: Any, sensor: Any = 0, seed: int = 0, spp: int = 0) -> Frame:
        """The picture as a `Frame`; ``spp`` 0 takes the sensor's."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        sampler = FrameSampler(
            scene,
            sensor,
            features=self.features,
            depth=self.max_depth,
            rr_depth=self.rr_depth,
            integrator=self.nested,
        )
        return sampler.sample(spp or sensor.sampler().sample_count(), int(seed)).frame(
            windows=film_windows(sensor)
        )

    def render(
        self,
        scene: Any,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> Any:
        """All channels as a tensor ``(H, W, C)``; the film holds them, too."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        planes = planes_of(self.frame(scene, sensor, seed, spp))
        first = ["R", "G", "B"]
        means = [n for n in planes if "variance" not in n and n not in first]
        self._names = first + means + [n for n in planes if "variance" in n]
        height, width = planes["R"].shape
        flat = [mi.Float(planes[name].ravel()) for name in self._names]
        count = len(flat)
        pixels = dr.zeros(mi.Float, width * height * count)
        index = dr.arange(mi.UInt32, width * height) * count
        for channel, plane in enumerate(flat):
            dr.scatter(pixels, plane, index + channel)
        return mi.TensorXf(pixels, shape=(height, width, count))

    def to_string(self) -> str:
        """For ``print``; `lambent.render.scene` reads the depths off it."""
        return (
            f"LambentFrames[\n  max_depth = {self.max_depth},\n  rr_depth = {self.rr_depth},\n"
            f'  features = "{self.features}"\n]'
        )


mi.register_integrator(NAME, lambda props: LambentFrames(props))
