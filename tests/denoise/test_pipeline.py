"""The pipeline: strength, alpha, sums, black frames, arrays, settings."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import lambent
from lambent.denoise.pipeline import Settings, clean
from lambent.errors import OptionError, UnknownNameError
from lambent.filters.denoiser import DENOISERS, About, Denoiser
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat


@dataclass(frozen=True)
class Mean(Denoiser):
    """A 3x3 box in NumPy: linear, so sums must survive exactly."""

    about: ClassVar[About] = About("mean", "box", "none")

    def margin(self) -> int:
        return 1

    def filter(self, frame, targets):
        padded = np.pad(targets, ((1, 1), (1, 1), (0, 0)), mode="edge")
        h, w = targets.shape[:2]
        total = sum(padded[i : i + h, j : j + w] for i in range(3) for j in range(3))
        return (total / np.float32(9)).astype(np.float32)


@pytest.fixture(autouse=True)
def mean_model():
    DENOISERS.register("mean", Mean)


def frame(**more) -> Frame:
    rng = np.random.default_rng(3)
    key, fill = rng.exponential(1, (2, 20, 30, 3)).astype(np.float32)
    return Frame.from_arrays(colour=key + fill, lighting={"key": key, "fill": fill}, **more)


def test_lighting_layers_still_sum_at_any_strength():
    for strength in (0.3, 1.0):
        out = lambent.denoise(frame(), model="mean", strength=strength)
        total = out.extras["key"].data + out.extras["fill"].data
        np.testing.assert_allclose(total, out.colour, rtol=1e-5)


def test_strength_is_a_linear_blend():
    noisy = frame()
    full = lambent.denoise(noisy, model="mean").colour
    half = lambent.denoise(noisy, model="mean", strength=0.5).colour
    np.testing.assert_allclose(half, 0.5 * noisy.colour + 0.5 * full, rtol=1e-5)
    none = lambent.denoise(noisy, model="mean", strength=0).colour
    np.testing.assert_array_equal(none, noisy.colour)


def test_passes_choose_layers():
    noisy = frame()
    out = lambent.denoise(noisy, model="mean", passes="key")
    assert not np.array_equal(out.extras["key"].data, noisy.extras["key"].data)
    np.testing.assert_array_equal(out.extras["fill"].data, noisy.extras["fill"].data)
    only = lambent.denoise(noisy, model="mean", passes="beauty")
    np.testing.assert_array_equal(only.extras["key"].data, noisy.extras["key"].data)


def test_the_input_is_never_changed():
    noisy = frame()
    before = noisy.colour.copy()
    lambent.denoise(noisy, model="mean")
    np.testing.assert_array_equal(noisy.colour, before)


def test_variance_of_what_was_filtered_is_dropped():
    noisy = frame(colour_variance=np.ones((20, 30, 3)))
    out = lambent.denoise(noisy, model="mean")
    assert not out.has(Role.COLOUR, Stat.VARIANCE)


def test_black_passes_through_with_a_note():
    black = Frame.from_arrays(colour=np.zeros((8, 8, 3)))
    out = lambent.denoise(black, model="mean")
    assert not out.colour.any()
    assert any("black" in note for note in out.notes)


def test_array_in_frame_out():
    image = np.random.default_rng(0).random((9, 11, 3))
    out = lambent.denoise(image, model="mean", albedo=np.ones((9, 11, 3)))
    assert isinstance(out, Frame)
    assert out.colour.shape == (9, 11, 3)
    assert out.has(Role.ALBEDO)


@pytest.mark.parametrize("verb", ["denoise", "render"])
def test_a_verb_stays_a_function_whatever_is_imported_of_its_package(verb):
    """Python binds a package to its name in the parent when anything in it is imported."""
    script = f"""
        import inspect, pydoc
        import lambent.{verb}.{"tiles" if verb == "denoise" else "scene"}
        from lambent.{verb} import {"files" if verb == "denoise" else "motion"}
        import lambent
        assert inspect.isfunction(lambent.{verb}), lambent.{verb}
        from lambent import {verb}
        assert inspect.isfunction({verb})
        text = pydoc.plain(pydoc.render_doc(lambent.{verb}))
        assert {'"strength:"' if verb == "denoise" else '"spp:"'} in text, text[:400]
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_four_channels_are_colour_and_alpha():
    out = lambent.denoise(np.ones((9, 11, 4)), model="mean")
    assert out.has(Role.ALPHA)


def test_grey_of_one_channel_stays_one_channel():
    out = lambent.denoise(np.random.default_rng(0).random((9, 11)), model="mean")
    assert out[Role.COLOUR].shape == (9, 11, 1)


