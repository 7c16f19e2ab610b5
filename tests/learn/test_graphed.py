"""A recorded step: the loss and the gradients of one that is not."""

import made
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.learn import batches
from lambent.learn.denoising import DenoisingTask
from lambent.learn.recipe import TrainRecipe
from lambent.training.graphed import Graphed
from lambent.training.task import RecordableTask


@pytest.fixture
def task(tmp_path, monkeypatch):
    monkeypatch.setattr(batches, "LEAST", 16)  # the small crops here are shrunk, too

    def task_of(device, int8=False):
        options = {"int8": int8}
        recipe = TrainRecipe(name="x", size="fast", batch=4, held_out=0.0, options=options)
        found = DenoisingTask(recipe, made.stills(tmp_path))
        found.device = device
        return found

    return task_of


def eager(task, model, tensors):
    """Loss, gradients, names of the terms. Nothing of the graph may live on, on another stream."""
    loss, terms = task.loss_of(model, tensors)
    return loss.detach(), torch.autograd.grad(loss, list(model.parameters())), set(terms)


def test_what_is_recorded_is_the_loss_of_the_loop(task):
    made_here = task("cpu")
    assert isinstance(made_here, RecordableTask)
    model = made_here.network()
    loss, terms = made_here.loss(model, (0, 0, 2))
    loss.backward()
    tensors = made_here.tensors((0, 0, 2))
    found, parts, grads = Graphed(model, made_here.loss_of)._step(tensors)
    assert torch.equal(found, loss.detach())
    assert parts.keys() == terms.keys()
    for parameter, grad in zip(model.parameters(), grads, strict=True):
        torch.testing.assert_close(parameter.grad, grad)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("int8", [False, True])
def test_a_recorded_step_is_the_step(task, int8):
    made_here, device = task("cuda", int8), torch.device("cuda")
    model = made_here.network().to(device, memory_format=torch.channels_last)
    if int8:
        model.fit(made_here.tensors((0, 0, 4))[0])
    graphed = Graphed(model, made_here.loss_of)
    shapes = set()
    for step in range(0, 48, 4):
        tensors = made_here.tensors((step, 0, 4))
        shapes.add(tensors[1].shape)
        loss, wanted, names = eager(made_here, model, tensors)
        found, terms = graphed(tensors)
        torch.testing.assert_close(found, loss, rtol=2e-3, atol=1e-4)
        assert set(terms) == names
        pairs = list(zip(model.parameters(), wanted, strict=True))
        apart = sum((p.grad - g).square().sum() for p, g in pairs)
        assert float(apart / sum(g.square().sum() for g in wanted)) < 1e-3
    assert len(shapes) == 2
