"""Finding layers that add up to the beauty, and keeping the sum."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.filters.sums import Term, find_sums, keep_sums, terms
from lambent.frame.layer import Layer
from lambent.frame.role import Role


def light(seed: int, size: tuple[int, int] = (30, 40)) -> np.ndarray:
    return np.random.default_rng(seed).gamma(0.5, 1, (*size, 3)).astype(np.float32)


def plain(count: int) -> list[Term]:
    return [Term(i) for i in range(count)]


def indices(sums) -> set[tuple[int, ...]]:
    return {tuple(t.layer for t in members) for members in sums}


def test_two_partitions_are_found_among_others():
    """direct + indirect and three light groups, with an unrelated layer in between."""
    share = np.random.default_rng(9).random((30, 40, 1)).astype(np.float32)
    beauty = light(0)
    groups = [beauty * s for s in (0.1, 0.6, 0.3)]
    layers = [beauty * share, light(7), *groups, beauty * (1 - share)]
    assert indices(find_sums(beauty, layers, plain(6))) == {(0, 5), (2, 3, 4)}


def test_half_precision_is_close_enough_and_a_tenth_is_not():
    beauty = light(0)
    parts = [(beauty * s).astype(np.float16).astype(np.float32) for s in (0.37, 0.63)]
    half = beauty.astype(np.float16).astype(np.float32)
    assert indices(find_sums(half, parts, plain(2))) == {(0, 1)}
    assert find_sums(half, [parts[0], parts[1] * 0.9], plain(2)) == []


def test_a_layer_lit_in_one_spot_only_belongs():
    """A light group that touches a few pixels is no black layer."""
    spot = np.zeros((30, 40, 3), np.float32)
    spot[17:19, 23:26] = 5
    rest = light(1)
    assert indices(find_sums(rest + spot, [rest * 0.5, spot, rest * 0.5], plain(3))) == {(0, 1, 2)}


def test_a_single_layer_equal_to_the_beauty_is_no_sum():
    beauty = light(0)
    assert find_sums(beauty, [beauty.copy(), light(3)], plain(2)) == []


def test_thirty_layers_are_searched_in_bounded_time():
    """The search is cut off, never exponential."""
    beauty = light(0)
    layers = [beauty / 30 for _ in range(29)] + [light(5)]
    assert find_sums(beauty, layers, plain(30)) == []


def test_cycles_products():
    """Cycles: colour·(direct + indirect) + emission, in old and in new names."""
    for names in (
        ("DiffDir", "DiffInd", "DiffCol"),
        ("Diffuse Direct", "Diffuse Indirect", "Diffuse Color"),
    ):
        colour = np.clip(light(1), 0, 1)
        layers = [
            Layer(Role.LIGHTING, light(2), name=f"ViewLayer.{names[0]}"),
            Layer(Role.LIGHTING, light(3), name=f"ViewLayer.{names[1]}"),
            Layer(Role.EMISSION, light(4), name="ViewLayer.Emit"),
        ]
        albedo = Layer(Role.DIFFUSE_ALBEDO, colour, name=f"ViewLayer.{names[2]}")
        images = [layer.data for layer in layers]
        beauty = colour * (images[0] + images[1]) + images[2]
        summands = terms(layers, [*layers, albedo])
        sums = find_sums(beauty, images, summands)
        assert indices(sums) == {(0, 1, 2)}
        cleaned = [image * f for image, f in zip(images, (0.9, 1.2, 1.1), strict=True)]
        kept = keep_sums(beauty, cleaned, sums)
        total = colour * (kept[0] + kept[1]) + kept[2]
        np.testing.assert_allclose(total, beauty, rtol=1e-5, atol=1e-7)


def test_kept_in_proportion_and_not_negative():
    """One factor for all layers of a pixel; a layer at 0 stays at 0."""
    beauty = np.full((2, 2, 3), 4, np.float32)
    a, b = np.full_like(beauty, 3), np.full_like(beauty, 5)
    b[0, 0] = 0
    kept = keep_sums(beauty, [a, b], [(Term(0), Term(1))])
    assert kept[0][1, 1, 0] == pytest.approx(1.5)
    assert kept[1][1, 1, 0] == pytest.approx(2.5)
    assert (kept[0][0, 0] == 4).all()
    assert (kept[1][0, 0] == 0).all()


def test_where_all_layers_are_dark_the_light_is_shared_equally():
    beauty = np.full((1, 1, 3), 2, np.float32)
    zero = np.zeros_like(beauty)
    kept = keep_sums(beauty, [zero, zero], [(Term(0), Term(1))])
    assert (kept[0] == 1).all()
    assert (kept[1] == 1).all()
    assert (zero == 0).all()


def test_a_layer_in_two_sums_is_settled_once():
    """direct + indirect + emission and diffuse + specular + emission both hold afterwards."""
    d, i, e = light(1), light(2), light(3)
    beauty = d + i + e
    f, s = 0.3 * (d + i), 0.7 * (d + i)
    sums = find_sums(beauty, [d, i, e, f, s], plain(5))
    assert indices(sums) == {(0, 1, 2), (2, 3, 4)}
    cleaned = [x * 0.9 for x in (d, i, e, f, s)]
    kept = keep_sums(beauty, cleaned, sums)
    np.testing.assert_allclose(kept[0] + kept[1] + kept[2], beauty, rtol=1e-5)
    np.testing.assert_allclose(kept[2] + kept[3] + kept[4], beauty, rtol=1e-5, atol=1e-6)
