"""First-order regression over windows: known answers, and a plain NumPy twin."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.kernels.regression import (
    OWN_WEIGHT,
    Window,
    first_order,
    least_weights,
    patch_weights,
    zeroth_order,
)


def twin_weights(guide, variance, window, k=1.0, least=False):
    """w[c, q] for every centre and pixel as a dictionary, straight from the formulas."""
    height, width, _ = guide.shape
    R, F = window.radius, window.patch
    pad = R + F
    u = np.pad(guide.astype(np.float64), ((pad, pad), (pad, pad), (0, 0)), mode="symmetric")
    v = np.pad(variance.astype(np.float64), ((pad, pad), (pad, pad), (0, 0)), mode="symmetric")
    weights = {}
    for cy in range(0, height, window.stride):
        for cx in range(0, width, window.stride):
            for dy in range(-R, R + 1):
                for dx in range(-R, R + 1):
                    qy, qx = cy + dy, cx + dx
                    if not (0 <= qy < height and 0 <= qx < width):
                        continue
                    here = np.s_[cy + R : cy + R + 2 * F + 1, cx + R : cx + R + 2 * F + 1]
                    there = np.s_[qy + R : qy + R + 2 * F + 1, qx + R : qx + R + 2 * F + 1]
                    d = (u[here] - u[there]) ** 2 - (v[here] + np.minimum(v[here], v[there]))
                    d = np.minimum(d / (1e-10 + k * k * (v[here] + v[there])), 1e4)
                    far = d.mean(axis=(0, 1)).max() if least else d.mean()
                    weights[cy, cx, qy, qx] = np.exp(-max(0.0, far))
    return weights


def twin_regression(weights, features, image, window, power, ridge, quiet):
    height, width, _ = image.shape
    R = window.radius
    total = OWN_WEIGHT * image.astype(np.float64)
    mass = np.full((height, width, 1), OWN_WEIGHT)
    centres = sorted({key[:2] for key in weights})
    for cy, cx in centres:
        near = [key[2:] for key in weights if key[:2] == (cy, cx)]
        X = np.array(
            [
                [1.0, (qx - cx) / R, (qy - cy) / R, *(features[qy, qx] - features[cy, cx])]
                for qy, qx in near
            ],
            np.float64,
        )
        Y = np.array([image[q] for q in near], np.float64)
        w = np.array([weights[(cy, cx, *q)] for q in near]) ** power
        gram = X.T @ (w[:, None] * X)
        extra = ridge * np.diag(gram) + quiet**2 * gram[0, 0]
        extra[0] = 0
        beta = np.linalg.solve(gram + np.diag(extra), X.T @ (w[:, None] * Y))
        for q, x, wq in zip(near, X, w, strict=True):
            total[q] += wq * (x @ beta)
            mass[q] += wq
    return total / mass


@pytest.fixture(scope="module")
def noisy():
    rng = np.random.default_rng(3)
    height, width = 13, 15
    features = rng.random((height, width, 2), dtype=np.float32)
    image = (features @ rng.random((2, 3)) + 0.2 * rng.standard_normal((height, width, 3))).astype(
        np.float32
    )
    variance = (0.02 + 0.04 * rng.random((height, width, 3))).astype(np.float32)
    return features, image, variance


@pytest.mark.parametrize(("stride", "power"), [(1, 1), (2, 4)])
def test_agrees_with_the_formulas(noisy, stride, power):
    """The kernel is three fused loops; the twin is the text of the equations."""
    features, image, variance = noisy
    window = Window(radius=3, patch=1, stride=stride)
    weights = patch_weights(image, variance, window)
    twin = twin_weights(image, variance, window)
    found = np.array(weights.planes).reshape(
        window.offsets(), window.centres(13), window.centres(15)
    )
    for (cy, cx, qy, qx), value in twin.items():
        offset = (qy - cy + 3) * 7 + qx - cx + 3
        assert found[offset, cy // stride, cx // stride] == pytest.approx(value, abs=2e-5)
    result = first_order(weights, features, image, (power,), ridge=1e-4)[0]
    expected = twin_regression(twin, features, image, window, power, 1e-4, 1e-3)
    np.testing.assert_allclose(result, expected, atol=2e-4)


@pytest.mark.parametrize("stride", [1, 2])
def test_least_weight_of_the_channels(noisy, stride):
    """Away from the borders, where patches do not see the mirrored image."""
    _, image, variance = noisy
    window = Window(3, 1, stride)
    weights = least_weights(image, variance, window, k=0.7)
    shape = (window.offsets(), window.centres(13), window.centres(15))
    found = np.array(weights.planes).reshape(shape)
    seen = 0
    for (cy, cx, qy, qx), value in twin_weights(image, variance, window, 0.7, least=True).items():
        if min(cy, qy) >= 1 and max(cy, qy) < 12 and min(cx, qx) >= 1 and max(cx, qx) < 14:
            offset = (qy - cy + 3) * 7 + qx - cx + 3
            assert found[offset, cy // stride, cx // stride] == pytest.approx(value, abs=2e-5)
            seen += 1
    assert seen > 500
    assert found[0, 0].max() == 0  # up and left of the first row there is nothing


@pytest.mark.parametrize("stride", [1, 2])
def test_affine_functions_of_features_come_back(stride):
    """The model holds exactly, whatever the weights: only the ridge (1e-6) and rounding differ."""
    rng = np.random.default_rng(5)
    features = rng.random((40, 51, 7), dtype=np.float32)
    y, x = np.mgrid[:40, :51] / 20.0
    image = features @ rng.standard_normal((7, 3)) + x[..., None] - 2 * y[..., None] + 3
    image = image.astype(np.float32)
    guide = rng.random((40, 51, 3), dtype=np.float32)
    weights = patch_weights(guide, np.full_like(guide, 0.1), Window(9, 3, stride))
    result = first_order(weights, features, image, (1,), ridge=1e-6)[0]
    # OWN_WEIGHT mixes in the image itself, which is the same here.
    assert np.abs(result - image).max() < 5e-4 * np.ptp(image)


def test_useless_features_do_no_harm():
    """Constant, repeated and nearly constant features (a grey albedo) make the matrix singular."""
    rng = np.random.default_rng(6)
    height, width = 24, 30
    ramp = np.linspace(0, 1, width, dtype=np.float32)[None, :, None].repeat(height, 0)
    nearly = 0.7 + 1e-7 * rng.standard_normal((height, width, 1)).astype(np.float32)
    features = np.concatenate([ramp, ramp, ramp, np.ones_like(ramp), nearly, ramp * 0], axis=2)
    image = np.repeat(2 * ramp + 1, 3, axis=2)
    noisy = image + 0.1 * rng.standard_normal(image.shape).astype(np.float32)
    weights = patch_weights(noisy, np.full_like(noisy, 0.01), Window())
    result = first_order(weights, features, noisy, (1,), ridge=1e-4)[0]
    assert np.isfinite(result).all()
    assert np.mean((result - image) ** 2) < 0.1 * np.mean((noisy - image) ** 2)


def test_many_channels_are_those_alone(noisy):
    """Channels go through the kernel six at a time."""
    features, image, variance = noisy
    weights = patch_weights(image, variance, Window(3, 1, 1))
    stack = np.concatenate([image, 2 * image, image[:, :, ::-1]], axis=2)
    together = first_order(weights, features, stack)[0]
    alone = first_order(weights, features, image)[0]
    np.testing.assert_allclose(together[:, :, :3], alone, atol=1e-5)
    np.testing.assert_allclose(together[:, :, 3:6], 2 * alone, atol=2e-5)
    np.testing.assert_allclose(together[:, :, 6:], alone[:, :, ::-1], atol=1e-5)


@pytest.mark.parametrize(("stride", "power"), [(1, 1), (2, 4), (3, 2)])
def test_zeroth_order_is_a_mean_of_means(noisy, stride, power):
    """The text of the equation, and so within the range of the image; a constant stays."""
    _, image, variance = noisy
    window = Window(3, 1, stride)
    weights = patch_weights(image, variance, window)
    stack = np.concatenate([image, np.full_like(image[:, :, :1], 7)], axis=2)
    result = zeroth_order(weights, stack, power)
    twin = twin_weights(image, variance, window)
    total, mass = OWN_WEIGHT * stack.astype(np.float64), np.full((13, 15, 1), OWN_WEIGHT)
    for centre in {key[:2] for key in twin}:
        near = {key[2:]: w**power for key, w in twin.items() if key[:2] == centre}
        mean = sum(w * stack[q] for q, w in near.items()) / sum(near.values())
        for q, w in near.items():
            total[q] += w * mean
            mass[q] += w
    np.testing.assert_allclose(result, total / mass, atol=2e-4)
    assert result[:, :, :3].min() >= image.min() - 1e-6
    assert result[:, :, :3].max() <= image.max() + 1e-6


@pytest.mark.parametrize("shape", [(1, 1), (1, 17), (9, 1)])
def test_tiny_images(shape):
    """One pixel, one row, one column: windows reach far outside."""
    image = np.full((*shape, 3), 0.5, np.float32)
    weights = patch_weights(image, image * 0, Window())
    result = first_order(weights, image[:, :, :1], image)[0]
    np.testing.assert_allclose(result, image, rtol=1e-6)
