"""Lamps put into training crops are what samples that see a lamp or do not would give."""

from dataclasses import replace

import made
import numpy as np
import pytest
from made import few_threads  # noqa: F401

from lambent.denoise.inputs import signals_of
from lambent.learn import lamps
from lambent.learn.augment import Example
from lambent.learn.lamps import Lamp

COVER = 0.3
RADIANCE = np.array([100.0, 50.0, 20.0], np.float32)


def example(spp, black=True):
    noisy = signals_of(made.frame(np.random.default_rng(0), spp))
    if black:
        names = {n: np.zeros_like(v) for n, v in noisy.layers.items()}
        noisy = replace(noisy, colour=np.zeros_like(noisy.colour), layers=names)
    zero = np.zeros((3, 64, 64), np.float32)
    return Example(noisy, zero if black else noisy.colour, zero[:1])


def lamp(cover, features=False):
    return Lamp(np.full((64, 64), cover, np.float32), RADIANCE, features)


def test_a_lamp_that_fills_pixels_is_free_of_noise():
    lit = lamps.add(example(4), lamp(1.0), np.random.default_rng(1))
    np.testing.assert_array_equal(lit.noisy.colour, lit.target)
    assert np.all(lit.target == RADIANCE[:, None, None])
    assert np.all(lit.noisy.layers["colour_std"] == 0)


@pytest.mark.parametrize("spp", [2, 16])
def test_half_covered_pixels_have_the_mean_and_the_variance_of_their_samples(spp):
    lit = lamps.add(example(spp), lamp(COVER), np.random.default_rng(2))
    got = lit.noisy.colour[0] / RADIANCE[0]
    truth = COVER * (1 - COVER) / spp  # of a binomial share
    assert got.mean() == pytest.approx(COVER, abs=4 * np.sqrt(truth) / 64)
    assert got.var() == pytest.approx(truth, rel=0.1)
    # what the layer says of it is right on average
    told = (lit.noisy.layers["colour_std"] ** 2).mean() / RADIANCE.mean() ** 2
    assert told == pytest.approx(truth, rel=0.1)
    np.testing.assert_allclose(lit.target[1], COVER * RADIANCE[1], rtol=1e-6)


def test_features_are_the_lamp_s_own_or_left_alone():
    start = example(4, black=False)
    left = lamps.add(start, lamp(1.0), np.random.default_rng(3)).noisy.layers
    own = lamps.add(start, lamp(1.0, features=True), np.random.default_rng(3)).noisy.layers
    for name in ("albedo", "normal", "depth"):
        np.testing.assert_array_equal(left[name], start.noisy.layers[name])
        assert np.ptp(own[name].reshape(len(own[name]), -1), axis=1).max() == 0
    assert np.linalg.norm(own["normal"][:, 0, 0]) == pytest.approx(1, rel=1e-5)


def test_drawn_lamps_are_small_and_whole():
    rng = np.random.default_rng(4)
    covers = [lamps.draw((64, 64), rng).cover for _ in range(200)]
    assert all(c.min() >= 0 and c.max() <= 1 for c in covers)
    areas = np.array([c.sum() for c in covers])
    assert np.median(areas) < 40
    assert (areas > 0).mean() > 0.95
    assert np.percentile(areas, 5) < 4  # some are as small as a firefly
