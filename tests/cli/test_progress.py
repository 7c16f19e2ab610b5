"""Progress must stay silent for short work and be sparse in a log."""

from __future__ import annotations

import time

import pytest

from lambent.cli import progress as module
from lambent.cli.progress import Progress, show_seconds


def test_short_work_shows_nothing(capsys):
    with Progress("short") as progress:
        progress.report(1, 2, "filtering")
    assert capsys.readouterr().err == ""


def test_a_log_gets_plain_lines_with_time_left(capsys, monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.05)
    monkeypatch.setattr(module, "LOG_EVERY", 30.0)
    with Progress("long") as progress:
        progress.report(0, 4, "filtering")
        time.sleep(0.02)
        progress.report(1, 4, "filtering")
        time.sleep(0.15)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("long: filtering, 25 %, ")
    assert lines[0].endswith(" left")


def test_time_left_follows_the_pace():
    progress = Progress("x")
    assert progress.seconds_left() is None
    progress.report(0, 10, "filtering")
    time.sleep(0.05)
    progress.report(5, 10, "filtering")
    assert progress.seconds_left() == pytest.approx(0.05, abs=0.04)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.314, "0.31 s"), (3.14, "3.1 s"), (42.4, "42 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")],
)
def test_seconds_read_well(seconds, text):
    assert show_seconds(seconds) == text
