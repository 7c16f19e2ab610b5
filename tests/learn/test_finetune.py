"""Fine-tuning: pairs and halves, what is held out, what is refused."""

import dataclasses

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

from lambent.denoise.model_file import read_model
from lambent.errors import LayerError, OptionError
from lambent.frame.files import read, write
from lambent.frame.frame import Frame
from lambent.learn.export import export
from lambent.learn.finetune import FinetuneTask, finetune, pairs_of
from lambent.learn.networks.lambent import LambentNet


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
    batch = task.made(0, range(2))
    loss, _ = task.loss(LambentNet("fast"), batch)
    assert float(loss.detach()) > 0


def halves(tmp_path, count):
    """Frames of two halves each, as pairs."""
    pairs = []
    for number in range(count):
        rng = np.random.default_rng(number)
        a, b = (made.frame(rng, 2, 320) for _ in range(2))
        path = tmp_path / f"half{number}.exr"
        layers = {"colour_half_a": a.colour, "colour_half_b": b.colour}
        write(path, Frame.from_arrays(spp=4, colour=(a.colour + b.colour) / 2, **layers))
        pairs += pairs_of(path)
    return pairs


def test_of_both_halves_the_same_tiles_are_held_out(tmp_path):
    task = FinetuneTask(halves(tmp_path, 2), "fast")
    of = [{(y, x) for n, y, x in task._held if n == m} for m in range(4)]
    assert of[0] == of[1] != of[2] == of[3]
    assert of[0]


def test_against_a_half_brighter_is_not_better(tmp_path):
    """Relative to its own brightness a network that makes all brighter would win."""
    torch.manual_seed(0)
    task = FinetuneTask(halves(tmp_path, 1), "fast")
    number, *_ = task._held[0]
    task._held = task._held[:1]
    pair = task.pairs[number]
    noise = np.random.default_rng(0).exponential(1, pair.target.shape).astype(np.float32)
    task.pairs[number] = pair = dataclasses.replace(pair, target=pair.target * noise, epsilon=1e-6)
    model = LambentNet("fast").eval()
    before = task.score(model)[0]["score"]
    assert task.score(model)[0]["score"] == pytest.approx(before)
    signals = dataclasses.replace(pair.noisy, colour=2 * pair.noisy.colour)
    task.pairs[number] = dataclasses.replace(pair, noisy=signals)
    assert task.score(model)[0]["score"] > before


def test_epsilon_is_a_radiance_of_the_frame(shots):
    (pair,) = pairs_of(shots[0])
    frame = read(shots[0])
    factor = float(pair.noisy.colour.mean() / frame.colour.mean())
    assert pair.epsilon == pytest.approx(0.01 * factor**2, rel=1e-3)
    task = FinetuneTask([pair], "fast")
    row = task.made(0, [0])  # at another exposure
    gain = float(row.inputs.target.nanmean()) / pair.target.mean()
    assert 0.3 < float(row.epsilon) / (pair.epsilon * gain**2) < 3
    black = dataclasses.replace(pair, target=0 * pair.target)
    row = FinetuneTask([black], "fast").made(0, [0])
    assert float(row.epsilon) == pytest.approx(pair.epsilon)


def test_little_data_frees_the_first_layers_only(shots):
    task = FinetuneTask(pairs_of(shots[0]), "fast")
    free = {n.split(".")[0] for n, p in task.network().named_parameters() if p.requires_grad}
    assert free == {"stem", "enc0"}


def test_what_is_held_out_is_not_told(shots):
    """Crops may lie there, but neither what they should be nor a gradient comes from there."""
    (pair,) = pairs_of(shots[0])
    first = FinetuneTask([pair], "fast")
    (_, y, x), *_ = first._held
    target = pair.target.copy()
    target[:, y : y + 128, x : x + 128] = 1e3
    task = FinetuneTask([dataclasses.replace(pair, target=target)], "fast")
    torch.manual_seed(0)
    model = LambentNet("fast")
    shares = []
    for n in range(12):
        row, other = task.made(0, [n]), first.made(0, [n])
        np.testing.assert_array_equal(row.inputs.target, other.inputs.target)
        shares.append(float(row.inputs.target.isnan().float().mean()))
        assert torch.isfinite(row.epsilon).all()
        assert torch.isfinite(row.inputs.packed).all()
    assert 0 < np.mean(shares) < 0.6
    losses = [t.loss(model, t.made(0, (6, 9)))[0] for t in (first, task)]
    assert float(losses[0].detach()) == float(losses[1].detach()) > 0
    losses[1].backward()
    assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)


class Fixed(torch.nn.Module):
    """A network with all weight on the pixel itself, but for a share of everything around."""

    def __init__(self, blur):
        super().__init__()
        self.blur = blur

    def forward(self, packed):
        b, _, h, w = packed.shape
        sizes = [(144, 1), (35, 1), (35, 2), (35, 4), (25, 8), (36, 1)]
        levels = [torch.zeros(b, n, h // part, w // part) for n, part in sizes]
        levels[0][:, 48:52] = 20 - self.blur
        levels[5][:, 16:20] = 20
        return tuple(levels)


def test_held_out_tiles_are_told_once_the_model_is_better_on_them(shots):
    (pair,) = pairs_of(shots[0])
    noisy, smooth = Fixed(0), Fixed(20)
    for models, after, told in (
        ((noisy, smooth), 0.0, 2),  # better
        ((smooth, noisy), 0.0, None),  # worse
        ((noisy, smooth, noisy), 0.0, 2),  # later scores are of what has been learned from
        ((noisy, smooth), 1e9, None),  # too early
    ):
        task = FinetuneTask([pair], "fast", tell_after=after)
        scores = [task.score(model)[0]["score"] for model in models]
        assert (scores[0] > scores[1]) == (models[0] is noisy)
        assert task.told_at == told
        hidden = [bool(task.made(0, [n]).inputs.target.isnan().any()) for n in range(12)]
        assert any(hidden) == (told is None)


def test_noisy_targets_stay_held_out(tmp_path):
    task = FinetuneTask(halves(tmp_path, 1), "fast", tell_after=0.0)
    for model in (Fixed(0), Fixed(20)):
        task.score(model)
    assert task.told_at is None


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
