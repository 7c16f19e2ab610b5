"""Batches: what is drawn, merged, changed and encoded is what it says."""

import os
import subprocess
import sys

import made
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from made import few_threads  # noqa: F401

from lambent.denoise import inputs, lobes, samples
from lambent.learn import batches, changes, denoising, lamps
from lambent.learn.denoising import DenoisingTask
from lambent.learn.recipe import TrainRecipe
from lambent.learn.rendered import RenderedBatch
from lambent.learn.rows import AT, NAMES, PLANES, Example, Rows, rows_of
from lambent.learn.stills import Stills
from lambent.learn.train import train_task as train


@pytest.fixture
def stills(tmp_path):
    return made.stills(tmp_path)


@pytest.fixture
def rows(stills):
    return Stills(stills).rows(8, torch.Generator().manual_seed(1))


def dice(value):
    """In place of `rows.random`: every die shows the same."""
    return lambda size, count, rng: torch.full((size, count), float(value))


def test_merged_levels_are_one_render(stills):
    """Of 1, 4 and 16 samples, the first without a variance that could be told."""
    whole = Stills(stills)
    levels, target, deviation = stills[0].load()
    rows = whole.merged(torch.tensor([0]), torch.ones(1, 4, dtype=torch.bool))
    assert float(rows.spp) == 21
    for name in ("albedo", "depth"):
        mean = sum(n * lv.layers[name] for n, lv in zip((1, 4, 16), levels, strict=True)) / 21
        np.testing.assert_allclose(rows.layer(name)[0], mean, rtol=1e-4, atol=1e-5)
    told = [(lv.spp, lv.layers["colour_std"]) for lv in levels if "colour_std" in lv.layers]
    one = sum(n * n * std**2 for n, std in told) / sum(n for n, _ in told)  # of a single sample
    np.testing.assert_allclose(rows.layer("colour_std")[0], np.sqrt(one / 21), rtol=1e-3, atol=1e-6)
    np.testing.assert_array_equal(rows.target[0, :3], target)
    np.testing.assert_array_equal(rows.target[0, 3:], deviation)
    alone = whole.merged(torch.tensor([1]), torch.zeros(1, 4, dtype=torch.bool))
    assert float(alone.spp) == 4
    np.testing.assert_allclose(alone.planes[0, :3], levels[1].colour, rtol=1e-6)


def test_what_the_network_reads_is_what_it_reads_at_run_time(stills):
    """`denoise.inputs` for NumPy, one frame at a time, against the rows of a batch."""
    for still in stills[:2]:
        levels, target, deviation = still.load()
        for signals in levels:
            rows = rows_of([Example(signals, target, deviation)])
            packed, colour, divisor, *_ = batches.ready(
                rows, torch.ones(1, len(inputs.MASKS)), rows.spp, torch.zeros(1)
            )
            wanted = inputs.pack(
                np, inputs.encode(np, signals, 1.0), inputs.constants(signals, 0.0)
            )
            np.testing.assert_allclose(packed[0], wanted, atol=2e-5)
            np.testing.assert_array_equal(colour[0], signals.colour)
            np.testing.assert_allclose(divisor[0], inputs.divisor(np, signals.layers["albedo"]))


