"""The metrics: values worked out by hand, limits, twins, and what they do with bad pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from lambent.errors import LayerError, OptionError, UnknownNameError
from lambent.frame.exposure import auto_exposure
from lambent.frame.tonemap import display
from lambent.metrics.flip import PPD, flip_hdr, flip_hdr_map, flip_ldr, flip_ldr_map, hdr_exposures
from lambent.metrics.metric import METRICS
from lambent.metrics.pair import Pair
from lambent.metrics.psnr import psnr
from lambent.metrics.relmse import relmse, relmse_map
from lambent.metrics.rmse import rmse, rmse_map
from lambent.metrics.smape import smape, smape_map
from lambent.metrics.ssim import dssim, ssim, ssim_map

CHEAP = ["relmse", "relmse-trimmed", "smape", "rmse", "psnr", "ssim", "dssim"]


def picture(seed: int = 0, height: int = 32, width: int = 36) -> np.ndarray:
    """A smooth HDR picture: a ramp, a bright spot, coloured."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    spot = 8 * np.exp(-((x - width / 2) ** 2 + (y - height / 2) ** 2) / 20)
    grey = 0.05 + x / width + spot
    tint = np.random.default_rng(seed).uniform(0.5, 1.5, 3)
    return (grey[..., None] * tint).astype(np.float32)


def noisy(image: np.ndarray, seed: int = 1, strength: float = 0.3) -> np.ndarray:
    g = np.random.default_rng(seed)
    return (image * g.gamma(1 / strength**2, strength**2, image.shape)).astype(np.float32)


# ------------------------------------------------------------ known answers


def test_relmse_of_one_pixel_by_hand():
    # ((0.5² + 0² + 1²)/3) / (((1 + 2 + 3)/3)² + 0.01): the squared mean, not the mean square.
    image = np.array([[[1.5, 2.0, 2.0]]], np.float32)
    reference = np.array([[[1.0, 2.0, 3.0]]], np.float32)
    expected = (0.25 + 0 + 1) / 3 / (4 + 0.01)
    assert relmse(image, reference) == pytest.approx(expected, rel=1e-6)
    assert relmse_map(image, reference)[0, 0] == pytest.approx(expected, rel=1e-6)


def test_relmse_on_black_is_squared_error_over_epsilon():
    assert relmse(np.full((4, 4, 3), 0.1), np.zeros((4, 4, 3))) == pytest.approx(1.0, rel=1e-6)


def test_relmse_without_the_worst_pixels_forgets_a_firefly():
    reference = np.ones((50, 40, 3), np.float32)
    image = reference + 0.1
    image[7, 7] = 1000  # one of 2000 pixels; 0.1 % are two
    plain = 0.01 / 1.01
    assert relmse(image, reference, trim=0.001) == pytest.approx(plain, rel=1e-5)
    assert relmse(image, reference) == pytest.approx(
        (1999 * plain + 999**2 / 1.01) / 2000, rel=1e-5
    )


def test_trimmed_is_never_more_than_untrimmed():
    for seed in range(5):
        r = picture(seed)
        x = noisy(r, seed + 10, 0.8)
        assert relmse(x, r, trim=0.001) <= relmse(x, r)
        assert relmse(x, r, trim=0.1) < relmse(x, r, trim=0.01) < relmse(x, r)


def test_trim_is_rounded_down_so_that_small_images_lose_nothing():
    r = picture(0, 10, 10)
    assert relmse(noisy(r), r, trim=0.001) == relmse(noisy(r), r)


def test_relmse_trim_out_of_range_is_an_option_error():
    with pytest.raises(OptionError, match="trim is 1"):
        relmse(np.ones((2, 2, 3)), np.ones((2, 2, 3)), trim=1)


