"""Two looks at a frame: as it is, and turned by half; the mean of what both say.

A network that is trained on turned pictures is nearly, not quite, the same for both; the mean of
its logits has some of the errors of neither ("self-ensemble", Timofte et al. 2016, which averages
pictures). Nothing is turned here but the network: a convolution of a turned picture, turned back,
is the convolution with its kernel turned. So both halves read one input and write one grid:

- 3x3 kernels are turned; where they go two pixels at a time, they begin on the other pixel;
- the first layer finds the pixels of a 2x2 cell in the opposite order (`inputs.pack`), and the
  heads write taps and pixels in the opposite order (`kernels.pyramid`);
- a head and its turned one are one convolution that reads the features of both looks, with half of
  each one's weights. Two heads and their sum would be three of the largest tensors there are. An
  output's weights share a step in int8; that of the finer of both becomes the coarser one's.

Borders and tiles come out as in one look: a padded frame's grid of 32 pixels is its own mirror
image. Turned weights are made from the model file when it is loaded.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lambent.denoise.inputs import CHANNELS, PLANES
from lambent.denoise.openvino import openvino
from lambent.kernels.pyramid import COARSE, OWN

#: Outputs of the heads: sub-pixels of the finest level, and logits in order.
_FINE = 4


def two_views(graph: Any, again: Any) -> Any:
    """One graph out of two of the same model file, the second turned by half."""
    ov = openvino()
    op = ov.opset13
    for node in again.get_ordered_ops():
        if node.get_type_name() == "Convolution" and not _is_head(node):
            _turn(op, node)
    (first,), (second,) = graph.get_parameters(), again.get_parameters()
    for target in second.output(0).get_target_inputs():
        target.replace_source_output(first.output(0))
    ends = [
        _joined(op, a.input_value(0).get_node(), b.input_value(0).get_node())
        for a, b in zip(graph.get_results(), again.get_results(), strict=True)
    ]
    return ov.Model(ends, [first], "two views")


def _is_head(conv: Any) -> bool:
    return int(conv.input_value(1).get_shape()[2]) == 1


def _turn(op: Any, conv: Any) -> None:
    """A convolution of a picture turned by half, turned back."""
    weights = conv.input_value(1).get_node()
    if weights.get_type_name() == "Multiply":  # int8: numbers, and a scale for each output
        user, place = weights, 0
    else:
        user, place = conv, 1
    source = user.input_value(place).get_node()
    if source.get_type_name() == "Convert":
        user, place, source = source, 0, source.input_value(0).get_node()
    data = np.array(source.data)[:, :, ::-1, ::-1]
    if data.shape[1] == CHANNELS:
        data = data[:, turned_inputs()]
    new = op.constant(np.ascontiguousarray(data), source.get_element_type())
    user.input(place).replace_source_output(new.output(0))
    if list(conv.get_attributes()["strides"]) == [2, 2]:
        new = op.convolution(
            conv.input_value(0), conv.input_value(1), [2, 2], [0, 0], [1, 1], [1, 1]
        )
        for target in conv.output(0).get_target_inputs():
            target.replace_source_output(new.output(0))


def _joined(op: Any, end: Any, turned_end: Any) -> Any:
    """A head of both looks: the mean of what each says."""
    features, weights, biases, short = [], [], [], False
    for node, turned in ((end, False), (turned_end, True)):
        conv = node.input_value(0).get_node()
        weight, short = _weights(conv.input_value(1).get_node())
        bias = _weights(node.input_value(1).get_node())[0]
        if turned:
            order = turned_outputs(len(weight))
            weight, bias = weight[order], bias[:, order]
        features.append(conv.input_value(0))
        weights.append(weight / 2)
        biases.append(bias / 2)
    weight = np.concatenate(weights, axis=1)
    if short:
        step = np.maximum(np.abs(weight).max(axis=(1, 2, 3), keepdims=True), 1e-12) / 127
        numbers = op.constant(np.rint(weight / step).astype(np.int8))
        kernel = op.multiply(op.convert(numbers, "f32"), op.constant(step.astype(np.float32)))
    else:
        kernel = op.constant(weight)
    both = op.concat(features, 1)
    sums = op.convolution(both, kernel, [1, 1], [0, 0], [0, 0], [1, 1])
    return op.add(sums, op.constant(biases[0] + biases[1]))


def _weights(node: Any) -> tuple[Any, bool]:
    """A constant's values as float32, and whether they are kept as whole numbers with a scale."""
    kind = node.get_type_name()
    if kind == "Multiply":
        whole, scale = (_weights(node.input_value(n).get_node())[0] for n in (0, 1))
        return whole * scale, True
    if kind == "Convert":
        return _weights(node.input_value(0).get_node())
    return np.array(node.data).astype(np.float32), False


def turned_inputs() -> np.ndarray:
    """Where the stem finds each channel: the pixels of a cell in the opposite order."""
    planes = np.arange(4 * PLANES).reshape(PLANES, 4)[:, ::-1].reshape(-1)
    return np.concatenate([planes, np.arange(4 * PLANES, CHANNELS)])


def turned_outputs(count: int) -> np.ndarray:
    """Where each output of a head comes from: taps, pixels of a cell, in the opposite order."""
    fine = count % _FINE == 0
    logits = count // _FINE if fine else count
    taps = np.arange(logits)
    own = min(logits, OWN)  # the albedo has 9
    taps[:own] = taps[:own][::-1]
    if logits > OWN:
        taps[OWN : OWN + COARSE] = taps[OWN : OWN + COARSE][::-1]
    if not fine:
        return taps
    return (_FINE * taps[:, None] + np.arange(_FINE)[::-1]).reshape(-1)
