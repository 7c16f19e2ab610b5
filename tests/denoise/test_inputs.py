"""What the network reads: NumPy, PyTorch and the kernel agree; misses and absent layers."""

import numpy as np
import pytest

from lambent.denoise import inputs, prepare
from lambent.frame.frame import Frame
from lambent.frame.role import Role
from lambent.kernels.pyramid import Workspace, logits_memory, padded


def frame(height=40, width=52, seed=0, **without):
    rng = np.random.default_rng(seed)

    def r(channels):
        return rng.random((height, width, channels), np.float32)

    depth = r(1) * 9 + 1
    depth[:3] = 0
    depth[3:5] = 1e10
    depth[5] = np.inf
    layers = {
        "colour": r(3) * 4,
        "albedo": r(3),
        "normal": r(3) * 2 - 1,
        "depth": depth,
        "roughness": r(1),
        "colour_variance": r(3),
        "albedo_variance": r(3) * 0.1,
        "normal_variance": r(3) * 0.1,
        "depth_variance": r(1),
    }
    for name, gone in without.items():
        if gone:
            layers.pop(name)
    return Frame.from_arrays(spp=8, **layers)


def by_numpy(made, preference=0.3):
    whole = prepare.Whole.of(made)
    signals = inputs.signals_of(made, whole.depth)
    planes = inputs.encode(np, signals, whole.exposure)
    high, wide = padded(made.height), padded(made.width)
    planes = np.pad(
        planes, ((0, 0), (0, high - made.height), (0, wide - made.width)), mode="symmetric"
    )
    return inputs.pack(np, planes, inputs.constants(signals, preference))


SUBSETS = [
    {},
    {"albedo": 1, "albedo_variance": 1},
    {"depth": 1, "depth_variance": 1, "roughness": 1},
    {name: 1 for name in ("albedo_variance", "normal_variance", "depth_variance")},
    {
        name: 1
        for name in (
            "albedo", "normal", "depth", "roughness", "colour_variance", "albedo_variance",
            "normal_variance", "depth_variance",
        )
    },
]  # fmt: skip


@pytest.mark.parametrize("without", SUBSETS, ids=lambda w: f"without {len(w)}")
def test_the_kernel_is_the_description(without):
    made = frame(**without)
    packed = prepare.packed_inputs(prepare.Given.of(made), prepare.Whole.of(made), 0.3, "auto")
    expected = by_numpy(made)
    assert packed.shape == (1, *expected.shape)
    np.testing.assert_allclose(packed[0], expected, atol=2e-6)


@pytest.mark.heavy
def test_pytorch_encodes_alike():
    import torch

    made = frame()
    signals = inputs.signals_of(made)
    tensors = inputs.Signals(
        torch.tensor(signals.colour),
        {name: torch.tensor(layer.copy()) for name, layer in signals.layers.items()},
        signals.spp,
    )
    a, b = inputs.encode(np, signals, 0.7), inputs.encode(torch, tensors, 0.7)
    np.testing.assert_allclose(b.numpy(), a, atol=1e-6)
    numbers = inputs.constants(signals, 0.5)
    np.testing.assert_array_equal(
        inputs.pack(torch, b, torch.tensor(numbers)).numpy(),
        inputs.pack(np, b.numpy(), numbers),
    )


def test_masks_tell_what_is_there():
    numbers = inputs.constants(inputs.signals_of(frame()), 0.25)
    assert numbers[:7].tolist() == [1, 1, 1, 1, 1, 1, 0]  # no history
    assert numbers[7:] == pytest.approx([0.3, 1, 0.25])
    bare = inputs.signals_of(Frame.from_arrays(colour=frame().colour))
    assert inputs.constants(bare, 0).tolist() == [0] * 10


def test_misses_are_far():
    signals = inputs.signals_of(frame())
    depth = signals.layers["depth"][0]
    assert (depth[:6] == 1).all()
    assert (depth[6:] < 1).all()


def test_diffuse_and_specular_albedo_make_one():
    half = np.full((32, 32, 3), 0.25, np.float32)
    made = Frame.from_arrays(colour=half, diffuse_albedo=half, specular_albedo=2 * half)
    np.testing.assert_allclose(inputs.albedo_of(made), 0.75)


def test_what_is_not_finite_counts_as_nothing():
    made = frame()
    albedo = made[Role.ALBEDO].copy()
    albedo[10, 10] = np.nan
    made = made.with_layer(made.layer(Role.ALBEDO).with_data(albedo))
    packed = prepare.packed_inputs(prepare.Given.of(made), prepare.Whole.of(made), 0, "auto")
    assert np.isfinite(packed).all()


def test_split_and_merged_are_inverse_for_any_gate():
    made = frame()
    given = prepare.Given.of(made)
    alpha = made[Role.ROUGHNESS]
    space = Workspace()
    logits = logits_memory((36, 32, 32))
    logits[...] = np.random.default_rng(1).normal(size=logits.shape)
    d = prepare.divisors(given, logits, "auto", space)
    assert d is not None
    level = prepare.split(given, [made.colour, alpha], [True, False], d, "auto", space)
    gate = np.random.default_rng(0).normal(size=(4, 32, 32)).astype(np.float32)
    colour, same = prepare.merged(given, level, gate, [3, 1], [True, False], d, "auto")
    np.testing.assert_allclose(colour, made.colour, rtol=1e-5)
    np.testing.assert_array_equal(same, alpha)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_divided_layer_has_the_albedos_channels_or_their_mean(channels):
    made = frame()
    given = prepare.Given.of(made)
    logits = logits_memory((36, 32, 32))
    logits[...] = np.where(np.arange(9) == 4, 0, -100).repeat(4)[:, None, None]
    d = prepare.divisors(given, logits, "auto")
    layer = prepare.split(given, [made.colour[:, :, :channels]], [True], d, "auto")
    by = given.divisor() if channels == 3 else given.divisor().mean(axis=2, keepdims=True)
    inside = layer.planes[:channels, : made.height, : made.width].transpose(1, 2, 0)
    np.testing.assert_allclose(inside, made.colour[:, :, :channels] / by, rtol=1e-5)


def test_no_divisor_is_0():
    """Where all weight lies outside the frame nothing would be left, and light over nothing."""
    made = frame()
    albedo = made[Role.ALBEDO].copy()
    albedo[5, 5] = np.inf
    given = prepare.Given.of(made.with_layer(made.layer(Role.ALBEDO).with_data(albedo)))
    logits = logits_memory((36, 32, 32))
    logits[...] = np.where(np.arange(9) == 0, 300, 0).repeat(4)[:, None, None]  # up and left
    d = prepare.divisors(given, logits, "auto")
    layer = prepare.split(given, [made.colour], [True], d, "auto")
    assert np.isfinite(layer.planes).all()
    gate = np.zeros((4, 32, 32), np.float32)
    (out,) = prepare.merged(given, layer, gate, [3], [True], d, "auto")
    np.testing.assert_allclose(out, made.colour, rtol=1e-5)
