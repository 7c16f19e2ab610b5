"""An item to an EXR and back: exact where it counts, small elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from fake import FakeView

from lambent.dataset.item import Item, Still
from lambent.dataset.pack import check_pixels, packed, rounded, unpacked
from lambent.dataset.source import Window
from lambent.errors import DamagedFileError
from lambent.frame.exr import decode
from lambent.frame.files import read
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role, Stat

WINDOW = Window(90, 20, 32)


def still(seed: int = 1, spp: tuple[int, ...] = (1, 4), shift: float = 0.0) -> Still:
    view = FakeView(seed, (192, 96), shift, motion=True)
    levels = tuple(view.one(WINDOW, n, 10 + n).frame() for n in spp)
    return Still(levels, view.one(WINDOW, 64, 99).frame())


def stored(item: Item, tmp_path) -> Item:
    path = tmp_path / "item.exr"
    path.write_bytes(packed(item))
    return unpacked(path)


def crop(**layers) -> Item:
    """An item whose only level has these layers."""
    frame = Frame.from_arrays(spp=4, **layers)
    return Item((Still((frame,), frame),), {})


def test_every_layer_comes_back_to_half_precision(tmp_path):
    made = still()
    found = stored(Item((made,), {"index": 3}), tmp_path)
    assert found.about == {"index": 3}
    assert [f.spp for f in found.levels] == [1, 4]
    assert found.target.spp == 64
    for before, after in zip(
        (*made.levels, made.target), (*found.levels, found.target), strict=True
    ):
        means = [k for k in before.layers if k[1] is Stat.MEAN]
        assert set(means) <= set(after.layers)
        for key in means:
            a, b = before.layers[key].data, after.layers[key].data
            scale = np.maximum(np.abs(a), np.abs(before.colour)) if a.shape[2] == 3 else np.abs(a)
            assert (np.abs(a - b) <= 2.0**-10 * scale + 1e-6).all(), key
            assert before.layers[key].space == after.layers[key].space


def test_sums_hold_to_float_precision(tmp_path):
    found = stored(Item((still(),), {}), tmp_path)
    for frame in (*found.levels, found.target):
        colour = frame.colour
        assert np.allclose(frame[Role.DIFFUSE] + frame[Role.SPECULAR], colour, rtol=1e-3, atol=1e-6)
        above = (frame[Role.DIFFUSE] <= colour).all(axis=2)
        total = frame[Role.DIFFUSE] + frame[Role.SPECULAR]
        assert np.allclose(total[above], colour[above], rtol=1e-6)
        assert (frame[Role.SPECULAR] >= 0).all()
    level = found.levels[1]
    halves = (level["colour.half_a"] + level["colour.half_b"]) / 2
    assert np.allclose(halves, level.colour, rtol=2e-3, atol=1e-6)


def test_derived_layers_are_not_in_the_file_unless_they_break_the_sum(tmp_path):
    path = tmp_path / "item.exr"
    path.write_bytes(packed(Item((still(),), {})))
    names = {c for part in decode(path).parts for c in part.channels}
    assert not any(c.rpartition(".")[0].endswith(("specular", "indirect", "half_b")) for c in names)
    colour = np.full((8, 8, 3), 1.0, np.float32)
    odd = crop(colour=colour, diffuse=0.5 * colour, specular=0.25 * colour)
    found = stored(odd, tmp_path)
    assert np.array_equal(found.levels[0][Role.SPECULAR], 0.25 * colour)


def test_variances_keep_their_size_over_many_decades(tmp_path):
    rng = np.random.default_rng(0)
    variance = (10.0 ** rng.uniform(-14, 3, (16, 16, 3))).astype(np.float32)
    colour = np.ones((16, 16, 3), np.float32)
    found = stored(crop(colour=colour, colour_variance=variance), tmp_path)
    again = found.levels[0]["colour.variance"]
    assert np.abs(again / variance - 1).max() < 1 / 31
    albedo = stored(crop(colour=colour, albedo=colour, albedo_variance=variance), tmp_path)
    mean = np.repeat(variance.mean(axis=2, keepdims=True), 3, axis=2)
    assert np.abs(albedo.levels[0]["albedo.variance"] / mean - 1).max() < 1 / 31


def test_values_beyond_a_half_are_kept_as_floats(tmp_path):
    colour = np.ones((8, 8, 3), np.float32)
    colour[2, 3] = (1e6, 3.0, 1e-7)
    motion = np.full((8, 8, 2), 100.03, np.float32)
    depth = np.full((8, 8, 1), np.inf, np.float32)
    depth[0] = 12.345
    found = stored(crop(colour=colour, motion=motion, depth=depth), tmp_path).levels[0]
    assert found.colour[2, 3, 0] == np.float32(1e6)
    assert np.abs(found[Role.MOTION] - motion).max() <= 1 / 64
    assert np.isinf(found[Role.DEPTH][1:]).all()
    assert np.allclose(found[Role.DEPTH][0], 12.345, rtol=1e-3)


def test_dim_scenes_do_not_drown(tmp_path):
    """Radiance near a half's smallest number: its error must be small beside the typical value."""
    rng = np.random.default_rng(1)
    colour = (1e-6 * rng.uniform(0.1, 1, (16, 16, 3))).astype(np.float32)
    found = stored(crop(colour=colour), tmp_path).levels[0]
    assert np.abs(found.colour - colour).max() < 1e-9


