"""Lamps put into training crops are what samples that see a lamp or do not would give."""

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise.inputs import signals_of
from lambent.learn import lamps
from lambent.learn.rows import Example, rows_of

COVER = 0.3
RADIANCE = torch.tensor([100.0, 50.0, 20.0])


def rows(spp, black=True):
    noisy = signals_of(made.frame(np.random.default_rng(0), spp))
    found = rows_of([Example(noisy, noisy.colour, np.zeros((1, 64, 64), np.float32))])
    if black:
        found.planes.zero_(), found.target.zero_()
    return found


def lamp(cover, own=0.0):
    drawn = lamps.draw(1, 64, 64, torch.Generator().manual_seed(5))
    drawn.cover = torch.full((1, 1, 64, 64), cover)
    drawn.radiance = RADIANCE[None, :, None, None]
    drawn.own = torch.full((1, 1, 1, 1), own)
    return drawn


def added(to, what, seed):
    lamps.add(to, what, torch.Generator().manual_seed(seed))
    return to


def test_a_lamp_that_fills_pixels_is_free_of_noise():
    lit = added(rows(4), lamp(1.0), 1)
    assert torch.equal(lit.planes[:, :3], lit.target[:, :3])
    assert bool((lit.target[0, :3] == RADIANCE[:, None, None]).all())
    assert not bool(lit.layer("colour_std").any())


@pytest.mark.parametrize("spp", [2, 16])
def test_half_covered_pixels_have_the_mean_and_the_variance_of_their_samples(spp):
    lit = added(rows(spp), lamp(COVER), 2)
    got = lit.planes[0, 0] / RADIANCE[0]
    truth = COVER * (1 - COVER) / spp  # of a binomial share
    assert float(got.mean()) == pytest.approx(COVER, abs=4 * np.sqrt(truth) / 64)
    assert float(got.var()) == pytest.approx(truth, rel=0.1)
    # what the layer says of it is right on average
    told = float(lit.layer("colour_std").square().mean() / RADIANCE.mean() ** 2)
    assert told == pytest.approx(truth, rel=0.1)
    torch.testing.assert_close(lit.target[0, 1], (COVER * RADIANCE[1]).expand(64, 64))


def test_features_are_the_lamp_s_own_or_left_alone():
    start = rows(4, black=False)
    left = added(rows(4, black=False), lamp(1.0), 3)
    own = added(rows(4, black=False), lamp(1.0, own=1.0), 3)
    for name in ("albedo", "normal", "depth"):
        torch.testing.assert_close(left.layer(name), start.layer(name), rtol=0, atol=0)
        flat = own.layer(name).flatten(2)
        assert float((flat.amax(2) - flat.amin(2)).max()) == 0
    assert float(own.layer("normal")[0, :, 0, 0].norm()) == pytest.approx(1, rel=1e-5)


def test_drawn_lamps_are_small_and_whole():
    covers = lamps.draw(200, 64, 64, torch.Generator().manual_seed(4)).cover
    assert 0 <= float(covers.min()) <= float(covers.max()) <= 1
    areas = covers.sum((1, 2, 3)).numpy()
    assert np.median(areas) < 40
    assert (areas > 0).mean() > 0.95
    assert np.percentile(areas, 5) < 4  # some are as small as a firefly
