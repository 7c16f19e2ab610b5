"""Weighted windows against a plain NumPy twin: two routes to one result."""

import numpy as np
import pytest

from lambent.kernels.exponential import exp_weight
from lambent.kernels.separable import separable_mean
from lambent.kernels.window import weighted_window


def likeness(p, q, k, s):
    """exp(s - k₀·|p - q|²), as a kernel sees it."""
    exponent = s
    for a, b in zip(p, q, strict=True):
        exponent = exponent - (a - b) * (a - b) * k[0]
    return exp_weight(exponent)


def blind(p, q, k, s):
    return exp_weight(s)


def window_twin(targets, guide, radius, k0, spatial):
    height, width, _ = targets.shape
    ok = np.isfinite(guide).all(axis=2) & np.isfinite(targets).all(axis=2)
    clean, seen = np.where(ok[..., None], targets, 0.0), np.where(np.isfinite(guide), guide, 0.0)
    result = np.zeros(targets.shape)
    for y in range(height):
        for x in range(width):
            rows = slice(max(0, y - radius), y + radius + 1)
            columns = slice(max(0, x - radius), x + radius + 1)
            apart = ((seen[rows, columns] - seen[y, x]) ** 2).sum(axis=2)
            top, left = rows.start - y + radius, columns.start - x + radius
            s = spatial[top : top + apart.shape[0], left : left + apart.shape[1]]
            w = np.exp(s - k0 * apart) * ok[rows, columns]
            result[y, x] = (w[..., None] * clean[rows, columns]).sum(axis=(0, 1)) / w.sum()
    return result


def spatial(radius):
    step = np.arange(-radius, radius + 1) ** 2
    return -(step[:, None] + step[None, :]) / 9.0


@pytest.mark.parametrize("shape", [(1, 1), (1, 19), (23, 1), (14, 33)])
@pytest.mark.parametrize("radius", [0, 1, 4])
def test_agrees_with_its_twin(shape, radius):
    """Also where the image is smaller than the window, and where rows are not a vector long."""
    rng = np.random.default_rng(3)
    targets = rng.random((*shape, 3), dtype=np.float32)
    guide = rng.random((*shape, 2), dtype=np.float32)
    found = weighted_window(targets, guide, radius, likeness, [2.5], spatial(radius))
    wanted = window_twin(targets, guide, radius, 2.5, spatial(radius))
    assert np.abs(found - wanted).max() < 2e-6


def test_a_window_wider_than_one_kernel():
    """Radius 7 is cut into two launches a row."""
    rng = np.random.default_rng(4)
    targets, guide = rng.random((9, 40, 1), dtype=np.float32), rng.random((9, 40, 1), np.float32)
    found = weighted_window(targets, guide, 7, likeness, [1.0], spatial(7))
    assert np.abs(found - window_twin(targets, guide, 7, 1.0, spatial(7))).max() < 2e-6


def test_many_channels_get_the_same_weights_as_few():
    """More channels than one kernel holds take the other route (stored weights)."""
    rng = np.random.default_rng(5)
    targets = rng.random((12, 20, 21), dtype=np.float32)
    guide = rng.random((12, 20, 2), dtype=np.float32)
    together = weighted_window(targets, guide, 3, likeness, [1.0], spatial(3))
    for channel in (0, 7, 8, 20):
        alone = weighted_window(
            targets[:, :, channel : channel + 1], guide, 3, likeness, [1.0], spatial(3)
        )
        np.testing.assert_allclose(together[:, :, channel], alone[:, :, 0], atol=1e-6)


def test_nan_stays_where_it_is():
    """A NaN neighbour gets no weight; a NaN pixel gets the mean of the others."""
    rng = np.random.default_rng(6)
    targets = rng.random((11, 17, 3), dtype=np.float32)
    guide = rng.random((11, 17, 2), dtype=np.float32)
    targets[4, 5, 1] = np.nan
    guide[8, 8, 0] = np.inf
    found = weighted_window(targets, guide, 2, likeness, [1.0], spatial(2))
    assert np.isfinite(found).all()
    assert np.abs(found - window_twin(targets, guide, 2, 1.0, spatial(2))).max() < 2e-6


def test_a_pixel_without_any_neighbour_is_left_alone():
    """Nothing to average: nothing is made up."""
    targets = np.full((3, 3, 1), np.nan, np.float32)
    assert np.isnan(weighted_window(targets, None, 1, blind)).all()


def test_arguments_are_left_alone():
    targets = np.ones((4, 5, 2), np.float32)
    targets.flags.writeable = False
    weighted_window(targets, targets, 1, likeness, [1.0])
    assert (targets == 1).all()


def test_separable_mean_agrees_with_the_window():
    """Two routes to a Gaussian: separable passes, and a window."""
    rng = np.random.default_rng(7)
    targets = rng.random((13, 21, 3), dtype=np.float32)
    targets[3, 3] = np.nan
    taps = np.exp(-(np.arange(-4, 5) ** 2) / 9.0)
    there = weighted_window(targets, None, 4, blind, spatial=spatial(4))
    assert np.abs(separable_mean(targets, taps) - there).max() < 3e-6


def test_box_of_an_impulse():
    """Known answer: 1/n inside the window, n smaller at the border, 0 outside."""
    targets = np.zeros((9, 9, 1), np.float32)
    targets[1, 4] = 1.0
    found = separable_mean(targets, [1.0] * 5)[:, :, 0]
    assert found[3, 4] == pytest.approx(1 / 25)
    assert found[0, 4] == pytest.approx(1 / 15)
    assert found[1, 2] == pytest.approx(1 / 20)
    assert found[4, 4] == 0
    assert found[1, 7] == 0


def test_exponential_is_as_exact_as_it_says():
    from lambent.kernels.arrays import backend

    x = np.linspace(-69.3, 80.0, 200_001).astype(np.float32)
    found = exp_weight(backend().Float(x)).numpy()
    assert np.abs(found / np.exp(x.astype(np.float64)) - 1).max() < 1e-5
    assert exp_weight(backend().Float([-1e30])).numpy()[0] < 1e-30
