"""Training in int8: the rounding, its gradients, and what OpenVINO makes of it."""

import made
import numpy as np
import openvino as ov
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise.inputs import CHANNELS
from lambent.errors import OptionError
from lambent.learn.averaging import average
from lambent.learn.denoising import DenoisingTask
from lambent.learn.export import export, float_weights
from lambent.learn.networks.lambent import LambentNet
from lambent.learn.networks.rounded import NAMES, RoundedNet, rounded
from lambent.learn.recipe import TrainRecipe
from lambent.learn.train import train_task as train


def inputs(count=2, size=32, seed=0):
    return torch.rand(count, CHANNELS, size, size, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    model = RoundedNet("fast")
    model.fit(inputs())
    return model


def test_rounding_and_its_gradients_are_the_papers():
    x = torch.tensor([-0.4, 0.26, 0.74, 9.0], requires_grad=True)
    step = torch.tensor(0.5, requires_grad=True)
    y = rounded(x, step, 0, 8)
    assert y.tolist() == [0.0, 0.5, 0.5, 4.0]
    y.sum().backward()
    assert x.grad.tolist() == [0.0, 1.0, 1.0, 0.0]
    # Esser et al. 2020, eq. 3: round(x/s) - x/s inside, the bounds outside
    assert step.grad.item() == pytest.approx(0 + (1 - 0.52) + (1 - 1.48) + 8)


def test_training_and_evaluation_round_alike(network):
    x = inputs(seed=1)
    exact = LambentNet("fast")
    exact.load_state_dict({k: v for k, v in network.state_dict().items() if "steps" not in k})
    with torch.no_grad():
        learning = network.train()(x)
        running = network.eval()(x)
        floats = exact(x)
    for a, b, c in zip(learning, running, floats, strict=True):
        spread = float(c.std())
        assert float((a - b).abs().mean()) < 2e-3 * spread
        assert 1e-4 * spread < float((b - c).abs().mean()) < 0.1 * spread


def test_it_runs_in_int8_and_comes_back(network, tmp_path):
    from lambent.denoise.model_file import read_model

    path = tmp_path / "int8.lambent"
    export(network, path, {"name": "int8", "recipe": {"size": "fast"}}, None, half=True)
    file = read_model(path)
    assert file.card["int8"] is True
    parameters = sum(p.numel() for p in network.parameters())
    assert path.stat().st_size < 1.2 * parameters  # a byte a weight
    core = ov.Core()
    graph = core.read_model(file.network, file.weights)
    compiled = core.compile_model(graph, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    x = inputs(1, seed=2)
    with torch.no_grad():
        exact = [o.numpy() for o in network.eval()(x)]
    found = list(compiled(x.numpy()).values())
    for a, b in zip(found, exact, strict=True):
        assert np.abs(a - b).mean() < 0.03 * b.std()  # what float sums round another way
    kinds = [op.get_type_name() for op in graph.get_ops()]
    assert kinds.count("FakeQuantize") >= len(NAMES)
    again = float_weights(str(path), steps=True)
    assert set(again) == set(network.state_dict())
    for name in NAMES:
        assert again[f"steps.{name}"].item() == pytest.approx(
            network.steps[name].item(), abs=1e-3
        ), name
    for name, value in network.state_dict().items():
        if name.endswith("weight"):
            step = value.abs().amax(dim=(1, 2, 3), keepdim=True) / 127
            assert bool(((again[name] - value).abs() <= 0.51 * step + 1e-3 * step).all()), name
    average([str(path), str(path)], tmp_path / "mean.lambent")
    assert set(float_weights(str(tmp_path / "mean.lambent"), steps=True)) == set(again)


def test_an_int8_run_begins_with_a_float_one(tmp_path):
    recipe = TrainRecipe(
        name="int8", size="fast", steps=4, batch=2, warmup=1, check_every=4, checked=2,
        held_out=0.0, options={"int8": True},
    )  # fmt: skip
    task = DenoisingTask(recipe, made.stills(tmp_path))
    with pytest.raises(OptionError, match="rounding is learned last"):
        task.started(None)
    torch.manual_seed(1)
    begin = LambentNet("fast").state_dict()
    start = task.started(begin)
    assert set(start) == set(RoundedNet("fast").state_dict())
    run = train(recipe, task, tmp_path / "run", "cpu", start=start)
    ended = run.weights()
    assert any(not torch.equal(ended[f"steps.{n}"], start[f"steps.{n}"]) for n in NAMES)
    assert task.started(ended) is ended  # nothing is fitted anew where steps are there
    whole = TrainRecipe(name="x", size="fast", held_out=0.0, options={"int9": True})
    with pytest.raises(OptionError, match="int9"):
        DenoisingTask(whole, made.stills(tmp_path))
