"""Features: scales, misses, variances; and that a tile gets those of its frame."""

import numpy as np
import pytest

from lambent.errors import LayerError, OptionError
from lambent.filters.features import MISS_SIGMA, features, fit_scales, variance_of
from lambent.frame.frame import Frame
from lambent.frame.misses import miss_mask
from lambent.frame.role import Role


def frame(**more):
    rng = np.random.default_rng(0)
    layers = {
        "colour": rng.random((6, 8, 3), dtype=np.float32),
        "albedo": rng.random((6, 8, 3), dtype=np.float32),
        "normal": rng.random((6, 8, 3), dtype=np.float32),
        "depth": 1 + rng.random((6, 8), dtype=np.float32),
    }
    return Frame.from_arrays(**{**layers, **more})


def test_albedo_and_normal_are_as_they_are():
    f = frame()
    found = features(f)
    names = ("albedo.r", "albedo.g", "albedo.b", "normal.x", "normal.y", "normal.z", "depth")
    assert found.names == names
    assert (found.stack[:, :, :3] == f[Role.ALBEDO]).all()
    assert (found.stack[:, :, found.index(Role.NORMAL)] == f[Role.NORMAL]).all()
    assert found.variance is None
    assert found.valid.all()


def test_depth_does_not_depend_on_the_unit():
    """Metres or centimetres: the same feature; ten per cent is 0.1 anywhere."""
    f = frame()
    scaled = frame(depth=f[Role.DEPTH] * 100)
    a, b = features(f, [Role.DEPTH]).stack, features(scaled, [Role.DEPTH]).stack
    np.testing.assert_allclose(a, b, atol=1e-5)
    ratio = features(frame(depth=np.array([[2.0, 2.2] * 4] * 6)), [Role.DEPTH]).stack
    assert ratio[0, 1, 0] - ratio[0, 0, 0] == pytest.approx(np.log(1.1), abs=1e-6)


@pytest.mark.parametrize("miss", [0.0, np.inf, 1e10, 65504.0, 8.507e37, 3.4028235e38])
def test_misses_of_depth_are_told_apart(miss):
    """One unit behind the farthest hit, and a channel of their own."""
    f = frame()
    depth = f[Role.DEPTH].copy()
    depth[2, 3] = miss
    f = frame(depth=depth)
    found = features(f)
    assert found.names[-1] == "miss"
    assert found.stack[:, :, -1].sum() == 1
    assert found.stack[2, 3, -1] == 1
    hits = np.delete(found.stack[:, :, 6].reshape(-1), 2 * 8 + 3)
    assert found.stack[2, 3, 6] == pytest.approx(hits.max() + 1.0, abs=1e-5)
    assert found.valid.all()
    assert miss_mask(f).sum() == 1


def test_negative_depth_is_a_distance():
    """Camera space looks down -z in many renderers."""
    f = frame()
    a = features(f, [Role.DEPTH]).stack
    b = features(frame(depth=-f[Role.DEPTH]), [Role.DEPTH]).stack
    assert (a == b).all()


def test_position_is_measured_in_extents():
    rng = np.random.default_rng(1)
    position = rng.random((6, 8, 3), dtype=np.float32) * [4, 200, 30] + 1000
    position[0, 0] = np.inf
    f = frame(position=position, depth=None)
    found = features(f)
    channels = found.index(Role.POSITION)
    assert np.abs(found.stack[:, :, channels]).max() < 0.7
    assert np.ptp(found.stack[:, :, channels[1]]) > 0.8
    assert found.stack[0, 0, -1] == 1
    assert (found.stack[0, 0, channels] == 0).all()


def test_variance_is_scaled_like_its_feature():
    """Known answer: var(ln z) = var(z)/z² to first order; albedo unchanged; none is 0."""
    f = frame()
    variance = np.full((6, 8), 0.01, np.float32)
    found = features(f.with_layer(next(iter(
        Frame.from_arrays(depth_variance=variance).all_layers()))))  # fmt: skip
    assert found.variance is not None
    np.testing.assert_allclose(
        found.variance[:, :, 6], 0.01 / f[Role.DEPTH][:, :, 0] ** 2, rtol=1e-5
    )
    assert (found.variance[:, :, :6] == 0).all()


def test_variance_from_half_buffers():
    """Unbiased: the mean over many pixels of (a - b)²/4 is the variance of (a + b)/2."""
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 80, 90, 3)).astype(np.float32)
    f = Frame.from_arrays(albedo=(a + b) / 2, albedo_half_a=a, albedo_half_b=b)
    found = variance_of(f, Role.ALBEDO)
    assert found is not None
    assert found.mean() == pytest.approx(0.5, rel=0.03)
    assert found.shape == (80, 90, 3)


def test_nan_is_reported_and_not_passed_on():
    f = frame()
    normal = f[Role.NORMAL].copy()
    normal[1, 1, 2] = np.nan
    found = features(frame(normal=normal))
    assert np.isfinite(found.stack).all()
    assert not found.valid[1, 1]
    assert found.valid.sum() == 47


def test_a_tile_with_the_scales_of_its_frame():
    f = frame(depth=np.where(np.arange(48).reshape(6, 8) == 40, np.inf, 2.0).astype(np.float32))
    scales = fit_scales(f)
    whole = features(f)
    tile = features(f.crop(0, 4, 2, 7), scales=scales)
    assert tile.names == whole.names  # also the channel for misses, though this tile has none
    assert (tile.stack == whole.stack[0:4, 2:7]).all()


def test_frames_without_features_and_wrong_roles():
    bare = Frame.from_arrays(colour=np.ones((2, 3, 3)))
    assert features(bare).stack.shape == (2, 3, 0)
    with pytest.raises(LayerError, match="--map depth"):
        features(bare, [Role.DEPTH])
    with pytest.raises(OptionError, match="take some of albedo"):
        features(bare, [Role.COLOUR])


def test_channels_are_told_their_sigma_by_role():
    depth = np.array([[1.0, 2.0, 0.0]], np.float32)[:, :, None]
    frame = Frame.from_arrays(
        colour=np.zeros((1, 3, 3)), diffuse_albedo=np.ones((1, 3, 3)), depth=depth
    )
    found = features(frame)
    assert [n.partition(".")[0] for n in found.names] == ["depth", *["diffuse_albedo"] * 3, "miss"]
    expected = [1 / (2 * 0.1), *[1 / (2 * 0.5)] * 3, 1 / (2 * MISS_SIGMA)]
    np.testing.assert_allclose(found.per_sigma(2.0, albedo=0.5, depth=0.1), expected, rtol=1e-6)
