"""The networks of the papers: sizes as published, gradients, over-fitting, the same at run time."""

import dataclasses

import made
import numpy as np
import pytest
import torch
from made import few_threads  # noqa: F401

import lambent
from lambent.denoise import lobes, papers
from lambent.denoise.dncnn import DnCNN as DnCNNDenoiser
from lambent.denoise.inputs import signals_of
from lambent.errors import FileError, LambentError, OptionError
from lambent.filters.denoiser import create
from lambent.filters.explain import explain
from lambent.frame.role import Role
from lambent.learn import photo, rendered
from lambent.learn.export import export_run
from lambent.learn.networks import blocks, dncnn, kernels, kpcn, modular
from lambent.learn.recipe import TrainRecipe
from lambent.learn.rows import Example
from lambent.learn.train import train_task as train
from lambent.training.run import Run

LEAN = {
    "kpcn": {"width": 8, "hidden": 2, "kernel": 5, "patch": 32},
    "dpcn": {"width": 8, "hidden": 2, "kernel": 5, "patch": 32},
    "modular": {"width": 8, "blocks": 1, "kernel": 3, "patch": 32},
    "blocks": {"width": 8, "blocks": 1, "patch": 32},
}


def task_of(name, folder, **more):
    settings = {
        "name": "test", "task": name, "steps": 6, "batch": 2, "warmup": 2, "check_every": 3,
        "checked": 4, "held_out": 0.0, "options": LEAN[name],
    }  # fmt: skip
    recipe = TrainRecipe(**(settings | more))
    folder.mkdir(exist_ok=True)
    return recipe, rendered.RenderedTask(recipe, made.stills(folder, lobes=True))


def parameters(model):
    return sum(p.numel() for p in model.parameters())


def depends_on(function, image, at, least=1e-9):
    """The rows of the pixels of ``image`` that the result at ``at`` depends on."""
    image = image.clone().requires_grad_()
    function(image)[..., at, at].sum().backward()
    rows = image.grad.abs().sum(dim=(0, 1, 3)).nonzero()[:, 0]
    return int(rows.min()), int(rows.max())


# ------------------------------------------------------------------ as published


def test_dncnn_is_the_paper_s():
    grey, blind = dncnn.DnCNN(1, 17), dncnn.DnCNN(3, 20)
    # 3x3 convolutions 1→64 and 64→1 with biases, 15 of 64→64 with two numbers a filter
    assert parameters(grey) == 9 * 64 + 64 + 15 * (9 * 64 * 64 + 2 * 64) + 9 * 64 + 1 == 556_097
    assert parameters(blind) == 27 * 64 + 64 + 18 * (9 * 64 * 64 + 2 * 64) + 27 * 64 + 3
    assert (grey.receptive_field(), blind.receptive_field()) == (35, 41)
    y = torch.rand(2, 3, 24, 40)
    assert blind(y).shape == y.shape
    grey.eval()
    assert depends_on(grey, torch.rand(1, 1, 61, 61), 30) == (30 - 17, 30 + 17)


def test_the_cost_of_a_network_is_counted():
    from lambent.learn.export import cost_of
    from lambent.learn.task import Exportable

    grey = dncnn.DnCNN(1, 17)
    found = cost_of(Exportable(grey, (torch.zeros(1, 1, 16, 16),), "pixels"))
    assert found == {"parameters": 556_097, "macs": 2 * 9 * 64 + 15 * 9 * 64 * 64}


def test_kpcn_is_the_paper_s():
    full = kpcn.KPCN()
    hidden = 25 * lobes.PLANES * 100 + 100 + 7 * (25 * 100 * 100 + 100)
    assert parameters(full) == 2 * (hidden + 25 * 100 * 441 + 441) == 5_877_482
    assert parameters(kpcn.DPCN()) == 2 * (hidden + 25 * 100 * 3 + 3)
    assert full.receptive_field() == 37
    planes = torch.zeros(1, lobes.PLANES, 16, 24)
    assert [tuple(t.shape) for t in full(planes, planes)] == [(1, 441, 16, 24)] * 2
    assert [tuple(t.shape) for t in kpcn.DPCN()(planes, planes)] == [(1, 3, 16, 24)] * 2
    small = kpcn.KPCN(kpcn.KPCNOptions(width=4, kernel=3))
    reached = depends_on(lambda x: small(x, x)[0], torch.rand(1, lobes.PLANES, 61, 61), 30)
    assert reached == (30 - 18, 30 + 18)
    with pytest.raises(OptionError, match="centre"):
        kpcn.KPCN(kpcn.KPCNOptions(kernel=4))


