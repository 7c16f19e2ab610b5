"""The loop: exact resuming, over-fitting, several processes, what it refuses."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.errors import DamagedFileError, FileError, OptionError
from lambent.learn import losses
from lambent.learn.batches import ready
from lambent.learn.denoising import Batch, DenoisingTask
from lambent.learn.networks.lambent import LambentNet, denoised
from lambent.learn.recipe import TrainRecipe
from lambent.learn.rows import Example, rows_of
from lambent.learn.train import train_task as train

RECIPE = TrainRecipe(
    name="test", size="fast", steps=6, batch=2, warmup=2, check_every=6, checked=4, held_out=0.0
)


@pytest.fixture
def task(tmp_path):
    return DenoisingTask(RECIPE, made.stills(tmp_path))


def same(a, b):
    return all(torch.equal(a[name], b[name]) for name in a)


def test_a_resumed_run_is_an_uninterrupted_one(task, tmp_path):
    whole = train(RECIPE, task, tmp_path / "whole", "cpu")
    for steps in (2, 3, 6):
        pieces = train(RECIPE, task, tmp_path / "pieces", "cpu", steps=steps)
    assert same(whole.weights(), pieces.weights())
    a, b = (torch.load(r.state, weights_only=True) for r in (whole, pieces))
    assert same(a["model"], b["model"])
    assert a["step"] == b["step"] == 6
    checks = [[ln["check"] for ln in r.lines() if "check" in ln][-1] for r in (whole, pieces)]
    assert checks[0] == checks[1]


@pytest.mark.parametrize("optimiser", ["momentum", "sgd"])
def test_descent_without_adam_resumes_too(optimiser, task, tmp_path):
    recipe = replace(RECIPE, optimiser=optimiser, rate=0.1)
    whole = train(recipe, task, tmp_path / "whole", "cpu")
    for steps in (3, 6):
        pieces = train(recipe, task, tmp_path / "pieces", "cpu", steps=steps)
    assert same(whole.weights(), pieces.weights())
    torch.manual_seed(recipe.seed)
    fresh = task.network().state_dict()
    assert not same(whole.weights(), fresh)


def test_two_processes_are_one(tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    made.stills(data)
    script = Path(__file__).with_name("parallel.py")
    for folder, count in (("one", 1), ("two", 2)):
        command = [sys.executable, str(script), str(data), str(tmp_path / folder)]
        if count == 2:
            run = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node=2"]
            command = [
                *run,
                "--master-port=0",
                "--rdzv-backend=c10d",
                "--rdzv-endpoint=localhost:0",
            ]
            command += [str(script), str(data), str(tmp_path / folder)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]
    one, two = (
        torch.load(tmp_path / name / "state.pt", weights_only=True)["model"]
        for name in ("one", "two")
    )
    torch.manual_seed(1)
    fresh = LambentNet("fast").state_dict()
    apart = sum(float((one[name] - two[name]).square().sum()) for name in one) ** 0.5
    moved = sum(float((one[name] - fresh[name]).square().sum()) for name in one) ** 0.5
    # bf16 rounds batches of two and of four differently, and Adam makes all steps equally long
    assert apart < 0.15 * moved, (apart, moved)


def test_it_overfits_one_crop():
    still = made.still(0)
    from lambent.denoise.inputs import MASKS, signals_of

    target = still.target.colour.transpose(2, 0, 1)
    example = Example(signals_of(still.levels[0]), target, np.zeros((1, 64, 64), np.float32))
    rows = rows_of([example])
    batch = Batch.of(*ready(rows, torch.ones(1, len(MASKS)), rows.spp, torch.zeros(1)))
    torch.manual_seed(0)
    model = LambentNet("fast")
    adam = torch.optim.Adam(model.parameters(), 2e-3)

    def error():
        x = denoised(model(batch.packed), batch.colour, batch.divisor)
        return losses.smape(x, batch.target).mean()

    first = float(error().detach())
    noisy = float(losses.smape(batch.colour, batch.target).mean())
    for _ in range(60):
        adam.zero_grad()
        loss = error()
        loss.backward()
        adam.step()
    last = float(loss.detach())
    assert last < 0.5 * first
    assert last < 0.15 * noisy


def test_another_recipe_is_refused(task, tmp_path):
    train(RECIPE, task, tmp_path / "run", "cpu", steps=1)
    with pytest.raises(OptionError, match="rate differ"):
        train(replace(RECIPE, rate=0.5), task, tmp_path / "run", "cpu")


def test_a_damaged_state_is_named(task, tmp_path):
    run = train(RECIPE, task, tmp_path / "run", "cpu", steps=1)
    run.state.write_bytes(run.state.read_bytes()[:1000])
    with pytest.raises(DamagedFileError, match=r"state\.pt"):
        train(RECIPE, task, tmp_path / "run", "cpu")


def test_a_run_of_an_earlier_network_is_named(task, tmp_path):
    run = train(RECIPE, task, tmp_path / "run", "cpu", steps=1)
    state = torch.load(run.state, weights_only=True)
    del state["model"]["albedo.weight"]
    torch.save(state, run.state)
    with pytest.raises(FileError, match=r"state\.pt.*another network"):
        train(RECIPE, task, tmp_path / "run", "cpu")


def test_the_run_folder_says_what_was_done(task, tmp_path):
    run = train(RECIPE, task, tmp_path / "run", "cpu")
    assert run.recipe() == RECIPE.as_dict()
    about = json.loads((run.folder / "run.json").read_text())
    assert about["torch"] == torch.__version__
    assert about["seconds"] > 0
    assert [line["step"] for line in run.lines() if "check" in line] == [6]
    assert len(list((run.folder / "pictures").glob("*.png"))) == 3  # one a level


def test_a_run_by_the_clock_is_not_bounded_by_steps(task, tmp_path, monkeypatch):
    now = iter(range(100_000))
    monkeypatch.setattr("lambent.training.loop.time.monotonic", lambda: float(next(now)))
    recipe = replace(RECIPE, steps=2, check_every=1000)
    said = []
    run = train(
        recipe, task, tmp_path / "run", "cpu", seconds=60.0,
        progress=lambda done, total, words: said.append((done, total)),
    )  # fmt: skip
    checks = [line["step"] for line in run.lines() if "check" in line]
    assert len(checks) == 1
    assert checks[0] > 2
    assert all(done <= total == 60.0 for done, total in said)


def test_of_time_and_steps_what_ends_first_counts(task, tmp_path):
    """And the rate is down by then, however much time is left."""
    run = train(RECIPE, task, tmp_path / "run", "cpu", seconds=1e6, steps=4)
    lines = run.lines()
    assert [line["step"] for line in lines if "check" in line] == [4]
    rates = [line["rate"] for line in lines if "rate" in line]
    state = torch.load(run.state, weights_only=True)
    assert state["step"] == 4
    assert state["optimiser"]["param_groups"][0]["lr"] < 0.5 * RECIPE.rate
    assert rates == sorted(rates, reverse=True)
