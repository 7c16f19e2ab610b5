"""Tiles must cover the picture once, fit the memory, and give the untiled result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from lambent.denoise.tiles import ALIGNMENT, filter_tiles, plan_tiles
from lambent.errors import OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.frame.frame import Frame
from lambent.frame.role import Role
from lambent.memory import parse_size, show_size


@dataclass(frozen=True)
class Mean3(Denoiser):
    """A box of radius 3 in plain NumPy: what the tiles are tested with."""

    about: ClassVar[About] = About("mean3", "box", "none")

    def margin(self) -> int:
        return 3

    def filter(self, frame, targets):
        padded = np.pad(targets, ((3, 3), (3, 3), (0, 0)), mode="edge")
        h, w = targets.shape[:2]
        total = sum(padded[i : i + h, j : j + w] for i in range(7) for j in range(7))
        return (total / np.float32(49)).astype(np.float32)


@pytest.mark.parametrize(
    ("height", "width", "budget"),
    [(100, 100, None), (1000, 700, 4_000_000), (4320, 8192, 50_000_000), (1, 9000, 300_000)],
)
def test_cores_cover_every_pixel_once_and_outers_fit(height, width, budget):
    plan = plan_tiles(height, width, 40, 16, budget)
    covered = np.zeros((height, width), np.uint8)
    for tile in plan.tiles:
        covered[tile.core.top : tile.core.bottom, tile.core.left : tile.core.right] += 1
        if budget is not None:
            assert tile.outer.pixels * 40 <= budget
        # the margin is there wherever the picture goes on
        assert tile.outer.top <= max(0, tile.core.top - 16)
        assert tile.outer.bottom >= min(height, tile.core.bottom + 16)
        assert tile.outer.left <= max(0, tile.core.left - 16)
        assert tile.outer.right >= min(width, tile.core.right + 16)
        assert tile.outer.top % ALIGNMENT == tile.outer.left % ALIGNMENT == 0
    assert (covered == 1).all()


def test_enough_memory_means_one_piece():
    assert len(plan_tiles(720, 1280, 1000, 64, 10**9).tiles) == 1
    assert len(plan_tiles(720, 1280, 1000, 64, None).tiles) == 1


def test_too_little_memory_is_refused_with_what_it_takes():
    with pytest.raises(OptionError, match="margin of 128 pixels needs"):
        plan_tiles(4320, 8192, 1000, 128, 1_000_000)


def test_tiled_equals_untiled():
    """The margin is exactly the filter's radius: one pixel less would show a seam."""
    rng = np.random.default_rng(1)
    frame = Frame.from_arrays(
        colour=rng.random((300, 260, 3), np.float32),
        lighting={"key": rng.random((300, 260, 3), np.float32)},
    )
    layers = [frame.layer(Role.COLOUR), frame.extras["key"]]
    plan = plan_tiles(300, 260, 100, 3, 100 * 140 * 140)
    assert len(plan.tiles) > 3
    calls = []
    tiled = filter_tiles(Mean3(), frame, layers, plan, lambda *state: calls.append(state))
    whole = Mean3().filter_layers(frame, layers)
    for a, b in zip(tiled, whole, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-6)
    assert calls[-1][0] == calls[-1][1]  # the progress reaches the end


def test_a_margin_too_small_would_show():
    """Breaks the promise on purpose, to see that the test above can fail."""
    frame = Frame.from_arrays(colour=np.random.default_rng(2).random((300, 260, 3), np.float32))
    layers = list(frame.layers.values())
    plan = plan_tiles(300, 260, 100, 0, 100 * 140 * 140)
    tiled = filter_tiles(Mean3(), frame, layers, plan)[0]
    assert np.abs(tiled - Mean3().filter_layers(frame, layers)[0]).max() > 1e-2


@pytest.mark.parametrize(
    ("text", "size"),
    [("4G", 2**32), ("512M", 2**29), ("1.5GiB", 3 * 2**29), ("1 kb", 1024), ("4294967296", 2**32)],
)
def test_sizes_are_read(text, size):
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["foo", "", "-1G", "0", "4X", "G"])
def test_sizes_that_make_no_sense_are_refused(text):
    with pytest.raises(OptionError, match="not an amount of memory"):
        parse_size(text)


def test_a_forgotten_unit_is_asked_for():
    with pytest.raises(OptionError, match="4 bytes") as told:
        parse_size("4")
    assert "4G" in str(told.value.remedy)
    assert parse_size(4096) == 4096  # a number in a program is bytes


def test_sizes_are_shown_as_people_write_them():
    assert [show_size(s) for s in (12, 2**20, 1.5 * 2**30, 22 * 2**30)] == [
        "12 B",
        "1 MiB",
        "1.50 GiB",
        "22.0 GiB",
    ]
