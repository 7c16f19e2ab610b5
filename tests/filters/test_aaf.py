"""Axis-aligned filter: a half-plane's soft shadow in closed form, NumPy twin, what it asks for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lambent.errors import LayerError, OptionError
from lambent.filters.aaf import AxisAligned, footprint
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role

LIGHT = 10.0  # height of the light over the receiver z = 0
SIGMA = 1.0  # deviation of its Gaussian


def shadow(height=96, width=128, samples=8, seed=0, step=0.02, low=0.4, high=6.0):
    """A half-plane x < 0 over the receiver, nearly touching it at the top, high at the bottom.

    The light is a Gaussian along x. From x on the receiver past the edge at height h one sees the
    light's points u > −x d2/h (d2 = d1 − h), so that visibility is Φ(x / (σ s)), s = d1/d2 − 1.
    Each pixel holds the mean of some samples of it.
    """
    rng = np.random.default_rng(seed)
    x = (np.arange(width) - width / 2 + 0.5) * step
    above = np.linspace(low, high, height)
    d2 = LIGHT - above
    slope = LIGHT / d2 - 1
    ratio = x[None, :] / (SIGMA * slope[:, None])
    truth = 0.5 * (1 + np.vectorize(math.erf)(ratio / math.sqrt(2)))
    noisy = rng.binomial(samples, truth) / samples
    position = np.zeros((height, width, 3))
    position[:, :, 0] = x
    position[:, :, 1] = (np.arange(height) * step)[:, None]
    normal = np.zeros((height, width, 3))
    normal[:, :, 2] = 1
    frame = Frame.from_arrays(
        colour=np.repeat(noisy[:, :, None], 3, axis=2), position=position, normal=normal
    )
    for name, value in (
        ("light_distance", np.full(height, LIGHT)),
        ("occluder_min", d2),
        ("occluder_max", d2),
    ):
        image = np.repeat(value[:, None, None], width, axis=1)
        frame = frame.with_layer(Layer(Role.OTHER, image, name=name))
    return frame, truth, slope


def box(image: np.ndarray, radius: int) -> np.ndarray:
    """Plain mean over a window, fewer pixels at the border."""
    total, count = np.zeros_like(image), np.zeros_like(image)
    height, width = image.shape
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            to = np.s_[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
            source = np.s_[max(0, dy) : height - max(0, -dy), max(0, dx) : width - max(0, -dx)]
            total[to] += image[source]
            count[to] += 1
    return total / count


def error(image: np.ndarray, truth: np.ndarray) -> float:
    return float(((image - truth) ** 2).mean())


def test_width_is_the_papers():
    """β = max(σ s2, (1 + s2) d)/(k μ) in scene units; the penumbra σ s2 is the half-plane's."""
    frame, _, slope = shadow()
    width = AxisAligned(light_sigma=SIGMA).widths(frame)
    expected = np.maximum(SIGMA * slope, (1 + slope) * 0.02) / 6
    np.testing.assert_allclose(width[:, 40], expected, rtol=1e-4)


def test_soft_shadow_gets_clean_and_stays_in_shape():
    """Against box filters: less error than of equal mean width, and nearly no bias."""
    frame, truth, _ = shadow()
    model = AxisAligned(light_sigma=SIGMA)
    clean = model(frame)[Role.COLOUR][:, :, 0]
    noisy = frame.colour[:, :, 0]
    assert error(clean, truth) < error(noisy, truth) / 60
    # A box of half width r has the deviation of a Gaussian of r/√3.
    mean_width = float(model.widths(frame).mean()) / 0.02
    for factor, share in ((0.5, 0.9), (0.7, 0.9), (1.0, 0.6), (1.4, 0.3)):
        radius = round(factor * mean_width * math.sqrt(3))
        assert error(clean, truth) < share * error(box(noisy, radius), truth)
    # Bias: the filter on the noiseless shadow. (At the picture's border windows are one-sided.)
    inner = np.s_[15:-15, 15:-15]
    exact = np.repeat(truth[:, :, None], 3, axis=2).astype(np.float32)
    bias = np.abs(model.filter(frame, exact)[:, :, 0] - truth)
    assert bias[inner].max() < 0.006
    assert np.abs(box(truth, round(mean_width * math.sqrt(3))) - truth)[:20].max() > 0.1