def test_lobes_of_rows_are_those_of_a_frame(tmp_path):
    still = made.stills(tmp_path, 1, lobes=True)[0]
    levels, target, deviation = still.load(lobes=True)
    rows = rows_of([Example(levels[1], target, deviation)])
    b = RenderedBatch.of(rows)
    parts = lobes.parts_of(np, levels[1])
    for name in ("diffuse", "specular", "albedo", "diffuse_planes", "specular_planes"):
        np.testing.assert_allclose(getattr(b, name)[0], getattr(parts, name), atol=1e-5, rtol=1e-5)
    again = lobes.together(torch, b.target_diffuse, b.target_specular, b.albedo)
    torch.testing.assert_close(again, b.target, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("change", ["turned", "cut", "exposed"])
def test_lobes_still_sum_to_the_colour(tmp_path, change):
    """And to what they do in the target, whatever is turned, cut or exposed."""
    rng = torch.Generator().manual_seed(4)
    rows = Stills(made.stills(tmp_path, lobes=True), lobes=True).rows(6, rng)
    shine = rows.planes[:, :3] - rows.layer("diffuse")
    ratio = (shine / rows.planes[:, :3].clamp_min(1e-3)).flatten(1).sort(1).values
    before = float(rows.target[:, 4:].sum())
    if change == "exposed":
        changes.exposed(rows, 1.0, rng)
        assert float(rows.target[:, 4:].sum()) != before
    else:
        rows = changes.turned(rows, rng) if change == "turned" else changes.cut(rows, 40, rng)
    again = rows.planes[:, :3] - rows.layer("diffuse")
    shares = (again / rows.planes[:, :3].clamp_min(1e-3)).flatten(1).sort(1).values
    if change == "cut":
        assert rows.planes.shape[2:] == rows.target.shape[2:] == (40, 40)
        # the same square of everything: light over albedo is smooth in it
        light = rows.target[:, 4:] / rows.layer("diffuse_albedo").clamp_min(1e-2)
        assert float(light.diff(dim=3).abs().mean()) < 0.03
    elif change == "turned":
        torch.testing.assert_close(shares, ratio, rtol=1e-3, atol=1e-3)
    else:
        here = rows.planes[:, :3] > 0.1
        assert float((again[here] / rows.planes[:, :3][here]).max()) <= float(ratio.max()) + 1e-3
    assert bool((rows.target[:, :3] - rows.target[:, 4:] > -2e-3).all())


def test_more_can_be_brought_in(stills):
    residents = Stills(stills[:2])
    assert residents.add(stills) == 2
    assert residents.add(stills) == 0
    whole = Stills(stills)
    assert len(residents) == len(whole) == 4
    torch.testing.assert_close(residents.spp, whole.spp)
    torch.testing.assert_close(residents.chance, whole.chance)


def test_shrunk_crops_have_the_noise_of_four_times_the_samples():
    """Many renders of a ramp: their spread after shrinking is what the deviations say."""
    rng = torch.Generator().manual_seed(7)
    ramp = torch.linspace(0.5, 2.0, 32).expand(32, 32)
    deviation = 0.3 * ramp
    count = 400
    planes = torch.zeros(count, PLANES, 32, 32)
    colour = ramp + deviation * torch.randn(count, 1, 32, 32, generator=rng)
    planes[:, :3] = colour
    noisy = Rows(planes, torch.ones(count, len(NAMES)), planes[:, :4], torch.full((count,), 8.0))
    noisy.layer("colour_std")[:] = deviation
    noisy.target = torch.cat([colour.expand(-1, 3, -1, -1), deviation.expand(count, 1, 32, 32)], 1)
    small = changes.shrunk(noisy)
    assert small.planes.shape[2:] == small.target.shape[2:] == (16, 16)
    assert float(small.spp[0]) == 32
    torch.testing.assert_close(
        small.planes[:, 0].mean(0), F.avg_pool2d(ramp[None], 2)[0], atol=0.06, rtol=0
    )
    spread = small.planes[:, 0].std(0)
    told = small.layer("colour_std")[0, 0]
    assert float((spread / told).mean()) == pytest.approx(1, abs=0.02)
    torch.testing.assert_close(small.target[:, 3], small.layer("colour_std")[:, 0])


def test_thinned_samples_have_the_same_mean_and_say_how_noisy_they_are():
    rng = torch.Generator().manual_seed(3)
    count, n, level, deviation = 64, 16, 0.7, 0.2  # deviation: of the mean of n samples
    planes = torch.zeros(count, PLANES, 24, 24)
    planes[:, :3] = level + deviation * torch.randn(count, 1, 24, 24, generator=rng)
    rows = Rows(
        planes,
        torch.ones(count, len(NAMES)),
        torch.zeros(count, 4, 24, 24),
        torch.full((count,), float(n)),
    )
    rows.layer("colour_std")[:] = deviation
    changes.thinned(rows, rng)
    assert float(rows.planes[:, :3].mean()) == pytest.approx(level, rel=0.02)
    spread = rows.planes[:, 0].std((1, 2))
    told = rows.layer("colour_std").square().mean((1, 2, 3)).sqrt()
    assert float((spread / told).mean()) == pytest.approx(1, abs=0.06)
    assert float(spread.max()) > 1.3 * deviation
    one = Rows(planes[:, :, :8, :8], rows.there, rows.target, torch.ones(count))
    one.planes[:, :3] = 1.0
    changes.thinned(one, rng)
    empty = (one.planes[:, 0] == 0).float().mean()
    assert 0.2 < float(empty) < 0.8  # pixels without light


def test_haze_adds_its_light_and_tells_its_noise():
    count, samples = 4000, 16
    planes = torch.zeros(count, PLANES, 8, 8)
    planes[:, :3] = 0.5
    planes[:, AT["albedo"]] = 0.8
    target = torch.full((count, 4, 8, 8), 0.5)
    names = torch.ones(count, len(NAMES))
    rows = Rows(planes, names, target, torch.full((count,), float(samples)))
    changes.hazed(rows, torch.Generator().manual_seed(6))
    light = rows.planes[:, :3].mean((2, 3))
    wanted = rows.target[:, :3].mean((2, 3))
    assert float((light / wanted).mean()) == pytest.approx(1, abs=0.01)
    assert float(wanted.max()) > 0.6  # there is fog
    spread = rows.planes[:, :3].mean(1).var((1, 2))
    told = rows.layer("colour_std").square().mean((1, 2, 3))
    assert float(told.sum() / spread.sum()) == pytest.approx(1, abs=0.15)
    albedo = rows.layer("albedo")
    told = rows.layer("albedo_std").square().mean((1, 2, 3)).sum()
    assert float(told / albedo.mean(1).var((1, 2)).sum()) == pytest.approx(1, abs=0.15)
    assert 0 < float(albedo.min()) < 0.7
    assert float(albedo.max()) == pytest.approx(0.8)


def test_some_batches_are_shrunk(stills, monkeypatch):
    residents = Stills(stills)
    monkeypatch.setattr(batches, "LEAST", 16)
    edge = residents.edge
    found = set()
    for step in range(8):
        packed, colour, divisor, target, deviation, preference = batches.batch_of(
            residents, 1, step, 2
        )
        rows = len(packed)
        found.add((rows, colour.shape[2]))
        assert packed.shape[2] * 2 == colour.shape[2] == target.shape[2] == deviation.shape[2]
        assert len(colour) == len(divisor) == len(target) == len(preference) == rows
        assert bool(torch.isfinite(packed).all())
    assert found == {(2, edge), (8, edge // 2)}


def test_batches_follow_from_seed_and_step(stills):
    residents = Stills(stills)
    a, b, c = (batches.batch_of(residents, 1, step, 4) for step in (5, 5, 6))
    assert all(torch.equal(x, y) for x, y in zip(a, b, strict=True))
    assert not torch.equal(a[0], c[0])
    assert all(bool(torch.isfinite(part).all()) for part in a)


def test_turning_keeps_normals_of_unit_length(rows):
    before = rows.layer("normal").norm(dim=1).mean()
    light = rows.target.sum((2, 3))
    turned = changes.turned(rows, torch.Generator().manual_seed(2))
    assert float(turned.layer("normal").norm(dim=1).mean()) == pytest.approx(float(before))
    torch.testing.assert_close(turned.target.sum((2, 3)), light)
    q = changes.rotations(64, torch.Generator().manual_seed(0))
    eye = torch.eye(3).expand(64, 3, 3)
    torch.testing.assert_close(q @ q.mT, eye, atol=1e-5, rtol=0)
    assert {round(float(d)) for d in torch.linalg.det(q)} == {-1, 1}


def test_paint_is_in_albedo_and_light_alike(rows):
    light = rows.target[:, :3] / rows.layer("albedo").clamp_min(1e-3)
    albedo = rows.layer("albedo").clone()
    changes.painted(rows, torch.Generator().manual_seed(2))
    again = rows.target[:, :3] / rows.layer("albedo").clamp_min(1e-3)
    torch.testing.assert_close(light, again, rtol=1e-3, atol=1e-3)
    assert float((rows.layer("albedo") - albedo).abs().mean()) > 0.02


def test_shadows_are_in_the_light_alone(rows):
    planes, target = rows.planes.clone(), rows.target.clone()
    changes.shaded(rows, torch.Generator().manual_seed(4))
    torch.testing.assert_close(rows.planes[:, 3:11], planes[:, 3:11], rtol=0, atol=0)
    gain = rows.target[:, :3] / target[:, :3].clamp_min(1e-4)
    noisy = rows.planes[:, :3] / planes[:, :3].clamp_min(1e-4)
    lit = (target[:, :3] > 1e-2) & (planes[:, :3] > 1e-2)
    torch.testing.assert_close(gain[lit], noisy[lit], rtol=1e-3, atol=1e-3)
    assert float(gain[lit].std()) > 0.1


def test_relief_bends_normals_and_light_alike(rows):
    before = Rows(rows.planes.clone(), rows.there.clone(), rows.target.clone(), rows.spp)
    rows.there[0, NAMES.index("normal")] = 0
    changes.embossed(rows, torch.Generator().manual_seed(4))
    normal, old = rows.layer("normal"), before.layer("normal")
    there = (old.norm(dim=1) > 0.3) & (rows.there[:, NAMES.index("normal"), None, None] > 0)
    torch.testing.assert_close(normal.norm(dim=1), old.norm(dim=1), atol=1e-4, rtol=1e-4)
    cosine = F.cosine_similarity(normal, old, dim=1)[there]
    assert 0.5 < float(cosine.mean()) < 0.999
    # one factor for all of it; and none where there are no normals
    lit = before.planes[:, :1].abs() > 1e-3
    factor = (rows.planes[:, :1] / before.planes[:, :1])[lit]
    assert float(factor.std()) > 0.02
    assert 1 / 8.1 < float(factor.min()) < float(factor.max()) < 8.1
    own = rows.planes[:, :1] / before.planes[:, :1].clamp_min(1e-6)
    torch.testing.assert_close(
        rows.target[:, :3][lit.expand(-1, 3, -1, -1)],
        (before.target[:, :3] * own)[lit.expand(-1, 3, -1, -1)], atol=1e-4, rtol=1e-3,
    )  # fmt: skip
    torch.testing.assert_close(rows.planes[0], before.planes[0])
    torch.testing.assert_close(rows.layer("albedo"), before.layer("albedo"))


def test_a_collage_shows_one_or_the_other_and_tells_its_noise():
    count, samples_ = 3000, 8
    planes = torch.zeros(count, PLANES, 8, 8)
    planes[:, :3, :4] = 1.0  # above bright, below dark; turned the other way round
    planes[:, AT["albedo"]] = planes[:, :3]
    target = torch.cat([planes[:, :3], torch.full((count, 1, 8, 8), 0.1)], 1)
    there = torch.ones(count, len(NAMES))
    rows = Rows(planes.clone(), there, target.clone(), torch.full((count,), float(samples_)))
    changes.collaged(rows, torch.Generator().manual_seed(2))
    light, wanted = rows.planes[:, 0], rows.target[:, 0]
    assert float((light - wanted).mean()) == pytest.approx(0, abs=2e-3)
    assert float((light * samples_ - (light * samples_).round()).abs().max()) < 1e-5
    told = rows.layer("colour_std")[:, 0].square().mean()
    assert float(told / (light - wanted).square().mean()) == pytest.approx(1, abs=0.1)
    torch.testing.assert_close(rows.layer("albedo")[:, 0], light)  # every layer alike
    assert float(rows.target[:, 3].max()) == pytest.approx(0.1, abs=1e-4)
    assert 0.2 < float((wanted[:, :4] < 0.5).float().mean()) < 0.8
    one = Rows(planes.clone(), there, target.clone(), torch.ones(count))
    changes.collaged(one, torch.Generator().manual_seed(2))
    assert set(one.planes[:, :3].unique().tolist()) == {0.0, 1.0}


@pytest.mark.parametrize("albedo", [True, False])
def test_the_guess_of_samples_is_that_of_run_time(albedo):
    rng = torch.Generator().manual_seed(5)
    x = 0.3 + torch.tensor([0.3, 0.05, 0.004, 0.0])[:, None, None, None] * torch.randn(
        4, 3, 40, 40, generator=rng
    )
    found = batches.guessed(x, torch.full((4,), albedo))
    for i in range(3):
        d = np.full((40, 40, 3), 0.95, np.float32) if albedo else None
        one = samples.guess(x[i].numpy().transpose(1, 2, 0), d, 1.0)
        assert float(found[i]) == pytest.approx(np.log2(one), abs=0.05)
    assert found[0] < found[1] < found[2]
    assert found[3] == 0  # no evidence


def test_only_what_tells_neither_samples_nor_variance_is_guessed(rows):
    masks = torch.ones(8, len(inputs.MASKS))
    deviations = list(inputs.MASKS).index("colour_std")
    masks[4:, deviations] = 0
    rows.there[:] = 1
    spp = torch.tensor([8.0, 0, 8, 0] * 2)
    packed = batches.ready(rows, masks, spp, torch.zeros(8))[0]
    size, known = packed[:, -3, 0, 0] * 10, packed[:, -2, 0, 0]
    assert known.tolist() == [1, 0, 1, 0] * 2
    assert size[:4].tolist() == pytest.approx([3, 0, 3, 0])
    assert size[[4, 6]].tolist() == pytest.approx([3, 3])
    assert (size[[5, 7]] > 0).all()


def test_patterns_have_edges_soft_and_sharp():
    found = changes.pattern(64, 64, 64, torch.Generator().manual_seed(0))
    assert found.shape == (64, 1, 64, 64)
    assert 0 <= float(found.min()) < 0.01
    assert 0.99 < float(found.max()) <= 1
    steepest = (found[..., 1:] - found[..., :-1]).abs().amax((1, 2, 3))
    assert float(steepest.min()) < 0.2
    assert float(steepest.max()) > 0.7


def test_lamps_stand_still(rows, monkeypatch):
    monkeypatch.setattr(lamps, "MOST", 1)
    before = rows.target.clone()
    lamps.lit(rows, torch.Generator().manual_seed(3))
    changed = (rows.target[:, :3] - before[:, :3]).abs().amax(1)
    noisy = rows.planes[:, :3].amax(1)
    full = rows.target[:, 3] < 1e-6 * before[:, 3].clamp_min(1e-9)  # nothing but the lamp is seen
    full &= changed > 0.1
    assert int(full.sum()) > 20
    ratio = noisy[full] / rows.target[:, :3].amax(1)[full]
    torch.testing.assert_close(ratio, torch.ones_like(ratio), rtol=1e-3, atol=1e-3)


def test_layers_are_kept_as_often_as_they_shall():
    class Some:
        planes = torch.zeros(4000, 1)

    masks, spp = changes.without_some(Some, torch.ones(4000), torch.Generator().manual_seed(0))
    whole, none = masks.all(1).float().mean(), (masks == 0).all(1).float().mean()
    rest = 1 - changes.ALL - changes.PLAIN - changes.COLOUR
    assert float(whole) == pytest.approx(changes.ALL + rest * 0.6**7, abs=0.03)
    assert float(none) == pytest.approx(changes.COLOUR + rest * 0.4**7, abs=0.03)
    assert float((spp == 0).float().mean()) == pytest.approx(changes.UNTOLD, abs=0.03)


@pytest.mark.parametrize("together", [1, 3])
def test_a_run_resumes(tmp_path, monkeypatch, together):
    monkeypatch.setitem(denoising.TOGETHER, "cpu", together)  # as on a GPU: stopped amid a draw
    recipe = TrainRecipe(
        name="resident", size="fast", steps=4, batch=2, warmup=1, check_every=4, checked=2,
        held_out=0.0,
    )  # fmt: skip
    task = DenoisingTask(recipe, made.stills(tmp_path))
    whole = train(recipe, task, tmp_path / "whole", "cpu").weights()
    for steps in (2, 4):
        pieces = train(recipe, task, tmp_path / "pieces", "cpu", steps=steps)
    assert all(torch.equal(whole[name], value) for name, value in pieces.weights().items())


def test_batches_of_one_draw_are_its_parts(stills, tmp_path, monkeypatch):
    recipe = TrainRecipe(name="x", size="fast", batch=2, held_out=0.0)
    task = DenoisingTask(recipe, stills)
    monkeypatch.setitem(denoising.TOGETHER, "cpu", 3)
    residents = Stills(stills)
    for step, batch in zip(range(2, 8), task.batches(2, 0, 1), strict=False):
        assert batch == (step, 0, 2)
        whole = batches.batch_of(residents, recipe.seed, step // 3, 6)
        parts = [part.chunk(3)[step % 3] for part in whole]
        found = task.tensors(batch)
        assert all(torch.equal(a, b) for a, b in zip(found, parts, strict=True))


INTERPRETED = """
import torch
from lambent.learn.networks import kernel_pyramid as plain, pyramid_cuda as triton
plain.available = lambda: False
torch.manual_seed(0)
for packed, above, (h, w) in (
    (True, True, (8, 12)), (False, True, (6, 4)), (False, False, (4, 4)), (True, False, (6, 8))
):
    count = (144 if packed else 35) if above else 100 if packed else 25
    z = torch.randn(2, count, h // 2 if packed else h, w // 2 if packed else w)
    z = z.to(memory_format=torch.channels_last)
    image, coarse = torch.rand(2, 6, h, w), torch.rand(2, 6, h // 2, w // 2) if above else None
    found = []
    for average in (plain.average, triton.average):
        a, b = z.clone().requires_grad_(), image.clone().requires_grad_()
        c = coarse.clone().requires_grad_() if above else None
        out = average(a, b, c, packed)
        (out * torch.arange(out.numel()).reshape(out.shape).sin()).sum().backward()
        found.append([out.detach(), a.grad, b.grad, *([c.grad] if above else [])])
    for one, two in zip(*found):
        torch.testing.assert_close(one, two, atol=1e-5, rtol=1e-4)
print("alike")
"""


def test_the_kernels_for_cuda_are_the_plain_tensors():
    environment = {**os.environ, "TRITON_INTERPRET": "1"}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", INTERPRETED],
        capture_output=True, text=True, env=environment, timeout=300,
    )  # fmt: skip
    assert done.stdout.strip() == "alike", done.stderr[-2000:]
