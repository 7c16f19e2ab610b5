"""Scenes of real things, from a folder (`lambent.scenes.assets`): arrangements and whole scenes.

The folder is ``assets`` of the recipe.
"""

from __future__ import annotations

import gc
from pathlib import Path

from lambent.dataset.mitsuba_source import MitsubaScene, MitsubaSource, Places
from lambent.dataset.recipe import Recipe
from lambent.dataset.validation import refuse_file
from lambent.errors import OptionError
from lambent.phases import Phases


class AssetSource(MitsubaSource):
    """Models, materials, maps and scenes of a folder, put together at random by seed."""

    def __init__(self, recipe: Recipe, device: str, phases: Phases) -> None:
        from lambent.scenes.assets.library import open_library

        super().__init__(recipe, device, phases)
        if not recipe.assets:
            raise OptionError(
                "the recipe needs a folder of assets",
                remedy="give --assets DIR, assets = in the recipe, or set LAMBENT_ASSETS",
            )
        self.library = open_library(Path(recipe.assets), refuse_file)
        self.licences = self.library.licences
        self.notes = self.library.notes

    def versions(self) -> dict[str, str]:
        """Of Mitsuba and Dr.Jit, and the digest of the folder."""
        return {**super().versions(), "assets": self.library.digest}

    def scene(self, seed: int, job: int, frames: int) -> MitsubaScene:
        """The scene of a seed."""
        from lambent.scenes.assets.arrange import arrangement
        from lambent.scenes.mitsuba.build import build
        from lambent.scenes.mitsuba.motion import animate

        mi = self.mi
        with self.phases("plan"):
            plan = arrangement(seed, self.library, mi)
            if frames > 1:
                plan = animate(plan, frames + 1, seed)
        gc.collect()  # see ProceduralSource
        with self.phases("build"):
            scene = build(plan, mi, 0, self.recipe.view)
        about = {"kind": plan.kind, "seed": seed, "triangles": plan.triangles}
        return MitsubaScene(self, scene, about, len(plan.cameras), frames, Places(plan))
