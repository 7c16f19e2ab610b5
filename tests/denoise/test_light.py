"""Light that a filter has lost is given back, to every layer alike."""

import numpy as np
import pytest

import lambent
from lambent.denoise.light import BLOCK, MOST, gain
from lambent.denoise.pipeline import _light_note
from lambent.frame.frame import Frame
from lambent.frame.role import Role


def fireflies(height=120, width=161, seed=0):
    """A soft picture of two layers; one pixel in three hundred of the second is eighty times."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / 100
    base = (0.3 + 0.2 * x * y)[:, :, None] * np.float32([1.0, 0.8, 0.6])
    hits = np.where(rng.random((height, width, 1)) < 1 / 300, 80.0, 0.0).astype(np.float32)
    diffuse, specular = base, (0.1 * base * (1 + hits)).astype(np.float32)
    return Frame.from_arrays(
        colour=diffuse + specular, diffuse=diffuse, specular=specular,
        alpha=np.ones((height, width, 1), np.float32),
    )  # fmt: skip


@pytest.mark.parametrize("model", ["oidn", "lambent"])
def test_the_picture_keeps_its_light(model):
    made = fireflies()
    plain = lambent.denoise(made, model=model, alpha=True)
    kept = lambent.denoise(made, model=model, alpha=True, keep_light=True)
    total = made.colour.sum(dtype=float)
    lost = 1 - plain.colour.sum(dtype=float) / total
    left = 1 - kept.colour.sum(dtype=float) / total
    assert lost > 0.005
    assert abs(left) < 0.3 * lost
    np.testing.assert_allclose(
        kept[Role.DIFFUSE] + kept[Role.SPECULAR], kept.colour, rtol=1e-3, atol=1e-4
    )
    np.testing.assert_array_equal(kept[Role.ALPHA], plain[Role.ALPHA])
    ratio = kept.colour / np.maximum(plain.colour, 1e-6)
    np.testing.assert_allclose(ratio[:, :, 1], ratio[:, :, 0], rtol=1e-4)  # hues stay


def test_where_nothing_is_lost_nothing_is_given():
    image = fireflies().colour
    np.testing.assert_allclose(gain(image, image), 1, rtol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (3, 50), (BLOCK + 1, BLOCK), (40, 41)])
def test_any_size_and_no_more_than_the_most(size):
    one = np.ones((*size, 3), np.float32)
    for factor in (0.01, 0.9, 100.0):
        found = gain(one, one * np.float32(factor))
        assert found.shape == (*size, 1)
        np.testing.assert_allclose(found, np.clip(1 / factor, 1 / MOST, MOST), rtol=1e-5)
    assert np.isfinite(gain(one, 0 * one)).all()
    np.testing.assert_array_equal(gain(0 * one, 0 * one), 1)


def test_it_is_part_of_what_makes_a_sequence():
    from lambent.denoise.pipeline import Settings

    assert Settings.checked(keep_light=True).key() != Settings.checked().key()


@pytest.mark.parametrize(
    ("factor", "notes"), [(1.0, 0), (0.98, 0), (1.029, 0), (0.95, 1), (1.04, 1)]
)
def test_a_change_of_light_is_noted_from_three_per_cent_on(factor, notes):
    image = np.full((8, 8, 3), 0.5, np.float32)
    assert len(_light_note(image, image * np.float32(factor))) == notes
