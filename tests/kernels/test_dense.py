"""Loops of our own against the Dr.Jit kernels, which have NumPy twins in the tests beside this."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.kernels import machine
from lambent.kernels.arrays import Layout
from lambent.kernels.dense_nlm import channel_mean, least_weight_rows
from lambent.kernels.dense_regression import WeightRows, band_rows, dense_first_order
from lambent.kernels.machine import LANES, Code, Kernel
from lambent.kernels.nlm import PatchSearch, nlm_mean
from lambent.kernels.regression import Window, first_order, least_weights

pytestmark = pytest.mark.skipif(not machine.available(), reason="no LLVM library to compile with")


@pytest.fixture
def noisy():
    def make(height, width, count=3):
        rng = np.random.default_rng(7)
        guide = rng.random((height, width, 3), dtype=np.float32)
        variance = (0.02 + 0.05 * rng.random((height, width, 3))).astype(np.float32)
        return guide, variance, rng.random((height, width, count), dtype=np.float32)

    return make


def test_a_loop_in_a_loop(noisy):
    """Σ over rows above, with carried sums, a power by exp, and more rows than one chunk."""

    def write(code: Code) -> None:
        source, result, stride = code.address(0), code.address(1), code.param(2)
        with code.loop("%first", "%last") as line, code.loop(0, stride, LANES) as column:
            with code.loop(0, code.integer("add", line.i, 1), 1, ["zeroinitializer"]) as above:
                at = code.integer("add", code.integer("mul", above.i, stride), column.i)
                value = code.exp(code.load(code.at(source, at)))
                above.carry = [code.op("fadd", above.carry[0], value)]
            to = code.integer("add", code.integer("mul", line.i, stride), column.i)
            code.store(above.after[0], code.at(result, to))

    source = -np.random.default_rng(0).random((11, 32), dtype=np.float32)
    result = np.zeros_like(source)
    Kernel("running", write).rows([source, result, 32], 0, 11, chunk=3)
    np.testing.assert_allclose(result, np.cumsum(np.exp(source), axis=0), rtol=2e-5)
    assert np.float32(1e-39) * np.float32(0.5) > 0  # flushing to zero ends with the kernel


@pytest.mark.parametrize(
    ("height", "width", "radius", "patch"),
    [(13, 15, 3, 1), (40, 51, 9, 3), (1, 40, 9, 3), (50, 3, 2, 0), (1, 1, 3, 3), (75, 20, 4, 2)],
)
def test_weights_are_those_of_the_kernel(noisy, height, width, radius, patch):
    guide, variance, _ = noisy(height, width)
    guide[height // 2, width // 2, 1] += 1000  # beyond the bound of a distance
    window = Window(radius, patch, 1)
    shape = (window.offsets(), height, width)
    expected = np.array(least_weights(guide, variance, window, k=0.8).planes).reshape(shape)
    found = least_weight_rows(guide, variance, radius, patch, 0.8, "auto", rows=height).image()
    np.testing.assert_allclose(found.transpose(1, 0, 2), expected, atol=2e-6)


@pytest.mark.parametrize(("radius", "patch"), [(9, 1), (5, 3), (2, 3)])
def test_mean_is_that_of_the_kernel(noisy, radius, patch):
    """Over three bands; what is not finite takes no part, and keeps its value."""
    guide, variance, targets = noisy(70, 33, 2)
    guide[3, 4], targets[5, 6, 1], targets[68, 30] = np.nan, np.inf, np.nan
    part, spread, numbers = guide[:, :, :1], variance[:, :, :1], (0.25, 1.0, 1e-7)
    search = PatchSearch.of(part, spread, radius, patch, numbers=numbers)
    expected = nlm_mean(targets, search)
    found = channel_mean(targets, part, spread, radius, patch, numbers, "auto")
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert np.isfinite(found).mean() > 0.99


@pytest.mark.parametrize(
    ("height", "width", "radius", "F", "C"),
    [(13, 15, 3, 2, 3), (150, 21, 3, 7, 3), (30, 33, 4, 0, 1), (20, 70, 9, 10, 8), (1, 1, 9, 1, 3)],
)
def test_regression_is_that_of_the_kernel(noisy, height, width, radius, F, C):
    """With and without features, over the end of the ring, over groups of images."""
    guide, variance, images = noisy(height, width, C)
    features = np.random.default_rng(9).random((height, width, F), dtype=np.float32)
    powers = (4, 1)
    weights = least_weights(guide, variance, Window(radius, 1, 1))
    rows = least_weight_rows(guide, variance, radius, 1, 1.0, "auto")
    found = dense_first_order(rows, features, images, powers, 1e-4)
    expected = first_order(weights, features, images, powers, 1e-4)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5)
    assert height < 100 or rows.rows < height


def test_weights_below_the_smallest_number_cost_nothing_and_do_nothing(noisy):
    """Far pixels have weights near 1e-38: their fourth power is zero, not a denormal."""
    guide, _, images = noisy(24, 40)
    guide[:, 20:] += 10
    still = np.full_like(guide, 1e-4)
    rows = least_weight_rows(guide, still, 3, 1, 1.0, "auto")
    (found,) = dense_first_order(rows, guide[:, :, :1], images, (4,), 1e-4)
    weights = least_weights(guide, still, Window(3, 1, 1))
    (expected,) = first_order(weights, guide[:, :, :1], images, (4,), 1e-4)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_a_ring_that_is_too_short_is_our_bug(noisy):
    guide, _, images = noisy(200, 16)
    layout = Layout(200, 16, 9)
    short = WeightRows(guide, band_rows(), layout, 3, "auto", lambda *_: None)
    with pytest.raises(AssertionError):
        dense_first_order(short, guide, images, (1,), 1e-4)
