"""Losses: what they are 0 for, and that noise of the target does not move them."""

import numpy as np
import pytest
import torch

from lambent.frame.tonemap import srgb
from lambent.learn import losses
from lambent.metrics.ssim import dssim


def images(seed=0):
    torch.manual_seed(seed)
    return torch.rand(2, 3, 32, 32) + 0.1


def test_all_are_zero_for_the_target_itself():
    r = images()
    for loss in (losses.smape, losses.logarithmic, losses.gradient):
        assert float(loss(r, r).abs().max()) < 1e-6
    assert float(losses.relative_square(r, r, r[:, :1]).abs().max()) < 1e-6
    total, terms = losses.denoising(r, r, r, torch.zeros(2, 1, 32, 32), torch.zeros(2))
    assert float(total) < 1e-6
    assert set(terms) == {"log", "square", "bright", "gradient", "wide", "structure"}


def test_structure_is_the_metric():
    """Of pictures without noise it is DSSIM, up to the window; blur costs more than a tint."""
    r = images()
    r = torch.nn.functional.interpolate(r, scale_factor=4, mode="bicubic").clamp(0.02, 0.95)
    blurred = torch.nn.functional.avg_pool2d(r, 5, 1, 2, count_include_pad=False)
    none = torch.zeros(2, 1, 128, 128)
    for x in (blurred, 1.1 * r):
        ours = float(losses.structure(x, r, none).mean())
        metric = np.mean(
            [dssim(*(np.moveaxis(p[n].numpy(), 0, 2) for p in (x, r)), 1.0) for n in (0, 1)]
        )
        assert ours == pytest.approx(metric, rel=0.35)
    assert losses.structure(blurred, r, none).mean() > 3 * losses.structure(1.1 * r, r, none).mean()


def test_noise_of_the_target_is_no_structure():
    """A grey wall and a noisy target: the wall is the most similar, not a picture with noise."""
    torch.manual_seed(0)
    wall = torch.full((4, 3, 64, 64), 0.3)
    sigma = 0.03
    r = wall + sigma * torch.randn_like(wall)
    deviation = torch.full((4, 1, 64, 64), sigma)
    wrong = wall + sigma * torch.randn_like(wall)
    told = float(losses.structure(wall, r, deviation).mean())
    assert told < 0.3 * float(losses.structure(wall, r, 0 * deviation).mean())
    assert told < 0.3 * float(losses.structure(wrong, r, deviation).mean())


def test_displayed_is_the_tone_map():
    x = torch.linspace(0, 1.2, 100)
    np.testing.assert_allclose(losses.displayed(x).numpy(), srgb(x.numpy()), atol=1e-5)


def test_with_a_large_epsilon_the_dark_hardly_counts():
    r = torch.tensor([0.02, 0.8])[:, None, None, None].expand(2, 3, 8, 8)
    none = torch.zeros(2, 1, 8, 8)
    small, large = (
        losses.relative_square(1.3 * r, r, none, epsilon).mean((1, 2, 3))
        for epsilon in (losses.EPSILON, losses.WHITE)
    )
    assert large[0] < 0.1 * small[0]
    assert large[1] > 0.6 * small[1]


def test_the_asymmetric_factor_sees_sides():
    r = torch.ones(1, 3, 8, 8)
    c, one = r + 1, torch.ones(1)
    beyond, before = losses.asymmetric(r - 0.1, r, c, one), losses.asymmetric(r + 0.1, r, c, one)
    assert float(beyond.mean()) == 1 + losses.ASYMMETRY
    assert float(before.mean()) == 1
    assert float(losses.asymmetric(r - 0.1, r, c, 0 * one).mean()) == 1


def test_a_noisy_target_weighs_less():
    r = torch.ones(1, 3, 32, 32)
    deviation = torch.zeros(1, 1, 32, 32)
    deviation[..., 16:] = 1.0
    weight = losses.trust(r, deviation)
    assert float(weight[..., :12].min()) > 0.99
    assert float(weight[..., 20:].max()) < 0.25


def test_cleaner_crops_weigh_more():
    r = torch.ones(3, 3, 16, 16)
    c = r * torch.tensor([1.05, 1.5, 8.0])[:, None, None, None]
    share = losses.evened(r, c, torch.ones(3, 1, 16, 16)).flatten()
    assert share[0] > 1 > share[2]
    one = losses.evened(r[:1], c[:1], torch.ones(1, 1, 16, 16))
    assert float(one) == float(share[0])  # whatever else is in the batch
    noise = losses.logarithmic(c, r).mean((1, 2, 3))
    assert (share * noise).diff().min() > 0  # but does not turn the order of the losses


def test_light_in_the_dark_keeps_its_slope():
    """A dark pixel that gets light from a lamp of 1000: the pull on the lamp's weight stays."""
    r = torch.full((1, 3, 8, 8), 0.1)
    for weight in (0.01, 0.1):
        logit = torch.tensor(weight).logit().requires_grad_()
        x = r + torch.sigmoid(logit) * (1000 - r)
        losses.logarithmic(x, r).mean().backward()
        assert float(logit.grad) > 0.3


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_discounting_does_not_darken(sigma):
    """Targets of true value 1 with skewed noise: the best constant under the weights is near 1."""
    torch.manual_seed(0)
    shape = 1 / sigma**2
    r = torch.distributions.Gamma(shape, shape).sample((4, 1, 256, 256)).expand(4, 3, 256, 256)
    deviation = r[:, :1] * sigma  # as a renderer estimates it: larger where the value is larger
    weight = losses.trust(r, deviation)
    mean = float((weight * r).sum() / (weight.sum() * 3))
    assert mean == pytest.approx(1, abs=0.02 * sigma + 0.002)


def test_the_unbiased_loss_is_least_at_the_mean():
    torch.manual_seed(1)
    r = torch.distributions.Exponential(1.0).sample((1, 3, 200, 200))
    values = torch.linspace(0.8, 1.2, 9)
    # the slope at the mean is that of the expectation: 0 up to noise
    x = torch.ones(1, requires_grad=True)
    losses.unbiased(x.expand_as(r), r.clamp_max(8)).backward()
    assert abs(float(x.grad)) < 0.05
    assert values.numel() == 9
