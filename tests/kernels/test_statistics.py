"""Means over statistically equal pixels: a NumPy twin, and Student's quantiles from tables."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lambent.kernels.statistics import disc, t_quantile, welch_mean


def twin(targets, mean, bound, features, radius, sigma, noise=None):
    height, width, _ = targets.shape
    result = np.zeros(targets.shape)
    for y in range(height):
        for x in range(width):
            total, mass = np.zeros(targets.shape[2]), 0.0
            for qy in range(max(0, y - radius), min(height, y + radius + 1)):
                for qx in range(max(0, x - radius), min(width, x + radius + 1)):
                    square = (qx - x) ** 2 + (qy - y) ** 2
                    far = (mean[y, x] - mean[qy, qx]) ** 2 > bound[y, x] + bound[qy, qx]
                    if square > radius**2 or (square > 0 and far.any()):
                        continue
                    gap = ((features[y, x] - features[qy, qx]) ** 2).sum()
                    w = math.exp(-square / (2 * sigma**2) - gap)
                    if noise is not None:
                        w *= min(1.0, noise[y, x] / noise[qy, qx])
                    total += w * targets[qy, qx]
                    mass += w
            result[y, x] = total / mass
    return result


def test_agrees_with_the_formulas():
    rng = np.random.default_rng(1)
    shape = (11, 14)
    mean = rng.standard_normal((*shape, 3)).astype(np.float32)
    bound = (2 * rng.random((*shape, 3))).astype(np.float32)
    features = rng.random((*shape, 2)).astype(np.float32)
    targets = rng.random((*shape, 9)).astype(np.float32)  # more than one kernel takes
    result = welch_mean(targets, mean, bound, features, 4, 3.0)
    np.testing.assert_allclose(result, twin(targets, mean, bound, features, 4, 3.0), atol=2e-6)


def test_without_features():
    """A frame may have neither albedo nor normal."""
    rng = np.random.default_rng(2)
    mean = rng.random((8, 9, 3)).astype(np.float32)
    none = np.zeros((8, 9, 0), np.float32)
    result = welch_mean(mean, mean, mean, none, 3, 2.0)
    np.testing.assert_allclose(result, twin(mean, mean, mean, none, 3, 2.0), atol=2e-6)


def test_noisier_members_weigh_less():
    """Noise levels over fifteen orders of magnitude."""
    rng = np.random.default_rng(3)
    mean = rng.random((8, 9, 3)).astype(np.float32)
    none = np.zeros((8, 9, 0), np.float32)
    noise = (10.0 ** rng.integers(-12, 4, (8, 9))).astype(np.float32)
    result = welch_mean(mean, mean, mean, none, 3, 2.0, noise=noise)
    np.testing.assert_allclose(result, twin(mean, mean, mean, none, 3, 2.0, noise), atol=2e-6)


def test_zero_variance_joins_equals_only():
    """Noise-free pixels: two flat regions stay as they are, to the last bit but rounding."""
    mean = np.ones((10, 10, 3), np.float32)
    mean[:, 5:] = 3
    none = np.zeros((10, 10, 0), np.float32)
    np.testing.assert_allclose(welch_mean(mean, mean, mean * 0, none, 4, 3.0), mean, rtol=1e-6)


@pytest.mark.parametrize(
    ("alpha", "freedom", "value"),
    [
        (0.05, 1, 12.7062),  # tables of Student's distribution, two-sided
        (0.05, 10, 2.22814),
        (0.005, 6, 4.31683),
        (0.005, 30, 3.02980),
        (0.002, 120, 3.15954),
        (0.005, math.inf, 2.80703),
    ],
)
def test_quantiles(alpha, freedom, value):
    assert t_quantile(alpha, freedom) == pytest.approx(value, abs=2e-5)


def test_disc_has_no_centre():
    """The centre is added once, by the kernel; the padding weighs nothing."""
    offsets, fall = disc(20, 10.0)
    real = fall > -1e20
    assert real.sum() == 1256  # lattice points in a disc of radius 20, without the centre
    assert len(offsets) % 4 == 0
    assert (np.abs(offsets[real]).sum(axis=1) > 0).all()
