"""The à-trous wavelet against a plain NumPy twin, and its transpose."""

import numpy as np
import pytest

from lambent.kernels.atrous import SPLINE, atrous, atrous_row, reach


def atrous_twin(targets, guide, features, scales, noise=None):
    """Offset by offset on whole images; what lies outside has weight 0."""
    state = np.concatenate([guide, targets], axis=2).astype(np.float64)
    channels = guide.shape[2]
    height, width = targets.shape[:2]
    for level, (soft, hard) in enumerate(scales):
        total, norm = np.zeros_like(state), np.zeros((height, width))
        for j in range(-2, 3):
            for i in range(-2, 3):
                dy, dx = j * 2**level, i * 2**level
                ys, xs = np.mgrid[0:height, 0:width]
                inside = (ys + dy >= 0) & (ys + dy < height) & (xs + dx >= 0) & (xs + dx < width)
                yq, xq = np.clip(ys + dy, 0, height - 1), np.clip(xs + dx, 0, width - 1)
                step = state[yq, xq, :channels] - state[:, :, :channels]
                apart = soft * (step**2).sum(axis=2)
                if features is not None:
                    square = (features[yq, xq] - features) ** 2
                    if noise is not None:
                        square = np.maximum(0, square - noise[yq, xq] - noise)
                    apart = apart + (np.asarray(hard) * square).sum(axis=2)
                w = SPLINE[j + 2] * SPLINE[i + 2] * np.exp(-apart) * inside
                total += w[..., None] * state[yq, xq]
                norm += w
        state = total / norm[..., None]
    return state[:, :, channels:]


SCALES = [(0.5 * 4**level, 1.0) for level in range(4)]


def images(shape):
    rng = np.random.default_rng(8)
    guide = rng.random((*shape, 3), dtype=np.float32)
    return rng.random((*shape, 2), np.float32), guide, rng.random((*shape, 2), np.float32)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (37, 1), (30, 45)])
@pytest.mark.parametrize("kind", ["guide", "features", "noise"])
def test_agrees_with_its_twin(shape, kind):
    targets, guide, features = images(shape)
    noise = 0.02 * features if kind == "noise" else None
    stops = None if kind == "guide" else features
    found = atrous(targets, guide, stops, SCALES, noise)
    assert np.abs(found - atrous_twin(targets, guide, stops, SCALES, noise)).max() < 3e-6


def test_a_factor_for_every_feature():
    targets, guide, features = images((30, 45))
    scales = [(soft, (4.0**-level, 2.0)) for level, (soft, _) in enumerate(SCALES)]
    found = atrous(targets, guide, features, scales)
    assert np.abs(found - atrous_twin(targets, guide, features, scales)).max() < 3e-6


@pytest.mark.parametrize("pixel", [(20, 15), (0, 0), (44, 3)])
def test_a_row_is_what_delta_images_show(pixel):
    """The transposed filter against the filter itself on one delta image a pixel."""
    shape = (30, 45)
    _, guide, features = images(shape)
    x, y = pixel
    row = atrous_row(guide, features, SCALES[:3], x, y)
    deltas = np.eye(shape[0] * shape[1], dtype=np.float32).reshape(*shape, -1)
    chosen = np.random.default_rng(0).choice(deltas.shape[2], 24, replace=False)
    chosen[0] = y * shape[1] + x
    shown = atrous(deltas[:, :, chosen], guide, features, SCALES[:3])[y, x]
    np.testing.assert_allclose(row.reshape(-1)[chosen], shown, atol=1e-7)
    assert row.sum() == pytest.approx(1.0, abs=1e-5)


def test_a_row_leaves_out_bad_pixels():
    """Weights of a frame with NaN in it: none on the bad pixel, the rest sum to one."""
    _, guide, features = images((20, 20))
    guide[9, 11] = np.nan
    row = atrous_row(guide, features, SCALES[:3], 10, 10)
    assert row[9, 11] == 0
    assert row.sum() == pytest.approx(1.0, abs=1e-5)


def test_reach():
    """An impulse is seen exactly that far on a flat image."""
    flat = np.zeros((1, 101, 1), np.float32)
    impulse = flat.copy()
    impulse[0, 50] = 1.0
    found = atrous(impulse, flat, None, SCALES[:3])[0, :, 0]
    (seen,) = np.nonzero(found)
    assert seen.min() == 50 - reach(3)
    assert seen.max() == 50 + reach(3)