def test_modular_has_its_parts():
    model = modular.Modular(modular.ModularOptions(width=8, blocks=2, kernel=5))
    x = torch.rand(1, lobes.PLANES + 1, 16, 24)
    assert [tuple(t.shape) for t in model(x)] == [
        (1, 26, 16, 24), (1, 26, 8, 12), (1, 25, 4, 6),
    ]  # fmt: skip
    encoder = 9 * lobes.PLANES * 8 + 8 + 9 * 64 + 8
    assert parameters(model) == encoder + 2 * 2 * (9 * 64 + 8) + 8 + 9 * 8 * 26 + 26
    assert model.multiple == 4
    # features and kernels can be had apart: a temporal form joins features in between
    for a, b in zip(model.predicted(model.features(x)), model(x), strict=True):
        assert torch.equal(a, b)
    frozen = modular.Modular(dataclasses.replace(model.options, frozen=True))
    free = {name.split(".")[0] for name, p in frozen.named_parameters() if p.requires_grad}
    assert free == {"encoder"}


def test_a_frozen_trunk_is_taken_over_with_a_fresh_encoder():
    first = modular.Modular(modular.ModularOptions(width=8, blocks=1))
    second = modular.Modular(dataclasses.replace(first.options, frozen=True))
    own = second.state_dict()
    begun = second.started(first.state_dict())
    assert set(begun) == set(own)
    for name, value in begun.items():
        source = own if name.startswith("encoder.") else first.state_dict()
        assert torch.equal(value, source[name]), name


@pytest.mark.parametrize("block", blocks.BLOCKS)
@pytest.mark.parametrize("activation", blocks.ACTIVATIONS)
def test_building_blocks_cost_the_same(block, activation):
    options = blocks.BlocksOptions(width=32, block=block, activation=activation, norm=True)
    width = blocks.width_of(options)
    cost = blocks.macs_of_block(width, block, activation)
    plain = blocks.macs_of_block(32, "plain")
    assert 0.75 * plain <= cost <= plain
    x = torch.rand(1, lobes.PLANES, 16, 24)
    assert blocks.Blocks(options)(x).shape == (1, 3, 16, 24)


def test_attention_looks_within_its_window():
    torch.manual_seed(0)
    layer = blocks.Attention(16, shifted=False)
    layer.norm_a = layer.norm_b = torch.nn.Identity()  # these see the whole picture
    assert depends_on(layer, torch.rand(1, 16, 24, 24), 10) == (8, 15)
    moved = blocks.Attention(16, shifted=True)
    moved.norm_a = moved.norm_b = torch.nn.Identity()
    assert depends_on(moved, torch.rand(1, 16, 24, 24), 10) == (4, 11)


def test_unknown_blocks_are_named():
    with pytest.raises(OptionError, match="there is no 'gelu'"):
        blocks.Blocks(blocks.BlocksOptions(activation="gelu"))


# ------------------------------------------------------------------ kernels


