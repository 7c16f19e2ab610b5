"""NFOR, tuned: linear in the targets, exact where it must be, better than its input."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.errors import OptionError
from lambent.filters.denoiser import create
from lambent.filters.nfor_tuned import NFORTuned, box_mean, limit, spatial_variance
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat


def rendered(height=48, width=56, noise=0.3, seed=0, **drop):
    """A made-up render: two objects, a texture in the albedo, light that falls off; 8 samples."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    inside = ((x - width / 2) ** 2 + (y - height / 2) ** 2 < (height / 3) ** 2)[..., None]
    stripes = 0.5 + 0.4 * np.sign(np.sin(x / 3))[..., None]
    albedo = np.where(inside, [0.8, 0.3, 0.2], stripes).astype(np.float32)
    normal = np.where(inside, [0, 0, 1], [0, 1, 0]).astype(np.float32)
    depth = np.where(inside[..., 0], 2.0, 4 + y / height).astype(np.float32)
    clean = (albedo * (0.4 + x[..., None] / width)).astype(np.float32)
    samples = clean + noise * np.sqrt(clean) * rng.standard_normal((8, height, width, 3))
    samples = samples.astype(np.float32)
    arrays = {
        "colour": samples.mean(0),
        "colour_variance": samples.var(0, ddof=1) / 8,
        "colour_half_a": samples[::2].mean(0),
        "colour_half_b": samples[1::2].mean(0),
        "albedo": albedo,
        "normal": normal,
        "depth": depth,
    }
    return Frame.from_arrays(spp=8, **{k: v for k, v in arrays.items() if k not in drop}), clean


HALVES = {"colour_half_a": 0, "colour_half_b": 0}
ALL = {**HALVES, "colour_variance": 0}


@pytest.mark.parametrize(
    ("drop", "gain", "wide"),
    [({}, 3, 12), (HALVES, 2, 8), (ALL, 2.5, 8)],
    ids=["halves", "variance", "plain"],
)
def test_lowers_the_error(drop, gain, wide):
    """Each of the three kinds of frame; the texture in the albedo must survive.

    Noise is even here and features explain everything, so that a wide k is best.
    """
    frame, clean = rendered(**drop)
    before = np.mean((frame.colour - clean) ** 2)
    assert np.mean((NFORTuned()(frame).colour - clean) ** 2) < before / gain
    assert np.mean((NFORTuned(k=1.0)(frame).colour - clean) ** 2) < before / wide
    assert (len(NFORTuned().remarks(frame)) == 0) == (not drop)


def test_nothing_rings_beside_a_firefly():
    """No value below zero, and none above the frame's own, where planes would be steep."""
    frame, _ = rendered(noise=0.1)
    fly = np.zeros((48, 56, 1), np.float32)
    fly[::9, ::8] = 60.0
    half = {"colour_half_a": 2 * fly, "colour_half_b": 0 * fly, "colour_variance": fly**2}
    arrays = {
        "colour": frame.colour + fly,
        "colour_half_a": frame[Role.COLOUR, Stat.HALF_A] + half["colour_half_a"],
        "colour_half_b": frame[Role.COLOUR, Stat.HALF_B],
        "colour_variance": frame[Role.COLOUR, Stat.VARIANCE] + half["colour_variance"],
    }
    guides = {role.value: frame[role] for role in (Role.ALBEDO, Role.NORMAL, Role.DEPTH)}
    result = NFORTuned()(Frame.from_arrays(spp=8, **arrays, **guides)).colour
    assert result.min() > -1e-5
    assert result.max() <= 61.5


def test_limit_is_a_share():
    """Half the way where the plane is below zero as far as the mean is above; none from zero."""
    mean = np.array([[[1.0, 1.0, 1.0], [1.0, 2.0, 1.0], [0.0, 1.0, 1.0]]], np.float32)
    plane = np.array([[[0.5, 1.0, 2.0], [-1.0, 2.0, 1.0], [0.1, 1.0, 1.0]]], np.float32)
    np.testing.assert_allclose(limit(plane, mean)[0, :, 0], [1.0, 0.5, 0.0])


