"""What holds for every classical filter of a weighted mean, and known answers of each."""

import math

import numpy as np
import pytest

from lambent.errors import LayerError
from lambent.filters.denoiser import create
from lambent.filters.log_colour import DARK, log_colour
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.noise_level import haar_level
from lambent.frame.role import Role

MODELS = (
    "box", "gaussian", "bilateral", "cross-bilateral", "nlm", "joint-nlm", "atrous", "atrous-tuned"
)  # fmt: skip
#: Each with features; with and without variance other kernels run.
VARIANCE = (False, True)


def scene(height=40, width=52, noise=0.3, variance=False, grey=False, seed=0):
    """Two surfaces and a gradient, with relative noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    left = (x < width / 2).astype(np.float32)
    clean = (0.2 + 0.6 * left + 0.2 * y / max(height, 2))[:, :, None] * [1.0, 0.8, 0.5]
    if grey:
        clean = np.repeat(clean[:, :, :1], 3, axis=2)
    step = rng.normal(size=(height, width, 1 if grey else 3))
    colour = (clean * (1 + noise * step)).astype(np.float32)
    layers = {
        "colour": colour,
        "albedo": np.repeat((0.2 + 0.5 * left)[:, :, None], 3, axis=2).astype(np.float32),
        "normal": np.stack([left, 1 - left, np.zeros_like(left)], axis=2),
        "depth": (2 + y / 100).astype(np.float32),
    }
    if variance:
        layers["colour_variance"] = ((noise * clean) ** 2).astype(np.float32)
        layers["albedo_variance"] = np.full((height, width, 3), 1e-4, np.float32)
    return Frame.from_arrays(**layers), clean.astype(np.float32)


@pytest.mark.parametrize("variance", VARIANCE)
@pytest.mark.parametrize("model", MODELS)
def test_weights_sum_to_one_and_are_the_same_for_all_targets(model, variance):
    """Constants stay; the filter is linear; layers still sum to the beauty.

    To float32: sums of up to 441 terms round by some 1e-6 relative.
    """
    frame, _ = scene(variance=variance)
    denoiser = create(model).fitted(frame)
    rng = np.random.default_rng(1)
    key = rng.random((40, 52, 3), dtype=np.float32)
    fill = frame.colour - key
    constant = np.full((40, 52, 1), 0.7, np.float32)
    found = denoiser.filter(frame, np.concatenate([frame.colour, key, fill, constant], axis=2))
    assert np.abs(found[:, :, 9] - 0.7).max() < 6e-6
    assert np.abs(found[:, :, 3:6] + found[:, :, 6:9] - found[:, :, :3]).max() < 5e-6
    alone = denoiser.filter(frame, key)
    assert np.abs(alone - found[:, :, 3:6]).max() < 2e-6


@pytest.mark.parametrize("variance", VARIANCE)
@pytest.mark.parametrize("model", MODELS)
def test_tiles_with_their_margin_give_the_untiled_result(model, variance):
    """Cut anywhere, also where a tile's own median depth or exposure would be another."""
    frame, _ = scene(90, 150, variance=variance)
    options = {"levels": 3} if model.startswith("atrous") else {}
    denoiser = create(model, **options).fitted(frame)
    whole = denoiser.filter(frame, frame.colour)
    margin = denoiser.margin()
    for y0, y1, x0, x1 in ((0, 31, 0, 45), (40, 61, 70, 95), (70, 90, 120, 150)):
        top, left = max(0, y0 - margin), max(0, x0 - margin)
        tile = frame.crop(top, min(90, y1 + margin), left, min(150, x1 + margin))
        part = denoiser.filter(tile, tile.colour)[y0 - top : y1 - top, x0 - left : x1 - left]
        assert np.abs(part - whole[y0:y1, x0:x1]).max() <= 1e-5


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (2, 2)])
@pytest.mark.parametrize("model", MODELS)
def test_the_smallest_images(model, shape):
    frame, _ = scene(*shape, variance=shape == (2, 2))
    found = create(model)(frame)
    assert found.colour.shape == (*shape, 3)
    assert np.isfinite(found.colour).all()
    if shape == (1, 1):
        np.testing.assert_allclose(found.colour, frame.colour, rtol=1e-5)


