"""Repair: known damage in known places, nothing else touched."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.misses import miss_mask
from lambent.frame.repair import decoded_normals, repair, replaced
from lambent.frame.role import Role, Stat


def picture(seed: int = 0, size: tuple[int, int] = (12, 16)) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.2, 1.0, (*size, 3)).astype(np.float32)


def unit_normals(size: tuple[int, int] = (12, 16)) -> np.ndarray:
    n = np.random.default_rng(3).normal(size=(*size, 3))
    return (n / np.linalg.norm(n, axis=2, keepdims=True)).astype(np.float32)


def test_clean_frame_is_handed_on() -> None:
    frame = Frame.from_arrays(colour=picture(), albedo=picture(1), normal=unit_normals())
    result, repairs = repair(frame)
    assert not repairs
    assert repairs.sentences() == []
    assert result.notes == ()
    for key, layer in frame.layers.items():
        assert result.layers[key] is layer  # not even copied


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (np.nan, "nan"),
        (np.inf, "infinite"),
        (-np.inf, "infinite"),
        (-5.0, "negative"),
        (65504.0, "huge"),
        (3e9, "huge"),
    ],
)
def test_one_bad_value(value: float, kind: str) -> None:
    """It becomes the median of its eight neighbours; every other value stays bit for bit."""
    colour = picture()
    broken = colour.copy()
    broken[5, 7, 1] = value
    result, repairs = repair(Frame.from_arrays(colour=broken))
    around = np.delete(colour[4:7, 6:9, 1].ravel(), 4)
    assert result.colour[5, 7, 1] == pytest.approx(np.median(around))
    others = np.ones(colour.shape, bool)
    others[5, 7, 1] = False
    assert np.array_equal(result.colour[others], colour[others])
    (counts,) = repairs.layers
    assert getattr(counts, kind) == counts.replaced == repairs.total == 1
    assert counts.pixels == 1
    assert "'colour'" in repairs.sentences()[0]
    assert broken[5, 7, 1] == value or np.isnan(value)  # the argument is not changed


def test_no_bad_pixel_reaches_another() -> None:
    """Two frames that differ in damaged values only come out with the same sound values."""
    damage = np.random.default_rng(4).random((12, 16, 3)) < 0.3
    one, two = picture(), picture()
    one[damage] = np.nan
    two[damage] = np.random.default_rng(5).choice([np.inf, -np.inf, np.nan], damage.sum())
    first, _ = repair(Frame.from_arrays(colour=one))
    second, _ = repair(Frame.from_arrays(colour=two))
    assert np.array_equal(first.colour, second.colour)
    assert np.array_equal(first.colour[~damage], picture()[~damage])


def test_holes_are_filled_from_5x5_and_else_zero() -> None:
    colour = picture(size=(15, 15))
    colour[3:12, 3:12] = np.nan
    result, repairs = repair(Frame.from_arrays(colour=colour))
    (counts,) = repairs.layers
    assert counts.nan == 81 * 3
    assert counts.zeroed == 25 * 3  # the inner 5x5 has nothing sound within two pixels
    assert np.all(result.colour[5:10, 5:10] == 0)
    assert np.all(result.colour[4, 4] > 0)
    assert "75 without a sound neighbour" in repairs.sentences()[0]


def test_all_nan_and_one_pixel() -> None:
    for shape in ((1, 1, 3), (1, 9, 3), (9, 1, 3)):
        result, repairs = repair(Frame.from_arrays(colour=np.full(shape, np.nan, np.float32)))
        assert np.all(result.colour == 0)
        assert repairs.total == np.prod(shape)


def test_negative_lobes_are_kept_and_told() -> None:
    colour = picture()
    colour[0, 0] = -1e-4
    result, repairs = repair(Frame.from_arrays(colour=colour))
    assert not repairs
    assert np.array_equal(result.colour, colour)
    assert "3 slightly negative" in result.notes[0]


def test_rounding_below_zero_is_no_damage() -> None:
    """Cycles' nearly black passes hold -1e-7; beside the beauty that is nothing."""
    nearly = np.full((12, 16, 3), 6e-8, np.float32)
    nearly[3, 3] = -1.8e-7
    layers = [Layer(Role.COLOUR, picture()), Layer(Role.LIGHTING, nearly, name="glass")]
    frame = Frame.from_layers(layers)
    result, repairs = repair(frame)
    assert not repairs
    assert repairs.layers[0].kept_negative == 3
    assert result.extras["glass"] is frame.extras["glass"]
    alone, damaged = repair(Frame.from_layers(layers[1:]))
    assert damaged.total == 3  # without a beauty the layer is its own measure
    assert alone.extras["glass"].data.min() > 0


