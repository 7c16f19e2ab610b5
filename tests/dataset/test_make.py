"""Making sets: the same whatever the way, whole after any end, mended when damaged."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fake import truth

import lambent.dataset
from conftest import write_recipe
from lambent.cli import main
from lambent.dataset import produce
from lambent.dataset.check import verify
from lambent.dataset.make import default_folder, make
from lambent.errors import FileError, OptionError
from lambent.frame.role import Role, Stat


def contents(folder: Path) -> dict[str, str]:
    """Every item file with the hash of what is in it."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for kind in ("crops", "clips")
        for path in sorted((folder / kind).rglob("*"))
        if path.is_file()
    }


def lines(folder: Path) -> list[dict]:
    """The list of items without what depends on the clock."""
    found = [json.loads(line) for line in (folder / "items.jsonl").read_text().splitlines()]
    return [{k: v for k, v in line.items() if k != "seconds"} for line in found]


@pytest.fixture
def made(recipe, tmp_path) -> Path:
    """A set, made without interruption."""
    outcome = make(recipe, tmp_path / "set")
    assert (outcome.made, outcome.left, outcome.failed) == (13, 0, [])
    return tmp_path / "set"


def test_the_set_is_read_back(made, recipe):
    dataset = lambent.dataset.open(made)
    assert len(dataset) == 13
    assert (dataset.crops, dataset.clips) == (range(10), range(10, 13))
    item = dataset[4]
    assert item.about["index"] == 4
    assert tuple(f.spp for f in item.levels) == tuple(item.about["spp"])
    assert item.levels[0].colour.shape == (32, 32, 3)
    assert item.target.spp == item.about["target_spp"][0] >= 32
    assert item.target.has(Role.COLOUR, Stat.VARIANCE)
    clip = dataset.find("clip", 2)
    assert len(clip.stills) == recipe.clip_frames
    assert all(s.target.has(Role.MOTION) for s in clip.stills)
    with pytest.raises(IndexError):
        dataset[13]
    with pytest.raises(OptionError, match="no crop 77"):
        dataset.find("crop", 77)


def test_noise_is_independent_between_levels_and_target(recipe, tmp_path):
    """The fake's noise is a factor for each pixel; those of two pictures must not correlate.

    Three correlations over N pixels, each within 4 / sqrt(N): false alarm 2 in 10,000.
    """
    recipe = dataclasses.replace(
        recipe, count=16, clip_count=0, levels=2, spp=(2, 4), mean_spp=3, target_spp=8,
        target_most=8, uniform=0.0,
    )  # fmt: skip
    make(recipe, tmp_path / "set")
    factors: list[list[np.ndarray]] = [[], [], []]
    for item in lambent.dataset.open(tmp_path / "set"):
        layers, middle = truth(item.about["seed"] + item.about["camera"], recipe.view)
        x, y, edge = item.about["window"]
        cut = np.s_[y : y + edge, x : x + edge]
        noisy = (middle[cut] > 0) & (layers[Role.COLOUR][cut][..., 0] > 0)
        for listed, frame in zip(factors, (*item.levels, item.target), strict=True):
            listed.append(frame.colour[..., 0][noisy] / layers[Role.COLOUR][cut][..., 0][noisy])
    table = np.corrcoef([np.concatenate(f) for f in factors])
    count = sum(map(len, factors[0]))
    assert count > 2000
    assert np.abs(table[np.triu_indices(3, 1)]).max() < 4 / np.sqrt(count)


def test_the_number_of_processes_changes_nothing(recipe, made, tmp_path):
    make(recipe, tmp_path / "two", processes=2)
    assert contents(tmp_path / "two") == contents(made)
    assert lines(tmp_path / "two") == lines(made)


def test_the_size_of_the_batch_changes_nothing(recipe, made, tmp_path, monkeypatch):
    from lambent.dataset import workers

    for size in (1, 3):
        monkeypatch.setattr(
            workers, "attempt", lambda *args, size=size: produce.attempt(*args, batch=size)
        )
        make(recipe, tmp_path / f"by{size}")
        assert contents(tmp_path / f"by{size}") == contents(made)