def test_layers_still_sum():
    """Light groups go through the operator of the beauty: 1e-5 of the beauty's range."""
    frame, _ = rendered()
    part = np.random.default_rng(1).random((48, 56, 1)).astype(np.float32)
    key = frame.colour * part
    frame = Frame.from_layers(
        [*frame.layers.values(), *Frame.from_arrays(lighting={"key": key}).all_layers()], spp=8
    )
    denoiser = NFORTuned()
    stack = np.concatenate([frame.colour, key, frame.colour - key], axis=2)
    result = denoiser.fitted(frame).filter(frame, stack)
    np.testing.assert_allclose(result[:, :, :3], result[:, :, 3:6] + result[:, :, 6:], atol=3e-5)
    named = denoiser(frame)
    np.testing.assert_allclose(named.extras["key"].data, result[:, :, 3:6], atol=3e-5)


@pytest.mark.parametrize("drop", [{}, ALL], ids=["halves", "plain"])
def test_constants_pass(drop):
    """Weights of a constant target sum to one, features or not."""
    frame, _ = rendered(24, 30, **drop)
    flat = np.full((24, 30, 3), 2.5, np.float32)
    np.testing.assert_allclose(NFORTuned().filter(frame, flat), flat, rtol=2e-5)


def test_affine_image_of_features_is_untouched():
    """A noise-free image that the model can hold comes back: no blur over its texture."""
    rng = np.random.default_rng(4)
    albedo = rng.random((40, 44, 3)).astype(np.float32)
    normal = rng.random((40, 44, 3)).astype(np.float32)
    colour = albedo @ rng.random((3, 3)) + normal @ rng.random((3, 3)) + 1
    frame = Frame.from_arrays(
        colour=colour, albedo=albedo, normal=normal, colour_variance=np.full_like(colour, 1.0)
    )
    result = NFORTuned(ridge=1e-6)(frame).colour
    # Where few pixels of a window are alike, the guard against quiet features shows (1e-3 squared).
    assert np.abs(result - colour).mean() < 3e-4
    assert np.abs(result - colour).max() < 0.02


def test_tiles_equal_the_whole():
    """A crop with the margin around it gives the same pixels (crops begin at even pixels)."""
    denoiser = NFORTuned(radius=3, patch=1)
    margin = denoiser.margin() + denoiser.margin() % 2
    frame, _ = rendered(2 * margin + 20, 2 * margin + 24)
    fitted = denoiser.fitted(frame)
    whole = fitted.filter(frame, frame.colour)
    core = np.s_[margin : margin + 8, margin + 2 : margin + 12]
    tile = frame.crop(0, 2 * margin + 8, 2, 2 * margin + 14)
    part = fitted.filter(tile, tile.colour)
    np.testing.assert_allclose(
        part[margin : margin + 8, margin : margin + 10], whole[core], atol=2e-5
    )


def test_centres_on_every_pixel():
    """The paper's own stride and every other pixel: the same error within a half."""
    frame, clean = rendered()
    error = [np.mean((NFORTuned(stride=s)(frame).colour - clean) ** 2) for s in (1, 2)]
    assert error[0] == pytest.approx(error[1], rel=0.5)


def test_spatial_variance_finds_the_noise():
    """Gaussian noise on a ramp: the estimate is its variance within a tenth."""
    rng = np.random.default_rng(7)
    ramp = np.linspace(0, 5, 200, dtype=np.float32)[None, :, None] + np.zeros((200, 1, 3))
    noisy = (ramp + 0.2 * rng.standard_normal(ramp.shape)).astype(np.float32)
    assert spatial_variance(noisy).mean() == pytest.approx(0.04, rel=0.1)
    assert np.abs(spatial_variance(ramp.astype(np.float32))[5:-5, 5:-5]).max() < 1e-8


def test_box_mean_keeps_constants():
    image = np.full((4, 5, 2), 3.0, np.float32)
    np.testing.assert_allclose(box_mean(image, 3), image)


def test_one_pixel():
    frame = Frame.from_arrays(colour=np.full((1, 1, 3), 0.25, np.float32))
    np.testing.assert_allclose(NFORTuned()(frame).colour, 0.25, rtol=1e-6)


def test_options():
    assert create("nfor-tuned", radius="5").radius == 5
    with pytest.raises(OptionError, match="stride"):
        create("nfor-tuned", stride="0")
    with pytest.raises(OptionError, match="radius"):
        create("nfor-tuned", radius="0")
