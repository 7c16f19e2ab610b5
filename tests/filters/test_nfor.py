"""NFOR as in the paper: against its steps in plain NumPy, sums of layers, and what it must do."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.errors import LayerError, OptionError
from lambent.filters.denoiser import create
from lambent.filters.nfor import _RIDGE, NFOR, estimated_error
from lambent.filters.nfor_tuned import NFORTuned
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role, Stat
from lambent.kernels.regression import QUIET


def rendered(height=15, width=17, noise=0.3, seed=0, feature_noise=0.1):
    """A shaded stripe pattern seen by 8 samples, with halves of the colour and of the albedo."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    albedo = (0.5 + 0.3 * np.sin(x / 2 + y / 5))[..., None] * np.array([1, 0.8, 0.6])
    depth = 3 + y / height
    clean = albedo * (0.4 + x[..., None] / width)
    samples = clean + noise * np.sqrt(clean) * rng.standard_normal((8, height, width, 3))
    seen = albedo + feature_noise * rng.standard_normal((8, height, width, 3))
    frame = Frame.from_arrays(
        spp=8,
        colour=samples.mean(0),
        colour_variance=samples.var(0, ddof=1) / 8,
        colour_half_a=samples[::2].mean(0),
        colour_half_b=samples[1::2].mean(0),
        albedo=seen.mean(0),
        albedo_variance=seen.var(0, ddof=1) / 8,
        albedo_half_a=seen[::2].mean(0),
        albedo_half_b=seen[1::2].mean(0),
        depth=depth,
    )
    return frame, clean.astype(np.float32)


# ------------------------------------------------------------------ the twin


def windows(height, width, radius):
    """(centre, neighbour) of every pair inside the image."""
    for cy in range(height):
        for cx in range(width):
            for qy in range(max(0, cy - radius), min(height, cy + radius + 1)):
                for qx in range(max(0, cx - radius), min(width, cx + radius + 1)):
                    yield (cy, cx), (qy, qx)


def pixel_distance(u, v, c, q, k):
    """Of two pixels, channel by channel; ε is too small to matter where there is variance."""
    apart = (u[c] - u[q]) ** 2 - (v[c] + np.minimum(v[c], v[q]))
    return np.minimum(apart / (1e-10 + k * k * (v[c] + v[q])), 1e4)


def patch_pairs(guide, variance, c, q, patch, k):
    """Distances of the pixels of two patches, those pairs that are inside the image."""
    height, width = guide.shape[:2]
    up, left = (-min(patch, *pair) for pair in zip(c, q, strict=True))
    down, right = (
        min(patch, size - 1 - max(pair)) + 1
        for size, pair in zip((height, width), zip(c, q, strict=True), strict=True)
    )
    here, there = (np.s_[y + up : y + down, x + left : x + right] for y, x in (c, q))
    return pixel_distance(guide, variance, here, there, k).reshape(-1, guide.shape[2])


def nlm(image, guide, variance, radius, patch, k):
    """NLM on one channel: pairs of the patch inside the image count."""
    height, width = image.shape[:2]
    total, mass = np.zeros_like(image, np.float64), np.zeros((height, width, 1))
    for (cy, cx), (qy, qx) in windows(height, width, radius):
        found = patch_pairs(guide, variance, (cy, cx), (qy, qx), patch, k)
        w = np.exp(-max(0.0, float(np.mean(found))))
        total[cy, cx] += w * image[qy, qx]
        mass[cy, cx] += w
    return total / mass


def regression(image, guide, variance, features, radius, patch, k):
    """Collaborative, by `lstsq` (SVD) and not by normal equations; the least weight of channels."""
    height, width = image.shape[:2]
    weights = {}
    for c, q in windows(height, width, radius):
        found = patch_pairs(guide, variance, c, q, patch, k)
        weights.setdefault(c, {})[q] = np.exp(-np.maximum(0, np.mean(found, axis=0))).min()
    total, mass = 1e-4 * image.astype(np.float64), np.full((height, width, 1), 1e-4)
    for c, near in weights.items():
        X = np.array(
            [
                [1, (q[1] - c[1]) / radius, (q[0] - c[0]) / radius, *(features[q] - features[c])]
                for q in near
            ]
        )
        w = np.array(list(near.values()))
        Y = np.array([image[q] for q in near], np.float64)
        root = np.sqrt(w)[:, None]
        # The damping of the kernel as rows below: windows with few likes are near singular.
        energy = w @ X**2
        damped = np.sqrt(_RIDGE * energy + QUIET**2 * energy[0]) * (np.arange(X.shape[1]) > 0)
        rows = np.concatenate([root * X, np.diag(damped)])
        sides = np.concatenate([root * Y, np.zeros((X.shape[1], 3))])
        planes = X @ np.linalg.lstsq(rows, sides, rcond=1e-9)[0]
        for q, wq, plane in zip(near, w, planes, strict=True):
            total[q] += wq * plane
            mass[q] += wq
    return total / mass


