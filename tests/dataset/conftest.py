"""Recipes of the fake source, which subprocesses find through PYTHONPATH."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from lambent.dataset.recipe import Recipe

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))


@pytest.fixture(autouse=True)
def fake_is_importable(monkeypatch):
    paths = [str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))


@pytest.fixture
def recipe() -> Recipe:
    return Recipe(
        name="fake",
        seed=3,
        source="fake:FakeSource",
        count=10,
        clip_count=3,
        items_per_scene=4,
        cameras_per_scene=2,
        view=(192, 96),
        crop=32,
        levels=2,
        spp=(1, 64),
        mean_spp=8,
        target_spp=32,
        target_most=64,
        clips_per_scene=2,
        clip_frames=3,
        pilot_spp=8,
    )


@pytest.fixture
def recipe_file(recipe, tmp_path) -> Path:
    return write_recipe(tmp_path / "recipe.toml", recipe)


def write_recipe(path: Path, recipe: Recipe) -> Path:
    import json

    lines = [f"{key} = {json.dumps(value)}" for key, value in recipe.as_dict().items()]
    path.write_text("\n".join(lines) + "\n")
    return path
