"""Scenes rendered by Blender's Cycles: random ones, and .blend files.

One order renders all pictures of a view (`lambent.scenes.cycles`), so these scenes give whole
stills in place of samples that add up. A random scene draws its own cameras and crops, and is quick
to build: each item has a scene of its own.
"""

from __future__ import annotations

import atexit
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lambent.dataset.item import Still
from lambent.dataset.recipe import Recipe
from lambent.dataset.source import Draw
from lambent.errors import OptionError, UnknownNameError
from lambent.frame.frame import Frame
from lambent.phases import Phases

if TYPE_CHECKING:
    from lambent.scenes.cycles import CyclesWorker


class RandomSource:
    """Random Cycles scenes. The recipe's kinds take turns, or all kinds come up."""

    licences = ("random Cycles scenes: made by Lambent, CC0-1.0",)

    def __init__(self, recipe: Recipe, device: str, phases: Phases) -> None:
        from lambent.scenes.cycles.worker import KINDS

        if recipe.items_per_scene != 1 or recipe.clips_per_scene != 1:
            raise OptionError(
                "a random Cycles scene gives one item",
                remedy="set items_per_scene = 1 and clips_per_scene = 1",
            )
        for kind in recipe.kinds:
            if kind not in KINDS:
                raise UnknownNameError("kind of Cycles scene", kind, KINDS)
        self.recipe, self.device, self.phases = recipe, device, phases
        self._worker: CyclesWorker | None = None

    def versions(self) -> Mapping[str, str]:
        """Of Blender. Raises `EngineError` where there is none."""
        return {"blender": self.worker.version}

    @property
    def worker(self) -> CyclesWorker:
        """The Blender that renders; started when it is first needed, ended with this process."""
        if self._worker is None:
            from lambent.scenes.cycles import CyclesWorker

            device = "cuda" if self.device == "cuda" else "cpu"
            self._worker = CyclesWorker(device=device)
            atexit.register(self._worker.close)
        return self._worker

    def scene(self, seed: int, job: int, frames: int) -> RandomCyclesScene:
        """The scene of a seed."""
        kinds = self.recipe.kinds
        return RandomCyclesScene(self, seed, kinds[job % len(kinds)] if kinds else None, frames)


@dataclass
class RandomCyclesScene:
    """A random Cycles scene. ``about`` is complete once it has been rendered."""

    source: RandomSource
    seed: int
    kind: str | None
    frames: int
    cameras: int = 1
    about: dict[str, Any] = field(default_factory=dict)

    def stills(
        self, camera: int, edge: int, spp: Sequence[int], target_spp: int
    ) -> tuple[Still, ...]:
        """Every still of the item, levels and target from one order."""
        with self.source.phases("Cycles"):
            views = self.source.worker.render_random(
                self.seed,
                spp_list=spp,
                size=(edge, edge),
                frames=self.frames,
                reference_spp=target_spp,
                reference_blocks=8,
                kind=self.kind,
            )
        first = views[0]
        self.about = {
            "kind": first.kind,
            "seed": self.seed,
            "view_camera": first.camera,
            "view_window": [round(share, 5) for share in first.window],
        }
        return tuple(Still(view.noisy, view.target) for view in views)


class BlendSource:
    """.blend files through Cycles: crops of whole pictures of the recipe's ``view``.

    Every noise level and target is a whole picture, so let the view be little larger than the crop.
    """

    licences: Sequence[str] = ()

    def __init__(self, recipe: Recipe, device: str, phases: Phases) -> None:
        if not recipe.scenes:
            raise OptionError(
                "the recipe names no .blend", remedy='add a line: scenes = ["kitchen.blend"]'
            )
        self.recipe, self.device, self.phases = recipe, device, phases
        self._process: Any = None

    @property
    def process(self) -> Any:
        """The Blender that renders, kept from picture to picture."""
        if self._process is None:
            from lambent.render.cycles.process import BlenderProcess

            self._process = BlenderProcess()
            atexit.register(self._process.close)
        return self._process

    def versions(self) -> Mapping[str, str]:
        """Of Blender. Raises `EngineError` where there is none."""
        self.process.start()
        return {"blender": self.process.version}

    def scene(self, seed: int, job: int, frames: int) -> BlendScene:
        """A file; they take turns. A clip begins where the seed says."""
        path = self.recipe.scenes[job % len(self.recipe.scenes)]
        first = 2 + seed % 200 if frames > 1 else None
        name = Path(path).stem
        about = {"kind": name, "scene": name, "seed": seed, "normals": "camera"}
        return BlendScene(self, path, first, frames, about)


@dataclass(frozen=True)
class BlendScene:
    """A .blend file with its own camera."""

    source: BlendSource
    path: str
    first: int | None
    frames: int
    about: Mapping[str, Any]
    cameras: int = 1

    def views(self, camera: int) -> Sequence[BlendView]:
        """One view, or one for each frame of a clip."""
        numbers = [None if self.first is None else self.first + k for k in range(self.frames)]
        return [BlendView(self, number) for number in numbers]


@dataclass(frozen=True)
class BlendView:
    """What the file's camera sees in one frame."""

    scene: BlendScene
    number: int | None

    def pilot(self, size: tuple[int, int], spp: int, seed: int) -> Frame:
        """The whole picture, small."""
        return self._render(size, spp, seed)

    def sample(self, draws: Sequence[Draw]) -> list[RenderedSamples]:
        """Windows of the whole picture, each from a render of its own."""
        made = []
        for draw in draws:
            frame = self._render(self.scene.source.recipe.view, draw.spp, draw.seed)
            x, y, edge = draw.window.x, draw.window.y, draw.window.edge
            made.append(RenderedSamples((frame.crop(y, y + edge, x, x + edge),)))
        return made

    def _render(self, size: tuple[int, int], spp: int, seed: int) -> Frame:
        from lambent.render.cycles import render_blend

        source = self.scene.source
        with source.phases("Cycles"):
            return render_blend(
                self.scene.path,
                spp=spp,
                size=size,
                frame=self.number,
                seed=seed,
                device=source.device,
                halves=spp > 1,
                passes="light",
                process=source.process,
            )


@dataclass(frozen=True)
class RenderedSamples:
    """Independent renders of the same picture; their sum is their mean by samples."""

    frames: tuple[Frame, ...]

    @property
    def spp(self) -> int:
        """Samples of all renders."""
        return sum(frame.spp or 1 for frame in self.frames)

    def __add__(self, other: RenderedSamples) -> RenderedSamples:
        return RenderedSamples((*self.frames, *other.frames))

    def frame(self) -> Frame:
        """One frame of all."""
        from lambent.render.cycles.frames import joined

        if len(self.frames) == 1:
            return self.frames[0].replace(extras={}, spp=self.spp)
        return joined(self.frames, halves=False).replace(extras={}, spp=self.spp)
