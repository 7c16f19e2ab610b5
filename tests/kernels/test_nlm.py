"""Non-local means against a plain NumPy twin."""

import numpy as np
import pytest

from lambent.kernels.nlm import (
    PatchSearch,
    nlm_mean,
    nlm_weights,
    patch_distances,
    squared_difference,
    variance_difference,
)


def differences(kind, u, v, p, q, numbers):
    step = (u[p] - u[q]) ** 2
    if kind is squared_difference:
        return np.mean(step * numbers[0]) - numbers[1]
    k2, alpha, epsilon = numbers
    noise = alpha * (v[p] + np.minimum(v[p], v[q]))
    return np.mean((step - noise) / (epsilon + k2 * (v[p] + v[q])))


def distance_twin(kind, u, v, p, q, patch, numbers):
    """Mean over the pairs of patch pixels of which both lie inside the image."""
    height, width, _ = u.shape
    terms = []
    for j in range(-patch, patch + 1):
        for i in range(-patch, patch + 1):
            a, b = (p[0] + j, p[1] + i), (q[0] + j, q[1] + i)
            if all(0 <= s[0] < height and 0 <= s[1] < width for s in (a, b)):
                terms.append(differences(kind, u, v, a, b, numbers))
    return np.mean(terms)


def nlm_twin(targets, kind, u, v, radius, patch, numbers, joint=None):
    height, width, _ = targets.shape
    result = np.zeros(targets.shape)
    for y in range(height):
        for x in range(width):
            total, norm = 0.0, 0.0
            for qy in range(max(0, y - radius), min(height, y + radius + 1)):
                for qx in range(max(0, x - radius), min(width, x + radius + 1)):
                    d = distance_twin(kind, u, v, (y, x), (qy, qx), patch, numbers)
                    if joint is not None:
                        d = max(d, np.sum((joint[y, x] - joint[qy, qx]) ** 2) * 3.0)
                    w = np.exp(-max(0.0, d))
                    total, norm = total + w * targets[qy, qx], norm + w
            result[y, x] = total / norm
    return result


def feature_square(p, q, k):
    total = 0.0
    for a, b in zip(p, q, strict=True):
        total = total + (a - b) * (a - b)
    return total * k[0]


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (8, 1), (7, 10)])
@pytest.mark.parametrize(
    ("kind", "numbers"),
    [(squared_difference, (3.0, 0.1)), (variance_difference, (0.2, 0.7, 0.01))],
)
def test_agrees_with_its_twin(shape, kind, numbers):
    rng = np.random.default_rng(1)
    targets = rng.random((*shape, 2), dtype=np.float32)
    u = rng.random((*shape, 3), dtype=np.float32)
    v = 0.05 + 0.1 * rng.random((*shape, 3), dtype=np.float32)
    given = v if kind is variance_difference else None
    search = PatchSearch.of(u, given, 2, 1, kind, numbers)
    wanted = nlm_twin(targets, kind, u, v, 2, 1, numbers)
    assert np.abs(nlm_mean(targets, search) - wanted).max() < 3e-6


def test_the_worse_of_colour_and_features_decides():
    rng = np.random.default_rng(2)
    targets, joint = rng.random((6, 7, 3), np.float32), rng.random((6, 7, 2), np.float32)
    search = PatchSearch.of(targets, None, 2, 1, squared_difference, (1.0, 0.0))
    found = nlm_mean(targets, search, (joint, feature_square), [3.0])
    wanted = nlm_twin(targets, squared_difference, targets, None, 2, 1, (1.0, 0.0), joint)
    assert np.abs(found - wanted).max() < 3e-6


def test_distances_and_weights_one_by_one():
    """What NFOR and others build on: the image of each offset."""
    rng = np.random.default_rng(3)
    u = rng.random((6, 20, 1), dtype=np.float32)
    search = PatchSearch.of(u, None, 1, 2, squared_difference, (4.0, 0.2))
    stride = search.layout.stride
    seen = []
    for (dx, dy, d), (_, _, w) in zip(patch_distances(search), nlm_weights(search), strict=True):
        seen.append((dx, dy))
        distance, weight = d.numpy().reshape(6, stride), w.numpy().reshape(6, stride)
        y, x = 2, 18
        wanted = distance_twin(squared_difference, u, None, (y, x), (y + dy, x + dx), 2, (4.0, 0.2))
        assert distance[y, x] == pytest.approx(wanted, abs=2e-6)
        assert weight[y, x] == pytest.approx(np.exp(-max(0, wanted)), abs=2e-6)
        assert weight[0, 0] == 0 or (dx >= 0 and dy >= 0)  # outside: no weight
    assert seen == [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]


def test_a_bad_pixel_gets_no_weight_and_spoils_nobody():
    rng = np.random.default_rng(4)
    image = rng.random((12, 14, 3), dtype=np.float32)
    image[5, 6] = np.nan
    search = PatchSearch.of(image, None, 3, 1, squared_difference, (1.0, 0.0))
    found = nlm_mean(image, search)
    assert np.isfinite(found).all()
    delta = np.zeros((12, 14, 1), np.float32)
    delta[5, 6] = 1.0
    assert (nlm_mean(delta, search) == 0).all()
