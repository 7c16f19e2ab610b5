"""Model files: PyTorch and OpenVINO agree, int8 stays near, weights come back."""

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise import prepare
from lambent.denoise.inputs import divisor
from lambent.denoise.learned import Lambent
from lambent.frame.role import Role
from lambent.learn.export import export, float_weights
from lambent.learn.networks.lambent import LambentNet, denoised


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return LambentNet("fast").eval()


@pytest.fixture(scope="module")
def files(network, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models")
    rng = np.random.default_rng(0)
    examples = []
    for spp in (1, 4, 16):
        frame = made.frame(rng, spp)
        given, whole = prepare.Given.of(frame), prepare.Whole.of(frame)
        examples.append(prepare.packed_inputs(given, whole, 0.0, "cpu")[0].copy())
    export(network, folder / "float.lambent", {"name": "float"}, None)
    export(network, folder / "int8.lambent", {"name": "int8"}, examples)
    return folder


def by_torch(network, frame):
    whole = prepare.Whole.of(frame)
    packed = prepare.packed_inputs(prepare.Given.of(frame), whole, 0.0, "cpu")
    colour = torch.tensor(frame.colour.transpose(2, 0, 1)[None] * whole.exposure)
    d = divisor(torch, torch.tensor(frame[Role.ALBEDO].transpose(2, 0, 1)[None].copy()))
    with torch.no_grad():
        out = denoised(network(torch.tensor(packed)), colour, d)
    return out[0].numpy().transpose(1, 2, 0) / whole.exposure


def test_openvino_and_pytorch_agree(network, files):
    frame = made.frame(np.random.default_rng(7), 4)
    model = Lambent(weights=str(files / "float.lambent"), precision="f32")
    ours = model(frame, "beauty").colour
    np.testing.assert_allclose(ours, by_torch(network, frame), rtol=2e-4, atol=2e-5)


def test_int8_stays_near(network, files):
    frame = made.frame(np.random.default_rng(8), 4)
    exact = by_torch(network, frame)
    ours = Lambent(weights=str(files / "int8.lambent"))(frame, "beauty").colour
    noise = np.abs(frame.colour - exact).mean()
    assert 0 < np.abs(ours - exact).mean() < 0.05 * noise


def test_weights_come_back(network, files):
    own = network.state_dict()
    exact, rounded = (float_weights(str(files / f"{n}.lambent")) for n in ("float", "int8"))
    assert set(exact) == set(rounded) == set(own)
    for name, value in own.items():
        torch.testing.assert_close(exact[name], value)
        if name.endswith("weight"):  # a step of the channel (the first layer has half as many)
            step = value.abs().amax(dim=(1, 2, 3), keepdim=True) / 127
            assert bool(((rounded[name] - value).abs() <= 1.1 * step + 1e-7).all()), name


def test_the_mean_of_two_models_lies_between_them(tmp_path):
    from lambent.errors import OptionError
    from lambent.learn.averaging import average
    from lambent.learn.export import export, float_weights

    paths = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        path = tmp_path / f"{seed}.lambent"
        export(LambentNet("fast"), path, {"name": str(seed), "recipe": {"size": "fast"}}, None)
        paths.append(str(path))
    torch.manual_seed(3)
    other = tmp_path / "other.lambent"
    export(LambentNet("default"), other, {"name": "other"}, None)
    card = average(paths, tmp_path / "mean.lambent")
    assert [part["name"] for part in card["parts"]] == ["1", "2"]
    assert "score" not in card  # that of another's weights would be a lie
    assert card["score_says"].startswith("not measured")
    one, two, mean = (float_weights(p) for p in (*paths, str(tmp_path / "mean.lambent")))
    for name, value in mean.items():
        torch.testing.assert_close(value, (one[name] + two[name]) / 2, rtol=2e-3, atol=1e-4)
    with pytest.raises(OptionError, match="different sizes"):
        average([paths[0], str(other)], tmp_path / "no.lambent")