@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_subtracting_the_variance_of_the_reference_is_unbiased(offset):
    # 400 noisy references of a known truth, two hypotheses, each held to 4 standard errors.
    g = np.random.default_rng(3)
    truth = np.full((16, 16, 3), 2.0, np.float32)
    image = truth + np.float32(offset)
    sigma = 0.05
    variance = np.full(truth.shape, sigma**2, np.float32)
    plain, corrected = [], []
    for _ in range(400):
        reference = truth + g.normal(0, sigma, truth.shape).astype(np.float32)
        plain.append(relmse(image, reference))
        corrected.append(relmse(image, reference, reference_variance=variance))
    # What the docstring says is left: noise of the denominator that goes with the numerator's.
    left = 4 * offset * sigma**2 / (3 * 2.0**3)
    error = np.std(corrected) / math.sqrt(len(corrected))
    expected = relmse(image, truth) + left
    assert abs(np.mean(corrected) - expected) < 4 * error + 0.02 * left
    assert np.mean(plain) - np.mean(corrected) == pytest.approx(sigma**2 / 4.01, rel=0.01)


def test_smape_by_hand_and_bounded():
    image = np.array([[[1.0, 0.0, 3.0]]], np.float32)
    reference = np.array([[[2.0, 0.0, 1.0]]], np.float32)
    expected = (1 / 3.01 + 0 + 2 / 4.01) / 3
    assert smape(image, reference) == pytest.approx(expected, rel=1e-6)
    assert smape_map(image, reference)[0, 0] == pytest.approx(expected, rel=1e-6)
    assert smape(np.full((3, 3, 3), 1e6), np.zeros((3, 3, 3))) <= 1


def test_rmse_by_hand():
    image = np.zeros((2, 2, 3), np.float32)
    reference = np.zeros((2, 2, 3), np.float32)
    reference[0, 0] = (3, 0, 0)
    assert rmse(image, reference) == pytest.approx(math.sqrt(9 / 12), rel=1e-6)
    assert rmse_map(image, reference)[0, 0] == pytest.approx(math.sqrt(3), rel=1e-6)


def test_psnr_by_hand():
    # Display values 1 and 0 at exposure 1 in a quarter of the pixels: mean squared error 1/4.
    reference = np.zeros((2, 2, 3), np.float32)
    image = reference.copy()
    image[0, 0] = 5  # clipped to 1
    assert psnr(image, reference, exposure=1) == pytest.approx(10 * math.log10(4), rel=1e-6)


def test_psnr_uses_the_exposure_of_the_reference_for_both():
    r = picture()
    x = noisy(r)
    e = auto_exposure(r)
    mean = np.mean((display(x, e).astype(float) - display(r, e)) ** 2)
    assert psnr(x, r) == pytest.approx(-10 * math.log10(mean), abs=1e-3)
    # So doubling both changes nothing, and doubling one does.
    assert psnr(2 * x, 2 * r) == pytest.approx(psnr(x, r), abs=1e-3)
    assert psnr(2 * x, r) != pytest.approx(psnr(x, r), abs=0.1)


@pytest.mark.parametrize("name", [*CHEAP, "flip-ldr", "flip-hdr"])
def test_an_image_equals_itself(name):
    r = picture()
    perfect = {"psnr": math.inf, "ssim": 1.0}.get(name, 0.0)
    assert METRICS[name].score(Pair.of(r, r.copy())) == pytest.approx(perfect, abs=1e-6)


@pytest.mark.parametrize("name", [*CHEAP, "flip-ldr", "flip-hdr"])
def test_more_noise_is_worse(name):
    r = picture()
    scores = [METRICS[name].score(Pair.of(noisy(r, 1, s), r)) for s in (0.05, 0.2, 0.8)]
    if METRICS[name].better == "higher":
        scores.reverse()
    assert scores == sorted(scores)
    assert scores[0] < scores[-1]


# -------------------------------------------------------------------- twins


@pytest.mark.parametrize("size", [(40, 56), (11, 30), (130, 97)])
def test_ssim_agrees_with_scikit_image(size):
    r = picture(0, *size)
    x = noisy(r)
    e = auto_exposure(r)
    theirs, their_map = structural_similarity(
        display(x, e),
        display(r, e),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
        full=True,
    )
    assert ssim(x, r) == pytest.approx(theirs, abs=1e-4)
    assert dssim(x, r) == pytest.approx((1 - theirs) / 2, abs=5e-5)
    assert np.abs(ssim_map(x, r) - their_map.mean(axis=2)).max() < 1e-3


