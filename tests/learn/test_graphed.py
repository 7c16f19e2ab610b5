"""A recorded step: the loss and the gradients of one that is not."""

import made
import pytest
import torch

from lambent.learn import resident
from lambent.learn.denoising import DenoisingTask
from lambent.learn.graphed import Graphed
from lambent.learn.recipe import TrainRecipe

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")


@pytest.mark.parametrize("int8", [False, True])
def test_a_recorded_step_is_the_step(tmp_path, monkeypatch, int8):
    monkeypatch.setattr(resident, "LEAST", 16)  # the small crops here are shrunk, too
    device = torch.device("cuda")
    recipe = TrainRecipe(name="x", size="fast", batch=4, held_out=0.0, options={"int8": int8})
    task = DenoisingTask(recipe, made.stills(tmp_path))
    task.device = "cuda"
    model = task.network().to(device, memory_format=torch.channels_last)
    if int8:
        model.fit(task.tensors((0, 0, 4), device)[0])
    graphed = Graphed(model, task.loss_of)
    shapes = set()
    for step in range(0, 48, 4):
        tensors = task.tensors((step, 0, 4), device)
        shapes.add(tensors[1].shape)
        loss, _ = task.loss_of(model, tensors)
        wanted = torch.autograd.grad(loss, list(model.parameters()))
        found, terms = graphed(tensors)
        torch.testing.assert_close(found, loss.detach(), rtol=2e-3, atol=1e-4)
        assert set(terms) == {"log", "square", "gradient", "wide"}
        apart = sum(
            (p.grad - g).square().sum() for p, g in zip(model.parameters(), wanted, strict=True)
        )
        whole = sum(g.square().sum() for g in wanted)
        assert float(apart / whole) < 1e-3
    assert len(shapes) == 2
