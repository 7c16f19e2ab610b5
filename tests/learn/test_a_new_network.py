"""CONTRIBUTING's "how to add a network", with a toy: its class, its entries, its denoiser.

The toy is one convolution that predicts a kernel for each pixel. Nothing else of the package has to
change for it to be trained, exported, listed and used.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import ClassVar

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401
from torch import nn

import lambent
from lambent.cli import main
from lambent.denoise.lobes import PLANES, whole_of
from lambent.denoise.papers import NetworkDenoiser
from lambent.errors import OptionError
from lambent.filters.denoiser import DENOISERS, About
from lambent.frame.role import Role
from lambent.kernels.predicted import predicted_window
from lambent.learn.export import export_run
from lambent.learn.networks import kernels
from lambent.learn.recipe import train_recipe_from
from lambent.learn.rendered import RenderedNetwork, RenderedTask, rendered_task
from lambent.learn.rows import Example
from lambent.learn.task import Learnable
from lambent.learn.tasks import TASKS
from lambent.learn.train import train_task

# ------------------------------------------------ src/lambent/learn/networks/toy.py


@dataclass(frozen=True)
class ToyOptions:
    """``kernel``: side of the predicted windows. ``patch``: side of the crops."""

    kernel: int = 3
    patch: int = 32


class Toy(RenderedNetwork):
    """Planes ``(B, PLANES, H, W)`` to logits ``(B, kernel², H, W)``."""

    def __init__(self, options: ToyOptions | None = None) -> None:
        super().__init__()
        self.options = options or ToyOptions()
        self.layer = nn.Conv2d(PLANES, self.options.kernel**2, 3, 1, 1)

    def forward(self, planes):
        return self.layer(planes)

    def inputs(self, b):
        return (b.whole_planes,)

    def cleaned(self, outputs, b):
        return kernels.apply(outputs, b.noisy)

    def loss(self, outputs, b):
        return {"l1": (self.cleaned(outputs, b) - b.target).abs().mean()}

    def reach(self):
        return 1 + 1 + self.options.kernel // 2  # differences of neighbours, the layer, the window


LEARN_TOY = Learnable(ToyOptions, (("kernel", 1, 41), ("patch", 16, 1024)), Toy, rendered_task)

# ------------------------------------------------ src/lambent/denoise/toy.py


@dataclass(frozen=True)
class ToyDenoiser(NetworkDenoiser):
    """All layers with the same kernels."""

    about: ClassVar[About] = About(
        name="toy",
        title="A toy",
        paper="(none)",
        uses=("albedo", "normal", "depth"),
        cost="one convolution and a window",
        when="never for a result",
    )

    def filter_layers(self, frame, layers):
        planes = whole_of(np, self.signals(frame)[0]).diffuse_planes
        (logits,) = self.outputs(planes)
        return [predicted_window(layer.data, logits) for layer in layers]


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The toy's line in each registry, for one test."""
    for registry, thing in ((TASKS, LEARN_TOY), (DENOISERS, ToyDenoiser)):
        monkeypatch.setitem(registry._own, "toy", "")
        monkeypatch.setitem(registry._loaded, "toy", thing)


# ------------------------------------------------ recipes/train/toy.toml

RECIPE = {
    "name": "toy", "task": "toy", "steps": 30, "batch": 2, "warmup": 2, "check_every": 15,
    "checked": 4, "held_out": 0.25, "rate": 0.03, "decay": 0.8, "options": {"kernel": 5},
}  # fmt: skip


def test_it_is_trained_exported_and_denoises(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = train_recipe_from(RECIPE)
    task = RenderedTask(recipe, made.stills(tmp_path))
    run = train_task(recipe, task, tmp_path / "run", "cpu")
    checks = [line["check"]["relmse/noisy"] for line in run.lines() if "check" in line]
    assert checks[-1] < checks[0] < 1, "training makes it better"
    card = export_run(run, task, tmp_path / "toy.lambent")
    assert card["options"] == {"kernel": 5, "patch": 32}

    frame = made.frame(np.random.default_rng(5), 4, lobes=True)
    clean = lambent.denoise(frame, "toy.lambent")
    truth = made.frame(np.random.default_rng(5), 4, clean=True, lobes=True).colour
    assert np.abs(clean.colour - truth).mean() < 0.8 * np.abs(frame.colour - truth).mean()
    # what the model file computes is what PyTorch computes with the run's weights in half floats
    model = task.network().eval()
    model.load_state_dict({k: v.half().float() for k, v in run.weights().items()})
    signals, factor = ToyDenoiser(weights="toy.lambent").fitted(frame).signals(frame)
    zeros = np.zeros((6, 64, 64), np.float32)
    by_torch = task.clean(model, Example(signals, zeros, zeros[:1])) / factor
    np.testing.assert_allclose(clean.colour, by_torch.transpose(1, 2, 0), rtol=1e-4, atol=1e-4)
    # linear: the lighting layers still sum
    total = clean[Role.DIFFUSE] + clean[Role.SPECULAR]
    np.testing.assert_allclose(total, clean.colour, rtol=1e-4, atol=1e-4)

    assert main(["models", "toy.lambent", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["title"] == "A toy"
    assert shown["training"]["recipe"]["task"] == "toy"


def test_its_reach_is_what_a_result_depends_on():
    model = Toy(ToyOptions(kernel=5))
    planes = torch.rand(1, PLANES, 21, 21)
    image = torch.rand(1, 3, 21, 21, requires_grad=True)
    kernels.apply(model(planes), image)[..., 10, 10].sum().backward()
    rows = image.grad.abs().sum(dim=(0, 1, 3)).nonzero()[:, 0]
    assert (int(rows.min()), int(rows.max())) == (8, 12)
    assert model.reach() == 4


def test_its_options_are_checked():
    with pytest.raises(OptionError, match="kernel = 99 is out of range"):
        LEARN_TOY.options_from({"kernel": 99})
