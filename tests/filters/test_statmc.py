"""StatMC: who is averaged with whom, and how much noise is left."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.errors import LayerError, OptionError
from lambent.filters.denoiser import create
from lambent.filters.features import smoothed_variance
from lambent.filters.statmc import StatMC, johnson
from lambent.filters.statmc_tuned import StatMCTuned
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role
from lambent.kernels.statistics import t_quantile


def two_regions(spp=32, size=64, step=2.0, seed=0):
    """Two flat halves, 1 and 1 + step, with normal samples of deviation 0.4 in each channel."""
    rng = np.random.default_rng(seed)
    clean = np.ones((size, size, 3), np.float32)
    clean[:, size // 2 :] += step
    samples = clean + 0.4 * rng.standard_normal((spp, size, size, 3)).astype(np.float32)
    frame = Frame.from_arrays(
        spp=spp,
        colour=samples.mean(0),
        colour_variance=samples.var(0, ddof=1) / spp,
        colour_half_a=samples[::2].mean(0),
        colour_half_b=samples[1::2].mean(0),
    )
    return frame, clean


def test_edge_stays_and_noise_falls():
    """The variance left is Σw² of the disc's Gaussian, within what a rejected 1.5 % changes."""
    frame, clean = two_regions()
    denoiser = StatMC(radius=8, sigma=4.0)
    result = denoiser(frame).colour
    inner = np.s_[10:-10, 10:22]  # no border, no edge within the disc
    left = (result - clean)[inner].var()
    y, x = np.mgrid[-8:9, -8:9]
    w = np.where(x**2 + y**2 <= 64, np.exp(-(x**2 + y**2) / 32), 0)
    expected = (w**2).sum() / w.sum() ** 2 * 0.16 / 32
    assert left == pytest.approx(expected, rel=0.5)  # neighbours share their noise: few are free
    assert left < 0.16 / 32 / 40
    assert np.abs(result - clean).max() < 0.1  # at the edge too: nothing crosses a step of 2


def test_alpha_is_the_share_of_wrong_rejections():
    """Equal pixels are joined but for α: with one channel that carries noise, 5 %."""
    rng = np.random.default_rng(3)
    samples = np.ones((16, 60, 60, 3), np.float32)
    samples[..., 0] += rng.standard_normal((16, 60, 60)).astype(np.float32)
    frame = Frame.from_arrays(
        spp=16, colour=samples.mean(0), colour_variance=samples.var(0, ddof=1) / 16
    )
    denoiser = StatMC(radius=4, sigma=1e3, alpha=0.05)
    target = np.zeros((60, 60, 1), np.float32)
    target[30, 30] = 1
    # The weights of one pixel in all others: 1/members, or 0 where the test rejects.
    shares = []
    for y in range(8, 52, 9):
        for x in range(8, 52, 9):
            target[:] = 0
            target[y, x] = 1
            seen = denoiser.filter(frame, target)[y - 4 : y + 5, x - 4 : x + 5, 0]
            shares.append((seen > 0).sum() - 1)
    assert 1 - np.mean(shares) / 48 == pytest.approx(0.05, abs=0.04)


def test_constant_and_sum():
    frame, _ = two_regions(size=32)
    denoiser = StatMC()
    flat = np.full((32, 32, 1), 3.0, np.float32)
    np.testing.assert_allclose(denoiser.filter(frame, flat), flat, rtol=5e-6)
    part = np.random.default_rng(1).random((32, 32, 3)).astype(np.float32)
    stack = np.concatenate([frame.colour, part, frame.colour - part], axis=2)
    result = denoiser.filter(frame, stack)
    np.testing.assert_allclose(result[:, :, :3], result[:, :, 3:6] + result[:, :, 6:], atol=5e-6)


def test_tiles_equal_the_whole():
    frame, _ = two_regions(size=64)
    denoiser = StatMC(radius=6).fitted(frame)
    whole = denoiser.filter(frame, frame.colour)
    edge = denoiser.margin()
    tile = frame.crop(10, 50, 5, 55)
    part = denoiser.filter(tile, tile.colour)[edge:-edge, edge:-edge]
    np.testing.assert_allclose(part, whole[10 + edge : 50 - edge, 5 + edge : 55 - edge], atol=1e-6)


def test_features_separate_what_light_does_not():
    """Equal radiance on different albedo: not averaged, so a target told apart stays apart."""
    frame, _ = two_regions(size=32, step=0.0)
    albedo = np.zeros((32, 32, 3), np.float32)
    albedo[:, 16:] = 1
    with_albedo = frame.with_layer(Layer(Role.ALBEDO, albedo))
    mask = albedo[:, :, :1].copy()
    np.testing.assert_allclose(StatMC().filter(with_albedo, mask), mask, atol=1e-6)
    assert 0.2 < StatMC().filter(frame, mask)[16, 16, 0] < 0.8


