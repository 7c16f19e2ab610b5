"""The model that is chosen by the file, and the mean of two denoisers that it may be."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import lambent
from lambent.denoise.auto import choose
from lambent.denoise.files import denoise_file
from lambent.denoise.sequence import denoise_sequence
from lambent.filters.denoiser import create
from lambent.frame.role import Role
from lambent.frame.stamp import STAMP

SIZE = (96, 128)


def tent(image: np.ndarray) -> np.ndarray:
    """Noise as a splatted tent filter of radius 1 makes it: neighbours correlate by 0.3."""
    for axis in (0, 1):
        image = 0.76 * image + 0.12 * (np.roll(image, 1, axis) + np.roll(image, -1, axis))
    return image


def noisy(splatted: bool, seed: int = 0, dark: bool = False) -> lambent.Frame:
    """A frame whose colour is direct + indirect light; ``dark``: of which none is blue."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]] / SIZE[1]
    albedo = np.stack([0.3 + 0.4 * x, 0.5 + 0.3 * y, 0.6 - 0.3 * x], axis=2)
    lights = []
    for level in (0.8, 0.3):
        noise = rng.gamma(2.0, 0.5, (*SIZE, 3))
        light = albedo * level * (tent(noise) if splatted else noise)
        if dark:
            light[:, :, 2] = 0
        lights.append(light.astype(np.float32))
    return lambent.Frame.from_arrays(
        colour=lights[0] + lights[1],
        albedo=albedo.astype(np.float32),
        lighting={"direct": lights[0], "indirect": lights[1]},
    )


def test_a_splatted_filter_gets_lambent_any_other_file_the_mean() -> None:
    splat, white = choose(noisy(splatted=True)), choose(noisy(splatted=False))
    assert splat.model == "lambent"
    assert "correlates by" in splat.reason
    assert white.model == "lambent-oidn"


