"""Recipes: read, refused, hashed; and what follows from an item's number."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import write_recipe
from lambent.dataset.plan import Job, jobs, kneed, level_spp, number, scene_seed
from lambent.dataset.recipe import Recipe, load_recipe
from lambent.dataset.validation import CYCLES_SEEDS, SCENES, SEEDS
from lambent.errors import FileError, OptionError


def test_a_recipe_comes_back_from_its_file(recipe, tmp_path):
    assert load_recipe(write_recipe(tmp_path / "r.toml", recipe)) == recipe


def test_an_unknown_key_is_answered_with_the_nearest(tmp_path):
    path = tmp_path / "r.toml"
    path.write_text('name = "x"\nseed = 1\ntarget_ssp = 64\n')
    with pytest.raises(OptionError, match="target_ssp") as raised:
        load_recipe(path)
    assert "target_spp" in raised.value.remedy
    assert raised.value.file == str(path)


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ('count = "many"', "whole number"),
        ("count = 2.5", "whole number"),
        ("count = true", "whole number"),
        ("view = 640", "list of 2"),
        ("view = [640]", "list of 2"),
        ("vary = 1", "true or false"),
        ("uniform = 1.5", "out of range"),
        ("spp = [64, 4]", "upside down"),
        ("crop = 1000", "cannot hold a crop"),
        ("name = 'a/b'", "cannot be the name"),
    ],
)
def test_values_that_make_no_sense(tmp_path, line, word):
    path = tmp_path / "r.toml"
    start = "" if line.startswith("name") else 'name = "x"\n'
    path.write_text(f"{start}seed = 1\n{line}\n")
    with pytest.raises(OptionError, match=word):
        load_recipe(path)


def test_a_file_that_is_no_recipe(tmp_path):
    with pytest.raises(FileError, match="no such recipe"):
        load_recipe(tmp_path / "r.toml")
    (tmp_path / "r.toml").write_text("name = \n")
    with pytest.raises(FileError, match="not valid TOML"):
        load_recipe(tmp_path / "r.toml")
    (tmp_path / "r.toml").write_text('name = "x"\n')
    with pytest.raises(OptionError, match="no 'seed'"):
        load_recipe(tmp_path / "r.toml")


@pytest.mark.parametrize("name", SCENES)
def test_validation_scenes_are_refused_by_name(tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    (folder / "scene.xml").write_text("<scene/>")
    with pytest.raises(OptionError, match=f"'{name}' is a validation scene"):
        Recipe(name="x", seed=1, source="scenes", scenes=(str(folder / "scene.xml"),))
    # Nor through a link with an innocent name, nor with another spelling.
    (tmp_path / "innocent").symlink_to(folder)
    path = tmp_path / "r.toml"
    path.write_text('name = "x"\nseed = 1\nscenes = ["innocent/scene.xml"]\n')
    with pytest.raises(OptionError, match=f"'{name}' is a validation scene"):
        load_recipe(path)
    with pytest.raises(OptionError, match="validation scene"):
        Recipe(name="x", seed=1, scenes=(f"/a/{name.replace('-', '_').upper()}.blend",))


@pytest.mark.parametrize("seed", sorted(SEEDS))
def test_validation_seeds_are_refused(seed):
    with pytest.raises(OptionError, match=str(seed)):
        Recipe(name="x", seed=1, source="cycles", seeds=(5, seed))


def test_a_random_seed_is_never_reserved(recipe, monkeypatch):
    """Make the first answer a reserved one: the next is taken."""
    job = Job("crop", 7, (28,))
    before = scene_seed(recipe, job, 0)
    monkeypatch.setattr("lambent.dataset.plan.SEEDS", frozenset({before}))
    after = scene_seed(recipe, job, 0)
    assert after != before
    assert len(CYCLES_SEEDS) == 6


def test_the_essence_knows_what_matters(recipe):
    assert replace(recipe, count=99, clip_count=9, name="other").essence == recipe.essence
    assert replace(recipe, seed=4).essence != recipe.essence
    assert replace(recipe, target_spp=64).essence != recipe.essence


# ----------------------------------------------------------------------- plan


def test_an_item_is_the_same_however_much_is_missing(recipe):
    every = {"crop": set(range(10)), "clip": set(range(3))}
    some = {"crop": {1, 6, 9}, "clip": {2}}
    all_jobs = {(j.what, j.number): j for j in jobs(recipe, every)}
    assert sorted(i for j in all_jobs.values() if j.what == "crop" for i in j.items) == [*range(10)]
    for job in jobs(recipe, some):
        whole = all_jobs[job.what, job.number]
        assert set(job.items) == set(whole.items) & some[job.what]
        for item in job.items:
            assert level_spp(recipe, job, item) == level_spp(recipe, whole, item)


def test_numbers_of_different_names_differ(recipe):
    found = {number(recipe, "a", n, m) for n in range(100) for m in range(100)}
    assert len(found) > 9990
    assert max(found) < 2**31


def test_crops_and_clips_are_mixed(recipe):
    order = [j.what for j in jobs(recipe, {"crop": set(range(400)), "clip": set(range(20))})]
    first = order[: len(order) // 2]
    assert 3 <= first.count("clip") <= 7


def test_levels_are_log_spaced_with_the_mean_asked_for(recipe):
    recipe = replace(recipe, spp=(1, 1024), mean_spp=24, levels=3)
    weights = kneed(tuple(2**k for k in range(11)), 24)
    assert np.isclose(weights @ 2.0 ** np.arange(11), 24, rtol=1e-3)
    assert (np.diff(weights) < 0).all()
    assert weights[3] > 0.85 * weights[0], "not log-uniform where samples are few"
    found = [
        level_spp(recipe, Job("crop", n, (4 * n,)), 4 * n + k) for n in range(600) for k in range(4)
    ]
    assert all(len(set(spp)) == 3 and spp == tuple(sorted(spp)) for spp in found)
    assert (
        {2**k for k in range(9)} <= {n for spp in found for n in spp} <= {2**k for k in range(11)}
    )
    assert 15 < np.mean([max(spp) for spp in found]) < 34
    # Chosen per scene: within one the levels are more alike than between scenes.
    logs = np.log2(np.array(found, float)).mean(axis=1).reshape(600, 4)
    assert logs.mean(axis=1).std() > 1.5 * logs.std(axis=1).mean()


def test_the_documentation_has_every_key_with_its_default():
    text = (Path(__file__).parents[2] / "docs" / "reference" / "dataset_recipe.md").read_text()
    text = text.partition("## Recipes")[2]
    table = [line for line in text.splitlines() if line.startswith("| `")]
    told = {}
    for line in table:
        keys, defaults, _ = (cell.strip() for cell in line[1:-1].split("|", 2))
        defaults = defaults.strip("`")
        names = [key.strip("` ") for key in keys.split(",")]
        values = json.loads(f"[{defaults}]") if defaults[:1] in tuple('0123456789["t') else []
        told.update(dict(zip(names, values, strict=False)) if values else dict.fromkeys(names))
        if len(values) == 1:
            told.update(dict.fromkeys(names, values[0]))
    recipe = Recipe(name="x", seed=1)
    for key, default in recipe.as_dict().items():
        if key in ("name", "seed"):
            continue
        assert key in told, f"docs/reference/dataset_recipe.md lacks '{key}'"
        if default:
            assert told[key] == default, key
