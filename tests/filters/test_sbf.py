"""SURE-based filter: against NumPy, the derivative by differences, the estimate by truth."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.errors import LayerError, OptionError
from lambent.filters.sbf import SUREFilter, gaussian_taps, reach
from lambent.filters.sbf_tuned import SUREFilterTuned
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat


def scene(height=40, width=48, spp=8, seed=0, noise=0.3):
    """A sharp shadow that no feature shows, over two albedos; Gaussian noise of known variance."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    albedo = np.where((x < width // 2)[:, :, None], [0.8, 0.3, 0.2], [0.2, 0.4, 0.9])
    truth = albedo * np.where(y < height // 2, 1.0, 0.15)[:, :, None]
    deviation = np.full_like(truth, noise / np.sqrt(spp))
    colour = truth + rng.normal(size=truth.shape) * deviation
    frame = Frame.from_arrays(
        spp=spp,
        colour=colour,
        colour_variance=deviation**2,
        albedo=albedo,
        albedo_variance=np.full_like(albedo, 1e-4),
    )
    return frame, truth.astype(np.float32)


def twin(frame: Frame, model: SUREFilter, sigma: float, targets: np.ndarray):
    """Equation 1 in plain NumPy: means, Σw."""
    guide = model.guide(frame).astype(np.float64)
    half = guide.shape[2] // 2
    f, v = guide[:, :, :half], guide[:, :, half : 2 * half]
    u = guide[:, :, -1] if guide.shape[2] % 2 else np.ones(guide.shape[:2])
    height, width = targets.shape[:2]
    total, sums = np.zeros((height, width)), np.zeros(targets.shape)
    for (dx, dy), factor in zip(*gaussian_taps(sigma), strict=True):
        for y in range(max(0, -dy), min(height, height - dy)):
            x = np.arange(max(0, -dx), min(width, width - dx))
            q = (y + dy, x + dx)
            w = np.exp(factor - ((f[y, x] - f[q]) ** 2 / np.maximum(1, v[y, x] + v[q])).sum(-1))
            w *= np.minimum(1, u[y, x] / u[q])
            total[y, x] += w
            sums[y, x] += w[:, None] * targets[q]
    return sums / total[:, :, None], total


@pytest.mark.parametrize("by_variance", [True, False])
@pytest.mark.parametrize("sigma_colour", [None, 0.2])
def test_bank_against_numpy(sigma_colour, by_variance):
    frame, _ = scene(20, 23)
    spread = 10 ** np.random.default_rng(4).uniform(-4, 2, (20, 23, 3))
    frame = frame.with_layer(frame.layer(Role.COLOUR, Stat.VARIANCE).with_data(spread))
    model = SUREFilter(sigma_colour=sigma_colour, by_variance=by_variance)
    guide = model.guide(frame)
    targets = np.concatenate([frame.colour, frame.colour[:, :, :1] * 0.5], axis=2)
    mean, square, total, filtered = model._apply(frame, targets, guide, 2.0)
    expected, weights = twin(frame, model, 2.0, targets)
    np.testing.assert_allclose(filtered, expected, rtol=2e-4, atol=2e-5)
    np.testing.assert_allclose(total, weights, rtol=2e-4)
    np.testing.assert_array_equal(mean, filtered[:, :, :3])
    if sigma_colour is not None:
        expected, _ = twin(frame, model, 2.0, frame.colour**2)
        np.testing.assert_allclose(square, expected, rtol=2e-4, atol=2e-5)


def test_derivative_is_that_of_the_filter():
    """Equation 4 against central differences of the NumPy twin, with the colour term on."""
    frame, _ = scene(9, 9)
    model = SUREFilter(sigma_colour=0.3, _exposure=1.0)
    y, x, c, step = 4, 5, 1, 1e-3
    sides = []
    for sign in (1, -1):
        colour = frame.colour.copy()
        colour[y, x, c] += sign * step
        moved = frame.with_layer(frame.layer(Role.COLOUR).with_data(colour))
        sides.append(twin(moved, model, 2.0, colour)[0][y, x, c])
    difference = (sides[0] - sides[1]) / (2 * step)
    mean, total = twin(frame, model, 2.0, frame.colour)
    square, _ = twin(frame, model, 2.0, frame.colour**2)
    formula = 1 / total[y, x] + (square - mean**2)[y, x, c] / 0.3**2
    assert formula == pytest.approx(difference, rel=0.02)
    assert (square - mean**2)[y, x, c] / 0.3**2 > 0.1 / total[y, x]  # the term matters here


@pytest.mark.parametrize("relative", [False, True])
def test_sure_estimates_the_squared_error(relative):
    """Unbiased: over many pixels, the mean of SURE is the mean squared error, at every scale.

    9600 pixels x 3 channels; the standard error of the mean is below 2 % of the variance.
    """
    frame, truth = scene(80, 120, seed=3)
    model = SUREFilter(relative=relative, _exposure=1.0)
    guide = model.guide(frame)
    for sigma in model.bank():
        mean, square, total, _ = model._apply(frame, frame.colour, guide, sigma)
        level = (mean**2).mean(axis=2) + 0.01 if relative else 1.0
        estimate = (model.sure(frame, mean, square, total) * level).mean()
        error = ((mean - truth) ** 2).sum(axis=2).mean()
        variance = 3 * frame[Role.COLOUR, Stat.VARIANCE].mean()
        assert estimate == pytest.approx(error, abs=float(0.05 * variance))


@pytest.mark.parametrize(("kind", "gain"), [(SUREFilter, 0.9), (SUREFilterTuned, 0.8)])
def test_small_windows_at_the_shadow_and_large_ones_beside_it(kind, gain):
    frame, truth = scene(64, 64, noise=0.2)
    model = kind()
    guide = model.guide(frame)
    errors = []
    for sigma in model.bank():
        mean, square, total, _ = model._apply(frame, frame.colour, guide, sigma)
        errors.append(model.sure(frame, mean, square, total))
    chosen = model.choose(errors, guide)
    assert chosen[31:33].mean() < 1.2
    assert chosen[:12].mean() > chosen[31:33].mean() + 1
    clean = model(frame)[Role.COLOUR]
    error = ((clean - truth) ** 2).mean()
    for sigma in (1.0, 8.0):
        alone = kind(smallest=sigma, largest=sigma)(frame)[Role.COLOUR]
        assert error < gain * ((alone - truth) ** 2).mean()


def test_layers_still_sum_and_constants_stay():
    """A weighted average with the beauty's weights: linear, Σw = 1."""
    frame, _ = scene(32, 32)
    share = np.random.default_rng(1).random((32, 32, 1)).astype(np.float32)
    direct = frame.colour * share
    stack = np.concatenate([frame.colour, direct, frame.colour - direct, np.ones_like(share)], 2)
    result = SUREFilter().filter(frame, stack)
    np.testing.assert_allclose(result[:, :, 3:6] + result[:, :, 6:9], result[:, :, :3], atol=1e-5)
    np.testing.assert_allclose(result[:, :, 9], 1, atol=1e-5)


def test_firefly_is_not_spread():
    """Features do not know it, so that every scale would hand it on; the noise level does."""
    colour = np.ones((40, 40, 3), np.float32)
    variance = np.full((40, 40, 3), 0.01, np.float32)
    colour[20, 20], variance[20, 20] = 50, 1600
    frame = Frame.from_arrays(spp=16, colour=colour, colour_variance=variance)
    apart = np.hypot(*np.mgrid[-20:20, -20:20]) > 2  # the 3x3 beside it count as noisy themselves
    assert np.abs(SUREFilterTuned()(frame).colour - 1)[apart].max() < 0.01
    assert np.abs(SUREFilter()(frame).colour - 1)[apart].max() > 0.1


def test_tiles_equal_the_whole():
    frame, _ = scene(24, 128)
    model = SUREFilter(largest=4.0, selection=4.0).fitted(frame)
    whole = model.filter(frame, frame.colour)
    left = 64 - model.margin()
    piece = frame.crop(0, 24, left, 128)
    tile = model.filter(piece, piece.colour)
    np.testing.assert_allclose(tile[:, 64 - left :], whole[:, 64:], rtol=1e-4, atol=1e-5)
    assert model.margin() == 2 * reach(4.0) + 3


@pytest.mark.parametrize("size", [(1, 1), (1, 30), (30, 1)])
def test_small_images(size):
    frame, _ = scene(*size)
    clean = SUREFilter()(frame)[Role.COLOUR]
    assert clean.shape == (*size, 3)
    assert np.isfinite(clean).all()


def test_half_buffers_do_as_variance_and_features_are_optional():
    rng = np.random.default_rng(0)
    a, b = (rng.gamma(2, 0.5, (32, 32, 3)).astype(np.float32) for _ in range(2))
    frame = Frame.from_arrays(colour=(a + b) / 2, colour_half_a=a, colour_half_b=b)
    clean = SUREFilter()(frame)[Role.COLOUR]
    assert clean.std() < 0.3 * frame.colour.std()


def test_nan_does_not_spread():
    frame, _ = scene(24, 24)
    colour = frame.colour.copy()
    colour[12, 12] = np.nan
    bad = frame.with_layer(frame.layer(Role.COLOUR).with_data(colour))
    clean = SUREFilter().filter(bad, bad.colour)
    assert np.isfinite(clean).sum() >= clean.size - 3


def test_what_it_needs():
    with pytest.raises(LayerError, match="variance"):
        SUREFilter()(Frame.from_arrays(colour=np.ones((4, 4, 3))))
    with pytest.raises(OptionError, match="scales"):
        SUREFilter(smallest=4.0, largest=2.0)