def test_growing_keeps_what_is_there(recipe, made, tmp_path):
    small = dataclasses.replace(recipe, count=3, clip_count=1)
    outcome = make(small, tmp_path / "grown")
    assert outcome.made == 4
    times = {p: p.stat().st_mtime_ns for p in (tmp_path / "grown").rglob("*.exr")}
    outcome = make(recipe, tmp_path / "grown")
    assert (outcome.before, outcome.made) == (4, 9)
    assert contents(tmp_path / "grown") == contents(made)
    assert all(p.stat().st_mtime_ns == t for p, t in times.items())
    manifest = json.loads((tmp_path / "grown" / "manifest.json").read_text())
    assert manifest["recipe"]["count"] == 10
    assert manifest["licences"] == ["CC0-1.0"]


def test_another_recipe_is_refused(recipe, made):
    with pytest.raises(OptionError, match="different: target_spp"):
        make(dataclasses.replace(recipe, target_spp=64), made)


def test_time_is_kept(recipe, tmp_path):
    outcome = make(recipe, tmp_path / "set", seconds=1e-6)
    assert outcome.made == 1
    assert outcome.left == 12
    assert verify(tmp_path / "set").sound


def test_damage_is_named_and_mended(recipe, made):
    before = contents(made)
    flipped = made / "crops/000/000004.exr"
    content = bytearray(flipped.read_bytes())
    content[len(content) // 2] ^= 0x10
    flipped.write_bytes(content)
    (made / "crops/000/000007.exr").write_bytes(b"short")
    (made / "clips/000/000001.exr").unlink()
    (made / "crops/000/stranger.exr").write_bytes(b"?")
    (made / "crops/000/.000001.exr.abc.part").write_bytes(b"left by a kill")
    verdict = verify(made)
    assert set(verdict.corrupt) == {"crops/000/000004.exr", "crops/000/000007.exr"}
    assert verdict.missing == ("clips/000/000001.exr",)
    assert verdict.strangers == ("crops/000/stranger.exr",)
    assert verdict.good == 10
    with pytest.raises(FileError, match="missing"):
        lambent.dataset.open(made).find("clip", 1)
    outcome = make(recipe, made)
    assert outcome.made == 3
    assert sum("made again" in note for note in outcome.notes) == 3
    (made / "crops/000/stranger.exr").unlink()
    assert contents(made) == before
    assert verify(made).sound


def test_a_file_whose_line_was_lost_is_taken_up(recipe, made):
    before, listed = contents(made), lines(made)
    text = (made / "items.jsonl").read_text().splitlines(keepends=True)
    (made / "items.jsonl").write_text("".join(text[:6]) + text[6][:40])
    outcome = make(recipe, made)
    assert (outcome.made, outcome.notes) == (0, [])
    assert contents(made) == before
    assert lines(made) == listed


def test_a_file_of_another_set_is_not_taken_up(recipe, made, tmp_path):
    other = dataclasses.replace(recipe, seed=77)
    make(other, tmp_path / "other")
    before = contents(made)
    victim = made / "crops/000/000002.exr"
    victim.write_bytes((tmp_path / "other/crops/000/000002.exr").read_bytes())
    text = [x for x in (made / "items.jsonl").read_text().splitlines(True) if '"000002' not in x]
    text = [x for x in text if "000002.exr" not in x]
    (made / "items.jsonl").write_text("".join(text))
    assert make(recipe, made).made >= 1
    assert contents(made) == before


def test_two_at_once_are_refused(recipe, made):
    from lambent.dataset.folder import writing

    with writing(made), pytest.raises(FileError, match="another process"):
        make(recipe, made)
    assert make(recipe, made).made == 0, "the lock outlived its holder"


def test_a_scene_that_fails_does_not_stop_the_others(recipe, tmp_path):
    broken = dataclasses.replace(recipe, source="fake:BrokenSource", clip_count=0)
    outcome = make(broken, tmp_path / "set")
    (failed,) = outcome.failed
    assert failed.job.items == (0, 1, 2, 3)
    assert "no such plug-in" in failed.reason
    assert outcome.made == 6
    assert outcome.left == 4


def test_a_process_that_dies_costs_nothing_but_its_item(recipe, tmp_path, monkeypatch):
    crashing = dataclasses.replace(recipe, kinds=("crash",))
    make(crashing, tmp_path / "whole")
    monkeypatch.setenv("LAMBENT_FAKE_CRASH", str(tmp_path / "crashed"))
    outcome = make(crashing, tmp_path / "crashing", processes=2)
    assert (tmp_path / "crashed").exists()
    assert (outcome.made, outcome.failed) == (13, [])
    assert contents(tmp_path / "crashing") == contents(tmp_path / "whole")


def test_default_folder_is_in_the_cache(recipe, monkeypatch, tmp_path):
    monkeypatch.setenv("LAMBENT_CACHE", str(tmp_path))
    assert default_folder(recipe) == tmp_path / "datasets" / "fake"


# ------------------------------------------------------------------- killed


COMMAND = [sys.executable, "-m", "lambent", "dataset", "make"]


def start(recipe_file: Path, folder: Path, *options: str) -> subprocess.Popen:
    environment = {**os.environ, "LAMBENT_FAKE_SLEEP": "0.01"}
    return subprocess.Popen(
        [*COMMAND, str(recipe_file), "-o", str(folder), *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        # A shell's background jobs ignore SIGINT, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


@pytest.mark.parametrize("options", [(), ("--processes", "2")])
def test_killed_at_ten_moments(recipe, made, tmp_path, options):
    """Kill -9 at random moments, from the start of the work on; then let it finish."""
    folder = tmp_path / "killed"
    recipe_file = write_recipe(tmp_path / "recipe.toml", recipe)
    rng = np.random.default_rng(8)
    interrupted = 0
    for _ in range(10 if not options else 3):
        process = start(recipe_file, folder, *options)
        deadline = time.monotonic() + 30
        before = len(list(folder.rglob("*.exr")))
        while len(list(folder.rglob("*.exr"))) == before and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        time.sleep(float(rng.uniform(0, 0.05)))
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=30)
        interrupted += process.returncode == -signal.SIGKILL
        for path in folder.rglob("*.exr"):
            assert contents(made)[path.relative_to(folder).as_posix()] == (
                hashlib.sha256(path.read_bytes()).hexdigest()
            ), "a file that is there is not whole"
    assert interrupted >= 2
    process = start(recipe_file, folder, *options)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert contents(folder) == contents(made)
    assert lines(folder) == lines(made)
    assert not [p for p in folder.rglob(".*") if p.name != ".lock"]


@pytest.mark.parametrize("options", [(), ("--processes", "2")])
def test_ctrl_c_says_how_to_go_on(recipe, made, tmp_path, options):
    folder = tmp_path / "stopped"
    recipe_file = write_recipe(tmp_path / "recipe.toml", recipe)
    process = start(recipe_file, folder, *options)
    deadline = time.monotonic() + 30
    while not list(folder.rglob("*.exr")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "the same command goes on" in err
    assert "Traceback" not in err
    assert verify(folder).sound
    assert main(["dataset", "make", str(recipe_file), "-o", str(folder)]) == 0
    assert contents(folder) == contents(made)


def test_a_part_of_a_set_is_the_same_part_of_the_whole(made, recipe, tmp_path):
    place = tmp_path / "part"
    outcome = make(recipe, place, first=6, first_clip=2)
    assert (outcome.made, outcome.left) == (5, 0)
    whole, part = contents(made), contents(place)
    assert len(part) == 5
    assert all(whole[name] == digest for name, digest in part.items())
    again = make(recipe, place, first=6, first_clip=2)
    assert (again.made, again.before, again.left) == (0, 5, 0)
    rest = make(recipe, place)
    assert rest.made == 8
    assert contents(place) == whole
    with pytest.raises(OptionError, match="numbered from 0"):
        make(recipe, place, first=-1)
