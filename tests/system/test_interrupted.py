"""A run that is cut short, by a signal or a full disk, leaves nothing half-written and resumes."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

from lambent.cli import main

LAMBENT = [sys.executable, "-m", "lambent"]
COUNT = 12


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """Twelve frames, large enough that a signal arrives in the middle."""
    for number in range(1, COUNT + 1):
        renders.write(tmp_path / f"shot.{number:04d}.exr", renders.channels(270, 480, seed=number))
    return tmp_path


def command(folder: Path) -> list[str]:
    return [*LAMBENT, "denoise", str(folder / "shot.####.exr"), "-o", str(folder / "out")]


def start_and_wait_for(folder: Path, frames: int) -> subprocess.Popen[str]:
    """The command in the background, as soon as so many frames are written."""
    process = subprocess.Popen(
        command(folder),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=renders.heed_ctrl_c,
    )
    deadline = time.monotonic() + 60
    while len(list((folder / "out").glob("*.exr"))) < frames:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return process


def finished_frames(folder: Path) -> list[Path]:
    """The outputs, each of which must be a whole, readable file; and nothing beside them."""
    found = sorted((folder / "out").iterdir())
    for path in found:
        assert path.suffix == ".exr", f"{path} was left behind"
        assert renders.read(path)["R"].shape == (270, 480)
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]
    return found


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_signal_in_mid_sequence(sequence, number):
    process = start_and_wait_for(sequence, 2)
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode == 130
        assert "Traceback" not in err
        assert "interrupted" in err
    before = finished_frames(sequence)
    assert 2 <= len(before) < COUNT
    times = {p: p.stat().st_mtime_ns for p in before}

    done = subprocess.run(
        [*command(sequence), "--json"], capture_output=True, text=True, check=True
    )
    report = json.loads(done.stdout)
    assert len(report["skipped"]) == len(before)
    assert len(report["done"]) == COUNT - len(before)
    assert len(finished_frames(sequence)) == COUNT
    assert {p: p.stat().st_mtime_ns for p in before} == times, "a finished frame was made again"


def test_disk_full_part_way(tmp_path, monkeypatch, capsys):
    """The system says so when the bytes are to reach the disk; needs no special right."""

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    noisy = renders.write(tmp_path / "noisy.exr", renders.channels())
    monkeypatch.setattr("lambent.frame.atomic.os.fsync", full)
    assert main(["denoise", str(noisy), "--model", "oidn-fast"]) == 2
    text = capsys.readouterr().err
    assert "noisy_clean.exr" in text
    assert "make room" in text
    assert [p.name for p in tmp_path.iterdir()] == ["noisy.exr"]


def test_disk_really_full(tmp_path):
    """A file system of half a megabyte; needs the right to mount one."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(disk)]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if not mounted:
        pytest.skip("no right to mount a small disk")
    try:
        noisy = renders.write(tmp_path / "noisy.exr", renders.channels(270, 480))
        done = subprocess.run(
            [*LAMBENT, "denoise", str(noisy), "-o", str(disk / "out.exr"), "-m", "oidn-fast"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2, done.stderr
        assert "No space left" in done.stderr
        assert "make room" in done.stderr
        assert list(disk.iterdir()) == []
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_output_to_a_closed_pipe_is_no_error(tmp_path):
    """``lambent models | head -1``: the reader leaves early."""
    done = subprocess.run(
        f"{sys.executable} -m lambent models --json | head -1; exit ${{PIPESTATUS[0]}}",
        shell=True,
        executable="/bin/bash",
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert done.returncode in (0, 120)
    assert "Traceback" not in done.stderr
