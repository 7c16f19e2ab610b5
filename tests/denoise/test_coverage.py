"""Where alpha is noisy: structure of every kind is not, the noise of samples is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import lambent
from lambent.denoise import coverage
from lambent.denoise.coverage import box_count, exact, noisy_coverage
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat

SIDE, FINE = 64, 12
Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]


def frame_of(alpha: np.ndarray, **more) -> Frame:
    """Premultiplied grey light with noise of its own, and the alpha ``(H, W)``."""
    alpha = np.asarray(alpha, np.float32)
    light = np.random.default_rng(7).gamma(4, 0.25, alpha.shape).astype(np.float32)
    colour = np.repeat((alpha * light)[..., None], 3, axis=2)
    return Frame.from_arrays(colour=colour, alpha=alpha[..., None], **more)


# ------------------------------------------------------------------- pixel filters


def box(t: np.ndarray) -> np.ndarray:
    return (np.abs(t) < 0.5).astype(float)


def tent(t: np.ndarray) -> np.ndarray:
    return np.maximum(1 - np.abs(t), 0)


def gauss(t: np.ndarray) -> np.ndarray:
    return np.exp(-2 * t * t) * (np.abs(t) < 2)


def blackman_harris(t: np.ndarray) -> np.ndarray:
    u = t / 3 + 0.5  # 1.5 pixels wide, as in Cycles
    terms = zip((0.35875, -0.48829, 0.14128, -0.01168), range(4), strict=True)
    return np.where((u > 0) & (u < 1), sum(a * np.cos(2 * np.pi * k * u) for a, k in terms), 0)


def mitchell(t: np.ndarray) -> np.ndarray:
    x = np.abs(t)
    inner = (7 * x**3 - 12 * x**2 + 16 / 3) / 6
    outer = (-7 / 3 * x**3 + 12 * x**2 - 20 * x + 32 / 3) / 6
    return np.where(x < 1, inner, np.where(x < 2, outer, 0))


FILTERS = (box, tent, gauss, blackman_harris, mitchell)


def rendered(shape: Shape, pixel_filter: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Coverage without noise: ``shape`` on a fine grid, through a separable filter."""
    at = (np.arange((SIDE + 6) * FINE) + 0.5) / FINE - 3
    image = shape(at[None, :], at[:, None]).astype(np.float64)
    offset = (np.arange(SIDE) + 0.5)[:, None] - at[None, :]
    weights = pixel_filter(offset)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(weights @ image @ weights.T, np.float32)


def half_plane(angle: float) -> Shape:
    return lambda x, y: np.cos(angle) * (x - 32.3) + np.sin(angle) * (y - 31.1) > 0


def disc(radius: float) -> Shape:
    return lambda x, y: np.hypot(x - 32.3, y - 31.6) < radius


def hairs(width: float) -> Shape:
    rng = np.random.default_rng(0)
    lines = list(zip(rng.uniform(0, np.pi, 4), rng.uniform(-25, 25, 4), strict=True))

    def inside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        found = np.zeros(np.broadcast(x, y).shape, bool)
        for angle, shift in lines:
            across = np.cos(angle) * (x - 32) + np.sin(angle) * (y - 32) - shift
            found |= np.abs(across) < width / 2
        return found

    return inside


def boxes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(1)
    found = np.zeros(np.broadcast(x, y).shape, bool)
    for cx, cy, angle in zip(*rng.uniform(8, 56, (2, 10)), rng.uniform(0, 3, 10), strict=True):
        u = np.cos(angle) * (x - cx) + np.sin(angle) * (y - cy)
        v = np.cos(angle) * (y - cy) - np.sin(angle) * (x - cx)
        found |= (np.abs(u) < 4) & (np.abs(v) < 2.5)
    return found


SHAPES: dict[str, Shape] = {
    "edge, flat": half_plane(1.45),
    "edge, 0.3": half_plane(0.3),
    "edge, diagonal": half_plane(np.pi / 4),
    "large disc": disc(25),
    "disc": disc(8),
    "sphere of three pixels": disc(3),
    "hairs": hairs(0.4),
    "lines": hairs(1.0),
    "boxes": boxes,
}


