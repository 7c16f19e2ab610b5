"""Cycles' passes and blocks of samples as frames, on arrays with known answers."""

from __future__ import annotations

import numpy as np

from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role, Space, Stat
from lambent.render.cycles.frames import joined, mean_and_variance, with_lobes, world_normal


def test_lobes_of_a_file_without_passes_are_not_made() -> None:
    frame = Frame.from_arrays(colour=np.ones((2, 2, 3), np.float32))
    assert with_lobes(frame) is frame


def test_lobes() -> None:
    """Diffuse and direct are the sums of products; the others make up the beauty."""
    rng = np.random.default_rng(1)
    names = [
        f"{a} {b}" for a in ("Diffuse", "Glossy", "Transmission") for b in ("Direct", "Indirect")
    ]
    light = {n: rng.random((3, 4, 3), np.float32) for n in (*names, "Environment")}
    colours = {n: rng.random((3, 4, 3), np.float32) for n in ("Diffuse", "Glossy", "Transmission")}
    beauty = light["Environment"] + sum(
        (light[f"{n} Direct"] + light[f"{n} Indirect"]) * c for n, c in colours.items()
    )
    roles = {"Diffuse": Role.DIFFUSE_ALBEDO, "Glossy": Role.SPECULAR_ALBEDO}
    layers = [Layer(Role.COLOUR, beauty, name="View.Combined")]
    layers += [Layer(Role.LIGHTING, x, name=f"View.{n}") for n, x in light.items()]
    layers += [
        Layer(roles.get(n, Role.OTHER), x, name=f"View.{n} Color") for n, x in colours.items()
    ]
    frame = with_lobes(Frame.from_layers(layers))
    diffuse = (light["Diffuse Direct"] + light["Diffuse Indirect"]) * colours["Diffuse"]
    direct = light["Environment"] + sum(light[f"{n} Direct"] * c for n, c in colours.items())
    np.testing.assert_allclose(frame[Role.DIFFUSE], diffuse, rtol=1e-5)
    np.testing.assert_allclose(frame[Role.SPECULAR], beauty - diffuse, atol=1e-5)
    np.testing.assert_allclose(frame[Role.DIRECT], direct, rtol=1e-5)
    np.testing.assert_allclose(frame[Role.INDIRECT], beauty - direct, atol=1e-5)


def test_variance_is_unbiased_for_blocks_of_any_size() -> None:
    """Means of 1, 3 and 4 normal samples of variance 1: the mean of all has variance 1/8."""
    rng = np.random.default_rng(2)
    spp = (1, 3, 4)
    images = [rng.standard_normal((200, 200, 1)) / np.sqrt(n) for n in spp]
    mean, variance = mean_and_variance([i.astype(np.float32) for i in images], spp)
    # 40,000 estimates of 2 degrees of freedom: standard error of their mean is 0.5 % of it.
    assert abs(variance.mean() * 8 - 1) < 0.03
    assert abs(mean.var() * 8 - 1) < 0.03


def test_joined() -> None:
    """Means by samples, first block for what is no average, variance and halves of the colour."""
    blocks = [
        Frame.from_arrays(
            spp=n, colour=np.full((2, 2, 3), v, np.float32),
            depth=np.full((2, 2, 1), v, np.float32), albedo=np.full((2, 2, 3), v, np.float32),
        )
        for n, v in ((1, 1.0), (3, 5.0))
    ]  # fmt: skip
    frame = joined(blocks)
    assert frame.spp == 4
    assert frame.colour[0, 0, 0] == 4.0
    assert frame[Role.DEPTH][0, 0, 0] == 1.0
    assert frame[Role.COLOUR, Stat.HALF_A][0, 0, 0] == 1.0
    assert frame[Role.COLOUR, Stat.HALF_B][0, 0, 0] == 5.0
    # (1·(1−4)² + 3·(5−4)²) / (4·1)
    assert frame[Role.COLOUR, Stat.VARIANCE][0, 0, 0] == 3.0
    assert frame.has(Role.ALBEDO, Stat.VARIANCE)
    assert not joined(blocks[:1]).has(Role.COLOUR, Stat.VARIANCE)


def test_world_normal() -> None:
    """A camera that looks along +y: what faces it looks along −y in the world."""
    to_world = [[1, 0, 0, 5], [0, 0, -1, 6], [0, 1, 0, 7], [0, 0, 0, 1]]
    facing = np.zeros((1, 1, 3), np.float32)
    facing[..., 2] = -1  # Cycles' camera looks along +z
    layer = Layer(Role.NORMAL, facing, space=Space.CAMERA)
    turned = world_normal(Frame.from_layers([layer]), to_world)
    np.testing.assert_allclose(turned[Role.NORMAL][0, 0], (0, -1, 0))
    assert turned.layer(Role.NORMAL).space is Space.WORLD