def test_rounding_is_to_nearest():
    values = np.array([1.0, 1.03, 1.04, -3.3, 0.0, np.inf, -np.inf], np.float32)
    assert rounded(values, 4).tolist() == [1.0, 1.0, 1.0625, -3.25, 0.0, np.inf, -np.inf]
    assert np.isnan(rounded(np.array([np.nan], np.float32), 4)).all()


def test_a_clip_has_stills_in_order(tmp_path):
    stills = tuple(still(shift=1.5 * k, spp=(4,)) for k in range(3))
    found = stored(Item(stills, {}), tmp_path)
    assert found.is_clip
    assert len(found.stills) == 3
    for before, after in zip(stills, found.stills, strict=True):
        assert np.allclose(before.levels[0].colour, after.levels[0].colour, rtol=1e-3)
        assert np.allclose(after.levels[0][Role.MOTION], (1.5, 0))


def test_lambent_reads_the_file_as_its_first_level(tmp_path):
    made = still(spp=(4, 16))
    path = tmp_path / "item.exr"
    path.write_bytes(packed(Item((made,), {})))
    frame = read(path)
    assert frame.spp == 4
    for role in (Role.COLOUR, Role.ALBEDO, Role.NORMAL, Role.DEPTH, Role.DIFFUSE):
        assert np.allclose(frame[role], made.levels[0][role], rtol=1e-3, atol=1e-4), role
    assert "n1" in frame.extras
    assert "target" in frame.extras


def test_the_same_item_is_the_same_bytes():
    assert packed(Item((still(),), {"a": 1, "b": 2})) == packed(Item((still(),), {"b": 2, "a": 1}))


def test_damage_is_told(tmp_path):
    content = packed(Item((still(),), {}))
    path = tmp_path / "item.exr"
    path.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(DamagedFileError):
        check_pixels(path, WINDOW.edge)
    path.write_bytes(content)
    check_pixels(path, WINDOW.edge)
    with pytest.raises(DamagedFileError, match="is 32x32 pixels in place of 33x33"):
        check_pixels(path, WINDOW.edge + 1)
    plain = Frame.from_layers([Layer(Role.COLOUR, np.ones((8, 8, 3), np.float32))])
    from lambent.frame.files import write

    write(tmp_path / "plain.exr", plain)
    with pytest.raises(DamagedFileError, match="not an item"):
        unpacked(tmp_path / "plain.exr")