@pytest.mark.parametrize("model", MODELS)
def test_nan_does_not_spread(model):
    """One bad pixel: finite everywhere else, and as good as before two windows away."""
    frame, _ = scene()
    broken = frame.colour.copy()
    broken[20, 30] = np.nan
    spoilt = frame.with_layer(frame.layer(Role.COLOUR).with_data(broken))
    found = create(model)(spoilt).colour
    assert np.isfinite(np.delete(found.reshape(-1, 3), 20 * 52 + 30, axis=0)).all()
    assert abs(found[0:8, 0:8].mean() - create(model)(frame).colour[0:8, 0:8].mean()) < 0.02


@pytest.mark.parametrize("model", MODELS)
def test_grey_stays_grey_and_the_range_is_kept(model):
    frame, _ = scene(grey=True, variance=True)
    found = create(model)(frame).colour
    assert np.ptp(found, axis=2).max() == 0
    assert found.min() >= frame.colour.min() - 1e-6
    assert found.max() <= frame.colour.max() + 1e-6


@pytest.mark.parametrize("variance", VARIANCE)
@pytest.mark.parametrize("model", MODELS)
def test_noise_falls(model, variance):
    """Every filter is closer to the truth than its input; those that see edges, than the box."""
    frame, clean = scene(60, 80, variance=variance)
    before = np.mean((frame.colour - clean) ** 2)
    after = np.mean((create(model)(frame).colour - clean) ** 2)
    assert after < 0.5 * before
    if model in ("cross-bilateral", "joint-nlm", "atrous"):
        box = np.mean((create("box")(frame).colour - clean) ** 2)
        assert after < box


def test_box_is_the_plain_mean():
    frame, _ = scene()
    found = create("box", radius=1).filter(frame, frame.colour)
    np.testing.assert_allclose(found[10, 10], frame.colour[9:12, 9:12].mean(axis=(0, 1)), rtol=1e-5)


def test_bilateral_with_a_huge_range_is_a_gaussian():
    frame, _ = scene()
    options = {"radius": 5, "sigma_spatial": 1.5, "sigma_range": 1e6}
    found = create("bilateral", **options).filter(frame, frame.colour)
    wanted = create("gaussian", radius=5, sigma=1.5).filter(frame, frame.colour)
    assert np.abs(found - wanted).max() < 1e-5


def test_bilateral_is_the_same_at_any_exposure():
    """HDR: a frame ten stops brighter is filtered alike."""
    frame, _ = scene()
    bright = frame.with_layer(frame.layer(Role.COLOUR).with_data(frame.colour * 1024))
    for model in ("bilateral", "nlm", "atrous"):
        a, b = create(model)(frame).colour, create(model)(bright).colour
        np.testing.assert_allclose(b / 1024, a, rtol=2e-4, atol=1e-5)


def test_cross_bilateral_does_not_cross_an_edge_of_a_feature():
    """With tiny σ the mean is taken on one side alone."""
    frame, _ = scene()
    left = (np.arange(52) < 26).astype(np.float32)
    target = np.repeat(left[None, :, None], 40, axis=0)
    found = create("cross-bilateral", sigma_albedo=0.02).filter(frame, np.ascontiguousarray(target))
    assert np.abs(found - target).max() < 1e-6


def test_cross_bilateral_discounts_the_noise_of_features():
    """A noisy albedo on one flat surface: with its variance known, the window mixes again."""
    rng = np.random.default_rng(5)
    colour = rng.random((30, 30, 3), dtype=np.float32)
    albedo = (0.5 + 0.2 * rng.normal(size=(30, 30, 3))).astype(np.float32)
    bare = Frame.from_arrays(colour=colour, albedo=albedo)
    variance = np.full((30, 30, 3), 0.04, np.float32)
    told = Frame.from_arrays(colour=colour, albedo=albedo, albedo_variance=variance)
    spread = [create("cross-bilateral").filter(f, colour)[8:-8, 8:-8].var() for f in (bare, told)]
    assert spread[1] < 0.3 * spread[0]


def test_nlm_on_a_flat_noisy_image_is_nearly_the_box():
    """All patches differ by noise alone, which the variance explains: n = 11² pixels are mixed.

    Var of the mean falls by about 1/121; a few weights below one and the pixel's own weight of one
    leave a factor of at most 2 (20 x 20 independent windows: 5 % on the variance).
    """
    rng = np.random.default_rng(6)
    colour = (1 + 0.1 * rng.normal(size=(120, 120, 3))).astype(np.float32)
    variance = np.full_like(colour, 0.01)
    frame = Frame.from_arrays(colour=colour, colour_variance=variance)
    found = create("nlm", radius=5, k=1.0)(frame).colour
    assert 0.8 / 121 < found[10:-10, 10:-10].var() / 0.01 < 2.0 / 121
    unknown = create("nlm", radius=5, k=1.0)(Frame.from_arrays(colour=colour)).colour
    assert 0.8 / 121 < unknown[10:-10, 10:-10].var() / 0.01 < 2.5 / 121