# ---------------------------------------------------------------------- alpha


def disc(noise: float) -> np.ndarray:
    y, x = np.mgrid[0:80, 0:80]
    edge = np.clip(30 - np.hypot(x - 40, y - 40), 0, 1).astype(np.float32)
    if noise:
        fog = np.random.default_rng(0).uniform(0.5 - noise, 0.5 + noise, edge.shape)
        edge = np.where(edge > 0, fog, 0).astype(np.float32)
    return edge[:, :, None]


@pytest.mark.parametrize(
    ("wanted", "noise", "filtered"),
    [(None, 0, False), (None, 0.3, True), (True, 0, True), (False, 0.3, False)],
)
def test_alpha_is_filtered_where_noisy_or_wanted(wanted, noise, filtered):
    alpha = disc(noise)
    noisy = Frame.from_arrays(colour=np.repeat(alpha, 3, axis=2) + 0, alpha=alpha)
    out = lambent.denoise(noisy, model="mean", alpha=wanted)
    assert np.array_equal(out[Role.ALPHA], alpha) != filtered
    assert 0 <= out[Role.ALPHA].min() <= out[Role.ALPHA].max() <= 1


def test_colour_does_not_spill_beyond_coverage():
    alpha = disc(0)
    noisy = Frame.from_arrays(colour=np.repeat(alpha, 3, axis=2), alpha=alpha)
    out = lambent.denoise(noisy, model="mean")
    outside = alpha[..., 0] == 0
    assert not out.colour[outside].any()


def test_light_without_coverage_is_kept():
    """A glow has radiance where nothing covers: additive light is no spill."""
    alpha = disc(0)
    glow = np.full((80, 80, 3), 0.25, np.float32)
    out = lambent.denoise(Frame.from_arrays(colour=glow, alpha=alpha), model="mean")
    np.testing.assert_allclose(out.colour, glow, rtol=1e-6)


def test_filtered_alone_and_with_alpha_agree_on_colour():
    alpha = disc(0.3)
    noisy = Frame.from_arrays(colour=np.repeat(alpha, 3, axis=2), alpha=alpha)
    out = lambent.denoise(noisy, model="mean", alpha=True)
    # premultiplied white: colour and coverage got the same weights, so they stay equal
    np.testing.assert_allclose(out.colour[..., :1], out[Role.ALPHA], rtol=1e-5)


# ------------------------------------------------------------------- settings


def test_stages_are_timed_and_layers_named():
    done = clean(frame(), Settings.checked(model="mean"))
    assert {"repair", "filter", "blend"} <= set(done.seconds)
    assert set(done.layers) == {"colour", "key", "fill"}


def test_tiles_give_the_same_result():
    rng = np.random.default_rng(5)
    noisy = Frame.from_arrays(colour=rng.random((400, 300, 3), np.float32))
    whole = lambent.denoise(noisy, model="mean").colour
    from lambent import memory
    from lambent.denoise.pipeline import RESERVE

    limit = int((memory.used() + 4 * 3 * 120000 + 10_000_000) / (1 - RESERVE))
    done = clean(noisy, Settings.checked(model="mean", max_memory=limit))
    np.testing.assert_allclose(done.frame.colour, whole, atol=1e-6)


def test_large_frames_report_progress_with_filters_that_cannot_tell():
    noisy = Frame.from_arrays(colour=np.ones((1500, 1500, 3), np.float32))
    calls: list[float] = []
    clean(
        noisy, Settings.checked(model="mean"), lambda done, total, text: calls.append(done / total)
    )
    assert len(calls) >= 3
    assert calls == sorted(calls)
    assert calls[-1] == 1


@pytest.mark.parametrize(
    "options",
    [
        {"strength": 2.0},
        {"strength": -1.0},
        {"strength": float("nan")},
        {"max_memory": "foo"},
        {"threads": 0},
        {"device": "quantum"},
    ],
)
def test_nonsense_is_refused(options):
    with pytest.raises(OptionError):
        Settings.checked(model="mean", **options)


def test_unknown_names_are_refused():
    with pytest.raises(UnknownNameError, match="did you mean oidn"):
        Settings.checked(model="odin")
    with pytest.raises(UnknownNameError, match="albedo"):
        Settings.checked(model="mean", roles={"albdo": "x"})
    with pytest.raises(UnknownNameError):
        Settings.checked(model="mean", params={"radius": 3})


def test_only_what_changes_the_picture_is_in_the_key():
    a = Settings.checked(model="mean", threads=2, max_memory="4G")
    b = Settings.checked(model="mean")
    assert a.key() == b.key()
    assert a.key() != Settings.checked(model="mean", strength=0.5).key()
