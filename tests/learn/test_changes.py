"""What is done to a row is done to noisy frame and target alike, and is what it says."""

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise.inputs import MASKS, signals_of
from lambent.learn import batches, changes, splat
from lambent.learn.rows import AT, NAMES, PLANES, Example, rows_of


def rows(count=1, spp=4):
    rng = np.random.default_rng(0)
    noisy = signals_of(made.frame(rng, spp))
    clean = made.frame(rng, spp, clean=True).colour.transpose(2, 0, 1)
    return rows_of([Example(noisy, clean, np.full((1, 64, 64), 0.01, np.float32))] * count)


def test_turning_moves_everything_together():
    start = rows(48)
    # a picture of the target's own values finds each pixel again
    start.target[:] = torch.randperm(64 * 64).reshape(64, 64).float()
    before = start.target[0, 0].flatten().argsort()
    old = {name: start.layer(name).clone() for name in NAMES}
    turned = changes.turned(start, torch.Generator().manual_seed(1))
    seen = set()
    for i in range(48):
        order = turned.target[i, 0].flatten().argsort()
        seen.add(tuple(order[:4].tolist()))
        for name in ("albedo", "depth", "colour_std"):
            a = turned.layer(name)[i, 0].flatten()[order]
            assert torch.equal(a, old[name][i, 0].flatten()[before])
    assert len(seen) == 8  # four quarters, each mirrored or not
    torch.testing.assert_close(turned.layer("normal").norm(dim=1), torch.ones(48, 64, 64))


def test_normals_are_turned_as_one():
    """By one matrix a crop: angles between them stay, whether or not the picture turns too."""
    start = rows(16)
    normal = torch.nn.functional.normalize(torch.randn(1, 3, 64, 64), dim=1)
    start.planes[:, AT["normal"]] = normal
    start.target[:] = torch.arange(64 * 64).reshape(64, 64).float()
    turned = changes.turned(start, torch.Generator().manual_seed(3))
    wanted = normal[0].flatten(1)
    same = 0
    for i in range(16):
        order = turned.target[i, 0].flatten().argsort()
        now = turned.layer("normal")[i].flatten(1)[:, order]
        torch.testing.assert_close(now.T[:200] @ now[:, :200], wanted.T[:200] @ wanted[:, :200])
        same += torch.equal(now, wanted)
    assert 0 < same < 16


def test_recolouring_keeps_light_over_albedo_apart_from_a_gain():
    start = rows(8)
    plain = start.target[:, :3] / start.layer("albedo")
    light = start.planes[:, :3] / start.target[:, :3]
    changes.recoloured(start, torch.Generator().manual_seed(0))
    ratio = start.target[:, :3] / start.layer("albedo") / plain[:, :1]
    # every channel is the old light (the same in all channels) times one number
    one = ratio.mean((2, 3), keepdim=True)
    torch.testing.assert_close(ratio, one.expand_as(ratio), rtol=1e-3, atol=1e-4)
    assert bool((one > 0).all())
    noise = (start.planes[:, :3] / start.target[:, :3]).flatten(1).sort(1).values
    torch.testing.assert_close(noise, light.flatten(1).sort(1).values, rtol=1e-3, atol=1e-3)


def test_dropped_layers_leave_nothing_behind():
    start = rows(400)
    masks, _ = changes.without_some(start, start.spp, torch.Generator().manual_seed(2))
    shown = start.there * batches._of_layers(masks)
    seen = {tuple(n for n, there in zip(NAMES, row, strict=True) if there) for row in shown}
    assert () in seen
    assert ("albedo", "normal") in seen
    assert any("colour_std" in layers and "depth" in layers for layers in seen)
    for layers in seen:
        assert "albedo_std" not in layers or "albedo" in layers
    start.planes[:, 3:PLANES] = 7.0  # of what is dropped nothing is read
    none = torch.zeros(400, len(MASKS))
    packed = batches.ready(start, none, start.spp, torch.zeros(400))[0]
    assert not bool(packed[:, 12 : 4 * PLANES].any())


@pytest.mark.parametrize("kind", range(3), ids=splat.FILTERS)
def test_splatting_a_constant_changes_nothing(kind):
    image, kinds = torch.full((1, 2, 20, 30), 3.0), torch.tensor([[kind]])
    torch.testing.assert_close(splat.expected(image, kinds), image)
    rng = torch.Generator().manual_seed(0)
    out = splat.splatted(image, torch.tensor([4.0]), kinds, rng)
    assert float((out - 3).abs().median()) < 1e-5


@pytest.mark.parametrize("kind", range(3), ids=splat.FILTERS)
def test_splatting_has_its_expectation(kind):
    rng = torch.Generator().manual_seed(3)
    image, kinds = torch.rand(1, 1, 24, 24, generator=rng), torch.tensor([[kind]])
    many = splat.splatted(
        image.expand(300, -1, -1, -1), torch.full((300,), 4.0), kinds.expand(300, 1), rng
    )
    # the quotient of means is not the mean of quotients: a small bias stays
    assert float((many.mean(0) - splat.expected(image, kinds)[0]).abs().mean()) < 0.02


@pytest.mark.parametrize("kind", range(3), ids=splat.FILTERS)
def test_the_expected_filter_is_the_filter_s_mean_over_a_pixel(kind):
    """An impulse spreads as the filter itself, integrated numerically here."""
    image = torch.zeros(1, 1, 11, 11)
    image[0, 0, 5, 5] = 1
    found = splat.expected(image, torch.tensor([[kind]]))[0, 0].numpy()
    functions = {
        "tent": lambda x: np.maximum(0, 1 - abs(x)),
        "gaussian": lambda x: np.where(abs(x) < 2, np.exp(-2 * x * x) - np.exp(-8), 0),
        "mitchell": lambda x: np.where(
            abs(x) < 1, (7 * abs(x) ** 3 - 12 * x**2 + 16 / 3) / 6,
            np.where(abs(x) < 2, (-7 / 3 * abs(x) ** 3 + 12 * x**2 - 20 * abs(x) + 32 / 3) / 6, 0),
        ),
    }  # fmt: skip
    at = np.linspace(-0.5, 0.5, 2001)
    line = np.array([functions[splat.FILTERS[kind]](d - at).mean() for d in range(-2, 3)])
    line /= line.sum()
    np.testing.assert_allclose(found[3:8, 3:8], np.outer(line, line), atol=5e-4)


def test_a_tent_makes_neighbours_alike():
    rng = torch.Generator().manual_seed(4)
    image = 1 + torch.randn(1, 1, 200, 200, generator=rng)
    out = splat.splatted(image, torch.tensor([64.0]), torch.tensor([[0]]), rng)[0, 0]
    out = out - out.mean()
    correlation = float((out[:, 1:] * out[:, :-1]).mean() / (out * out).mean())
    assert correlation == pytest.approx(0.3, abs=0.08)


def test_a_splatted_frame_has_no_variance():
    start = rows(6)
    means = start.planes[:, :11].mean((0, 2, 3))
    splat.filtered(start, torch.Generator().manual_seed(5))
    there = dict(zip(NAMES, start.there[0].tolist(), strict=True))
    assert there["albedo"] == 1
    assert not any(there[name] for name in NAMES if name.endswith("_std"))
    torch.testing.assert_close(start.planes[:, :11].mean((0, 2, 3)), means, rtol=0.05, atol=0.01)
