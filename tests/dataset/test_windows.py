"""Crops: where something is to be learned, with the density told."""

from __future__ import annotations

import numpy as np
import pytest
from fake import FakeView

from lambent.dataset.windows import choose, maps
from lambent.frame.frame import Frame

VIEW = (192, 96)


@pytest.fixture
def pilot() -> Frame:
    """Left third black, middle third noisy and patterned, right third lit and smooth."""
    return FakeView(3, VIEW).pilot((96, 48), 8, 5)


def test_no_crop_is_black_or_smooth(pilot):
    for seed in range(20):
        found = choose(pilot, VIEW, 32, 6, 1.0, np.random.default_rng(seed))
        assert len(found) == 6
        for choice in found:
            left, right = choice.window.x, choice.window.x + 32
            assert right > 64, "black"
            assert left < 130, "smooth"  # a pilot's pixel is two of the view
            assert 0 <= choice.window.y <= 96 - 32
            assert 0 <= left <= 192 - 32


def test_interesting_windows_come_up_in_proportion_to_their_density(pilot):
    """First draws only; each window is counted, and counts follow the density that is told."""
    counts: dict[int, int] = {}
    density: dict[int, float] = {}
    rng = np.random.default_rng(6)

    class Unshifted:
        """The lattice is not shifted, so that windows come up again."""

        choice = rng.choice

        def integers(self, high: int) -> int:
            return 0

    for _ in range(4000):
        (choice,) = choose(pilot, VIEW, 32, 1, 0.2, Unshifted())
        key = choice.window.x * 1000 + choice.window.y
        counts[key] = counts.get(key, 0) + 1
        density[key] = choice.density
    observed = np.array([counts[k] for k in counts])
    expected = np.array([density[k] for k in counts])
    expected *= 4000 / expected.sum()
    chi2 = float(((observed - expected) ** 2 / expected).sum())
    freedom = len(counts) - 1
    assert chi2 < freedom + 4 * np.sqrt(2 * freedom)
    assert expected.max() > 1.2 * expected.min(), "nothing is preferred"


def test_an_even_draw_has_density_one(pilot):
    found = choose(pilot, VIEW, 32, 4, 1.0, np.random.default_rng(1))
    assert np.allclose([c.density for c in found], 1.0)


def test_crops_of_a_view_overlap_little(pilot):
    found = choose(pilot, VIEW, 24, 5, 0.3, np.random.default_rng(2))
    for n, a in enumerate(found):
        for b in found[:n]:
            wide = max(0, 24 - abs(a.window.x - b.window.x))
            high = max(0, 24 - abs(a.window.y - b.window.y))
            assert wide * high <= 0.3 * 24**2


def test_a_black_view_gives_nothing():
    black = np.zeros((48, 96, 3), np.float32)
    frame = Frame.from_arrays(colour=black, colour_variance=black)
    assert choose(frame, VIEW, 32, 4, 0.3, np.random.default_rng(0)) == ()
    grey = Frame.from_arrays(colour=black + 0.5, colour_variance=black)
    assert choose(grey, VIEW, 32, 4, 0.3, np.random.default_rng(0)) == ()


def test_a_view_of_the_crop_s_size_has_one_window(pilot):
    (choice,) = choose(pilot, (32, 32), 32, 1, 0.3, np.random.default_rng(0))
    assert (choice.window.x, choice.window.y) == (0, 0)


def test_noise_and_edges_count(pilot):
    interest, light = maps(pilot)
    assert interest.shape == light.shape == (48, 96)
    left, middle, right = (interest[:, s].mean() for s in np.s_[2:30, 34:62, 66:94])
    assert middle > 4 * max(left, right)