def test_half_buffers_instead_of_variance():
    """One degree of freedom a pixel, smoothed; the edge must still stay."""
    frame, clean = two_regions()
    halves = frame.without((Role.COLOUR, frame.layer(Role.COLOUR).stat.VARIANCE))
    denoiser = StatMC(radius=8, sigma=4.0)
    assert denoiser.tested(halves)[2] == 25.0
    assert len(denoiser.remarks(halves)) == 1
    assert np.abs(denoiser(halves)[Role.COLOUR] - clean).max() < 0.12


def test_box_cox_layers_decide():
    """Where the frame has them they are what is tested: here they say that all is equal."""
    frame, _ = two_regions(size=24)
    flat = np.zeros((24, 24, 3), np.float32)
    for name, image in (("boxcox", flat), ("boxcox_variance", flat + 1), ("boxcox_skew", flat)):
        frame = frame.with_layer(Layer(Role.OTHER, image, name=name))
    result = StatMC(radius=20, sigma=1e3)(frame).colour
    assert np.ptp(result[12, 8:16]) < 0.5  # the step of 2 is gone
    assert np.ptp(StatMC(radius=20, sigma=1e3, boxcox=False)(frame).colour[12, 8:16]) > 1.9


def firefly():
    """A flat frame of 1 with deviation 0.1, and one pixel at 50 whose deviation is 40."""
    rng = np.random.default_rng(5)
    colour = (1 + 0.1 * rng.standard_normal((40, 40, 1)) * np.ones(3)).astype(np.float32)
    variance = np.full((40, 40, 3), 0.01, np.float32)
    colour[20, 20], variance[20, 20] = 50, 1600
    return Frame.from_arrays(spp=16, colour=colour, colour_variance=variance)


def test_firefly_does_not_spread():
    """The test joins a firefly with all around: it must not be handed to those who know better."""
    frame = firefly()
    apart = np.hypot(*np.mgrid[-20:20, -20:20]) > 2  # the 3x3 beside it count as noisy themselves
    assert np.abs(StatMCTuned()(frame).colour - 1)[apart].max() < 0.1
    assert np.abs(StatMCTuned()(frame).colour[20, 20] - 1).max() < 1  # and is healed itself
    spread = StatMC()(frame).colour
    assert spread[20, 26].min() > 1.05  # the paper's rule, for comparison


def test_smoothed_variance():
    """3x3 means of the variance; a floor of a thousandth of the mean; no dependence on units."""
    frame = firefly()
    level = smoothed_variance(frame)
    assert level[20, 20] == level[19, 21] == pytest.approx((1600 + 8 * 0.01) / 9, rel=1e-4)
    assert level[5, 5] == pytest.approx(0.01, rel=1e-3)
    clean = Frame.from_arrays(colour=frame.colour * 0 + 2, colour_variance=frame.colour * 0)
    np.testing.assert_allclose(smoothed_variance(clean), 4e-6, rtol=1e-5)
    with pytest.raises(LayerError, match="variance"):
        smoothed_variance(Frame.from_arrays(colour=frame.colour))


def test_johnson():
    """m + μ₃/(6 s² n): exponential samples have μ₃ = 2, s² = 1."""
    one = np.ones((1, 1, 3), np.float32)
    np.testing.assert_allclose(johnson(one, one / 10, 2 * one, 10), 1 + 2 / 60, rtol=1e-6)
    np.testing.assert_allclose(johnson(one, one * 0, 2 * one, 10), 1)


def test_what_is_missing_is_said():
    colour = np.ones((4, 4, 3), np.float32)
    with pytest.raises(LayerError, match=r"colour\.variance"):
        StatMC()(Frame.from_arrays(colour=colour))
    with pytest.raises(LayerError, match="both"):
        StatMC()(Frame.from_arrays(colour=colour, colour_half_a=colour))
    with pytest.raises(OptionError, match="alpha"):
        create("statmc", alpha="2")
    unknown = Frame.from_arrays(colour=colour, colour_variance=colour)
    assert StatMC().tested(unknown)[2] == float("inf")


def test_the_plain_name_is_the_papers_rule():
    """Radius 20, σ = 10, Welch's test alone: two pixels, by hand."""
    plain = create("statmc")
    assert (plain.radius, plain.sigma, plain.alpha, plain.by_variance) == (20, 10.0, 0.005, False)
    colour = np.array([[[1.0, 1, 1], [1.2, 1.2, 1.2]]], np.float32)
    frame = Frame.from_arrays(spp=9, colour=colour, colour_variance=np.full_like(colour, 0.01))
    t = t_quantile(0.005, 16)
    assert t**2 * 0.02 > 0.2**2  # so they are joined
    w = np.exp(-1 / 200)
    expected = [(1 + 1.2 * w) / (1 + w), (1.2 + w) / (1 + w)]
    np.testing.assert_allclose(plain(frame).colour[0, :, 0], expected, rtol=1e-5)
