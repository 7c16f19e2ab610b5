"""The example is small, complete and what its README says."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import lambent
from lambent.frame.role import Role

FOLDER = Path(__file__).parents[2] / "examples" / "still_life"
sys.path.insert(0, str(FOLDER))


def test_both_files_together_stay_below_two_megabytes():
    assert sum((FOLDER / f"{n}.exr").stat().st_size for n in ("noisy", "reference")) < 2_000_000


def test_layers_are_found_without_any_flag():
    frame = lambent.read(FOLDER / "noisy.exr")
    assert all(frame.has(r) for r in (Role.COLOUR, Role.ALBEDO, Role.NORMAL, Role.DEPTH))
    assert frame.spp == 12
    assert (frame.width, frame.height) == (480, 300)
    albedo = frame["albedo"]
    assert albedo.min() >= 0
    assert albedo.max() <= 1
    assert np.isfinite(frame.colour).all()


def test_the_reference_is_the_same_picture_with_less_noise():
    noisy, reference = (lambent.read(FOLDER / f"{n}.exr").colour for n in ("noisy", "reference"))
    assert noisy.shape == reference.shape
    assert abs(noisy.mean() / reference.mean() - 1) < 0.02
    steps = [np.abs(np.diff(np.minimum(i, 1), axis=1)).mean() for i in (noisy, reference)]
    assert steps[1] < 0.5 * steps[0]


def test_the_wire_solid_is_a_dodecahedron_that_stands_on_a_face():
    from shapes import dodecahedron

    corners, edges = dodecahedron()
    assert (len(corners), len(edges)) == (20, 30)
    assert np.bincount(np.ravel(edges)).tolist() == [3] * 20
    assert np.isclose(corners[:, 1], corners[:, 1].min()).sum() == 5


def test_textures_are_reflectances_and_repeat_with_their_seed():
    import textures

    for make in (textures.wood, textures.plaid, textures.engraving, textures.plaster):
        image = make()
        assert image.dtype == np.float32
        assert image.min() >= 0
        assert image.max() <= 1
    np.testing.assert_array_equal(textures.peel(64), textures.peel(64))