def test_kernel_against_numpy():
    """Both passes in plain NumPy, with a step in the normals."""
    frame, _, _ = shadow(20, 24, step=0.05)
    normal = np.array(frame[Role.NORMAL])
    normal[:, 13:] = [1, 0, 0]
    frame = frame.with_layer(frame.layer(Role.NORMAL).with_data(normal))
    model = AxisAligned(light_sigma=SIGMA, radius=5)
    position, beta = frame[Role.POSITION].astype(np.float64), model.widths(frame)
    image = frame.colour.astype(np.float64)
    for dx, dy in ((1, 0), (0, 1)):
        result = np.zeros_like(image)
        for y in range(20):
            for x in range(24):
                total = 0.0
                for s in range(-5, 6):
                    v, u = y + s * dy, x + s * dx
                    if not (0 <= v < 20 and 0 <= u < 24) or normal[y, x] @ normal[v, u] < 0.9:
                        continue
                    away = ((position[y, x] - position[v, u]) ** 2).sum()
                    w = math.exp(-away / (2 * float(beta[y, x]) ** 2))
                    result[y, x] += w * image[v, u]
                    total += w
                result[y, x] /= total
        image = result
    clean = model.filter(frame, frame.colour)
    np.testing.assert_allclose(clean, image, rtol=1e-4, atol=1e-5)


def test_pixels_without_a_blocked_ray():
    """They take the least slope near them; far from any they stay untouched."""
    frame, _, slope = shadow(24, 64)
    holes = np.array(frame.extras["occluder_max"].data)
    holes[:, 20:] = 0
    holes[5, 5] = np.inf
    frame = frame.with_layer(frame.extras["occluder_max"].with_data(holes))
    model = AxisAligned(light_sigma=SIGMA)
    width = model.widths(frame)
    assert width[5, 5] == pytest.approx(float(width[3, 5]))
    assert width[5, 21] > 0
    assert (width[:, 22:] == 0).all()
    clean = model.filter(frame, frame.colour)
    np.testing.assert_allclose(clean[:, 22:], frame.colour[:, 22:], atol=1e-6)
    assert slope[3] < slope[5]


def test_layers_still_sum_and_texture_stays():
    """One set of weights; with albedo given, a texture under even light is not touched."""
    frame, _, _ = shadow(24, 32)
    rng = np.random.default_rng(2)
    grey = rng.uniform(0.1, 0.9, (24, 32, 1)).astype(np.float32)
    frame = frame.with_layer(Layer(Role.ALBEDO, np.repeat(grey, 3, axis=2)))
    share = rng.random((24, 32, 1)).astype(np.float32)
    direct = frame.colour * share
    lit = np.repeat(grey * 2, 3, axis=2)
    stack = np.concatenate([frame.colour, direct, frame.colour - direct, lit, grey], axis=2)
    result = AxisAligned(light_sigma=SIGMA).filter(frame, stack)
    np.testing.assert_allclose(result[:, :, 3:6] + result[:, :, 6:9], result[:, :, :3], atol=1e-5)
    np.testing.assert_allclose(result[:, :, 9:12], lit, rtol=1e-4)
    plain = AxisAligned(light_sigma=SIGMA, demodulate=False).filter(frame, lit)
    assert np.abs(plain - lit).max() > 0.1


def test_tiles_equal_the_whole():
    frame, _, _ = shadow(40, 96)
    model = AxisAligned(light_sigma=SIGMA)
    whole = model.filter(frame, frame.colour)
    left = 48 - model.margin()
    piece = frame.crop(0, 40, left, 96)
    tile = model.filter(piece, piece.colour)
    np.testing.assert_allclose(tile[:, 48 - left :], whole[:, 48:], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (1, 20), (20, 1)])
def test_small_images_and_misses(size):
    frame, _, _ = shadow(*size)
    position = np.array(frame[Role.POSITION])
    position[0, 0] = np.inf
    frame = frame.with_layer(frame.layer(Role.POSITION).with_data(position))
    clean = AxisAligned(light_sigma=SIGMA).filter(frame, frame.colour)
    assert np.isfinite(clean).all()
    np.testing.assert_array_equal(clean[0, 0], frame.colour[0, 0])


def test_footprint_does_not_cross_silhouettes():
    position = np.zeros((3, 6, 3), np.float32)
    position[:, :, 0] = np.arange(6) * 0.5
    position[:, 3:, 2] = 100
    position[:, :, 1] = np.arange(3)[:, None] * 2
    assert np.allclose(footprint(position), 0.5)


def test_missing_layers_are_named():
    frame, _, _ = shadow(8, 8)
    extras = {k: v for k, v in frame.extras.items() if k != "occluder_min"}
    with pytest.raises(LayerError, match="occluder_min") as caught:
        AxisAligned()(frame.replace(extras=extras))
    assert "light_distance" not in caught.value.message
    with pytest.raises(LayerError, match="position"):
        AxisAligned()(frame.without(Role.POSITION))
    with pytest.raises(OptionError, match="light_sigma"):
        AxisAligned(light_sigma=0.0)