def test_the_gradient_of_predicted_kernels():
    torch.manual_seed(0)
    logits = torch.randn(1, 9, 4, 5, dtype=torch.float64, requires_grad=True)
    image = torch.rand(1, 2, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(kernels.apply, (logits, image))


def test_kernels_are_means_of_what_lies_in_the_image():
    torch.manual_seed(0)
    logits = 3 * torch.randn(2, 25, 9, 7)
    weights = kernels.softmax(logits)
    torch.testing.assert_close(weights.sum(1), torch.ones(2, 9, 7))
    assert float(weights[:, 0, 0, 0].abs().max()) == 0  # the tap up left of the first pixel
    grey = torch.full((2, 3, 9, 7), 0.7)
    torch.testing.assert_close(kernels.apply(logits, grey), grey)


def test_run_time_kernels_are_those_of_training():
    from lambent.kernels.predicted import predicted_window, weights_at

    rng = np.random.default_rng(0)
    logits = rng.normal(0, 3, (49, 13, 18)).astype(np.float32)
    image = rng.random((13, 18, 4), np.float32)
    ours = predicted_window(image, logits)
    torchs = kernels.apply(torch.tensor(logits[None]), torch.tensor(image.transpose(2, 0, 1)[None]))
    np.testing.assert_allclose(ours.transpose(2, 0, 1), torchs[0].numpy(), rtol=1e-5, atol=1e-6)
    # a sure logit outside the image, or of a pixel that does not count, takes nothing from others
    sure = logits.copy()
    sure[0] = 120
    corner = predicted_window(image, sure)[0, 0]
    np.testing.assert_allclose(corner, ours[0, 0], rtol=1e-4)
    broken = image.copy()
    broken[5, 9] = np.nan
    sure = logits.copy()
    sure[24] = 120
    assert np.isfinite(predicted_window(broken, sure)[5, 9]).all()
    for x, y in ((0, 0), (17, 12), (9, 5)):
        w = weights_at(logits, x, y)
        assert w.sum() == pytest.approx(1, abs=1e-6)
        np.testing.assert_allclose((w[:, :, None] * image).sum((0, 1)), ours[y, x], rtol=1e-5)


# ------------------------------------------------------------------ inputs


def test_parts_come_together_again():
    frame = made.frame(np.random.default_rng(0), 4, lobes=True)
    signals = signals_of(frame)
    signals = dataclasses.replace(signals, layers={**signals.layers, **lobes.lobes_of(frame)})
    for parts in (lobes.parts_of(np, signals), lobes.whole_of(np, signals)):
        whole = lobes.together(np, parts.diffuse, parts.specular, parts.albedo)
        np.testing.assert_allclose(whole, signals.colour, rtol=1e-4, atol=1e-5)
        assert parts.diffuse_planes.shape == (lobes.PLANES, 64, 64)
    by_torch = lobes.parts_of(
        torch,
        dataclasses.replace(
            signals,
            colour=torch.tensor(signals.colour),
            layers={name: torch.tensor(layer) for name, layer in signals.layers.items()},
        ),
    )
    by_numpy = lobes.parts_of(np, signals)
    for name in ("diffuse", "specular", "albedo", "diffuse_planes", "specular_planes"):
        a, b = getattr(by_torch, name).numpy(), getattr(by_numpy, name)
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5, err_msg=name)


def test_the_cache_keeps_the_lobes(tmp_path):
    (still,) = made.stills(tmp_path, 1, lobes=True)
    source = made.still(0, lobes=True)
    levels, target, _ = still.load(lobes=True)
    e = still.exposure
    for level, frame in zip(levels, source.levels, strict=True):
        diffuse = frame[Role.DIFFUSE].transpose(2, 0, 1) * e
        np.testing.assert_allclose(level.layers["diffuse"], diffuse, rtol=2e-3, atol=1e-4)
        assert level.layers["specular_std"].shape == (1, 64, 64)
    diffuse = source.target[Role.DIFFUSE].transpose(2, 0, 1) * e
    np.testing.assert_allclose(target[3:], diffuse, rtol=2e-3, atol=1e-4)
    levels, target, _ = still.load()
    assert len(target) == 3
    assert not set(lobes.LOBES) & set(levels[0].layers)


# ------------------------------------------------------------------ learning


@pytest.mark.parametrize("name", LEAN)
def test_a_network_learns_one_crop_by_heart(name, tmp_path):
    _, task = task_of(name, tmp_path)
    crops = dataclasses.replace(task.made(0, 2), progress=1.0)
    torch.manual_seed(0)
    model = task.network()
    adam = torch.optim.Adam(model.parameters(), 3e-3)
    found = []
    for _ in range(60):
        loss, _ = task.loss(model, crops)
        adam.zero_grad()
        loss.backward()
        adam.step()
        found.append(float(loss.detach()))
    assert found[-1] < 0.6 * found[0], found[::10]


@pytest.mark.parametrize("name", LEAN)
def test_a_resumed_run_is_an_uninterrupted_one(name, tmp_path):
    recipe, task = task_of(name, tmp_path / "data")
    whole = train(recipe, task, tmp_path / "whole", "cpu")
    for steps in (2, 6):
        pieces = train(recipe, task, tmp_path / "pieces", "cpu", steps=steps)
    a, b = (torch.load(r.state, weights_only=True)["model"] for r in (whole, pieces))
    assert all(torch.equal(a[n], b[n]) for n in a)


def test_parts_learn_alone_and_then_together(tmp_path):
    _, task = task_of("kpcn", tmp_path)
    model = task.network()
    for step, names in ((0, {"diffuse", "specular"}), (5, {"colour"})):
        _, terms = task.loss(model, task.made(step, 1))
        assert set(terms) == names