def test_a_bright_area_is_a_light() -> None:
    """A sun that overflows a half is kept; a single overflowing pixel is damage."""
    colour = picture(size=(20, 20))
    colour[5:9, 5:9] = 65504.0
    colour[15, 15] = 65504.0
    result, repairs = repair(Frame.from_arrays(colour=colour))
    assert repairs.layers[0].huge == 3
    assert repairs.layers[0].kept_huge == 48
    assert np.all(result.colour[5:9, 5:9] == 65504.0)
    assert result.colour[15, 15].max() <= 1.0
    assert "areas" in result.notes[0]


def test_depth_misses_are_no_damage() -> None:
    """Infinity, 1e10 and 0 are misses: kept, not counted, and in the mask."""
    depth = np.full((4, 6, 1), 3.0, np.float32)
    depth[0, 0], depth[0, 1], depth[0, 2], depth[0, 3] = np.inf, 1e10, 0.0, 65504.0
    frame = Frame.from_arrays(colour=picture(size=(4, 6)), depth=depth)
    result, repairs = repair(frame)
    assert not repairs
    assert result.layers[Role.DEPTH, Stat.MEAN] is frame.layers[Role.DEPTH, Stat.MEAN]
    expected = np.zeros((4, 6), bool)
    expected[0, :4] = True
    assert np.array_equal(miss_mask(result), expected)


def test_nan_depth_among_misses() -> None:
    depth = np.full((3, 3, 1), np.inf, np.float32)
    depth[1, 1] = np.nan
    result, repairs = repair(Frame.from_arrays(depth=depth))
    assert repairs.layers[0].nan == 1
    assert np.all(np.isinf(result[Role.DEPTH]))


def test_miss_mask_without_depth() -> None:
    """A position and a normal of exactly 0, or a position at infinity; nothing known: no miss."""
    position, normal = picture(), unit_normals()
    position[0, 0] = normal[0, 0] = 0
    normal[1, 1] = 0  # glass has no normal in Cycles, but a position
    position[2, 2] = np.inf
    mask = miss_mask(Frame.from_arrays(position=position, normal=normal))
    assert {tuple(p) for p in np.argwhere(mask)} == {(0, 0), (2, 2)}
    assert not miss_mask(Frame.from_arrays(colour=picture())).any()


def test_negative_depths_are_a_convention() -> None:
    frame = Frame.from_arrays(depth=-np.ones((4, 4, 1), np.float32))
    result, repairs = repair(frame)
    assert not repairs
    assert result[Role.DEPTH].max() == -1


def test_variances() -> None:
    variance = picture() * 0.1
    variance[2, 2, 0], variance[3, 9, 1], variance[6, 6, 2] = np.nan, -1.0, np.inf
    variance[8, 8, 0] = 1e9  # fireflies do have such variances
    frame = Frame.from_arrays(colour=picture(), colour_variance=variance)
    result, repairs = repair(frame)
    (counts,) = repairs.layers
    assert (counts.nan, counts.negative, counts.infinite, counts.huge) == (1, 1, 1, 0)
    fixed = result[Role.COLOUR, Stat.VARIANCE]
    assert fixed.min() >= 0
    assert fixed[8, 8, 0] == 1e9


def test_lighting_layers_and_ids() -> None:
    """Every layer of light is repaired; ids may hold any bits, NaN among them."""
    layers = [
        Layer(Role.COLOUR, picture()),
        Layer(Role.LIGHTING, np.where(picture() > 0.9, np.nan, picture()), name="key"),
        Layer(Role.ID, np.full((12, 16, 3), np.nan, np.float32), name="crypto00"),
    ]
    frame = Frame.from_layers(layers)
    result, repairs = repair(frame)
    assert [r.name for r in repairs.layers] == ["key"]
    assert np.isfinite(result.extras["key"].data).all()
    assert result.extras["crypto00"] is frame.extras["crypto00"]
    chosen, nothing = repair(frame, layers=["colour"])
    assert not nothing
    assert chosen.extras["key"] is frame.extras["key"]


