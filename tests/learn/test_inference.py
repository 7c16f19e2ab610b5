"""The network on a GPU, tried on the processor: the same pictures as OpenVINO's."""

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise.engines import ENGINES
from lambent.denoise.learned import Lambent
from lambent.errors import EngineError
from lambent.filters.denoiser import create
from lambent.frame.frame import Frame
from lambent.frame.role import Role
from lambent.learn import inference
from lambent.learn.export import export, float_weights
from lambent.learn.networks.lambent import LambentNet


@pytest.fixture
def on_processor(monkeypatch):
    """What asks for CUDA gets the processor."""
    real = inference.filtered

    def filtered(model, packed, images, divided, divisor, device, views):
        assert device == "cuda"
        return real(model, packed, images, divided, divisor, "cpu", views)

    monkeypatch.setattr(inference, "filtered", filtered)
    ENGINES.register("cuda", inference.cuda)


def frame(guides=True):
    whole = made.frame(np.random.default_rng(0), 4, size=96, lobes=True)
    whole = whole.crop(3, 73, 0, 45)  # no multiple of 32
    alpha = np.linspace(0, 1, 70 * 45, dtype=np.float32).reshape(70, 45, 1)
    arrays = {"colour": whole.colour, "alpha": alpha, "diffuse": whole[Role.DIFFUSE]}
    if guides:
        arrays |= {"albedo": whole[Role.ALBEDO], "normal": whole[Role.NORMAL]}
    return Frame.from_arrays(**arrays, spp=4)


@pytest.fixture(scope="module")
def in_float(tmp_path_factory):
    """The small model's weights in a model file that is not int8."""
    network = LambentNet("fast")
    network.load_state_dict(float_weights("lambent-fast"))
    path = tmp_path_factory.mktemp("models") / "float.lambent"
    export(network, path, {"name": "float", "recipe": {"size": "fast"}}, None)
    return str(path)


@pytest.mark.parametrize("guides", [True, False])
@pytest.mark.parametrize("views", [1, 2])
def test_both_engines_give_one_picture(on_processor, in_float, guides, views):
    given = frame(guides)
    ours = Lambent(weights=in_float, views=views, precision="f32")(given, "all")
    theirs = Lambent(weights=in_float, views=views, device="cuda")(given, "all")
    for role in (Role.COLOUR, Role.DIFFUSE):
        # logits are bfloat16 on one side
        np.testing.assert_allclose(ours[role], theirs[role], rtol=1e-2, atol=3e-3)
        assert np.abs(ours[role] - given[role]).mean() > 0.01


@pytest.mark.parametrize("name", ["lambent", "lambent-fast", "lambent-best"])
def test_int8_is_rounded_alike_on_both_sides(on_processor, monkeypatch, name):
    """A clean frame with all layers: activations that end at 255 steps are what its kernels are of.

    So the same weights in float are no stand-in.
    """
    given = made.frame(np.random.default_rng(0), 64, size=96).crop(3, 73, 0, 45)
    ours, theirs = create(name)(given, "all"), create(name, device="cuda")(given, "all")

    def in_float(model, device):
        found = LambentNet("fast" if name == "lambent-fast" else "default")
        found.load_state_dict(float_weights(model))
        return found.eval()

    monkeypatch.setattr(inference, "network", in_float)
    others = create(name, device="cuda")(given, "all")
    change, apart, far = (
        np.abs(ours.colour - image).mean() for image in (given.colour, theirs.colour, others.colour)
    )
    assert apart < 0.02 * change
    assert apart < 0.6 * far


def test_alpha_is_filtered_without_the_albedo(on_processor, in_float):
    given = frame()
    alpha = [given.layer(Role.ALPHA)]
    ours = Lambent(weights=in_float, precision="f32").filter_layers(given, alpha)[0]
    theirs = Lambent(weights=in_float, device="cuda").filter_layers(given, alpha)[0]
    np.testing.assert_allclose(ours, theirs, atol=3e-3)
    assert np.abs(ours - given[Role.ALPHA]).max() > 1e-3


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