def test_a_preference_makes_overshooting_dear(tmp_path):
    _, task = task_of("modular", tmp_path)
    crop = task.made(0, 1)
    assert 0 <= float(crop.preference) <= 1
    model = task.network()
    losses = []
    for preference in (0.0, 1.0):
        b = dataclasses.replace(crop, preference=torch.tensor([preference]))
        outputs = model(*model.inputs(b))
        losses.append(float(model.loss(outputs, b)["smape"].detach()))
    assert losses[1] > 1.5 * losses[0]


# ------------------------------------------------------------------ run time


def exported(name, folder, **more):
    recipe, task = task_of(name, folder / "data", **more)
    run = train(recipe, task, folder / "run", "cpu")
    path = folder / f"{name}.lambent"
    card = export_run(run, task, path)
    model = task.network()
    # a model file holds half floats
    model.load_state_dict({k: v.half().float() for k, v in run.weights().items()})
    return task, model.eval(), path, card


@pytest.mark.parametrize("name", ["kpcn", "dpcn", "modular"])
@pytest.mark.parametrize("size", [(64, 64), (45, 38)])
def test_openvino_and_pytorch_agree(name, size, tmp_path):
    task, model, path, card = exported(name, tmp_path)
    frame = made.frame(np.random.default_rng(5), 4, lobes=True).crop(0, size[0], 0, size[1])
    denoiser = create(name, weights=str(path))
    ours = denoiser(frame, "beauty").colour
    assert card["reads"] == "lobes"
    # the same by PyTorch; modular on a frame continued to a multiple of four
    signals, factor = denoiser.fitted(frame).signals(frame)
    example = Example(signals, np.zeros((6, *size), np.float32), np.zeros((1, *size), np.float32))
    if name == "modular":
        more = [(0, 0), (0, -size[0] % 4), (0, -size[1] % 4)]
        layers = {n: np.pad(la, more, "edge") for n, la in signals.layers.items()}
        padded = dataclasses.replace(
            signals, colour=np.pad(signals.colour, more, "edge"), layers=layers
        )
        zeros = np.zeros((6, *padded.colour.shape[1:]), np.float32)
        example = Example(padded, zeros, zeros[:1])
    by_torch = task.clean(model, example)[:, : size[0], : size[1]] / factor
    np.testing.assert_allclose(ours, by_torch.transpose(1, 2, 0), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["kpcn", "dpcn", "modular"])
def test_tiles_are_exact_and_layers_come_along(name, tmp_path):
    _, _, path, _ = exported(name, tmp_path)
    frame = made.frame(np.random.default_rng(5), 4, size=224, lobes=True)
    options = {"weights": str(path)}
    whole = lambent.denoise(frame, name, passes="diffuse,specular", **options)
    assert np.isfinite(whole.colour).all()
    assert np.abs(whole.colour - frame.colour).mean() > 1e-3
    if name != "modular":
        total = whole[Role.DIFFUSE] + whole[Role.SPECULAR]
        np.testing.assert_allclose(total, whole.colour, rtol=1e-4, atol=1e-4)
    else:  # linear in the light: whatever sums in still sums out
        total = whole[Role.DIFFUSE] + whole[Role.SPECULAR]
        np.testing.assert_allclose(total, whole.colour, rtol=1e-3, atol=1e-4)
    from lambent.denoise.tiles import filter_tiles, plan_tiles

    denoiser = create(name, **options).fitted(frame)
    layers = [frame.layer(Role.COLOUR)]
    budget = 170 * 170 * denoiser.bytes_per_pixel(3)
    plan = plan_tiles(224, 224, denoiser.bytes_per_pixel(3), denoiser.margin(), budget)
    assert len(plan.tiles) > 1
    (tiled,) = filter_tiles(denoiser, frame, layers, plan)
    np.testing.assert_allclose(tiled, whole.colour, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["kpcn", "modular"])
def test_int8_stays_near(name, tmp_path, monkeypatch):
    monkeypatch.setattr(rendered, "CALIBRATION", 4)
    task, _, path, _ = exported(name, tmp_path)
    run = Run(tmp_path / "run")
    short = tmp_path / "int8.lambent"
    export_run(run, task, short, int8=True)
    frame = made.frame(np.random.default_rng(5), 4, lobes=True)
    exact, rounded = (create(name, weights=str(p))(frame, "beauty").colour for p in (path, short))
    noise = np.abs(frame.colour - exact).mean()
    assert 0 < np.abs(rounded - exact).mean() < 0.1 * noise


