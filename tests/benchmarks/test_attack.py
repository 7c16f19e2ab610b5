"""The attack, a few tries of each kind: the table counts what happens, and failures are seen."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
sys.path.insert(0, str(FOLDER))

import attack
import attack_files as files
import attack_tries as tries


def rows(text: str) -> dict[str, list[str]]:
    """The cells of the table by kind."""
    lines = [line.strip("| \n").split("|") for line in text.splitlines() if line.startswith("| ")]
    return {cells[0].strip(): [c.strip() for c in cells[1:]] for cells in lines[1:]}


def test_a_few_of_each_kind(capfd):
    code = attack.main(
        ["--scale", "0.003", "--only", "exr,roundtrips,pictures,models", "--jobs", "1"]
    )
    text = capfd.readouterr().out
    assert code == 0, text
    found = rows(text)
    assert {kind: int(cells[0]) for kind, cells in found.items()} == {
        "exr": 30, "roundtrips": 3, "pictures": 12, "models": 1,
    }  # fmt: skip
    for cells in found.values():
        assert int(cells[1]) + int(cells[2]) == int(cells[0])
        assert cells[3:6] == ["0", "0", "0"]
    assert int(found["exr"][1]) > 10


def test_a_kill_and_exit_codes(capfd):
    code = attack.main(["--scale", "0.002", "--only", "kills,exits"])
    text = capfd.readouterr().out
    assert code == 0, text
    assert [cells[0] for cells in rows(text).values()] == ["1", "2"]


def test_the_same_number_is_the_same_file():
    for make in (files.exr_mutant, files.picture_mutant, files.crafted_model):
        one, two, other = (make(tries.generator(4, "exr", n)) for n in (9, 9, 10))
        assert one == two
        assert one != other


@pytest.mark.parametrize("storage", files.STORAGES)
def test_sound_files_are_sound(storage, tmp_path):
    """What a round trip begins with is read by Lambent, every level of it."""
    from lambent.frame.exr import decode

    path = tmp_path / "a.exr"
    for order in files.ORDERS:
        path.write_bytes(files.exr(np.random.default_rng(1), "ZIP_COMPRESSION", storage, order))
        found = tries.levels(decode(path))
        assert {part for part, *_ in found} == set(range(files.STORAGES[storage][1]))
        assert (len({key[1:3] for key in found}) > 1) == ("p " in storage)


def test_a_lost_byte_is_counted(tmp_path):
    paths = tmp_path / "a.exr", tmp_path / "b.exr"
    raw = bytearray(files.exr(np.random.default_rng(1), "NO_COMPRESSION", "scanline"))
    paths[0].write_bytes(raw)
    raw[-3] ^= 1
    paths[1].write_bytes(raw)
    lost, words = tries.lost_between(*paths, set())
    assert lost == 1
    assert "channel" in words


PROCESS = """
import os, sys, time
print("ready", flush=True)
for line in sys.stdin:
    if int(line) == 2:
        {code}
    print('{{"end": "accepted", "lost": 0, "words": "", "peak": 1}}', flush=True)
"""


@pytest.mark.parametrize(("code", "end"), [("os.abort()", "crash"), ("time.sleep(60)", "hang")])
def test_a_dead_or_endless_process_is_counted_and_begun_again(code, end, tmp_path, monkeypatch):
    """A process that fails at its third try, in place of the one that a bad file would break."""
    (tmp_path / "attack_tries.py").write_text(PROCESS.format(code=code))
    monkeypatch.setattr(attack, "HERE", tmp_path)
    options = attack.Options(1, 3.0, 8 << 30, 1, None, tmp_path)
    tally = attack.attack_files("pictures", list(range(5)), options)
    assert (tally.tries, tally.accepted) == (5, 4)
    assert (tally.crashes, tally.hangs) == ((1, 0) if end == "crash" else (0, 1))
    assert "number 2" in tally.failures[0]


def test_half_written_files_are_seen(tmp_path):
    for path in attack.fill(tmp_path).glob("*.exr"):
        assert bool(attack.broken(path)) == (path.name == "cut.exr")
    page = tmp_path / "page.html"
    page.write_text("<html><body>")
    assert attack.broken(page) == 12


def test_an_unknown_kind_is_refused():
    done = subprocess.run(
        [sys.executable, str(FOLDER / "attack.py"), "--only", "exes"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "no kind exes" in done.stderr
