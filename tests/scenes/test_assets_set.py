"""A data set from a folder of assets, end to end, by the command line."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("mitsuba")

import numpy as np

import lambent.dataset
from lambent.cli import main

from .test_assets import assets, write_ball  # noqa: F401

RECIPE = """
name = "things"
seed = 2
source = "assets"
count = 2
kinds = ["table", "whole"]
items_per_scene = 1
cameras_per_scene = 1
view = [48, 32]
crop = 32
levels = 2
spp = [1, 8]
mean_spp = 2
target_spp = 8
target_most = 8
depth = 4
"""


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    monkeypatch.delenv("LAMBENT_ASSETS", raising=False)
    path = tmp_path / "things.toml"
    path.write_text(RECIPE)
    return path


def test_two_items_from_an_arrangement_and_a_whole_scene(recipe, assets, tmp_path, capsys):  # noqa: F811
    command = ["dataset", "make", str(recipe), "--assets", str(assets), "-o", str(tmp_path / "set")]
    assert main(command) == 0
    assert "left out: scenes_test/bathroom/scene.xml" in capsys.readouterr().out
    data = lambent.dataset.open(tmp_path / "set")
    assert [item.about["kind"] for item in data] == ["table", "whole"]
    for item in data:
        assert item.target.colour.shape == (32, 32, 3)
        assert np.isfinite(item.target.colour).all()
        assert item.target.colour.mean() > 0.001
        assert len(item.levels) == 2
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert "models/cube.glb: Cube, A. Person, CC0-1.0" in manifest["licences"]
    assert any(line.startswith("unknown: ") for line in manifest["licences"])
    # The same files, wherever the folder lies; with others the set is not continued.
    other = assets.parent / f"{assets.name}-elsewhere"
    other.symlink_to(assets)
    assert main([*command[:4], str(other), *command[5:]]) == 0
    other.unlink()
    (other / "models").mkdir(parents=True)
    write_ball(other / "models" / "ball.ply")
    assert main([*command[:4], str(other), *command[5:]]) == 4
    assert "another folder of assets" in capsys.readouterr().err


def test_without_a_folder_of_assets_the_ways_to_name_one_are_told(recipe, tmp_path, capsys):
    for extra, code, words in (
        ([], 4, "LAMBENT_ASSETS"),
        (["--assets", str(tmp_path / "none")], 3, "no such folder"),
    ):
        assert main(["dataset", "make", str(recipe), "-o", str(tmp_path / "set"), *extra]) == code
        err = capsys.readouterr().err
        assert words in err
        assert "Traceback" not in err


def test_the_recipe_may_name_the_folder(recipe, assets, tmp_path, monkeypatch):  # noqa: F811
    from lambent.dataset.recipe import load_recipe

    monkeypatch.setenv("LAMBENT_ASSETS", str(assets))
    assert load_recipe(recipe).assets == str(assets)
    recipe.write_text(RECIPE + 'assets = "here"\n')
    assert load_recipe(recipe).assets == str((tmp_path / "here").resolve())
    assert load_recipe(recipe, assets).assets == str(assets)
    assert load_recipe(recipe).essence == load_recipe(recipe, assets).essence
