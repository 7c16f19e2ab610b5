"""Which files a sequence is, where results go, and what counts as finished."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lambent.denoise.files import denoise_file
from lambent.denoise.pipeline import Settings
from lambent.denoise.sequence import (
    _output_for,
    denoise_sequence,
    find_jobs,
    is_sequence,
    listed_jobs,
    sort_out,
)
from lambent.errors import FileError, OutputError
from lambent.frame.files import write
from lambent.frame.frame import Frame


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


# ------------------------------------------------------- files that are left out


def names(selection) -> list[str]:
    return [job.source.name for job in selection.jobs]


def left_out(selection) -> dict[str, str]:
    return {path.name: why for path, why in selection.left_out.items()}


@pytest.fixture
def cleaned(tmp_path) -> Path:
    """A folder in which a command has been: its results lie beside their inputs."""
    rng = np.random.default_rng(0)
    for name in ("room.exr", "shot.0001.exr", "shot.0002.exr"):
        image = rng.gamma(2.0, 0.5, (8, 8, 3)).astype(np.float32)
        write(tmp_path / name, Frame.from_arrays(colour=image))
    denoise_file(tmp_path / "room.exr", model="box")
    denoise_sequence(tmp_path / "shot.####.exr", model="box")
    return tmp_path


def test_results_of_an_earlier_command_are_not_cleaned_again(cleaned):
    results = {"room_clean.exr", "shot_clean.0001.exr", "shot_clean.0002.exr"}
    everything = sorted(cleaned.glob("*.exr"))
    for found in (find_jobs(cleaned), listed_jobs(everything)):
        assert names(found) == ["room.exr", "shot.0001.exr", "shot.0002.exr"]
        assert left_out(found) == dict.fromkeys(results, "made by an earlier command")
    found = find_jobs(cleaned / "shot*.exr")
    assert names(found) == ["shot.0001.exr", "shot.0002.exr"]
    assert set(left_out(found)) == results - {"room_clean.exr"}


def test_a_clean_plate_is_no_result(cleaned):
    """The name alone does not make an EXR ours; and then its place is taken."""
    plate = cleaned / "room_clean.exr"
    plate.write_bytes((cleaned / "room.exr").read_bytes())
    assert "room_clean.exr" in names(find_jobs(cleaned))
    with pytest.raises(OutputError, match=r"is an input(.|\n)*room\.exr"):
        sort_out(listed_jobs([cleaned / "room.exr", plate]).jobs, Settings.checked(), True)


def test_previews_and_other_pictures_in_a_folder_are_named(cleaned):
    for name in ("room_clean_preview.png", "paint.tif", ".hidden.exr"):
        (cleaned / name).touch()
    (cleaned / "._room.exr").write_bytes(b"\0\5\x16\7")  # macOS: AppleDouble
    (cleaned / "gone.exr").symlink_to("nowhere.exr")
    found = left_out(find_jobs(cleaned))
    assert found["room_clean_preview.png"] == "made by an earlier command"
    assert found["paint.tif"] == "no EXR"
    assert found[".hidden.exr"] == "hidden"
    assert found["gone.exr"] == "no file"
    assert "._room.exr" not in found
    assert "._room.exr" not in names(find_jobs(cleaned))


def test_frames_with_other_padding_are_named(tmp_path):
    for name in ("shot.0001.exr", "shot.2.exr", "shot.final.exr"):
        (tmp_path / name).touch()
    found = find_jobs(tmp_path / "shot.####.exr")
    assert names(found) == ["shot.0001.exr"]
    assert left_out(found) == {"shot.2.exr": "its number is padded otherwise"}
    found = find_jobs(tmp_path / "shot.*.exr")
    assert names(found) == ["shot.0001.exr", "shot.2.exr"]
    assert left_out(found) == {"shot.final.exr": "without a frame number"}


@pytest.mark.parametrize("pattern", ["shot.*.exr", "."])
def test_two_files_with_one_number_are_refused_with_both_names(tmp_path, pattern):
    for name in ("shot.1.exr", "shot.0001.exr", "shot.0002.exr"):
        (tmp_path / name).touch()
    with pytest.raises(FileError, match=r"'shot\.0001\.exr' and 'shot\.1\.exr' are both frame 1"):
        find_jobs(tmp_path / pattern, "1-2")
    assert names(find_jobs(tmp_path / pattern, "2")) == ["shot.0002.exr"]


def test_two_negative_numbers_of_one_value_are_refused(tmp_path):
    for name in ("s.-001.exr", "s.-0001.exr"):
        (tmp_path / name).touch()
    with pytest.raises(FileError, match=r"both frame -1"):
        find_jobs(tmp_path / "s.####.exr")
