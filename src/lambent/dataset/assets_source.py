"""Scenes of real things, from a folder (`lambent.scenes.assets`): arrangements and whole scenes.

The folder is ``assets`` of the recipe.
"""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import numpy as np

from lambent.dataset.mitsuba_source import (
    COLOURS,
    MitsubaScene,
    MitsubaSource,
    Places,
    varied,
    varies,
)
from lambent.dataset.recipe import Recipe
from lambent.dataset.validation import refuse_asset
from lambent.errors import OptionError, UnknownNameError
from lambent.phases import Phases


class AssetSource(MitsubaSource):
    """Models, materials, maps and scenes of a folder, put together at random by seed."""

    def __init__(self, recipe: Recipe, device: str, phases: Phases) -> None:
        from lambent.scenes.assets.arrange import SHARES, WHOLE
        from lambent.scenes.assets.library import open_library

        super().__init__(recipe, device, phases)
        if not recipe.assets:
            raise OptionError(
                "the recipe needs a folder of assets",
                remedy="give --assets DIR, assets = in the recipe, or set LAMBENT_ASSETS",
            )
        self.library = open_library(Path(recipe.assets), refuse_asset)
        for kind in recipe.kinds:
            if kind not in SHARES:
                raise UnknownNameError("kind of scene", kind, SHARES)
            if not (self.library.scenes if kind == WHOLE else self.library.models):
                what = "whole scene" if kind == WHOLE else "model"
                raise OptionError(f"'{kind}' needs a {what}", file=self.library.folder)
        self.licences = self.library.licences
        self.notes = self.library.notes

    def versions(self) -> dict[str, str]:
        """Of Mitsuba and Dr.Jit, and the digest of the folder."""
        return {**super().versions(), "assets": self.library.digest}

    def scene(self, seed: int, job: int, frames: int) -> MitsubaScene:
        """The scene of a seed; the recipe's kinds take turns."""
        from lambent.scenes.assets.arrange import kind_of

        kinds = self.recipe.kinds
        kind = kinds[job % len(kinds)] if kinds else kind_of(seed, self.library)
        gc.collect()  # the scene before this one: see ProceduralSource
        return self._whole(seed, frames) if kind == "whole" else self._arranged(seed, kind, frames)

    def _arranged(self, seed: int, kind: str, frames: int) -> MitsubaScene:
        from lambent.scenes.assets.arrange import arrangement
        from lambent.scenes.mitsuba.build import build
        from lambent.scenes.mitsuba.motion import animate

        mi = self.mi
        with self.phases("plan"):
            plan = arrangement(seed, self.library, mi, kind)
            if frames > 1:
                plan = animate(plan, frames + 1, seed)
        gc.collect()  # meshes that were read for the plan
        with self.phases("build"):
            scene = build(plan, mi, 0, self.recipe.view)
        about = {"kind": plan.kind, "seed": seed, "triangles": plan.triangles}
        return MitsubaScene(self, scene, about, len(plan.cameras), frames, Places(plan))

    def _whole(self, seed: int, frames: int) -> MitsubaScene:
        """One of the folder's scenes with other cameras, lights and materials."""
        from lambent.render.scene import load
        from lambent.scenes.assets.whole import Cameras, WholePlaces

        random = np.random.Generator(np.random.PCG64(seed))
        path = self.library.scenes[int(random.integers(len(self.library.scenes)))]
        with self.phases("build"):
            scene = load(path, size=self.recipe.view, device=self.device).scene
            params = self.mi.traverse(scene)
            for key, _ in params:
                if varies(key):
                    value = np.array(params[key])
                    other = varied(key, value, random)
                    if key.endswith(COLOURS):  # somebody chose them: the other is half as far
                        other = (other + value) / 2
                    params[key] = type(params[key])(other)
                elif key.endswith(_PICTURES) and random.random() < 0.4:
                    params[key] = type(params[key])(_tinted(np.array(params[key]), random))
            params.update()
        with self.phases("plan"):
            cameras = Cameras(self.mi, scene)
            count = self.recipe.cameras_per_scene
            places = WholePlaces(cameras.at(seed, count), seed, cameras.reach)
        name = path.parent.name if path.stem == "scene" else path.stem
        about = {"kind": "whole", "scene": name, "seed": seed}
        return MitsubaScene(self, scene, about, count, frames, places)


#: Pictures of colour in a scene: ends of the names of parameters.
_PICTURES = ("reflectance.data", "base_color.data")


def _tinted(picture: Any, random: np.random.Generator) -> Any:
    """A picture ``(H, W, C)`` of reflectance in another colour, darker or brighter."""
    if picture.ndim != 3 or picture.shape[2] != 3:
        return picture
    factor = 2 ** random.normal(0, 0.4) * np.exp(random.normal(0, 0.2, 3))
    return np.clip(picture * factor, 0, 0.95).astype(picture.dtype)