def twin(frame, radius, patch):
    """Sections 5.1 to 5.4 in double precision."""
    a, b = (frame[Role.COLOUR, s].astype(np.float64) for s in (Stat.HALF_A, Stat.HALF_B))
    colour, v = (
        frame.colour.astype(np.float64),
        frame[Role.COLOUR, Stat.VARIANCE].astype(np.float64),
    )
    depth = np.log(frame[Role.DEPTH] / np.median(frame[Role.DEPTH])).astype(np.float64)
    fa, fb, both = [], [], []
    for c in range(3):
        part = slice(c, c + 1)
        ha, hb = (
            frame[Role.ALBEDO, s][:, :, part].astype(np.float64) for s in (Stat.HALF_A, Stat.HALF_B)
        )
        vf = frame[Role.ALBEDO, Stat.VARIANCE][:, :, part].astype(np.float64)
        fa.append(nlm(ha, hb, 2 * vf, 5, 3, 0.5))
        fb.append(nlm(hb, ha, 2 * vf, 5, 3, 0.5))
        both.append(nlm(*[(fa[-1] + fb[-1]) / 2] * 2, (fb[-1] - fa[-1]) ** 2 / 4, 2, 3, 0.5))
    fa, fb, both = (np.concatenate([*f, depth], axis=2) for f in (fa, fb, both))
    fits, errors = [], []
    for k in (0.5, 1.0):
        fit_a = regression(a, b, 2 * v, fb, radius, patch, k)
        fit_b = regression(b, a, 2 * v, fa, radius, patch, k)
        fits.append((fit_a, fit_b))
        apart = ((b - fit_a) ** 2 - 2 * v + (a - fit_b) ** 2 - 2 * v) / 2 - (fit_b - fit_a) ** 2 / 4
        errors.append(
            [nlm(apart[..., [c]], colour[..., [c]], v[..., [c]], 9, 1, 1.0) for c in range(3)]
        )
    share = np.concatenate(
        [
            nlm((errors[0][c] >= errors[1][c]) * 1.0, colour[..., [c]], v[..., [c]], 9, 1, 1.0)
            for c in range(3)
        ],
        axis=2,
    )
    one, two = (narrow + share * (wide - narrow) for narrow, wide in zip(*fits, strict=True))
    result, spread = (one + two) / 2, (two - one) ** 2 / 4
    return result, regression(result, result, 2 * spread, both, radius, patch, 1.0)


def test_the_steps_of_the_paper():
    """Single precision, Cholesky and a small ridge here; double precision and SVD there."""
    frame, _ = rendered(8, 9)
    once, twice = twin(frame, 3, 1)
    found = NFOR(radius=3, patch=1, second=False)(frame).colour
    np.testing.assert_allclose(found, once, atol=5e-3)
    assert np.abs(found - once).mean() < 3e-4
    found = NFOR(radius=3, patch=1)(frame).colour
    np.testing.assert_allclose(found, twice, atol=1e-2)
    assert np.abs(found - twice).mean() < 3e-4
    assert np.abs(twice - once).mean() > 3e-4  # the second regression does something


def test_error_estimate_is_unbiased():
    """A fit that knows nothing of the halves: the mean estimate is its squared error."""
    rng = np.random.default_rng(2)
    truth = np.full((200, 200, 3), 2.0, np.float32)
    fit = truth + np.float32(0.3)
    a, b = (truth + 0.5 * rng.standard_normal(truth.shape).astype(np.float32) for _ in range(2))
    variance = np.full_like(truth, 0.25 / 2)
    estimate = estimated_error(fit, fit, a, b, variance).mean()
    assert estimate == pytest.approx(0.09, abs=0.01)


def test_lowers_the_error():
    frame, clean = rendered(48, 56, feature_noise=0.0)
    before = np.mean((frame.colour - clean) ** 2)
    result = NFOR()(frame)
    assert np.mean((result.colour - clean) ** 2) < before / 8
    assert not NFOR().remarks(frame)