def test_a_frame_without_lobes_is_cleaned_too(tmp_path):
    _, _, path, _ = exported("kpcn", tmp_path)
    frame = made.frame(np.random.default_rng(5), 4)
    bare = lambent.Frame.from_arrays(colour=frame.colour)
    for one in (frame, bare):
        clean = create("kpcn", weights=str(path))(one, "beauty").colour
        assert np.isfinite(clean).all()
        assert np.abs(clean - one.colour).mean() > 1e-3


def test_learned_kernels_are_explained(tmp_path):
    _, _, path, _ = exported("kpcn", tmp_path)
    frame = made.frame(np.random.default_rng(5), 4, lobes=True)
    found = {
        part: explain(frame, "kpcn", 20, 30, weights=str(path), part=part)
        for part in ("diffuse", "specular")
    }
    for one in found.values():
        assert one.sum == pytest.approx(1, abs=1e-5)
        assert np.count_nonzero(one.weights) == 25
    assert np.abs(found["diffuse"].weights - found["specular"].weights).max() > 1e-6
    assert found["diffuse"].bias is None  # its result is no mean of the picture
    with pytest.raises(OptionError, match="not a weighted mean"):
        explain(frame, "dpcn", 20, 30)


def test_modular_weights_make_its_result(tmp_path):
    _, _, path, _ = exported("modular", tmp_path)
    frame = made.frame(np.random.default_rng(5), 4, size=34, lobes=True).without(Role.ALBEDO)
    frame = frame.without(Role.DIFFUSE_ALBEDO)
    denoiser = create("modular", weights=str(path)).fitted(frame)
    found = explain(frame, denoiser, 13, 11)
    assert found.sum == pytest.approx(1, abs=1e-5)
    left, top = found.origin
    height, width = found.weights.shape
    seen = frame.colour[top : top + height, left : left + width]
    clean = denoiser(frame, "beauty").colour[11, 13]
    mean = (found.weights[:, :, None] * seen).sum((0, 1))
    np.testing.assert_allclose(mean, clean, rtol=1e-4)


@pytest.mark.parametrize(("x", "y"), [(75, 41), (149, 90), (90, 98)])
def test_modular_weights_are_those_of_the_whole_frame(x, y):
    """Beyond the margin from the corner, at places that no pyramid's pixel begins at."""
    frame = made.frame(np.random.default_rng(5), 4, size=150, lobes=True).crop(0, 99, 0, 150)
    frame = frame.without(Role.ALBEDO).without(Role.DIFFUSE_ALBEDO)
    denoiser = create("modular").fitted(frame)
    found = explain(frame, denoiser, x, y)
    assert found.sum == pytest.approx(1, abs=1e-4)
    left, top = found.origin
    height, width = found.weights.shape
    seen = frame.colour[top : top + height, left : left + width]
    clean = denoiser(frame, "beauty").colour[y, x]
    np.testing.assert_allclose((found.weights[:, :, None] * seen).sum((0, 1)), clean, rtol=1e-3)


def test_bias_knows_that_weights_need_not_sum_to_one():
    """A striped albedo under constant light: nothing is lost, whatever the weights sum to."""
    stripes = np.where(np.arange(64) % 4 < 2, 0.9, 0.1).astype(np.float32)
    albedo = np.broadcast_to(stripes[None, :, None], (64, 64, 3)).copy()
    rng = np.random.default_rng(0)
    noisy = albedo * rng.gamma(16, 1 / 16, (64, 64, 1)).astype(np.float32)
    frame = lambent.Frame.from_arrays(colour=noisy, albedo=albedo)
    found = explain(frame, "modular", 33, 30, reference=albedo + lobes.EPSILON)
    assert abs(found.sum - 1) > 1e-3
    assert np.abs(found.bias).max() < 1e-3


def test_direct_prediction_has_no_other_layers(tmp_path):
    _, _, path, _ = exported("dpcn", tmp_path)
    frame = made.frame(np.random.default_rng(5), 4, lobes=True)
    light = lambent.Frame.from_arrays(colour=frame.colour, direct=frame.colour)
    with pytest.raises(OptionError, match="no kernels for 'direct'"):
        create("dpcn", weights=str(path))(light, "all")


