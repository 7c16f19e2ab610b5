"""Which files a sequence is, where results go, and what counts as finished."""

from __future__ import annotations

from pathlib import Path

import pytest

from lambent.denoise.sequence import _output_for, is_sequence, listed_jobs
from lambent.errors import FileError, OutputError


def test_patterns_globs_and_folders_are_sequences(tmp_path):
    assert is_sequence("shot.####.exr")
    assert is_sequence("shot.%04d.exr")
    assert is_sequence("shot.*.exr")
    assert is_sequence(tmp_path)
    assert not is_sequence("shot.0001.exr")


def test_a_file_whose_name_looks_like_a_pattern_is_a_file(tmp_path):
    odd = tmp_path / "take#1.exr"
    odd.write_bytes(b"")
    assert not is_sequence(odd)


@pytest.mark.parametrize(
    ("name", "output", "expected"),
    [
        ("shot.0007.exr", None, "shot_clean.0007.exr"),
        ("noisy_07.exr", None, "noisy_clean_07.exr"),
        ("shot.0007.exr", "out/c.####.exr", "out/c.0007.exr"),
        ("shot.0007.exr", "out/c.%03d.exr", "out/c.007.exr"),
        ("shot.0007.exr", "out", "out/shot.0007.exr"),
    ],
)
def test_outputs_are_sequences_too(name, output, expected):
    assert _output_for(Path(name), 7, "shot.####.exr", output) == Path(expected)


def test_many_frames_do_not_go_into_one_file():
    with pytest.raises(OutputError, match="many frames") as caught:
        _output_for(Path("shot.0007.exr"), 7, "shot.####.exr", "out.exr")
    assert "out.####.exr" in caught.value.remedy


def test_a_missing_file_in_a_list_is_named(tmp_path):
    with pytest.raises(FileError, match="absent"):
        listed_jobs([tmp_path / "absent.exr"])
