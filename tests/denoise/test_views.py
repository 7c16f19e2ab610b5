"""Two looks in one graph: each the network of a picture turned by half."""

import numpy as np
import openvino as ov
import pytest

from lambent.denoise.inputs import CHANNELS, PLANES
from lambent.denoise.model_file import loaded_model
from lambent.denoise.views import turned_inputs, turned_outputs, two_views


def run(graph, packed):
    compiled = ov.Core().compile_model(graph, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    return list(compiled(packed).values())


@pytest.mark.parametrize("name", ["lambent", "lambent-fast"])
def test_it_is_the_mean_of_both(name):
    file = loaded_model(name, "signals")

    def graph():
        return ov.Core().read_model(file.network, file.weights)

    rng = np.random.default_rng(0)
    packed = rng.random((1, CHANNELS, 48, 64), np.float32)
    packed[:, 4 * PLANES :] = rng.random((1, CHANNELS - 4 * PLANES, 1, 1))  # constants
    one = run(graph(), packed)
    turned = np.ascontiguousarray(packed[:, turned_inputs(), ::-1, ::-1])
    other = [level[:, turned_outputs(level.shape[1]), ::-1, ::-1] for level in run(graph(), turned)]
    both = run(two_views(graph(), graph()), packed)
    for a, b, c in zip(one, other, both, strict=True):
        mean, difference = (a + b) / 2, np.abs(a - b).mean()
        assert difference > 0  # there are two looks
        assert np.abs(c - mean).mean() < 0.1 * difference


def test_turning_twice_is_nothing():
    order = turned_inputs()
    np.testing.assert_array_equal(order[order], np.arange(CHANNELS))
    for count in (144, 35, 25, 36):
        order = turned_outputs(count)
        np.testing.assert_array_equal(order[order], np.arange(count))
