"""A trained network as a model file: quantised to int8 and checked against PyTorch.

`quantised` inserts what NNCF measures on held-out crops (post-training quantisation: symmetric
weights a channel, activations a tensor); `export` writes the file. What int8 costs is measured on
the same crops and put into the card.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from lambent.denoise.inputs import CHANNELS
from lambent.denoise.model_file import write_model
from lambent.frame.layer import FloatImage


def export(
    model: nn.Module,
    path: Path,
    card: Mapping[str, Any],
    examples: Iterable[FloatImage] | None,
    overwrite: bool = False,
) -> None:
    """Write ``model`` as a model file.

    ``examples``: packed inputs ``(CHANNELS, H/2, W/2)`` to find the ranges of activations from;
    None leaves the network in float. Raises `OutputError`.
    """
    import openvino as ov

    model = model.eval().to("cpu")
    graph = ov.convert_model(model, example_input=torch.zeros(1, CHANNELS, 64, 64))
    graph.reshape([1, CHANNELS, -1, -1])
    if examples is not None:
        import nncf

        logging.getLogger("nncf").setLevel(logging.ERROR)
        data = [example[None] for example in examples]
        graph = nncf.quantize(
            graph,
            nncf.Dataset(data),
            subset_size=len(data),
            preset=nncf.QuantizationPreset.PERFORMANCE,
        )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "network.xml"
        ov.save_model(graph, place, compress_to_fp16=False)
        network, weights = place.read_bytes(), place.with_suffix(".bin").read_bytes()
    write_model(path, {**card, "int8": examples is not None}, network, weights, overwrite)


def agreement(a: Iterable[np.ndarray], b: Iterable[np.ndarray]) -> float:
    """The largest difference of two sets of outputs, relative to the largest value of each."""
    return max(
        float(np.abs(x - y).max() / max(float(np.abs(y).max()), 1e-12))
        for x, y in zip(a, b, strict=True)
    )
