"""Networks from anybody's files: checked before they are compiled.

A model file's checksums fit whatever its author wrote, so its graph may be any graph. What runs
here is only made of the operations that our own networks are exported with, keeps the size of what
it reads or makes it smaller, and has the outputs that the kernels behind it read; nothing else
could be told from an attempt to fill the memory, or to have a kernel read beyond it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lambent.denoise.model_file import ModelFile, shipped
from lambent.errors import DamagedFileError

#: The operations that `lambent.learn.export` writes.
_OPERATIONS = frozenset(
    [
        "Add",
        "AvgPool",
        "BatchNormInference",
        "Concat",
        "Constant",
        "Convert",
        "Convolution",
        "Divide",
        "Elu",
        "FakeQuantize",
        "GroupConvolution",
        "Interpolate",
        "LeakyRelu",
        "Maximum",
        "MaxPool",
        "Minimum",
        "Multiply",
        "Parameter",
        "PRelu",
        "Relu",
        "Result",
        "Sigmoid",
        "Slice",
        "Subtract",
        "Tanh",
    ]
)
#: The edge of the inputs for which sizes are looked at, and the most channels a tensor may have.
_EDGE, _MOST_CHANNELS = 64, 4096


def check_graph(model: ModelFile, graph: Any, outputs: Sequence[tuple[int, int]]) -> None:
    """Raise `DamagedFileError` for an OpenVINO graph that is none of ours.

    ``outputs``: what the denoiser reads: channels, and the part of the inputs' size. The models
    that come with Lambent are not looked at.
    """
    if model.path in shipped().values():
        return
    wrong = _operations(graph) or _shapes(graph, outputs)
    if wrong:
        raise DamagedFileError(
            f"holds a network that is not one of Lambent's: {wrong}",
            file=model.path,
            remedy="use models from people you trust, or train one: lambent train",
        )


def _operations(graph: Any) -> str:
    for node in graph.get_ordered_ops():
        name = node.get_type_name()
        if name not in _OPERATIONS:
            return f"it computes {name[:40]!r}"
    return ""


def _shapes(graph: Any, outputs: Sequence[tuple[int, int]]) -> str:
    small = graph.clone()
    sizes = {}
    for number, port in enumerate(small.inputs):
        shape = port.get_partial_shape()
        if shape.rank.is_dynamic or shape.rank.get_length() != 4 or shape[1].is_dynamic:
            return f"its input {number} is not an image with channels"
        sizes[port] = [1, shape[1].get_length(), _EDGE, _EDGE]
    try:
        small.reshape(sizes)
    except RuntimeError as error:
        return str(error).strip().splitlines()[-1]
    for node in small.get_ordered_ops():
        if node.get_type_name() == "Constant":
            continue
        for port in node.outputs():
            shape = port.get_partial_shape()
            if shape.is_dynamic:
                return "the sizes of its tensors do not follow from its inputs'"
            size = list(shape.get_shape())
            large = size[1:2] > [_MOST_CHANNELS] or any(n > _EDGE for n in size[2:])
            if large and not _is_constant(node):
                return f"it makes a tensor {size} from {_EDGE}x{_EDGE} pixels"
    ends = [list(port.get_partial_shape().get_shape()) for port in small.outputs]
    wanted = [[1, count, _EDGE // part, _EDGE // part] for count, part in outputs]
    return "" if ends == wanted else f"its outputs are {ends}, not {wanted}"


def _is_constant(node: Any) -> bool:
    """Whether a node only converts or scales weights."""
    inputs = [port.get_source_output().get_node() for port in node.inputs()]
    return bool(inputs) and all(
        one.get_type_name() == "Constant" or _is_constant(one) for one in inputs
    )
