"""Models from anybody: a graph that is none of ours never runs."""

import numpy as np
import openvino as ov
import pytest

import lambent
from lambent.denoise.model_file import find_model, read_model, write_model
from lambent.errors import DamagedFileError, FileError

NOISY = np.random.default_rng(0).random((32, 32, 3), np.float32)


def packed(graph, tmp_path):
    ov.save_model(graph, str(tmp_path / "network.xml"), compress_to_fp16=False)
    return (tmp_path / "network.xml").read_bytes(), (tmp_path / "network.bin").read_bytes()


def made(tmp_path, card, graph):
    path = tmp_path / "foreign.lambent"
    write_model(path, card, *packed(graph, tmp_path))
    return path


def photo(operation):
    """A graph from a photograph to what ``operation`` makes of it."""
    from openvino import opset13 as op

    planes = op.parameter(ov.PartialShape([1, 3, -1, -1]), np.float32)
    return ov.Model([operation(op, planes)], [planes], "x")


CARD = {"reads": "pixels", "channels": 3, "margin": 4}


def test_ours_pass_when_they_are_copied_elsewhere(tmp_path):
    for name, options in (
        ("lambent-fast", {}),
        ("kpcn", {}),
        ("dpcn", {}),
        ("modular", {}),
        ("dncnn", {}),
    ):
        path = tmp_path / f"{name}.lambent"
        path.write_bytes(find_model(name).read_bytes())
        copy = lambent.denoise(NOISY, model=name, weights=str(path), **options)
        np.testing.assert_array_equal(
            copy.colour, lambent.denoise(NOISY, model=name, **options).colour
        )


def test_a_graph_of_another_purpose_may_run(tmp_path):
    graph = photo(lambda op, x: op.multiply(x, np.float32(0.5)))
    out = lambent.denoise(NOISY, model="dncnn", weights=str(made(tmp_path, CARD, graph)))
    assert out.colour.shape == NOISY.shape


@pytest.mark.parametrize(
    ("operation", "words"),
    [
        (lambda op, x: op.tile(x, np.array([1, 1, 4096, 4096])), "computes 'Tile'"),
        (lambda op, x: op.read_value(x, "v"), "computes"),
        (
            lambda op, x: op.interpolate(
                x, np.array([999.0, 999.0], np.float32), "nearest", "scales", axes=np.array([2, 3])
            ),
            "makes a tensor",
        ),
        (lambda op, x: op.concat([x] * 9, 1), "outputs"),
        (lambda op, x: op.add(x, np.zeros((1, 3, 5000, 1), np.float32)), "network"),
        (lambda op, x: op.concat([x] * 3000, 1), "makes a tensor"),
    ],
    ids=["tile", "state", "interpolate", "channels", "broadcast", "wide"],
)
def test_graphs_that_are_none_of_ours(tmp_path, operation, words):
    path = made(tmp_path, CARD, photo(operation))
    with pytest.raises(DamagedFileError, match=words):
        lambent.denoise(NOISY, model="dncnn", weights=str(path))


def test_a_pyramid_with_other_outputs_never_reaches_the_kernels(tmp_path):
    from openvino import opset13 as op

    planes = op.parameter(ov.PartialShape([1, 82, -1, -1]), np.float32)
    graph = ov.Model([op.relu(planes) for _ in range(6)], [planes], "x")
    path = made(tmp_path, {"reads": "signals"}, graph)
    with pytest.raises(DamagedFileError, match="its outputs are"):
        lambent.denoise(NOISY, model="lambent", weights=str(path))


@pytest.mark.parametrize(
    "change",
    [
        {"margin": 10**9}, {"margin": -1}, {"margin": "4"}, {"channels": 0}, {"channels": 99},
        {"options": {"kernel": 10**6}}, {"options": {"scales": 60}}, {"options": []},
        {"score": {"score": "good"}}, {"recipe": "x"}, {"data": [5]}, {"curve": [["a"]]},
        {"hours": float("nan")}, {"known_failures": "none"}, {"reads": ["pixels"]},
    ],
    ids=str,
)  # fmt: skip
def test_cards_that_make_no_sense(tmp_path, change):
    graph = photo(lambda op, x: op.multiply(x, np.float32(0.5)))
    good = {**CARD, "options": {}}
    path = made(tmp_path, good, graph)
    read_model(path)
    from lambent.archive import read_archive, write_archive

    archive = read_archive(path, "model")
    write_archive(path, "model", {**archive.card, **change}, archive.members, overwrite=True)
    with pytest.raises(FileError):
        read_model(path)
