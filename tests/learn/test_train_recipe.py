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
    "line", ["steps = 0", 'steps = "many"', "rate = -1", "held_out = 2", 'data = "one"']
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
    with pytest.raises(FileError, match="no TOML"):
        load_train_recipe(written(tmp_path, "name = "))


def test_folders_count_from_the_recipe(tmp_path):
    recipe = load_train_recipe(written(tmp_path, 'name = "x"\ndata = ["sets/a"]\n'))
    assert recipe.data == (str(tmp_path / "sets" / "a"),)


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*.toml")), ids=lambda p: p.stem)
def test_our_own_recipes_load(path):
    assert load_train_recipe(path).steps > 1000