def test_a_model_of_another_kind_is_refused(tmp_path):
    _, _, path, _ = exported("kpcn", tmp_path)
    frame = made.frame(np.random.default_rng(5), 4)
    with pytest.raises(FileError, match="reads lobes, not signals"):
        create("lambent", weights=str(path))(frame, "beauty")
    with pytest.raises(FileError, match="reads lobes, not pixels"):
        create("dncnn", weights=str(path))(frame, "beauty")
    for name in ("dpcn", "modular"):
        with pytest.raises(FileError, match=r"of the task 'kpcn'[\s\S]*--model kpcn"):
            create(name, weights=str(path))


def test_layers_are_cleaned_as_what_they_are():
    """Emission apart from both lobes, as some renderers write it: each layer by its own light."""
    made_ = made.frame(np.random.default_rng(5), 4, lobes=True)
    glow = np.full_like(made_.colour, 0.5)
    specular = made_[Role.SPECULAR]
    frame = lambent.Frame.from_arrays(
        colour=made_.colour + glow, diffuse=made_[Role.DIFFUSE], specular=specular, emission=glow,
        albedo=made_[Role.ALBEDO],
    )  # fmt: skip
    clean = create("kpcn")(frame, "all")
    # the mean of a logarithm is less than the logarithm of the mean
    assert 0.75 * specular.mean() < clean[Role.SPECULAR].mean() < 1.02 * specular.mean()
    total = clean[Role.DIFFUSE] + clean[Role.SPECULAR] + clean[Role.EMISSION]
    assert total.mean() == pytest.approx(clean.colour.mean(), rel=0.05)
    alone = lambent.Frame.from_arrays(colour=frame.colour, specular=specular)
    shine = create("kpcn")(alone, "all")[Role.SPECULAR]
    assert 0.75 * specular.mean() < shine.mean() < 1.02 * specular.mean()
    with pytest.raises(OptionError, match="no kernels for 'diffuse'"):
        create("dpcn")(frame, "diffuse")


def test_direct_prediction_makes_no_light_of_what_is_not_there(tmp_path):
    _, _, path, _ = exported("dpcn", tmp_path)
    denoiser = create("dpcn", weights=str(path))
    frame = made.frame(np.random.default_rng(5), 4, lobes=True)
    bare = lambent.Frame.from_arrays(colour=frame.colour)
    signals, factor = denoiser.fitted(bare).signals(bare)
    parts = lobes.parts_of(np, signals)
    said = denoiser.outputs(parts.diffuse_planes, parts.specular_planes)
    expected = np.maximum(np.expm1(said[0]), 0) * parts.albedo / factor
    np.testing.assert_allclose(denoiser(bare, "beauty").colour, expected.transpose(1, 2, 0))
    assert denoiser(frame, "beauty").colour.min() >= 0
    assert any("separate diffuse" in note for note in denoiser(bare, "beauty").notes)


@pytest.mark.parametrize("name", ["kpcn", "dpcn", "modular"])
def test_grey_lobes_count_as_colours(name):
    coloured = made.frame(np.random.default_rng(5), 4, lobes=True)
    roles = (Role.COLOUR, Role.DIFFUSE, Role.SPECULAR, Role.ALBEDO, Role.DIFFUSE_ALBEDO)
    one, three = coloured, coloured
    for role in roles:
        grey = coloured[role].mean(axis=2, keepdims=True)
        layer = coloured.layer(role)
        one = one.with_layer(layer.with_data(grey))
        three = three.with_layer(layer.with_data(np.repeat(grey, 3, axis=2)))
    clean, expected = (create(name)(f, "beauty").colour for f in (one, three))
    np.testing.assert_allclose(clean.mean(axis=2), expected.mean(axis=2), rtol=1e-4, atol=1e-5)


# ------------------------------------------------------------------ photographs


def pictures(count=6, size=64):
    y, x = np.mgrid[0:size, 0:size] / size
    found = []
    for n in range(count):
        waves = [0.5 + 0.4 * np.sin(7 * x * (n + 1) + k) * np.cos(5 * y) for k in range(3)]
        pixels = (np.stack(waves, 2) * 255).astype(np.uint8)
        found.append(photo.Photograph(f"{n}.png", pixels))
    return found


def photo_recipe(**more):
    options = {"depth": 4, "width": 8, "patch": 32} | more.pop("options", {})
    settings = {
        "name": "test", "task": "photo", "steps": 4, "batch": 2, "warmup": 1, "check_every": 4,
        "checked": 2, "options": options, "clip": 1e9, "held_out": 0.3,
    }  # fmt: skip
    return TrainRecipe(**(settings | more))


