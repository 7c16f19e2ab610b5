"""Which files a pattern means: holes, ranges, negative numbers, several sequences in one place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lambent.errors import FileError, OptionError
from lambent.frame.sequence import Sequence, format_range, parse_range, put_number


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two sequences, one with a hole, a still, and things that are no pictures."""
    for n in (1, 2, 3, 5, 6):
        (tmp_path / f"shot_v002.{n:04d}.exr").touch()
    for n in range(3):
        (tmp_path / f"albedo-{n}.exr").touch()
    for name in ("still.exr", "notes.0001.txt", ".shot_v002.0004.exr"):
        (tmp_path / name).touch()
    return tmp_path


@pytest.mark.parametrize(
    "pattern",
    [
        "shot_v002.####.exr",
        "shot_v002.%04d.exr",
        "shot_v002.$F4.exr",
        "shot_v002.*.exr",
        "shot_v002.000[1-9].exr",
        "shot_v002.0003.exr",
    ],
)
def test_every_way_to_name_it(folder: Path, pattern: str) -> None:
    """The version number in the name is not taken for the frame number."""
    sequence = Sequence.find(folder / pattern)
    assert list(sequence) == [1, 2, 3, 5, 6]
    assert sequence.missing == (4,)
    assert sequence.span == "1-3,5-6"
    assert sequence[5] == folder / "shot_v002.0005.exr"
    assert Path(sequence.pattern).name == "shot_v002.####.exr"


def test_ranges_and_holes(folder: Path) -> None:
    sequence = Sequence.find(folder / "shot_v002.####.exr", "1-5x2,4,7")
    assert list(sequence) == [1, 3, 5]
    assert sequence.missing == (4, 7)
    with pytest.raises(FileError, match="frames 4,7 are missing") as caught:
        sequence.complete()
    assert "--frames 1,3,5" in str(caught.value)
    assert Sequence.find(folder / "shot_v002.####.exr", "1-3").complete().missing == ()
    with pytest.raises(FileError, match=r"no frame of 20-30(.|\n)*1-3,5-6"):
        Sequence.find(folder / "shot_v002.####.exr", "20-30")
    with pytest.raises(FileError, match="frame 4 is missing"):
        sequence.read(4)


def test_folder_with_several_sequences(folder: Path) -> None:
    """They are grouped; finding *the* sequence there is an error that lists them."""
    found = Sequence.find_all(folder)
    assert [(Path(s.pattern).name, len(s)) for s in found] == [
        ("albedo-#.exr", 3),
        ("shot_v002.####.exr", 5),
    ]
    with pytest.raises(FileError, match=r"2 sequences.*albedo-#\.exr \(0-2\)"):
        Sequence.find(folder)


def test_no_match_says_what_there_is(folder: Path) -> None:
    with pytest.raises(FileError, match=r"no file matches(.|\n)*albedo-#\.exr"):
        Sequence.find(folder / "shoot.####.exr")
    with pytest.raises(FileError, match="does not exist"):
        Sequence.find(folder / "nowhere" / "shot.####.exr")
    with pytest.raises(FileError, match="no such file"):
        Sequence.find(folder / "shot.exr")
    with pytest.raises(OptionError, match="folder's name"):
        Sequence.find(folder / "v%02d" / "shot.exr")
    (folder / "empty").mkdir()
    with pytest.raises(FileError, match="no numbered picture"):
        Sequence.find(folder / "empty")


def test_negative_numbers(tmp_path: Path) -> None:
    """As printf pads them, and as other programs do; a dash in a name is no minus."""
    for name in ("s.-002.exr", "s.-0001.exr", "s.0000.exr", "s.0001.exr"):
        (tmp_path / name).touch()
    for pattern in ("s.####.exr", "s.*.exr", "s.0001.exr"):
        assert list(Sequence.find(tmp_path / pattern)) == [-2, -1, 0, 1]
    assert put_number("s.####.exr", -2) == "s.-002.exr"
    (tmp_path / "take-7.exr").touch()
    assert list(Sequence.find(tmp_path / "take-#.exr")) == [7]
    assert list(Sequence.find(tmp_path / "take-7.exr")) == [7]


def test_padding(tmp_path: Path) -> None:
    """More digits than hashes are fine where printf would write them; fewer are another name."""
    for name in ("a.0999.exr", "a.10000.exr", "a.7.exr"):
        (tmp_path / name).touch()
    assert list(Sequence.find(tmp_path / "a.####.exr")) == [999, 10000]
    assert list(Sequence.find(tmp_path / "a.%d.exr")) == [7, 10000]


def test_names_of_results(folder: Path) -> None:
    sequence = Sequence.find(folder / "shot_v002.####.exr")
    assert sequence.path_for(5, "out/clean.%03d.exr") == Path("out/clean.005.exr")
    assert sequence.path_for(5, "clean.##.png") == Path("clean.05.png")
    assert sequence.path_for(5, folder) == folder / "shot_v002.0005.exr"
    assert sequence.path_for(4, folder) == folder / "shot_v002.0004.exr"
    assert sequence.path_for(5, "new/") == Path("new/shot_v002.0005.exr")
    with pytest.raises(OptionError, match=r"no place(.|\n)*clean\.####\.exr"):
        sequence.path_for(5, "clean.exr")


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("7", (7,)),
        ("1-5", (1, 2, 3, 4, 5)),
        ("1-10x4", (1, 5, 9)),
        ("3,1,3", (1, 3)),
        ("-5--3", (-5, -4, -3)),
        ("-1-1", (-1, 0, 1)),
        (" 1 - 2 , 9", (1, 2, 9)),
    ],
)
def test_ranges(text: str, numbers: tuple[int, ...]) -> None:
    assert parse_range(text) == numbers
    assert parse_range(format_range(numbers)) == numbers


@pytest.mark.parametrize("text", ["", "a", "1-", "5-1", "1-5x0", "1-9999999999", "1..5", "1,,2"])
def test_bad_ranges(text: str) -> None:
    with pytest.raises(OptionError):
        parse_range(text)


def test_frames_are_read_when_asked_for(tmp_path: Path) -> None:
    """A broken frame harms nobody until it is its turn."""
    from lambent.frame.files import write
    from lambent.frame.frame import Frame

    for n in (1, 3):
        write(
            tmp_path / f"a.{n}.exr",
            Frame.from_arrays(colour=np.full((2, 3, 3), n, np.float32), spp=n),
        )
    (tmp_path / "a.2.exr").write_bytes(b"broken")
    sequence = Sequence.find(tmp_path / "a.#.exr")
    assert len(sequence) == 3
    assert (sequence.read(3).colour == 3).all()
    assert sequence.read(1).spp == 1
    with pytest.raises(FileError, match=r"a\.2\.exr"):
        sequence.read(2)


def test_shared_sequence(shared_data: Path) -> None:
    sequence = Sequence.find(shared_data / "sequence" / "cornell-orbit" / "noisy_##.exr")
    assert list(sequence) == list(range(8))
    assert sequence.read(4).colour.shape == (160, 160, 3)