def test_half_buffers_are_used():
    """Averaged weights of both halves; still a weighted mean."""
    frame, clean = scene(variance=True)
    rng = np.random.default_rng(7)
    step = (0.3 * clean * rng.normal(size=clean.shape)).astype(np.float32)
    whole = Frame.from_arrays(
        colour=frame.colour,
        colour_variance=frame["colour.variance"],
        colour_half_a=frame.colour + step,
        colour_half_b=frame.colour - step,
    )
    plain = whole.without(*[k for k in whole.layers if "half" in k[1].value])
    a = create("nlm").filter(whole, frame.colour)
    b = create("nlm").filter(plain, frame.colour)
    assert np.abs(a - b).max() > 1e-3
    assert np.mean((a - clean) ** 2) < 0.5 * np.mean((frame.colour - clean) ** 2)
    ones = create("nlm").filter(whole, np.ones((40, 52, 1), np.float32))
    assert np.abs(ones - 1).max() < 2e-6


def test_atrous_demodulated_keeps_texture():
    """A texture in the albedo alone, under even light, comes back exactly."""
    rng = np.random.default_rng(8)
    albedo = (0.1 + 0.8 * rng.random((40, 50, 3))).astype(np.float32)
    frame = Frame.from_arrays(colour=(albedo + 0.01) * 2, albedo=albedo)
    found = create("atrous", demodulate=True)(frame).colour
    np.testing.assert_allclose(found, frame.colour, rtol=1e-4)


def test_a_filter_that_needs_features_says_so():
    bare = Frame.from_arrays(colour=np.ones((4, 4, 3)))
    for model in ("cross-bilateral", "joint-nlm"):
        with pytest.raises(LayerError, match="albedo or diffuse_albedo"):
            create(model)(bare)


def test_noise_level_of_white_noise_and_of_pictures():
    """σ is found within 3 %, and edges or black background do not count."""
    rng = np.random.default_rng(9)
    noise = (0.05 * rng.normal(size=(200, 200, 3))).astype(np.float32)
    assert haar_level(noise) == pytest.approx(0.05, rel=0.03)
    stripes = noise + (np.arange(200) // 20 % 2)[None, :, None].astype(np.float32)
    assert haar_level(stripes) == pytest.approx(0.05, rel=0.03)
    stripes[:150] = 0
    assert haar_level(stripes) == pytest.approx(0.05, rel=0.05)
    assert haar_level(np.ones((8, 8, 3), np.float32)) == 0


def test_log_colour_compares_by_ratio():
    frame, _ = scene()
    exposure = auto_exposure(frame.colour)
    bright = np.array([[[1.0, 1.1, 100.0]]], np.float32) / np.float32(exposure)
    g = log_colour(bright, exposure)[0, 0]
    assert g[1] - g[0] == pytest.approx(math.log((1.1 + DARK) / (1 + DARK)), abs=1e-5)
    assert log_colour(np.array([[[-1.0]]], np.float32), 1.0)[0, 0, 0] == pytest.approx(
        math.log(DARK)
    )


def test_joint_nlm_mixes_along_a_curved_surface():
    """A normal that turns by 2 degrees a pixel: neighbours still count, an edge of it does not.

    Known weights, noise-free colour: exp(-(Δ/2)²/(k² max(τ, |∇|²))) with both in unit range.
    """
    angle = np.radians(2.0) * np.arange(40, dtype=np.float32)
    normal = np.zeros((24, 40, 3), np.float32)
    normal[:, :, 0], normal[:, :, 2] = np.sin(angle), np.cos(angle)
    normal[:, 30:] = [0, 1, 0]
    ones = np.ones((24, 40, 3), np.float32)
    frame = Frame.from_arrays(colour=ones, normal=normal, colour_variance=ones * 0.01)
    delta = np.zeros((24, 40, 1), np.float32)
    delta[12, 12] = 1
    found = create("joint-nlm", radius=3).filter(frame, delta)[12, :, 0]
    step = (np.sin(angle[12]) - np.sin(angle[14])) / 2
    assert found[14] / found[12] == pytest.approx(math.exp(-(step**2) / (0.36 * 1e-3)), rel=0.05)
    delta[12, 12], delta[12, 31] = 0, 1
    across = create("joint-nlm", radius=3).filter(frame, delta)[12, :, 0]
    assert across[28] < 1e-3 * across[31]
