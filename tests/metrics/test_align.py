"""`compare` and data windows: pixels of one place are compared, others never."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from lambent.errors import LayerError
from lambent.frame.files import write
from lambent.frame.frame import Frame
from lambent.frame.windows import Windows
from lambent.metrics.compare import compare
from lambent.metrics.relmse import relmse

WHOLE = (0, 0, 39, 29)


@pytest.fixture
def picture():
    """A whole picture ``(30, 40, 3)``."""
    return np.random.default_rng(0).uniform(0.1, 2, (30, 40, 3)).astype(np.float32)


def part(picture, x0, y0, x1, y1, display=WHOLE, factor=1.0):
    """What a renderer would write of a box of the picture, ``x1`` and ``y1`` included."""
    image = picture[y0 : y1 + 1, x0 : x1 + 1] * np.float32(factor)
    return Frame.from_arrays(colour=image).replace(windows=Windows((x0, y0, x1, y1), display))


def test_a_crop_is_compared_with_its_part_of_the_picture(picture):
    whole = part(picture, *WHOLE)
    crop = part(picture, 10, 5, 25, 16, factor=1.1)
    table = compare(whole, {"crop": crop}, ["relmse", "rmse"])
    assert table.size == (16, 12)
    assert table["crop"].values["relmse"] == pytest.approx(
        relmse(crop.colour, picture[5:17, 10:26])
    )
    assert table["crop"].values["relmse"] < 0.02
    assert any("16x12 at (10, 5)" in note for note in table.notes())
    assert table.map("crop", "relmse").shape == (12, 16)
    same = compare(crop, {"whole": whole, "itself": crop}, ["rmse"])
    assert same["itself"].values["rmse"] == 0
    assert same.size == (16, 12)


def test_partial_overlaps_are_compared_where_all_have_pixels(picture):
    """Of one size, but shifted: the case that once was compared as if aligned."""
    one, other = part(picture, 0, 0, 23, 19), part(picture, 4, 6, 27, 25)
    table = compare(one, {"other": other}, ["rmse"])
    assert table.size == (20, 14)
    assert table["other"].values["rmse"] == 0
    third = part(picture, 6, 2, 39, 12)
    table = compare(one, {"other": other, "third": third}, ["rmse"])
    assert table.size == (18, 7)
    assert [row.values["rmse"] for row in table.rows] == [0, 0]
    assert "18x7 at (6, 6)" in table.notes()[0]


def test_overscan_is_left_out(picture):
    wide = np.pad(picture, ((2, 1), (3, 4), (0, 0)))
    frame = Frame.from_arrays(colour=wide).replace(windows=Windows((-3, -2, 43, 30), WHOLE))
    table = compare(part(picture, *WHOLE), {"wide": frame}, ["rmse"])
    assert table.size == (40, 30)
    assert table["wide"].values["rmse"] == 0


def test_other_places_are_refused_with_the_offset(picture):
    left, right = part(picture, 0, 0, 9, 29), part(picture, 20, 3, 29, 29)
    with pytest.raises(LayerError, match=r"10x27 at \(20, 3\) of 40x30.*10x30 at \(0, 0\)"):
        compare(left, {"right": right})
    shifted = part(picture, 10, 0, 19, 29)
    with pytest.raises(LayerError, match=r"\(10, 0\) apart"):
        compare(left, {"shifted": shifted})


def test_another_display_window_is_refused_with_the_offset(picture):
    """48x40 at (10, 10) of 100x100 beside 48x40 that are a whole picture, say."""
    whole = part(picture, 0, 0, 19, 19, display=(0, 0, 19, 19))
    window = part(picture, 10, 10, 29, 29, display=(0, 0, 99, 99))
    with pytest.raises(LayerError, match=r"20x20 at \(10, 10\) of 100x100.*\(10, 10\) apart"):
        compare(whole, {"window": window})
    # The same pixels, whatever the size of the display.
    same = part(picture, 0, 0, 19, 19, display=(0, 0, 99, 99))
    table = compare(whole, {"same": same}, ["rmse"])
    assert table["same"].values["rmse"] == 0
    assert table.notes() == ()


def test_whole_pictures_with_other_corners_are_compared(picture):
    here = part(picture, 0, 0, 9, 9, display=(0, 0, 9, 9))
    there = here.replace(windows=Windows((5, 5, 14, 14), (5, 5, 14, 14)))
    assert compare(here, {"there": there}, ["rmse"])["there"].values["rmse"] == 0


def test_pictures_without_windows_lie_where_their_size_says(picture):
    crop = part(picture, 10, 5, 25, 16)
    table = compare(crop, {"array": picture[5:17, 10:26], "whole": picture}, ["rmse"])
    assert [row.values["rmse"] for row in table.rows] == [0, 0]
    with pytest.raises(LayerError, match="12x16"):
        compare(crop, {"other": picture[:16, :12]})


def test_the_variance_of_the_reference_is_cut_as_it_is(picture):
    whole, crop = part(picture, *WHOLE), part(picture, 10, 5, 25, 16, factor=1.2)
    variance = np.random.default_rng(1).uniform(0, 0.01, picture.shape).astype(np.float32)
    table = compare(whole, {"crop": crop}, ["relmse"], reference_variance=variance)
    cut = picture[5:17, 10:26], variance[5:17, 10:26]
    wanted = compare(cut[0], {"crop": crop.colour}, ["relmse"], reference_variance=cut[1])
    assert table["crop"].values == wanted["crop"].values


def test_the_command_honours_windows(picture, tmp_path):
    """Through files, and what is refused is refused with the offset."""

    def run(*names):
        return subprocess.run(
            [sys.executable, "-m", "lambent", "compare", *(str(tmp_path / n) for n in names),
             "--metrics", "rmse", "--json"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip

    frames = {
        "whole": part(picture, *WHOLE),
        "crop": part(picture, 10, 5, 25, 16),
        "moved": part(picture, 12, 7, 27, 18),
        "alone": part(picture, 0, 0, 15, 11, display=(0, 0, 15, 11)),
    }
    for name, frame in frames.items():
        write(tmp_path / f"{name}.exr", frame)
    found = json.loads(run("whole.exr", "crop.exr", "moved.exr").stdout)
    assert [image["metrics"]["rmse"] for image in found["images"]] == [0, 0]
    assert (found["width"], found["height"]) == (14, 10)
    refused = run("alone.exr", "crop.exr")
    assert refused.returncode == 3
    assert "(10, 5) apart" in refused.stderr
    assert "Traceback" not in refused.stderr