@pytest.mark.parametrize("pixel_filter", FILTERS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("shape", SHAPES)
def test_structure_is_no_noise(shape: str, pixel_filter) -> None:
    """Every pixel filter's edges, at every angle; in half precision and 8 bits, too."""
    alpha = rendered(SHAPES[shape], pixel_filter)
    assert ((alpha > 0.01) & (alpha < 0.99)).any()
    for stored in (alpha, alpha.astype(np.float16), np.round(np.clip(alpha, 0, 1) * 255) / 255):
        assert not noisy_coverage(frame_of(stored)).any()


def test_a_rendered_soft_edge_comes_back_bit_for_bit() -> None:
    """Through the whole pipeline and the default model, in a picture whose colour is noisy."""
    alpha = rendered(disc(20), blackman_harris)
    clean = lambent.denoise(frame_of(alpha))
    np.testing.assert_array_equal(clean[Role.ALPHA][..., 0], alpha)


def test_fog_and_penumbras_without_noise() -> None:
    y, x = np.mgrid[0:64, 0:64]
    for fog in (
        x / 63.0,
        0.5 + 0.3 * np.sin(x / 9) * np.cos(y / 7),
        0.5 + 0.4 * np.sin(x / 2) * np.cos(y / 2.5),
        np.clip((25 - np.hypot(x - 32, y - 32)) / 12, 0, 1),
    ):
        for stored in (fog, fog.astype(np.float16), np.round(fog * 255) / 255):
            assert not noisy_coverage(frame_of(stored)).any()


# --------------------------------------------------------------------------- noise


def covers() -> dict[str, np.ndarray]:
    """Means of coverage that is sampled: depth of field, motion blur, smoke."""
    y, x = np.mgrid[0:80, 0:96]
    apart = np.hypot(x - 48, y - 40)
    ramp = np.clip((x - 15) / 30, 0, 1) * np.clip((85 - x) / 30, 0, 1)
    return {
        "out of focus": np.clip((25 - apart) / 14 + 0.5, 0, 1),
        "moving": ramp * (np.abs(y - 40) < 25),
        "smoke": 0.4 + 0.3 * np.sin(x / 15) * np.cos(y / 11),
        "thin": np.full(x.shape, 0.1),
    }


def sampled(mean: np.ndarray, spp: int, seed: int = 0) -> np.ndarray:
    return (np.random.default_rng(seed).binomial(spp, mean) / spp).astype(np.float32)


@pytest.mark.parametrize("spp", [1, 2, 4, 16, 64])
@pytest.mark.parametrize("cover", covers())
def test_samples_are_noise(cover: str, spp: int) -> None:
    """It is seen in nearly all pixels of partial cover, and in none where cover is whole."""
    mean = covers()[cover]
    partial = (mean > 0.1) & (mean < 0.9) if cover != "thin" else np.ones(mean.shape, bool)
    noisy = noisy_coverage(frame_of(sampled(mean, spp)))
    assert noisy[partial].mean() > 0.9
    window = box_count(np.ones(mean.shape, bool), 2)
    whole = (box_count(mean == 0, 2) == window) | (box_count(mean == 1, 2) == window)
    assert not noisy[whole].any()


@pytest.mark.parametrize("model", ["lambent", "oidn", "dncnn"])
@pytest.mark.parametrize("spp", [1, 4, 64])
def test_cleaned_alpha_is_nearer_to_the_truth(model: str, spp: int) -> None:
    mean = covers()["out of focus"]
    noisy = sampled(mean, spp)
    clean = lambent.denoise(frame_of(noisy), model=model)
    found = clean[Role.ALPHA][..., 0]
    assert np.sqrt(np.mean((found - mean) ** 2)) < 0.7 * np.sqrt(np.mean((noisy - mean) ** 2))
    assert found.min() >= 0
    assert found.max() <= 1
    kept = exact(noisy[..., None])
    assert kept.mean() > 0.5
    np.testing.assert_array_equal(found[kept], noisy[kept])
    assert any(note.startswith("alpha was filtered in ") for note in clean.notes)


def test_noise_here_and_a_soft_edge_there() -> None:
    """Only the noisy part of a picture is filtered."""
    edge = rendered(disc(20), tent)
    alpha = np.zeros((64, 200), np.float32)
    alpha[:, :64] = edge
    alpha[:, 130:] = sampled(np.full((64, 70), 0.5), 8)
    noisy = noisy_coverage(frame_of(alpha))
    assert not noisy[:, :90].any()
    assert noisy[:, 134:].all()


def test_known_noise_decides() -> None:
    """Fur that looks like noise has no variance; two halves that are equal have none either."""
    fur = sampled(np.full((64, 64), 0.5), 16)
    none = np.zeros((64, 64, 1), np.float32)
    assert noisy_coverage(frame_of(fur)).all()
    assert not noisy_coverage(frame_of(fur, alpha_variance=none)).any()
    halves = {"alpha_half_a": fur[..., None], "alpha_half_b": fur[..., None]}
    assert not noisy_coverage(frame_of(fur, **halves)).any()
    a, b = (sampled(np.full((64, 64), 0.5), 8, seed) for seed in (1, 2))
    halves = {"alpha_half_a": a[..., None], "alpha_half_b": b[..., None]}
    frame = frame_of((a + b) / 2, **halves)
    assert noisy_coverage(frame).mean() > 0.95
    assert not lambent.denoise(frame, model="box").has(Role.ALPHA, Stat.HALF_A)


def test_exact_stays_even_where_filtering_is_asked_for() -> None:
    alpha = rendered(disc(12), gauss)
    clean = lambent.denoise(frame_of(alpha), model="gaussian", alpha=True)[Role.ALPHA][..., 0]
    assert not np.array_equal(clean, alpha)
    kept = exact(alpha[..., None])
    np.testing.assert_array_equal(clean[kept], alpha[kept])


def test_rows_are_looked_at_in_pieces(monkeypatch) -> None:
    alpha = sampled(np.full((90, 40), 0.4), 8)
    alpha[:30] = 1
    whole = noisy_coverage(frame_of(alpha))
    monkeypatch.setattr(coverage, "ROWS", 17)
    np.testing.assert_array_equal(noisy_coverage(frame_of(alpha)), whole)


def test_small_and_constant_pictures() -> None:
    for shape in ((1, 1), (1, 9), (2, 3), (5, 5)):
        assert not noisy_coverage(frame_of(np.full(shape, 0.5))).any()
        assert noisy_coverage(frame_of(np.linspace(0, 1, shape[0] * shape[1]).reshape(shape))).shape
    assert not noisy_coverage(Frame.from_arrays(colour=np.ones((4, 4, 3)))).any()


def test_twin_of_box_count() -> None:
    mask = np.random.default_rng(0).random((7, 9)) < 0.5
    found = box_count(mask, 2)
    for y in range(7):
        for x in range(9):
            window = mask[max(0, y - 2) : y + 3, max(0, x - 2) : x + 3]
            assert found[y, x] == window.sum()
