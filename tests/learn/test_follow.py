"""Training on a data set that grows."""

import hashlib
import time

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
from lambent.learn.loop import train
from lambent.learn.recipe import TrainRecipe

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
        held_out=0.0, data=(str(data),), options={"follow": True, "resident": True},
    )  # fmt: skip
    place = tmp_path / "cache"
    task = denoising_task(recipe, place)
    try:
        assert len(task.train.stills) == 2
        train(recipe, task, tmp_path / "run", "cpu", steps=1)
        add(data, 2)
        deadline = time.monotonic() + 120
        while len(cached(data, place, unpack=False)) < 3:
            assert time.monotonic() < deadline, "nobody unpacks"
            time.sleep(0.2)
        train(recipe, task, tmp_path / "run", "cpu", steps=2)
        assert len(task._residents) == 3
    finally:
        task.close()
    assert not any(process.is_alive() for process in task._follower._processes)
    assert torch.load(tmp_path / "run" / "state.pt", weights_only=True)["step"] == 2
