"""Recipes of training runs: what is refused, and that the shipped ones load."""

from pathlib import Path

import pytest

from lambent.errors import FileError, OptionError
from lambent.learn.recipe import load_train_recipe

RECIPES = Path(__file__).resolve().parents[2] / "recipes" / "train"


def written(folder, text):
    path = folder / "r.toml"
    path.write_text(text)
    return path


def test_an_unknown_key_names_the_nearest(tmp_path):
    with pytest.raises(OptionError, match=r"r\.toml.*'stepps'[\s\S]*did you mean 'steps'"):
        load_train_recipe(written(tmp_path, 'name = "x"\nstepps = 3\n'))


@pytest.mark.parametrize(
    "line",
    [
        "steps = 0",
        'steps = "many"',
        "rate = -1",
        "held_out = 2",
        'data = "one"',
        'optimiser = "adagrad"',
        "options = 3",
    ],
)
def test_senseless_values_are_refused(tmp_path, line):
    with pytest.raises(OptionError):
        load_train_recipe(written(tmp_path, f'name = "x"\n{line}\n'))


def test_a_name_is_needed(tmp_path):
    with pytest.raises(OptionError, match="'name'"):
        load_train_recipe(written(tmp_path, "steps = 3\n"))


def test_missing_and_broken_files(tmp_path):
    with pytest.raises(FileError, match="no such recipe"):
        load_train_recipe(tmp_path / "none.toml")
    with pytest.raises(FileError, match="not valid TOML"):
        load_train_recipe(written(tmp_path, "name = "))


def test_folders_count_from_the_recipe(tmp_path):
    recipe = load_train_recipe(written(tmp_path, 'name = "x"\ndata = ["sets/a"]\n'))
    assert recipe.data == (str(tmp_path / "sets" / "a"),)


def test_options_are_the_task_s(tmp_path):
    text = 'name = "x"\noptimiser = "sgd"\n[options]\nwidth = 4\n'
    recipe = load_train_recipe(written(tmp_path, text))
    assert recipe.options == {"width": 4}
    assert recipe.optimiser == "sgd"


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*.toml")), ids=lambda p: p.stem)
def test_our_own_recipes_load(path):
    from lambent.learn.rendered import RenderedNetwork
    from lambent.learn.tasks import TASKS

    recipe = load_train_recipe(path)
    entry = TASKS[recipe.task]
    assert recipe.data
    options = entry.options_from(recipe.options)
    if recipe.task == "photo":
        assert options.patch < 64
    elif issubclass(entry.network, RenderedNetwork):
        assert entry.network(options).reach() < 256


def test_ranges_are_the_entry_s_own(tmp_path):
    """And name fields that the options have; what is wrong is said before any data are made."""
    from dataclasses import fields

    from lambent.learn.recipe import train_recipe_from
    from lambent.learn.tasks import TASKS
    from lambent.learn.train import train

    for name in TASKS:
        known = {field.name for field in fields(TASKS[name].options)}
        assert {key for key, _, _ in TASKS[name].ranges} <= known
        with pytest.raises(OptionError, match="no key 'colour_of_the_wall'"):
            TASKS[name].options_from({"colour_of_the_wall": 1})
    TASKS["blocks"].options_from({"patch": 64})
    settings = {"name": "x", "task": "kpcn", "data": ["none.toml"], "options": {"kernel": 99}}
    with pytest.raises(OptionError, match="kernel = 99 is out of range"):
        train(train_recipe_from(settings), tmp_path / "run")


def test_a_set_that_is_named_by_its_recipe_is_made_first(tmp_path, monkeypatch):
    from lambent.learn import data
    from lambent.learn.recipe import train_recipe_from

    monkeypatch.setenv("LAMBENT_CACHE", str(tmp_path / "cache"))
    source = tmp_path / "tiny.toml"
    source.write_text(
        'name = "tiny"\nseed = 5\ncount = 1\nitems_per_scene = 1\ncameras_per_scene = 1\n'
        "crop = 32\nview = [64, 48]\nspp = [1, 2]\nlevels = 1\nmean_spp = 1\ntarget_spp = 4\n"
        "target_most = 4\n"
    )
    recipe = train_recipe_from({"name": "x", "data": [str(source), str(tmp_path / "plain")]})
    seen = []
    found = data.with_data(recipe, progress=lambda *args: seen.append(args))
    folder = tmp_path / "cache" / "datasets" / "tiny"
    assert found.data == (str(folder), str(tmp_path / "plain"))
    assert len(list(folder.rglob("*.exr"))) + len(list((folder / "crops").rglob("*"))) > 0
    assert seen
    before = {p: p.stat().st_mtime for p in (folder / "crops").rglob("*")}
    assert data.with_data(recipe).data == found.data
    assert before == {p: p.stat().st_mtime for p in (folder / "crops").rglob("*")}


@pytest.mark.parametrize("task", ["denoise", "photo", "kpcn", "dpcn", "modular", "blocks"])
def test_every_task_asks_for_data(task, tmp_path):
    from lambent.learn.recipe import train_recipe_from
    from lambent.learn.tasks import TASKS

    with pytest.raises(OptionError, match="names no data"):
        TASKS[task].make(train_recipe_from({"name": "x", "task": task}), tmp_path)
