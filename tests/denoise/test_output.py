"""Where the result of one file goes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lambent
from lambent.denoise.files import denoise_file, output_for
from lambent.errors import OutputError


@pytest.fixture
def noisy(tmp_path: Path) -> Path:
    rng = np.random.default_rng(1)
    image = rng.gamma(2.0, 0.5, (24, 32, 3)).astype(np.float32)
    return lambent.write(tmp_path / "noisy.exr", lambent.Frame.from_arrays(colour=image))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (None, "in/shot_clean.exr"),
        ("clean.exr", "clean.exr"),
        ("clean/", "clean/shot.exr"),
        ("clean", "clean/shot.exr"),
    ],
)
def test_a_name_without_an_ending_is_a_directory(given: str | None, expected: str) -> None:
    assert output_for(Path("in/shot.exr"), given) == Path(expected)


def test_a_directory_is_made_when_only_its_last_part_is_missing(noisy: Path) -> None:
    result = denoise_file(noisy, f"{noisy.parent}/clean/", model="box")
    assert result.output == noisy.parent / "clean" / "noisy.exr"
    assert result.output.is_file()
    with pytest.raises(OutputError, match="does not exist"):
        denoise_file(noisy, f"{noisy.parent}/a/b/c/", model="box")


def test_an_unknown_ending_is_refused_before_any_work(noisy: Path) -> None:
    before = sorted(noisy.parent.iterdir())
    with pytest.raises(OutputError, match="cannot tell the format"):
        denoise_file(noisy, noisy.parent / "clean.xyz", model="box")
    assert sorted(noisy.parent.iterdir()) == before
