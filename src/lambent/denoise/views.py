"""Two looks at a frame: as it is, and turned by half; the mean of what both say.

A network that is trained on turned pictures is nearly, not quite, the same for both; the mean of
its logits has some of the errors of neither ("self-ensemble", Timofte et al. 2016, which averages
pictures). Nothing is turned here but the network: a convolution of a turned picture, turned back,
is the convolution with its kernel turned. So both halves read one input and write one grid:

- 3x3 kernels are turned; where they go two pixels at a time, they begin on the other pixel;
- the first layer finds the pixels of a 2x2 cell in the opposite order (`inputs.pack`), and the
  heads write taps and pixels in the opposite order (`kernels.pyramid`);
- the heads' weights are halved, so that their sum is the mean.

Borders and tiles come out as in one look: a padded frame's grid of 32 pixels is its own mirror
image. Turned weights are made from the model file when it is loaded.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lambent.denoise.inputs import CHANNELS, PLANES
from lambent.kernels.pyramid import COARSE, OWN

#: Outputs of the heads: sub-pixels of the finest level, and logits in order.
_FINE = 4


def two_views(graph: Any, again: Any) -> Any:
    """One graph out of two of the same model file, the second turned by half."""
    import openvino as ov
    from openvino import opset13 as op

    for model, turned in ((graph, False), (again, True)):
        for node in model.get_ordered_ops():
            if node.get_type_name() == "Convolution":
                _prepare(op, node, turned)
    (first,), (second,) = graph.get_parameters(), again.get_parameters()
    for target in second.output(0).get_target_inputs():
        target.replace_source_output(first.output(0))
    ends = [
        op.add(a.input_value(0), b.input_value(0))
        for a, b in zip(graph.get_results(), again.get_results(), strict=True)
    ]
    return ov.Model(ends, [first], "two views")


def _prepare(op: Any, conv: Any, turned: bool) -> None:
    """Turn a convolution's weights, and halve those of a head."""
    shape = [int(n) for n in conv.input_value(1).get_shape()]
    head = shape[2] == 1
    order: np.ndarray | None = None
    if turned and head:
        order = turned_outputs(shape[0])
    weights = conv.input_value(1).get_node()
    scaled = weights.get_type_name() == "Multiply"  # int8: numbers, and a scale for each output

    def change(node: Any, place: int, scale: float, flip: bool = False, stem: bool = False) -> None:
        """Another constant in place of the one at an input of a node."""
        source = node.input_value(place).get_node()
        convert = source if source.get_type_name() == "Convert" else None
        if convert is not None:
            source = convert.input_value(0).get_node()
        data = np.array(source.data)
        if order is not None and data.ndim == 4:
            axis = 0 if data.shape[0] == shape[0] else 1
            data = np.take(data, order, axis=axis)
        if stem:
            data = data[:, turned_inputs()]
        if flip:
            data = data[:, :, ::-1, ::-1]
        if scale != 1:
            data = (data.astype(np.float32) * np.float32(scale)).astype(data.dtype)
        new = op.constant(np.ascontiguousarray(data), source.get_element_type())
        target = node if convert is None else convert
        target.input(0 if convert is not None else place).replace_source_output(new.output(0))

    half = 0.5 if head else 1.0
    if scaled:
        change(weights, 0, 1.0, turned, turned and shape[1] == CHANNELS)
        change(weights, 1, half)
    else:
        change(conv, 1, half, turned, turned and shape[1] == CHANNELS)
    if head:
        for target in conv.output(0).get_target_inputs():
            after = target.get_node()
            if after.get_type_name() == "Add":
                change(after, 1 - target.get_index(), half)
    if turned and list(conv.get_attributes()["strides"]) == [2, 2]:
        new = op.convolution(
            conv.input_value(0), conv.input_value(1), [2, 2], [0, 0], [1, 1], [1, 1]
        )
        for target in conv.output(0).get_target_inputs():
            target.replace_source_output(new.output(0))


def turned_inputs() -> np.ndarray:
    """Where the stem finds each channel: the pixels of a cell in the opposite order."""
    planes = np.arange(4 * PLANES).reshape(PLANES, 4)[:, ::-1].reshape(-1)
    return np.concatenate([planes, np.arange(4 * PLANES, CHANNELS)])


def turned_outputs(count: int) -> np.ndarray:
    """Where each output of a head comes from: taps, pixels of a cell, in the opposite order."""
    fine = count > 2 * (OWN + COARSE)
    logits = count // _FINE if fine else count
    taps = np.arange(logits)
    taps[:OWN] = taps[:OWN][::-1]
    if logits > OWN:
        taps[OWN : OWN + COARSE] = taps[OWN : OWN + COARSE][::-1]
    if not fine:
        return taps
    return (_FINE * taps[:, None] + np.arange(_FINE)[::-1]).reshape(-1)
