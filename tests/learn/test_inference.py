"""The network on a GPU, tried on the processor: the same pictures as OpenVINO's."""

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise.learned import Lambent
from lambent.errors import EngineError
from lambent.frame.frame import Frame
from lambent.frame.role import Role
from lambent.learn import inference

pytest.importorskip("openvino")


@pytest.fixture
def on_processor(monkeypatch):
    """What asks for CUDA gets the processor."""
    real = inference.filtered

    def filtered(model, packed, images, divisors, device, views):
        assert device == "cuda"
        return real(model, packed, images, divisors, "cpu", views)

    monkeypatch.setattr(inference, "filtered", filtered)


def frame(guides=True):
    whole = made.frame(np.random.default_rng(0), 4, size=96, lobes=True)
    whole = whole.crop(3, 73, 0, 45)  # no multiple of 32
    alpha = np.linspace(0, 1, 70 * 45, dtype=np.float32).reshape(70, 45, 1)
    arrays = {"colour": whole.colour, "alpha": alpha, "diffuse": whole[Role.DIFFUSE]}
    if guides:
        arrays |= {"albedo": whole[Role.ALBEDO], "normal": whole[Role.NORMAL]}
    return Frame.from_arrays(**arrays, spp=4)


@pytest.mark.parametrize("guides", [True, False])
@pytest.mark.parametrize("name", ["lambent", "lambent-fast", "lambent-best"])
def test_both_engines_give_one_picture(on_processor, guides, name):
    from lambent.filters.denoiser import create

    given = frame(guides)
    ours = create(name, precision="f32")(given, "all")
    theirs = create(name, device="cuda")(given, "all")
    for role in (Role.COLOUR, Role.ALPHA, Role.DIFFUSE):
        change = np.abs(ours[role] - given[role]).mean()
        assert np.abs(ours[role] - theirs[role]).mean() < 0.03 * change + 1e-6, role
    if name == "lambent-fast":  # int8 on one side, float on the other
        return
    np.testing.assert_allclose(ours.colour, theirs.colour, rtol=5e-3, atol=2e-3)  # bfloat16 logits


def test_what_is_not_finite_does_not_spread(on_processor):
    given = frame()
    colour = given.colour.copy()
    colour[10, 10] = np.nan
    damaged = Frame.from_arrays(colour=colour, albedo=given[Role.ALBEDO])
    layers = list(Frame.from_arrays(colour=colour).layers.values())
    images = Lambent(device="cuda").filter_layers(damaged, layers)
    assert np.isfinite(images[0]).all()


def test_without_a_device_it_says_so():
    if torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(EngineError, match="no CUDA device"):
        Lambent(device="cuda")(frame(), "beauty")