def test_encoded_normals_are_decoded() -> None:
    normals = unit_normals()
    frame = Frame.from_arrays(normal=0.5 + 0.5 * normals)
    result, _ = repair(frame)
    assert np.allclose(result[Role.NORMAL], normals, atol=1e-6)
    assert "decoded" in result.notes[0]


def test_normals_that_only_look_encoded_are_not() -> None:
    """All in one octant, or no unit vectors at all: not certain, so nothing is done."""
    assert decoded_normals(np.abs(unit_normals())) is None
    assert decoded_normals(picture()) is None
    assert decoded_normals(np.zeros((3, 3, 3), np.float32)) is None
    assert decoded_normals(unit_normals()) is None


def test_twin_of_replaced() -> None:
    """The vectorised median against a plain loop."""
    rng = np.random.default_rng(6)
    image = rng.normal(size=(9, 11, 2)).astype(np.float32)
    bad = rng.random(image.shape) < 0.6
    fixed, zeroed = replaced(image, bad)
    expected, empty = image.copy(), 0
    for y, x, c in np.argwhere(bad):
        for radius in (1, 2):
            rows = slice(max(0, y - radius), y + radius + 1)
            columns = slice(max(0, x - radius), x + radius + 1)
            sound = image[rows, columns, c][~bad[rows, columns, c]]
            if sound.size:
                expected[y, x, c] = np.median(sound)
                break
        else:
            expected[y, x, c] = 0
            empty += 1
    assert np.allclose(fixed, expected)
    assert zeroed == empty


def test_repairs_as_json() -> None:
    colour = picture()
    colour[0, 0, 0] = np.nan
    _, repairs = repair(Frame.from_arrays(colour=colour))
    assert repairs.as_dict()["colour"]["nan"] == 1


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 6), st.integers(1, 6), st.sampled_from(list(Role)))
def test_any_values_come_out_sound(seed: int, height: int, width: int, role: Role) -> None:
    """Whatever the bits of a layer with a role: finite afterwards (misses apart), never a crash."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2**32, (height, width, 3), np.uint32)
    image = bits.view(np.float32)
    from lambent.frame.role import INFO

    allowed = INFO[role].channels
    count = 3 if not allowed or 3 in allowed else allowed[0]
    image = np.resize(image, (height, width, count))
    result, _ = repair(Frame.from_layers([Layer(role, image)]))
    data = next(iter(result.all_layers())).data
    if role in (Role.DEPTH, Role.POSITION):
        assert not np.isnan(data).any()
    elif role not in (Role.ID, Role.OTHER):
        assert np.isfinite(data).all()


def test_real_file_with_nan_and_infinity(shared_data: Path) -> None:
    from lambent.frame.dialects import identify
    from lambent.frame.exr import decode

    exr = decode(shared_data / "exr" / "openexr_nan_inf.exr")
    found = identify(exr).of(Role.COLOUR)
    colour = np.stack([exr.parts[p].channels[n].data for p, n in found.channels], -1)
    result, repairs = repair(Frame.from_arrays(colour=colour))
    counts = repairs.layers[0]
    assert counts.nan == np.count_nonzero(np.isnan(colour))
    assert counts.infinite == np.count_nonzero(np.isinf(colour))
    assert np.isfinite(result.colour).all()
    sound = np.isfinite(colour) & (colour >= 0) & (colour < 65504)
    assert np.mean(result.colour[sound] == colour[sound]) == 1.0


def test_clean_frames_are_fast() -> None:
    """Two passes a layer: 10 channels of 1280x720 in 60 ms (loosely held: machines are shared)."""
    rng = np.random.default_rng(0)
    base = rng.uniform(0.1, 1, (720, 1280, 3)).astype(np.float32)
    frame = Frame.from_arrays(colour=base, albedo=base, normal=base - 0.5, depth=base[..., :1] + 1)
    for layer in frame.all_layers():
        assert layer.data is not None
    best = min(_timed(frame) for _ in range(5))
    assert best < 0.25


def _timed(frame: Frame) -> float:
    start = time.perf_counter()
    repair(frame)
    return time.perf_counter() - start