def test_layers_still_sum():
    """Lighting layers are divided between the halves as the beauty is; alpha is not."""
    frame, _ = rendered(32, 36, noise=0.1)
    part = np.random.default_rng(1).random((32, 36, 1)).astype(np.float32)
    key = frame.colour * part
    lights = Frame.from_arrays(lighting={"key": key, "fill": frame.colour - key})
    for layer in [*lights.all_layers(), Layer(Role.ALPHA, np.full((32, 36, 1), 0.5, np.float32))]:
        frame = frame.with_layer(layer)
    result = NFOR()(frame)
    together = result.extras["key"].data + result.extras["fill"].data
    np.testing.assert_allclose(together, result.colour, atol=2e-4)
    alpha = NFOR()(frame, passes="beauty,alpha").layer(Role.ALPHA)
    np.testing.assert_allclose(alpha.data, 0.5, rtol=2e-4)
    apart = result.extras["key"].data - NFOR().fitted(frame).filter(frame, key)
    assert np.abs(apart).max() > 1e-3  # crossing the halves matters


def test_filter_is_linear_with_weights_that_sum_to_one():
    frame, _ = rendered(24, 30)
    denoiser = NFOR().fitted(frame)
    flat = np.full((24, 30, 1), 2.5, np.float32)
    np.testing.assert_allclose(denoiser.filter(frame, flat), flat, rtol=5e-5)
    part = np.random.default_rng(1).random((24, 30, 3)).astype(np.float32)
    stack = np.concatenate([frame.colour, part, frame.colour - part], axis=2)
    result = denoiser.filter(frame, stack)
    np.testing.assert_allclose(result[:, :, :3], result[:, :, 3:6] + result[:, :, 6:], atol=2e-4)


def test_without_halves_the_frame_is_refused_and_the_tuned_form_named():
    frame, _ = rendered(24, 30)
    alone = frame.without((Role.COLOUR, Stat.HALF_A), (Role.COLOUR, Stat.HALF_B))
    with pytest.raises(LayerError, match=r"colour\.half_a") as caught:
        NFOR()(alone)
    assert caught.value.remedy.startswith("take the model nfor-tuned")
    assert np.isfinite(NFORTuned()(alone).colour).all()


def test_a_grey_beauty_stays_of_one_channel():
    frame, _ = rendered(16, 18)
    grey = {
        name: frame[key].mean(axis=2, keepdims=True)
        for name, key in (
            ("colour", (Role.COLOUR, Stat.MEAN)),
            ("colour_variance", (Role.COLOUR, Stat.VARIANCE)),
            ("colour_half_a", (Role.COLOUR, Stat.HALF_A)),
            ("colour_half_b", (Role.COLOUR, Stat.HALF_B)),
        )
    }
    result = NFOR(radius=3)(Frame.from_arrays(spp=8, **grey))
    assert result[Role.COLOUR].shape == (16, 18, 1)


def test_tiles_equal_the_whole():
    denoiser = NFOR(radius=2, patch=1)
    margin = denoiser.margin()
    frame, _ = rendered(12, 2 * margin + 20)
    fitted = denoiser.fitted(frame)
    whole = fitted(frame).colour
    tile = fitted.filter_layers(
        frame.crop(0, 12, 4, 2 * margin + 14),
        [frame.crop(0, 12, 4, 2 * margin + 14).layer(Role.COLOUR)],
    )[0]
    np.testing.assert_allclose(
        tile[:, margin : margin + 10], whole[:, margin + 4 : margin + 14], atol=1e-4
    )


def test_without_llvm_of_our_own_the_result_is_the_same(monkeypatch):
    """On a GPU, or where LLVM's library is not found by name, Dr.Jit's kernels do the work."""
    frame, _ = rendered(20, 26)
    fast = NFOR(radius=3)(frame).colour
    monkeypatch.setattr("lambent.filters.nfor.available", lambda device: False)
    np.testing.assert_allclose(NFOR(radius=3)(frame).colour, fast, atol=2e-4)


def test_options():
    assert create("nfor", radius="5", second="no") == NFOR(radius=5, second=False)
    for wrong in ({"stride": "0"}, {"radius": "0"}):
        with pytest.raises(OptionError, match="paper"):
            create("nfor", **wrong)