def test_a_photograph_gets_oidn(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    lambent.write(path, lambent.Frame.from_arrays(colour=noisy(splatted=True).colour))
    assert choose(lambent.read(path)).model == "oidn"


@pytest.mark.parametrize("splatted", [True, False])
def test_the_library_chooses_and_says_so(splatted: bool) -> None:
    frame = noisy(splatted)
    name = "lambent" if splatted else "lambent-oidn"
    clean = lambent.denoise(frame)
    assert [n for n in clean.notes if n.startswith(f"chose the model {name}: ")]
    wanted = lambent.denoise(frame, model=name)
    np.testing.assert_array_equal(clean.colour, wanted.colour)
    assert not [n for n in wanted.notes if "chose" in n]
    np.testing.assert_array_equal(create("auto")(frame).colour, wanted.colour)


def test_the_colour_is_the_mean_and_layers_sum_to_it() -> None:
    frame = noisy(splatted=False)
    mean = create("lambent-oidn")(frame)
    both = [create(name)(frame, "beauty").colour for name in ("lambent", "oidn")]
    np.testing.assert_allclose(mean.colour, 0.5 * (both[0] + both[1]), rtol=1e-5)
    parts = [mean.extras[name].data for name in ("direct", "indirect")]
    np.testing.assert_allclose(parts[0] + parts[1], mean.colour, rtol=3e-7, atol=1e-9)
    # in proportion: the ratio of both is what the kernels alone have
    own = [create("lambent")(frame).extras[name].data for name in ("direct", "indirect")]
    np.testing.assert_allclose(parts[0] * own[1], parts[1] * own[0], rtol=1e-4, atol=1e-7)


def test_where_all_layers_are_dark_none_gets_light() -> None:
    frame = noisy(splatted=False, dark=True)
    mean = create("lambent-oidn")(frame)
    parts = [mean.extras[name].data for name in ("direct", "indirect")]
    own = create("lambent")(frame)
    dark = (own.extras["direct"].data == 0) & (own.extras["indirect"].data == 0)
    assert dark[..., 2].all()
    assert not mean.colour[dark].any()
    assert not parts[0][dark].any()
    assert not parts[1][dark].any()
    np.testing.assert_allclose(parts[0] + parts[1], mean.colour, rtol=3e-7, atol=1e-9)


def test_tiles_agree_with_the_whole() -> None:
    rng = np.random.default_rng(3)
    light = rng.gamma(2.0, 0.5, (2, 704, 640, 3)).astype(np.float32)
    frame = lambent.Frame.from_arrays(
        colour=light[0] + light[1], lighting={"direct": light[0], "indirect": light[1]}
    )
    from lambent.denoise.pipeline import Settings, choose_layers
    from lambent.denoise.tiles import filter_tiles, plan_tiles

    denoiser = create("lambent-oidn").fitted(frame)
    layers = choose_layers(frame, Settings.checked(model="lambent-oidn"))
    whole, tiled = (
        filter_tiles(denoiser, frame, layers, plan_tiles(704, 640, 1, denoiser.margin(), budget))
        for budget in (None, 500 * 500)
    )
    for one, other in zip(whole, tiled, strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-3, atol=1e-4)


def test_a_file_says_what_was_chosen(tmp_path: Path) -> None:
    lambent.write(tmp_path / "a.exr", noisy(splatted=True))
    run = [sys.executable, "-m", "lambent", "denoise", tmp_path / "a.exr"]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    assert "with lambent\n" in done.stdout
    lines = [line for line in done.stdout.splitlines() if "chose the model lambent: " in line]
    assert len(lines) == 1
    import OpenEXR

    with OpenEXR.File(str(tmp_path / "a_clean.exr"), header_only=True) as file:
        stamp = json.loads(file.header(0)[STAMP])
    assert stamp["model"] == "auto"
    assert stamp["chosen"] == "lambent"
    run += ["--model", "lambent-oidn", "--dry-run", "-o", tmp_path / "b.exr", "--json"]
    plan = json.loads(subprocess.run(run, capture_output=True, text=True, check=True).stdout)
    assert plan["model"] == "lambent-oidn"


def test_a_shot_has_one_choice_that_survives_resuming(tmp_path: Path) -> None:
    for number in (1, 2, 3):
        lambent.write(tmp_path / f"s.{number:04}.exr", noisy(number == 1, seed=number))
    done = denoise_sequence(tmp_path / "s.####.exr", frames="1-2")
    assert [result.model for result in done.done] == ["lambent", "lambent"]
    again = denoise_sequence(tmp_path / "s.####.exr")
    assert len(again.skipped) == 2
    assert [result.model for result in again.done] == ["lambent"]
    # other files of a folder choose for themselves
    shutil.copy(tmp_path / "s.0001.exr", tmp_path / "t.exr")
    shutil.copy(tmp_path / "s.0002.exr", tmp_path / "u.exr")
    assert denoise_file(tmp_path / "t.exr").model == "lambent"
    assert denoise_file(tmp_path / "u.exr").model == "lambent-oidn"


def test_without_oidn_it_is_lambent_and_says_so(tmp_path: Path) -> None:
    lambent.write(tmp_path / "a.exr", noisy(splatted=False))
    code = (
        "import sys; sys.modules['mitsuba_oidn'] = None; import lambent; "
        f"print(lambent.denoise({str(tmp_path / 'a.exr')!r}).notes)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "chose the model lambent: Open Image Denoise is not installed" in done.stdout


def test_damaged_grey_and_small_frames_are_judged_too() -> None:
    frame = noisy(splatted=True)
    damaged = frame.colour.copy()
    damaged[5, 5] = np.nan
    damaged[60, 9] = np.inf
    layer = frame.layer(Role.COLOUR)
    assert layer is not None
    assert choose(frame.with_layer(layer.with_data(damaged))).model == "lambent"
    grey = frame.with_layer(layer.with_data(frame.colour[:, :, :1]))
    assert choose(grey).model == "lambent"
    assert lambent.denoise(np.zeros((4, 4, 3), np.float32)).colour.shape == (4, 4, 3)
    assert lambent.denoise(np.ones((5, 3, 3), np.float32)).colour.shape == (5, 3, 3)