def test_dncnn_learns_to_take_noise_off():
    recipe = photo_recipe(options={"sigma_low": 50.0, "sigma_high": 50.0})
    task = photo.PhotoTask(recipe, pictures())
    torch.manual_seed(0)
    model = task.network()
    adam = torch.optim.Adam(model.parameters(), 3e-3)
    batches = task.batches(0, 0, 1)
    losses = []
    for _ in range(80):
        loss, _ = task.loss(model, next(batches))
        adam.zero_grad()
        loss.backward()
        adam.step()
        losses.append(float(loss.detach()))
    batches.close()
    # the loss of leaving all noise where it is: ½ · 3 · 32² · σ²
    untouched = 0.5 * 3 * 32**2 * (50 / 255) ** 2
    patches = [task.patch(0, n) for n in range(8)]
    noisy, clean = (
        torch.tensor(np.stack([getattr(p, n) for p in patches])) for n in ("noisy", "clean")
    )
    assert float(dncnn.loss(noisy, clean)) == pytest.approx(untouched, rel=0.1)
    assert np.mean(losses[-10:]) < 0.6 * untouched
    scores, shown = task.score(model.eval())
    untouched = -20 * np.log10(50 / 255)
    assert scores["psnr 50"] > untouched + 3
    assert scores["score"] == pytest.approx(255 * 10 ** (-scores["psnr 50"] / 20))
    assert shown


@pytest.mark.parametrize(("norm", "residual"), [(True, True), (False, True), (True, False)])
def test_folding_changes_nothing(norm, residual):
    torch.manual_seed(0)
    model = dncnn.DnCNN(1, 5, 8, norm, residual)
    with torch.no_grad():
        for module in model.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.uniform_(-1, 1)
                module.running_var.uniform_(0.5, 2)
                module.weight.uniform_(0.5, 2)
                module.bias.uniform_(-1, 1)
    model.eval()
    y = torch.rand(1, 1, 20, 20)
    flat = dncnn.folded(model)
    assert not any(isinstance(m, torch.nn.BatchNorm2d) for m in flat.modules())
    torch.testing.assert_close(flat(y), model(y), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("colour", [True, False])
def test_dncnn_is_the_same_at_run_time(colour, tmp_path):
    from PIL import Image

    from lambent.frame.tonemap import srgb

    task = photo.PhotoTask(photo_recipe(options={"colour": colour}), pictures())
    run = train(task.recipe, task, tmp_path / "run", "cpu")
    path = tmp_path / "photo.lambent"
    card = export_run(run, task, path)
    assert card["score_says"].startswith("PSNR ")
    model = task.network()
    model.load_state_dict(run.weights())
    model.eval()
    noisy = pictures(1)[0].pixels
    Image.fromarray(noisy).save(tmp_path / "noisy.png")
    frame = lambent.read(tmp_path / "noisy.png")
    clean = lambent.denoise(frame, "dncnn", weights=str(path))
    y = torch.tensor(noisy.transpose(2, 0, 1)[None] / 255, dtype=torch.float32)
    with torch.no_grad():
        x = model(y) if colour else torch.cat([model(y[:, c : c + 1]) for c in range(3)], 1)
    expected = np.clip(x[0].numpy().transpose(1, 2, 0), 0, 1)
    np.testing.assert_allclose(srgb(clean.colour), expected, atol=1e-4)
    assert not any("tone-mapped" in note for note in clean.notes)


def test_radiance_keeps_its_highlights(tmp_path):
    task = photo.PhotoTask(photo_recipe(), pictures())
    run = train(task.recipe, task, tmp_path / "run", "cpu")
    export_run(run, task, tmp_path / "photo.lambent")
    frame = made.frame(np.random.default_rng(0), 16)
    bright = frame.colour.copy()
    bright[30, 30] = 5000
    lit = lambent.Frame.from_arrays(colour=bright)
    clean = lambent.denoise(lit, "dncnn", weights=str(tmp_path / "photo.lambent"))
    assert clean.colour[30, 30].min() > 4900
    assert any("tone-mapped" in note for note in clean.notes)


def test_a_scene_is_on_one_side_only():
    crops = [photo.Photograph(f"scene {n // 3}", p.pixels) for n, p in enumerate(pictures(24))]
    task = photo.PhotoTask(photo_recipe(held_out=0.4), crops)
    assert len(task.held) % 3 == len(task.pictures) % 3 == 0
    assert len(task.held) + len(task.pictures) == 24
    assert len(photo.PhotoTask(photo_recipe(held_out=0.0), crops).pictures) == 24


def test_some_patches_are_grey_with_one_noise():
    task = photo.PhotoTask(photo_recipe(options={"grey": 0.5}), pictures())
    patches = [task.patch(0, n) for n in range(40)]
    grey = [bool((p.noisy == p.noisy[:1]).all()) for p in patches]
    assert grey == [bool((p.clean == p.clean[:1]).all()) for p in patches]
    assert 8 < sum(grey) < 32


def test_pictures_that_are_none_are_named(tmp_path):
    with pytest.raises(FileError, match="no such folder"):
        photo.photographs(tmp_path / "none")
    with pytest.raises(FileError, match="no PNG or JPEG"):
        photo.photographs(tmp_path)
    (tmp_path / "._a.png").write_bytes(b"what macOS keeps beside a.png")
    with pytest.raises(FileError, match="no PNG or JPEG"):
        photo.photographs(tmp_path)
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(FileError, match=r"a\.png"):
        photo.photographs(tmp_path)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"options": {"sigma_low": 60.0}}, "above sigma_high"),
        ({"options": {"patch": 128}}, "too few"),
        ({"options": {"depht": 4}}, "did you mean 'depth'"),
    ],
)
def test_senseless_options_are_refused(settings, words):
    with pytest.raises(LambentError) as caught:
        photo.PhotoTask(photo_recipe(**settings), pictures())
    assert words in f"{caught.value.message} {caught.value.remedy}"


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("kpcn", papers.KPCN),
        ("dpcn", papers.DPCN),
        ("modular", papers.Modular),
        ("dncnn", DnCNNDenoiser),
    ],
)
def test_shipped_models_clean(name, kind):
    denoiser = create(name)
    assert type(denoiser) is kind
    assert denoiser.card()["recipe"]["name"] == name
    frame = made.frame(np.random.default_rng(8), 4, lobes=True)
    truth = made.frame(np.random.default_rng(8), 4, clean=True, lobes=True).colour
    clean = denoiser(frame, "beauty").colour
    assert np.abs(clean - truth).mean() < 0.7 * np.abs(frame.colour - truth).mean()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("modular", {"patch": 50}, "multiple of 4"),
        ("blocks", {"patch": 20, "block": "attention"}, "multiple of 8"),
    ],
)
def test_patches_that_do_not_suit_are_refused(name, options, words, tmp_path):
    with pytest.raises(OptionError) as caught:
        task_of(name, tmp_path, options={**LEAN[name], **options})
    assert words in caught.value.remedy


