"""A trained network as a model file, in half floats or int8.

A network that was trained in int8 (`networks.rounded`) is written with the steps that it learned.
For any other, int8 is what NNCF measures on training crops (post-training quantisation: symmetric
weights a channel, activations a tensor). `float_weights` reads both back, so that fine-tuning can
begin with a shipped model.
"""

from __future__ import annotations

import contextlib
import io
import logging
import math
import tempfile
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from lambent.denoise.inputs import CHANNELS
from lambent.denoise.model_file import find_model, read_model, write_model
from lambent.denoise.openvino import openvino, silent
from lambent.errors import LambentError
from lambent.frame.layer import FloatImage
from lambent.learn.account import account, before
from lambent.learn.networks.rounded import HIGHEST, RoundedNet, step_after
from lambent.learn.task import Exportable, ShippedTask
from lambent.training.run import Run


def export(
    model: nn.Module,
    path: Path,
    card: Mapping[str, Any],
    examples: Iterable[Any] | None,
    overwrite: bool = False,
    half: bool = False,
    inputs: Sequence[torch.Tensor] = (torch.zeros(1, CHANNELS, 64, 64),),
) -> None:
    """Write ``model`` as a model file; ``half``: its weights in half floats.

    ``examples``: inputs without batch, ``(CHANNELS, H/2, W/2)`` for our own (tuples for a network
    that takes several), to find the ranges of activations from; None leaves the network in float.
    ``inputs``: a tensor like each input. Raises `OutputError`.
    """
    # NNCF and the converter talk to standard output, which holds results alone
    with silent(), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        network, weights = _converted(model, examples, half, inputs)
    int8 = examples is not None or isinstance(model, RoundedNet)
    write_model(path, {**card, "int8": int8}, network, weights, overwrite)


def _converted(
    model: nn.Module,
    examples: Iterable[Any] | None,
    half: bool,
    inputs: Sequence[torch.Tensor],
) -> tuple[bytes, bytes]:
    """The network and its weights as OpenVINO writes them."""
    ov = openvino()
    model = model.eval().to("cpu")
    graph = ov.convert_model(model, example_input=tuple(inputs))
    free = {i: [1, like.shape[1], -1, -1] for i, like in enumerate(inputs)}
    graph.reshape(free)
    if examples is not None:
        import nncf

        logging.getLogger("nncf").setLevel(logging.ERROR)
        data = [
            tuple(part[None] for part in example) if isinstance(example, tuple) else example[None]
            for example in examples
        ]
        graph = nncf.quantize(
            graph,
            nncf.Dataset(data),
            subset_size=len(data),
            preset=nncf.QuantizationPreset.PERFORMANCE,
        )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "network.xml"
        ov.save_model(graph, place, compress_to_fp16=half)
        return place.read_bytes(), place.with_suffix(".bin").read_bytes()


def export_run(
    run: Run, task: ShippedTask, path: Path, overwrite: bool = False, int8: bool = False
) -> dict[str, Any]:
    """The best weights of a run as a model file, in half floats or int8; its card.

    int8 by measuring alone costs up to half of the error again (docs/notes/training.md): the
    network has to be trained on in int8 before that is worth its speed.
    """
    model = task.network()
    model.load_state_dict(run.weights())
    ready = task.exportable(model.eval())
    told = account(run)
    card = {
        **told,
        "score_says": task.says(told["score"]),
        "reads": ready.reads,
        **cost_of(ready),
        **ready.about,
        "data": task.about_data(),
    }
    if failures := told["recipe"].pop("known_failures", None):
        card["known_failures"] = failures
    if earlier := before(run):
        card["begun_with"] = earlier
    examples = task.calibration() if int8 else None
    export(ready.network, path, card, examples, overwrite, not int8, ready.examples)
    return card


def cost_of(ready: Exportable) -> dict[str, int]:
    """``parameters`` of a network, and its multiply-adds a pixel of the picture (``macs``).

    Of convolutions; what an attention or a predicted window multiplies is not counted.
    """
    macs = 0

    def count(module: nn.Module, _: Any, output: Any) -> None:
        nonlocal macs
        assert isinstance(module, nn.Conv2d)
        macs += output.numel() // module.out_channels * module.weight.numel()

    hooks = [
        module.register_forward_hook(count)
        for module in ready.network.modules()
        if isinstance(module, nn.Conv2d)
    ]
    with torch.no_grad():
        ready.network(*ready.examples)
    for hook in hooks:
        hook.remove()
    height, width = ready.examples[0].shape[2:]
    # packed signals have a quarter of the picture's pixels
    pixels = height * width * (4 if ready.reads == "signals" else 1)
    weights = sum(p.numel() for p in ready.network.parameters())
    return {"parameters": weights, "macs": round(macs / pixels)}


def float_weights(model: str, steps: bool = False) -> dict[str, torch.Tensor]:
    """The weights of a model file as float tensors, by the names of `networks.lambent`.

    Of an int8 model, each is its number times its channel's scale: what the network computes with.
    With ``steps``, those of its activations too, as `networks.rounded` names them. Raises
    `FileError`.
    """
    ov = openvino()
    file = read_model(find_model(model))
    graph = ov.Core().read_model(file.network, file.weights)
    found: dict[str, torch.Tensor] = {}
    for op in graph.get_ordered_ops():
        if steps and op.get_type_name() == "FakeQuantize":
            name = step_after(_source(op))
            top = float(np.asarray(op.input_value(2).get_node().data).reshape(-1)[0])
            levels = HIGHEST[name == "input"]
            found[f"steps.{name}"] = torch.tensor(math.log(top / levels))
        if op.get_type_name() != "Convolution":
            continue
        name = op.get_friendly_name().removeprefix("__module.").split("/")[0]
        weight = torch.from_numpy(_value(op.input_value(1).get_node()).copy())
        found[f"{name}.weight"] = weight
        found[f"{name}.bias"] = torch.zeros(len(weight))  # OpenVINO leaves out what adds nothing
        for target in op.output(0).get_target_inputs():
            after = target.get_node()
            if after.get_type_name() == "Add":
                bias = next(
                    v.get_node() for v in after.input_values() if v.get_node() is not op
                    and v.get_node().get_friendly_name() != op.get_friendly_name()
                )  # fmt: skip
                with contextlib.suppress(LambentError):  # a sum of features, no bias
                    found[f"{name}.bias"] = torch.from_numpy(_value(bias).reshape(-1).copy())
    return found


# ------------------------------------------------------------------- private


def _source(op: Any) -> str | None:
    """The convolution that an operation's values come from; None: the input."""
    while op.get_type_name() not in ("Convolution", "Parameter"):
        op = op.input_value(0).get_node()
    if op.get_type_name() == "Parameter":
        return None
    return str(op.get_friendly_name().removeprefix("__module.").split("/")[0])


def _value(node: Any) -> FloatImage:
    """A constant and the arithmetic around it, computed."""
    kind = node.get_type_name()
    values = [v.get_node() for v in node.input_values()]
    if kind == "Constant":
        return np.asarray(node.data, np.float32)
    if kind == "Convert":
        return _value(values[0])
    if kind == "Multiply":
        return np.asarray(_value(values[0]) * _value(values[1]))
    if kind == "Subtract":
        return np.asarray(_value(values[0]) - _value(values[1]))
    if kind == "Reshape":
        return _value(values[0])
    raise LambentError(f"a weight is made by {kind}, which is not known here")