def test_psnr_agrees_with_scikit_image():
    r = picture()
    x = noisy(r)
    e = auto_exposure(r)
    theirs = peak_signal_noise_ratio(display(r, e), display(x, e), data_range=1.0)
    assert psnr(x, r) == pytest.approx(theirs, abs=1e-3)


def test_ssim_of_tiny_images():
    for shape in ((1, 1, 3), (1, 9, 3), (5, 2, 3)):
        r = np.random.default_rng(0).random(shape).astype(np.float32)
        assert ssim(r, r) == pytest.approx(1.0, abs=1e-6)
        assert -1 <= ssim(r[::-1, ::-1], r) <= 1


# --------------------------------------------------------------------- FLIP


def test_flip_of_black_against_white_is_near_its_maximum():
    black, white = np.zeros((32, 32, 3)), np.ones((32, 32, 3))
    assert flip_ldr(white, black, exposure=1) > 0.9
    assert flip_ldr(black, white, exposure=1) == pytest.approx(
        flip_ldr(white, black, exposure=1), abs=1e-5
    )


def test_flip_is_what_flip_evaluator_says():
    import flip_evaluator

    r = picture()
    x = noisy(r)
    e = auto_exposure(r)
    _, ldr, used = flip_evaluator.evaluate(display(r, e), display(x, e), "LDR")
    assert flip_ldr(x, r) == pytest.approx(ldr, abs=1e-5)
    assert used["ppd"] == pytest.approx(PPD, rel=1e-5)
    _, hdr, _ = flip_evaluator.evaluate(r, x, "HDR")
    assert flip_hdr(x, r) == pytest.approx(hdr, abs=1e-5)
    assert flip_ldr_map(x, r).shape == flip_hdr_map(x, r).shape == r.shape[:2]


def test_hdr_flip_exposures_match_the_default_ones_where_both_make_sense():
    # The range is computed here only for mostly black references; its formula is FLIP's own.
    import flip_evaluator

    from lambent.metrics.flip import _shoulder

    r = picture()
    _, _, used = flip_evaluator.evaluate(r, r, "HDR", applyMagma=False)
    y = r @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    assert hdr_exposures(r) == {}
    assert used["startExposure"] == pytest.approx(_shoulder() - np.log2(y.max()), abs=0.01)
    assert used["stopExposure"] == pytest.approx(_shoulder() - np.log2(np.median(y)), abs=0.01)


def test_hdr_flip_of_a_black_or_mostly_black_reference_does_not_end_the_process():
    # flip-evaluator itself calls exit() for the first and takes 23 exposures for the second.
    r = picture()
    black = np.zeros_like(r)
    assert flip_hdr(r, black) > 0.5
    assert flip_hdr(black, black) == 0
    mostly = r.copy()
    mostly[:22] = 0
    chosen = hdr_exposures(mostly)
    assert 0 < chosen["stopExposure"] - chosen["startExposure"] < 14
    assert 0 < flip_hdr(noisy(mostly), mostly) < 1


# --------------------------------------------------- channels, shapes, names


def test_channels_are_not_mixed_up():
    # Red against blue: wrong order of channels anywhere would make these equal or zero.
    red = np.zeros((24, 24, 3), np.float32)
    red[..., 0] = 0.5
    blue = red[..., ::-1].copy()
    for name in (*CHEAP, "flip-ldr", "flip-hdr"):
        score = METRICS[name].score
        same = score(Pair.of(red, red, 1.0))
        other = score(Pair.of(blue, red, 1.0))
        assert other != pytest.approx(same, abs=1e-3), name
    # A person sees an error in green much more than the same one in blue: FLIP knows which is which
    grey = np.full((32, 32, 3), 0.2, np.float32)
    green, bluish = grey.copy(), grey.copy()
    green[..., 1] += 0.1
    bluish[..., 2] += 0.1
    assert flip_ldr(green, grey, 1.0) > flip_ldr(bluish, grey, 1.0)


