"""Training on a data set that grows."""

import hashlib
import time
from dataclasses import replace

import made
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.dataset.folder import add_item, begin, line_of
from lambent.dataset.item import Item
from lambent.dataset.pack import packed
from lambent.dataset.recipe import Recipe
from lambent.learn.cache import cached
from lambent.learn.denoising import denoising_task
from lambent.learn.recipe import TrainRecipe
from lambent.learn.train import train_task as train

SET = Recipe(name="growing", seed=1, count=8, crop=64)


def add(folder, index):
    about = {"what": "crop", "index": index, "seed": index, "essence": SET.essence}
    content = packed(Item((made.still(index),), about))
    line = line_of(about, hashlib.sha256(content).hexdigest(), len(content), None)
    add_item(folder, line, content)


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "growing"
    folder.mkdir()
    begin(folder, SET, {"versions": {}})
    for index in range(2):
        add(folder, index)
    return folder


def test_only_what_is_unpacked_is_found(data, tmp_path):
    assert cached(data, tmp_path / "cache", unpack=False) == []
    assert len(cached(data, tmp_path / "cache")) == 2
    add(data, 2)
    assert len(cached(data, tmp_path / "cache", unpack=False)) == 2
    assert len(cached(data, tmp_path / "cache")) == 3


def test_a_run_takes_in_what_is_added(data, tmp_path, monkeypatch):
    monkeypatch.setattr("lambent.learn.denoising.LOOK_EVERY", 0.0)
    recipe = TrainRecipe(
        name="follows", size="fast", steps=2, batch=2, warmup=1, check_every=100, checked=2,
        held_out=0.0, data=(str(data),), options={"follow": True},
    )  # fmt: skip
    place = tmp_path / "cache"
    task = denoising_task(recipe, place)
    try:
        assert len(task.stills) == 2
        train(recipe, task, tmp_path / "run", "cpu", steps=1)
        add(data, 2)
        deadline = time.monotonic() + 120
        while len(cached(data, place, unpack=False)) < 3:
            assert time.monotonic() < deadline, "nobody unpacks"
            time.sleep(0.2)
        train(recipe, task, tmp_path / "run", "cpu", steps=2)
        assert len(task.stills) == 3
    finally:
        task.close()
    assert not any(process.is_alive() for process in task._follower._processes)
    assert torch.load(tmp_path / "run" / "state.pt", weights_only=True)["step"] == 2


def test_a_run_that_began_with_weights_goes_on_with_its_own(data, tmp_path, monkeypatch):
    from lambent.denoise.model_file import read_model
    from lambent.learn.account import before
    from lambent.learn.train import train as verb
    from lambent.training.run import Run

    monkeypatch.setenv("LAMBENT_CACHE", str(tmp_path / "cache"))
    recipe = TrainRecipe(
        name="float", size="fast", steps=2, batch=2, warmup=1, check_every=2, checked=2,
        held_out=0.0, data=(str(data),),
    )  # fmt: skip
    first = verb(recipe, tmp_path / "float", device="cpu")
    rounded = replace(recipe, name="int8", options={"int8": True})
    for steps in (1, 2):
        verb(
            rounded, tmp_path / "int8", device="cpu", start=str(first.folder), steps=steps,
            output=tmp_path / "int8.lambent" if steps == 2 else None,
        )  # fmt: skip
    run = Run(tmp_path / "int8")
    assert [told["name"] for told in before(run)] == ["float"]
    card = read_model(tmp_path / "int8.lambent").card
    assert card["int8"] is True
    assert [told["recipe"]["size"] for told in card["begun_with"]] == ["fast"]
    assert card["begun_with"][0]["step"] == card["step"] == 2
    again = verb(replace(recipe, name="more"), tmp_path / "more", device="cpu", steps=1,
                 start=str(tmp_path / "int8.lambent"))  # fmt: skip
    assert [told["name"] for told in before(again)] == ["float", "int8"]
