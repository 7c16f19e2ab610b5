"""What is done to an example is done to noisy frame and target alike, and is what it says."""

from dataclasses import replace

import made
import numpy as np
import pytest
from made import few_threads  # noqa: F401

from lambent.denoise.inputs import Signals, signals_of
from lambent.learn import augment
from lambent.learn.augment import Example
from lambent.learn.splat import FILTERS, expected, splatted


def example(spp=4):
    rng = np.random.default_rng(0)
    noisy = signals_of(made.frame(rng, spp))
    clean = made.frame(rng, spp, clean=True).colour.transpose(2, 0, 1)
    return Example(noisy, clean, np.full((1, 64, 64), 0.01, np.float32))


def test_merged_levels_are_one_render():
    rng = np.random.default_rng(1)
    levels = [signals_of(made.frame(rng, spp)) for spp in (2, 6)]
    one = augment.merged(levels)
    assert one.spp == 8
    np.testing.assert_allclose(
        one.colour, (2 * levels[0].colour + 6 * levels[1].colour) / 8, rtol=1e-5
    )
    ratio = float((one.layers["colour_std"] / levels[0].layers["colour_std"]).mean())
    assert ratio == pytest.approx(0.5, rel=1e-3)  # four times the samples


def test_turning_moves_everything_together():
    start = example()
    values = np.random.default_rng(9).permutation(3 * 64 * 64).reshape(3, 64, 64)
    start = replace(start, target=values.astype(np.float32))  # each value once
    for seed in range(8):
        turned = augment.turned(start, np.random.default_rng(seed))
        # a picture of the target's own values finds each pixel again
        order = np.argsort(turned.target[0], axis=None)
        before = np.argsort(start.target[0], axis=None)
        for name in ("albedo", "depth", "colour_std"):
            a = turned.noisy.layers[name][0].reshape(-1)[order]
            b = start.noisy.layers[name][0].reshape(-1)[before]
            np.testing.assert_allclose(a, b, rtol=1e-6)
        length = np.linalg.norm(turned.noisy.layers["normal"], axis=0)
        np.testing.assert_allclose(length, 1, rtol=1e-5)


def test_recolouring_keeps_light_over_albedo_apart_from_a_gain():
    start = example()
    for seed in range(8):
        made_up = augment.recoloured(start, np.random.default_rng(seed))
        ratio = made_up.target / made_up.noisy.layers["albedo"]
        plain = start.target / start.noisy.layers["albedo"]
        gains = np.sort((ratio / plain[0]).reshape(3, -1).mean(axis=1))
        # every channel is the old light (the same in all channels) times one number
        for channel in ratio:
            np.testing.assert_allclose(channel / plain[0], (channel / plain[0]).mean(), rtol=1e-4)
        assert gains[0] > 0


def test_dropping_layers_leaves_plain_frames_often():
    rng = np.random.default_rng(2)
    seen = {tuple(sorted(augment.without_some(example(), rng).noisy.layers)) for _ in range(200)}
    assert () in seen
    assert ("albedo", "normal") in seen
    assert tuple(sorted(example().noisy.layers)) in seen
    for layers in seen:
        assert "albedo_std" not in layers or "albedo" in layers


@pytest.mark.parametrize("kind", FILTERS, ids=lambda kind: kind.name)
def test_splatting_a_constant_changes_nothing(kind):
    image = np.full((2, 20, 30), 3.0, np.float32)
    np.testing.assert_allclose(expected(image, kind), 3, rtol=1e-5)
    out = splatted(image, 4, kind, np.random.default_rng(0))
    assert np.median(np.abs(out - 3)) < 1e-5


@pytest.mark.parametrize("kind", FILTERS, ids=lambda kind: kind.name)
def test_splatting_has_its_expectation(kind):
    rng = np.random.default_rng(3)
    image = rng.random((1, 24, 24), np.float32)
    mean = np.mean([splatted(image, 4, kind, rng) for _ in range(300)], axis=0)
    # the quotient of means is not the mean of quotients: a small bias stays
    assert np.abs(mean - expected(image, kind)).mean() < 0.02


def test_a_tent_makes_neighbours_alike():
    rng = np.random.default_rng(4)
    image = rng.normal(1, 1, (1, 200, 200)).astype(np.float32)
    out = splatted(image, 64, FILTERS[0], rng)[0]
    out = out - out.mean()
    correlation = float((out[:, 1:] * out[:, :-1]).mean() / (out * out).mean())
    assert correlation == pytest.approx(0.3, abs=0.08)


def test_a_splatted_frame_has_no_variance():
    out = augment.filtered(example(), np.random.default_rng(5))
    assert not any(name.endswith("_std") for name in out.noisy.layers)
    assert isinstance(out.noisy, Signals)
