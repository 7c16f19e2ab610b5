"""How many samples a frame seems to have."""

import numpy as np
import pytest

from lambent.denoise import prepare
from lambent.denoise.samples import MOST, noise, seeming_samples
from lambent.frame.frame import Frame


def frame(deviation, guides=True, size=(90, 120), texture=0.0, **more):
    """Soft light with noise of a relative deviation, on a wall that may have a fine texture."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(np.float32) / 64
    albedo = 0.5 + texture * np.sign(np.sin(120 * x) * np.sin(110 * y))
    albedo = np.repeat(albedo[:, :, None], 3, 2).astype(np.float32)
    light = (0.3 + 0.1 * np.sin(x + y))[:, :, None]
    light = light * (1 + deviation * rng.standard_normal((*size, 1)))
    layers = {"colour": (albedo * light).astype(np.float32), **more}
    if guides:
        layers["albedo"] = albedo
    return Frame.from_arrays(**layers)


@pytest.mark.parametrize("guides", [True, False])
def test_the_noise_is_that_of_the_logarithm(guides):
    made = frame(0.02, guides)
    albedo = made.get("albedo")
    x = made.colour if albedo is None else made.colour / (albedo + 0.05)
    expected = 0.02 * float((16 * x / (1 + 16 * x)).mean())  # the slope of log(1 + 16 x) over ln x
    assert noise(made.colour, albedo, 1.0) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("guides", [True, False])
def test_the_less_noise_the_more_samples(guides):
    told = [seeming_samples(frame(d, guides), 1.0) for d in (0.5, 0.1, 0.05, 0.02, 0.001)]
    assert told == sorted(told)
    assert 1 <= told[0] < 4
    assert 64 < told[-1] <= MOST


def test_what_the_file_says_is_believed():
    assert seeming_samples(frame(0.001).replace(spp=3), 1.0) is None
    whole = prepare.Whole.of(frame(0.001).replace(spp=3))
    assert (whole.spp, whole.guess) == (3, None)
    variance = np.full((90, 120, 3), 1e-6, np.float32)
    assert seeming_samples(frame(0.001, colour_variance=variance), 1.0) is None


def test_texture_is_no_noise_where_the_albedo_has_it_and_makes_no_frame_clean():
    smooth = seeming_samples(frame(0.05), 1.0)
    divided = seeming_samples(frame(0.05, texture=0.3), 1.0)
    assert smooth / 8 < divided < 1.3 * smooth  # the offset of the divisor leaves some of it
    assert seeming_samples(frame(0.05, guides=False, texture=0.3), 1.0) < divided / 8


@pytest.mark.parametrize("size", [(1, 1), (2, 50), (3, 3), (40, 2)])
def test_too_small_a_frame_says_nothing(size):
    assert seeming_samples(frame(0.001, size=size), 1.0) is None


def test_black_surroundings_are_no_evidence():
    made = frame(0.3)
    colour = made.colour.copy()
    colour[:80] = 0
    dark = Frame.from_arrays(colour=colour, albedo=made["albedo"])
    assert noise(colour, made["albedo"], 1.0) > 0.1
    assert seeming_samples(dark, 1.0) == pytest.approx(seeming_samples(made, 1.0), rel=0.5)
    assert seeming_samples(Frame.from_arrays(colour=0 * colour), 1.0) is None


def test_what_is_not_finite_counts_as_black():
    colour = frame(0.02).colour.copy()
    colour[5, 5] = np.nan
    colour[7, 9] = np.inf
    assert np.isfinite(noise(colour, None, 1.0))


def test_the_network_is_told():
    """The same number for the frame and for its tiles."""
    made = frame(0.001)
    whole = prepare.Whole.of(made)
    assert whole.guess == seeming_samples(made, whole.exposure)
    given = prepare.Given.of(made.crop(0, 33, 0, 40))
    packed = prepare.packed_inputs(given, whole, 0.0, "auto")
    assert packed[0, -3, 0, 0] == pytest.approx(np.log2(whole.guess) / 10)
    assert packed[0, -2, 0, 0] == 0  # a guess, and told as one
    unknown = prepare.Whole(whole.exposure, whole.depth, None)
    packed = prepare.packed_inputs(given, unknown, 0.0, "auto")
    assert packed[0, -3:-1, 0, 0].tolist() == [0, 0]