def test_one_channel_and_four_channels():
    r = picture()
    x = noisy(r)
    grey = r[..., :1]
    assert relmse(x[..., :1], grey) == pytest.approx(
        relmse(np.repeat(x[..., :1], 3, 2), np.repeat(grey, 3, 2))
    )
    assert relmse(x[..., 0], r[..., 0]) == relmse(x[..., :1], grey)
    with_alpha = np.concatenate([x, np.full((*x.shape[:2], 1), 0.5, np.float32)], axis=2)
    assert relmse(with_alpha, r) == relmse(x, r)


@pytest.mark.parametrize("metric", [relmse, smape, rmse, psnr, ssim, dssim, flip_ldr, flip_hdr])
def test_sizes_that_differ_are_an_error_with_both_sizes(metric):
    with pytest.raises(LayerError, match=r"5x4.*6x4"):
        metric(np.zeros((4, 5, 3)), np.zeros((4, 6, 3)))


@pytest.mark.parametrize("shape", [(4, 4, 2), (4, 4, 5), (4,), (0, 4, 3), (2, 2, 2, 3)])
def test_shapes_that_are_no_image_are_an_error(shape):
    with pytest.raises(LayerError, match="has shape"):
        relmse(np.zeros(shape), np.zeros(shape))


def test_registry_knows_its_names_and_suggests():
    for name in METRICS:
        metric = METRICS[name]
        assert metric.name == name
        assert metric.about.endswith(".")
    with pytest.raises(UnknownNameError, match="did you mean relmse"):
        METRICS["relmsee"]


def test_arguments_are_not_changed():
    r = picture()
    x = noisy(r)
    x[3, 3, 1] = np.nan
    before = x.copy(), r.copy()
    for name in METRICS:
        METRICS[name].score(Pair.of(x, r))
    assert np.array_equal(x, before[0], equal_nan=True)
    assert np.array_equal(r, before[1])


# --------------------------------------------------------------- bad pixels


@pytest.mark.parametrize("value", [np.nan, -np.inf])
@pytest.mark.parametrize("name", list(METRICS))
def test_a_pixel_that_is_not_finite_costs_more_than_a_black_one(name, value):
    r = picture()
    r[5, 5] = 0.9 / auto_exposure(r)  # bright in the display, so black is the farthest there
    x = noisy(r, strength=0.1)
    black, bad = x.copy(), x.copy()
    black[5, 5] = 0
    bad[5, 5, 1] = value
    pair = Pair.of(bad, r)
    score = METRICS[name].score(pair)
    worse = METRICS[name].score(Pair.of(black, r))
    assert pair.bad.sum() == 1
    assert math.isfinite(score)
    if METRICS[name].better == "higher":
        assert score <= worse + 1e-6 < METRICS[name].score(Pair.of(x, r)) + 1e-6
    elif name == "relmse-trimmed":
        assert score >= METRICS[name].score(Pair.of(x, r)) * 0.99
    else:
        assert score >= worse - 1e-6


def test_a_bad_pixel_has_the_worst_error_in_the_map():
    r = picture()
    x = noisy(r)
    x[2, 3] = np.nan
    assert smape_map(x, r)[2, 3] == 1
    assert flip_ldr_map(x, r)[2, 3] == 1
    assert flip_hdr_map(x, r)[2, 3] == 1
    assert relmse_map(x, r)[2, 3] == relmse_map(x, r).max() > 0


def test_a_bad_pixel_of_the_reference_is_left_out():
    r = picture()
    x = noisy(r)
    hole = r.copy()
    hole[4, 4, 2] = np.inf
    keep = np.ones(r.shape[:2], bool)
    keep[4, 4] = False
    assert relmse(x, hole) == pytest.approx(float(relmse_map(x, r)[keep].mean()), rel=1e-5)
    assert relmse_map(x, hole)[4, 4] == 0
    for name in METRICS:
        assert math.isfinite(METRICS[name].score(Pair.of(x, hole)))


def test_an_image_of_nothing_but_nan_still_has_numbers():
    r = picture()
    x = np.full_like(r, np.nan)
    assert smape(x, r) == 1
    assert flip_ldr(x, r) == 1
    assert relmse(x, r) == pytest.approx(relmse(np.zeros_like(r), r))
