"""The statistics that benchmark frames carry are those of the samples."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

if importlib.util.find_spec("mitsuba") is None:
    pytest.skip("needs the extra `bench`", allow_module_level=True)
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import frames

mi = frames.start_mitsuba()  # before anything imports Dr.Jit, which looks for LLVM only once

import sampling


def moments_of(samples):
    """The record for samples ``(N, H, W, C)``, straight from the definitions."""
    d = samples - samples.mean(0)
    half = samples[::2, ..., :3].mean(0), samples[1::2, ..., :3].mean(0)
    return sampling.Moments(len(samples), samples.mean(0), (d**2).sum(0), (d**3).sum(0), *half)


def small_scene(radiance=1.0):
    """A matte cube of albedo 0.5 in a white furnace, 24x16."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 32, "rr_depth": 32},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 24, "height": 16, "rfilter": {"type": "box"}},
            },
            "light": {"type": "constant", "radiance": radiance},
            "block": {"type": "cube", "bsdf": {"type": "diffuse", "reflectance": 0.5}},
        }
    )


def test_adding_passes_gives_the_moments_of_all_samples():
    rng = np.random.default_rng(5)
    samples = rng.lognormal(size=(40, 2, 3, 4))
    both = moments_of(samples[:24]) + moments_of(samples[24:])
    once = moments_of(samples)
    assert both.count == once.count == 40
    for name in ("mean", "m2", "m3", "half_a", "half_b"):
        np.testing.assert_allclose(getattr(both, name), getattr(once, name), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(once.variance, samples.var(0, ddof=1) / 40, rtol=1e-12)


def test_welford_gives_the_moments_of_the_samples():
    """The update that runs in the kernel, here with plain numbers; the last channel has a third."""
    values = np.random.default_rng(2).gamma(1.5, size=(30, 2))
    mean, m2, m3 = [0.0, 0.0], [0.0, 0.0], [0.0]
    for n, (x, y) in enumerate(values, 1):
        mean, m2, m3 = sampling._welford(n, [x, y], mean, m2, m3)
    d = values - values.mean(0)
    np.testing.assert_allclose(mean, values.mean(0))
    np.testing.assert_allclose(m2, (d**2).sum(0))
    np.testing.assert_allclose(m3, (d[:, 1:] ** 3).sum(0))


def test_furnace_known_answers():
    """What misses sees 1 exactly; a convex body reflects its albedo; features are flat."""
    found = sampling.sample(small_scene(), 16, seed=3)
    colour, albedo = found.mean[..., :3], found.mean[..., 3:6]
    assert colour[0, 0] == pytest.approx([1, 1, 1], abs=1e-5)
    centre = slice(6, 10), slice(10, 14)
    error = np.sqrt(found.variance[centre][..., 0].sum()) / 16
    assert colour[centre].mean() == pytest.approx(0.5, abs=5 * error)
    assert albedo[8, 12] == pytest.approx([0.5] * 3, abs=1e-6)
    assert found.mean[8, 12, 8] == pytest.approx(1, abs=1e-6)  # normal z, towards the camera
    assert found.mean[8, 12, 9] == pytest.approx(4, abs=0.05)  # depth
    assert abs(found.m2[0, 0]).max() < 1e-8
    assert found.half_a[0, 0] == pytest.approx(found.half_b[0, 0], abs=1e-6)


def test_samples_in_one_pass_and_in_two_have_the_same_distribution():
    """Mean over the picture of two independent estimates, within six standard errors."""
    scene = small_scene()
    one = sampling.sample(scene, 64, seed=1)
    two = sampling.sample(scene, 32, seed=2) + sampling.sample(scene, 32, seed=9)
    error = np.sqrt((one.variance + two.variance).sum((0, 1)))
    gap = np.abs((one.mean - two.mean).sum((0, 1)))
    assert np.all(gap <= 6 * error + 1e-3)
    ratio = one.variance[..., 3:13].sum() / two.variance[..., 3:13].sum()
    assert 0.5 < ratio < 2


def test_agrees_with_mitsubas_own_film():
    scene = small_scene()
    ours = sampling.sample(scene, 256, seed=4)
    theirs = np.array(mi.render(scene, spp=256, seed=5))[..., :3]
    error = np.sqrt(2 * ours.variance[..., :3]) + 1e-4
    assert np.abs(ours.mean[..., :3] - theirs).max() <= 6 * error.max()


def test_a_reference_goes_on_where_it_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(frames, "REFERENCE_PASS", 8)
    scene, checkpoint = small_scene(), tmp_path / "sums.npz"
    first = frames.reference(scene, 8, checkpoint)
    more = frames.reference(scene, 24, checkpoint)
    at_once = frames.reference(scene, 24, tmp_path / "other.npz")
    assert (first.count, more.count) == (8, 24)
    np.testing.assert_array_equal(more.mean, at_once.mean)
