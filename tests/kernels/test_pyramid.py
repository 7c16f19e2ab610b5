"""Predicted kernels on a pyramid: compiled loops against NumPy, and what makes it an average."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lambent.kernels import machine, pyramid


def random_logits(rng, height, width, scale=2.0):
    """Logits of all five levels for a frame of that size."""
    high, wide = pyramid.padded(height), pyramid.padded(width)
    found = []
    for level in range(5):
        count = 144 if level == 0 else 35 if level < 4 else 25
        shift = max(1, level)
        logits = pyramid.logits_memory((count, high >> shift, wide >> shift))
        logits[...] = rng.normal(size=logits.shape) * scale
        found.append(logits)
    return found


def filled(rng, channels, height, width):
    """A level with random pixels inside the frame."""
    level = pyramid.level_of(channels, height, width)
    level.planes[:channels, :height, :width] = rng.random((channels, height, width), np.float32)
    return level


@pytest.mark.skipif(not machine.available("cpu"), reason="needs LLVM")
@pytest.mark.parametrize(("height", "width"), [(32, 32), (100, 150), (96, 33), (1, 1), (65, 128)])
def test_the_kernels_are_the_reference(height, width):
    rng = np.random.default_rng(height * 1000 + width)
    logits, level = random_logits(rng, height, width), filled(rng, 6, height, width)
    expected = pyramid.reference(logits, level.planes, level.mask)
    found = pyramid.filter_planes(logits, level)
    np.testing.assert_allclose(found.planes, expected, atol=3e-6)
    np.testing.assert_array_equal(found.mask, level.mask)


@pytest.mark.skipif(not machine.available("cpu"), reason="needs LLVM")
@pytest.mark.parametrize(("height", "width"), [(32, 32), (100, 150), (1, 1)])
def test_near_averages_are_the_reference(monkeypatch, height, width):
    rng = np.random.default_rng(height)
    level = filled(rng, 3, height, width)
    half = (level.height // 2, level.width // 2)
    logits = pyramid.logits_memory((36, *half))
    logits[...] = rng.normal(size=(36, *half)) * 3
    found = pyramid.average_planes(logits, level).planes.copy()
    monkeypatch.setattr(pyramid, "available", lambda device: False)
    expected = pyramid.average_planes(logits, level).planes
    np.testing.assert_allclose(found, expected, atol=3e-6)
    assert not found[:, height:].any()
    low, high = level.planes[:, :height, :width].min(), level.planes.max()
    assert low - 1e-5 <= found[:, :height, :width].min() <= found.max() <= high + 1e-5


@pytest.mark.skipif(not machine.available("cpu"), reason="needs LLVM")
def test_short_logits_are_their_floats():
    rng = np.random.default_rng(5)
    logits, level = random_logits(rng, 70, 90), filled(rng, 6, 70, 90)
    short = []
    for values in logits:
        short.append(pyramid.logits_memory(values.shape, short=True))
        short[-1][...] = values.view(np.uint32) >> 16
        values[...] = pyramid.as_floats(short[-1])
    long = pyramid.filter_planes(logits, level).planes
    np.testing.assert_array_equal(pyramid.filter_planes(short, level).planes, long)
    expected = pyramid.reference(short, level.planes, level.mask)
    np.testing.assert_allclose(long, expected, atol=3e-6)


def test_nothing_outside_the_frame_gets_weight():
    rng = np.random.default_rng(1)
    logits, level = random_logits(rng, 70, 50), filled(rng, 3, 70, 50)
    level.planes[:, :70, :50] = 1
    out = pyramid.filter_planes(logits, level).planes
    np.testing.assert_allclose(out[:, :70, :50], 1, atol=1e-5)
    assert not out[:, 70:].any()
    assert not out[:, :, 50:].any()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.1, 60))
@example(1710, 25.0)  # a pixel at the border whose own taps weigh e^-85 of one outside
@example(7, 60.0)
def test_it_is_an_average(seed, scale):
    rng = np.random.default_rng(seed)
    logits, level = random_logits(rng, 40, 40, scale), filled(rng, 3, 40, 40)
    inside = level.planes[:, :40, :40].copy()
    out = pyramid.filter_planes(logits, level).planes[:, :40, :40]
    for channel in range(3):
        assert out[channel].min() >= inside[channel].min() - 1e-5
        assert out[channel].max() <= inside[channel].max() + 1e-5


def test_it_is_linear_in_the_image():
    rng = np.random.default_rng(2)
    logits, level = random_logits(rng, 64, 64), filled(rng, 9, 64, 64)
    level.planes[6:9] = level.planes[0:3] + 3 * level.planes[3:6]
    out = pyramid.filter_planes(logits, level).planes
    np.testing.assert_allclose(out[6:9], out[0:3] + 3 * out[3:6], rtol=1e-5, atol=1e-5)


def test_a_certain_centre_leaves_the_image_alone():
    rng = np.random.default_rng(3)
    logits, level = random_logits(rng, 64, 96), filled(rng, 3, 64, 96)
    logits[0][4 * 12 : 4 * 13] = 60  # tap 12 of 25 is the pixel itself
    out = pyramid.filter_planes(logits, level).planes
    np.testing.assert_allclose(out, level.planes, atol=1e-6)


@pytest.mark.parametrize("near", [False, True])
def test_a_workspace_used_again_gives_the_same(near):
    rng = np.random.default_rng(4)
    space = pyramid.Workspace()
    for height, width in ((64, 96), (50, 90), (33, 70), (64, 96)):
        logits, level = random_logits(rng, height, width), filled(rng, 6, height, width)
        again = pyramid.level_of(6, height, width, space)
        again.planes[:, :height, :width] = level.planes[:, :height, :width]
        if near:
            found = pyramid.average_planes(logits[0], again, workspace=space)
            expected = pyramid.average_planes(logits[0], level)
        else:
            found = pyramid.filter_planes(logits, again, workspace=space)
            expected = pyramid.filter_planes(logits, level)
        np.testing.assert_array_equal(found.planes, expected.planes)


@pytest.mark.skipif(not machine.available("cpu"), reason="needs LLVM")
def test_what_is_compiled_ahead_is_what_a_frame_needs():
    pyramid.compile_all()
    kernels = (pyramid._gather_kernel, pyramid._down_kernel)
    made = [kernel.cache_info().misses for kernel in kernels]
    rng = np.random.default_rng(7)
    level = filled(rng, 3, 40, 40)
    short = [pyramid.logits_memory(level.shape, short=True) for level in random_logits(rng, 40, 40)]
    pyramid.filter_planes(short, level)
    pyramid.average_planes(pyramid.logits_memory((36, 32, 32), short=True), level)
    assert [kernel.cache_info().misses for kernel in kernels] == made


@pytest.mark.parametrize(("height", "width"), [(64, 96), (45, 70)])
def test_the_weights_of_a_pixel_make_it(height, width):
    rng = np.random.default_rng(3)
    logits, level = random_logits(rng, height, width), filled(rng, 3, height, width)
    expected = pyramid.reference(logits, level.planes, level.mask)
    for x, y in ((0, 0), (width - 1, height - 1), (33, 20)):
        weights = pyramid.weights_at(logits, level.mask, x, y)
        assert weights.sum() == pytest.approx(1, abs=1e-5)
        assert not weights[height:].any()
        made = (weights * level.planes[:3]).sum((1, 2))
        np.testing.assert_allclose(made, expected[:3, y, x], atol=1e-5)
