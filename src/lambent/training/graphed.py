"""A training step on CUDA as one launch.

A step of a small network is a thousand short kernels, and a processor launches them more slowly
than a large GPU is done with them. So what is the same in every step (network, filter, loss and
their gradients) is recorded once for each shape of a batch, as a CUDA graph, and played from then
on: a batch is copied to where the recording reads it, and loss and gradients are found where it
writes them. Batch, optimiser and running mean stay outside.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

#: Steps before a recording: kernels are compiled and chosen in them.
WARM_UP = 3

Loss = Callable[[nn.Module, Sequence[Tensor]], tuple[Tensor, Mapping[str, Tensor]]]


@dataclass
class _Recording:
    graph: Any
    inputs: list[Tensor]
    loss: Tensor
    terms: dict[str, Tensor]
    grads: tuple[Tensor | None, ...]


class Graphed:
    """``loss(model, tensors)`` and its gradients by recordings, one for each set of shapes.

    ``loss`` must not look at values of its tensors on the processor; and of the model nothing that
    was computed before, with its gradients, may be kept while one is made (CUDA refuses it).
    """

    def __init__(self, model: nn.Module, loss: Loss) -> None:
        self._model, self._loss = model, loss
        self._free = [p for p in model.parameters() if p.requires_grad]
        self._known: dict[tuple[torch.Size, ...], _Recording] = {}

    def __call__(self, tensors: Sequence[Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss and its terms; every free parameter's ``grad`` is set, not added to.

        What is returned is overwritten by the next call.
        """
        key = tuple(t.shape for t in tensors)
        if key not in self._known:
            self._known[key] = self._recorded(tensors)
        found = self._known[key]
        for place, tensor in zip(found.inputs, tensors, strict=True):
            place.copy_(tensor)
        found.graph.replay()
        for parameter, grad in zip(self._free, found.grads, strict=True):
            parameter.grad = grad
        return found.loss, found.terms

    def _recorded(self, tensors: Sequence[Tensor]) -> _Recording:
        inputs = [t.clone(memory_format=torch.preserve_format) for t in tensors]
        # on a stream of its own, as torch.cuda.graph asks for
        aside = torch.cuda.Stream()
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(WARM_UP):
                self._step(inputs)
        torch.cuda.current_stream().wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            loss, terms, grads = self._step(inputs)
        return _Recording(graph, inputs, loss, terms, grads)

    def _step(
        self, inputs: Sequence[Tensor]
    ) -> tuple[Tensor, dict[str, Tensor], tuple[Tensor | None, ...]]:
        loss, terms = self._loss(self._model, inputs)
        grads = torch.autograd.grad(loss, self._free, allow_unused=True)
        return loss.detach(), {name: t.detach() for name, t in terms.items()}, grads