def test_lobes_are_needed_where_they_are_learned(tmp_path):
    recipe = TrainRecipe(name="x", task="kpcn", held_out=0.0, options=LEAN["kpcn"])
    stills = made.stills(tmp_path)
    with pytest.raises(OptionError, match="diffuse and specular light apart"):
        rendered.RenderedTask(recipe, stills)
    blind = TrainRecipe(name="x", task="modular", held_out=0.0, options=LEAN["modular"])
    assert rendered.RenderedTask(blind, stills).made(0, 1).target.shape == (1, 3, 32, 32)


def test_weights_of_another_network_are_refused(tmp_path):
    recipe, task = task_of("modular", tmp_path / "data")
    other = task_of("kpcn", tmp_path / "other")[1].network().state_dict()
    with pytest.raises(OptionError, match="another network"):
        train(recipe, task, tmp_path / "run", "cpu", start=other)
    _, frozen = task_of("modular", tmp_path / "frozen", options={**LEAN["modular"], "frozen": True})
    with pytest.raises(OptionError, match="begins with nothing"):
        frozen.started(None)


def test_a_model_file_can_be_trained_on(tmp_path):
    from lambent.learn.export import float_weights

    for name in ("kpcn", "modular"):
        recipe, task = task_of(name, tmp_path / name)
        run = train(recipe, task, tmp_path / f"{name}-run", "cpu", steps=3)
        export_run(run, task, tmp_path / f"{name}.lambent")
        start = task.started(float_weights(str(tmp_path / f"{name}.lambent")))
        again = train(recipe, task, tmp_path / f"{name}-again", "cpu", start=start, steps=1)
        state = torch.load(again.state, weights_only=True)["model"]
        for key, value in run.weights().items():
            assert (state[key] - value).abs().max() < 0.02, key
