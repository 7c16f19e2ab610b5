"""Fine-tuning: pairs and halves, what is held out, what is refused."""

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise.model_file import read_model
from lambent.errors import LayerError, OptionError
from lambent.frame.files import write
from lambent.frame.frame import Frame
from lambent.learn.export import export
from lambent.learn.finetune import FinetuneTask, finetune, pairs_of
from lambent.learn.networks.lambent import LambentNet

pytest.importorskip("openvino")


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("models") / "start.lambent"
    export(LambentNet("fast"), path, {"name": "start", "recipe": {"size": "fast"}}, None)
    return path


@pytest.fixture
def shots(tmp_path):
    paths = []
    for number in range(2):
        rng = np.random.default_rng(number)
        path = tmp_path / f"shot{number}.exr"
        write(path, made.frame(rng, 4, 320))
        write(tmp_path / f"shot{number}.reference.exr", made.frame(rng, 4, 320, clean=True))
        paths.append(path)
    return paths


def test_it_lowers_the_error(start, shots, tmp_path):
    out = tmp_path / "mine.lambent"
    result = finetune(shots, str(start), out, 20.0, "cpu")
    assert result["steps"] > 3
    assert result["after"] < result["before"]
    card = read_model(out).card
    assert card["finetuned_on"]["frames"] == 2
    assert not card["int8"]


def test_half_buffers_suffice(tmp_path):
    rng = np.random.default_rng(0)
    a, b = (made.frame(rng, 2, 320) for _ in range(2))
    frame = Frame.from_arrays(
        spp=4,
        colour=(a.colour + b.colour) / 2,
        colour_half_a=a.colour,
        colour_half_b=b.colour,
        albedo=a["albedo"],
    )
    write(tmp_path / "noisy.exr", frame)
    pairs = pairs_of(tmp_path / "noisy.exr")
    assert [pair.noisy_target for pair in pairs] == [True, True]
    np.testing.assert_allclose(
        pairs[0].noisy.colour / pairs[1].target,
        pairs[0].noisy.colour[0, 0, 0] / pairs[1].target[0, 0, 0],
        rtol=1e-3,
    )
    task = FinetuneTask(pairs, "fast")
    batch = [task.row(0, n) for n in range(2)]
    loss, _ = task.loss(LambentNet("fast"), batch, torch.device("cpu"))
    assert float(loss.detach()) > 0


def test_little_data_frees_the_first_layers_only(shots):
    task = FinetuneTask(pairs_of(shots[0]), "fast")
    free = {n.split(".")[0] for n, p in task.network().named_parameters() if p.requires_grad}
    assert free == {"stem", "enc0"}


def test_crops_avoid_the_tiles_held_out(shots):
    pairs = pairs_of(shots[0])
    marked = pairs[0].target.copy()
    task = FinetuneTask(pairs, "fast")
    (_, y, x), *_ = task._held
    marked[:, y : y + 128, x : x + 128] = 1e3
    object.__setattr__(pairs[0], "target", marked)
    seen = [float(task.row(0, n).target.max()) for n in range(40)]
    assert np.mean([value > 100 for value in seen]) < 0.2


def test_a_frame_with_nothing_to_compare_with_is_named(tmp_path):
    path = tmp_path / "alone.exr"
    write(path, made.frame(np.random.default_rng(0), 4, 160))
    with pytest.raises(LayerError, match=r"alone\.exr.*neither a reference"):
        pairs_of(path)


def test_small_frames_are_refused(tmp_path):
    path = tmp_path / "small.exr"
    write(path, made.frame(np.random.default_rng(0), 4, 64))
    write(tmp_path / "small.reference.exr", made.frame(np.random.default_rng(0), 4, 64, clean=True))
    with pytest.raises(OptionError, match="128x128"):
        FinetuneTask(pairs_of(path), "fast")
