"""The page's picture codec: round trip, size, no bands in gradients, and the JavaScript twin."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.frame.tonemap import srgb
from lambent.report.codec import LEVELS, pack_map, pack_radiance, unpack_map, unpack_radiance


def noise(height: int, width: int, seed: int = 0) -> np.ndarray:
    g = np.random.default_rng(seed)
    return g.gamma(1.0, 0.3, (height, width, 3)).astype(np.float32)


@pytest.mark.parametrize(
    "size", [(1, 1), (1, 7), (5, 1), (2, 2), (3, 2), (31, 33), (64, 64), (97, 50)]
)
def test_round_trip_at_any_size(size):
    # Steps are in stops: an error of half a step of luma and chroma each, added up over levels.
    image = noise(*size)
    back = unpack_radiance(pack_radiance(image, 2.0))
    stops = np.abs(np.log2((back + 1 / 4096) / (image * 2 + 1 / 4096)))
    assert back.shape == image.shape
    assert np.percentile(stops, 90) < 0.3
    assert stops.max() < 1.2


def test_a_flat_picture_comes_back_at_every_brightness():
    for value in (0.0, 1e-5, 0.01, 1.0, 60.0, 2000.0):
        image = np.full((40, 40, 3), value, np.float32) * np.array([1, 0.5, 0.9], np.float32)
        back = unpack_radiance(pack_radiance(image, 1.0))
        assert np.allclose(back, image, rtol=0.012, atol=3e-6), value


@pytest.mark.parametrize("stops", [-6, -3, 0, 3, 6])
def test_gradients_show_no_bands_at_any_exposure(stops):
    # Less than one of 255 display levels off, in a slow gradient, after turning the exposure.
    x = np.linspace(0, 1, 640)
    ramp = 2.0 ** (-12 + 12 * x)
    image = (np.ones((64, 1, 1)) * ramp[None, :, None] * [1, 0.9, 0.7]).astype(np.float32)
    back = unpack_radiance(pack_radiance(image, 1.0))
    difference = np.abs(srgb(back * 2.0**stops) - srgb(image * 2.0**stops)) * 255
    assert difference.max() < 1.0


def test_smooth_pictures_weigh_next_to_nothing_and_noise_is_bounded():
    y, x = np.mgrid[:360, :640] / 640
    smooth = np.stack([x, y, x * y], axis=2).astype(np.float32) + 0.01
    assert len(pack_radiance(smooth, 1.0).payload) < 20_000
    assert len(pack_radiance(noise(360, 640), 1.0).payload) < 360 * 640 * 2.1


def test_pixels_that_are_not_finite_or_negative_become_black():
    image = np.full((16, 16, 3), 0.5, np.float32)
    image[3, 3] = np.nan
    image[9, 9] = -4
    image[12, 2, 0] = np.inf
    back = unpack_radiance(pack_radiance(image, 1.0))
    assert np.isfinite(back).all()
    assert back[3, 3].max() < 0.1
    assert back[9, 9].max() < 0.1


def test_maps_come_back():
    values = np.random.default_rng(0).random((45, 61)).astype(np.float32)
    packed = pack_map(values)
    assert len(packed.steps) == 1
    assert len(packed.steps[0]) == LEVELS + 1
    assert np.abs(unpack_map(packed) - values).max() < 0.15
    assert np.abs(unpack_map(packed).mean() - values.mean()) < 0.005
