"""Form factors of pairs against closed forms, brute force, and what must hold of any."""

import boxes
import numpy as np
import pytest
from boxes import mi, square

from lambent.errors import OptionError
from lambent.transport.radiosity import pairs
from lambent.transport.radiosity.pairs import exchange, form_factor, polygon_area


def brute(p, q, rng, count=400_000, blocked=None):
    """The double area integral by random points, with its standard error."""

    def points(t):
        u = rng.random((count, 2))
        return t[0] + u[:, :1] * (t[1] - t[0]) + u[:, 1:] * (t[3] - t[0])

    def normal(t):
        n = np.cross(t[1] - t[0], t[3] - t[0])
        return n / np.linalg.norm(n)

    x, y = points(p), points(q)
    way = y - x
    square_ = (way**2).sum(1)
    kernel = np.maximum(way @ normal(p), 0) * np.maximum(-(way @ normal(q)), 0)
    value = kernel / (np.pi * square_**2) * polygon_area(q[None])[0]
    if blocked is not None:
        value = value * ~blocked(x, y)
    return value.mean(), value.std() / np.sqrt(count)


def test_facing_squares():
    found = form_factor(square(), square(1)[::-1])
    assert found == pytest.approx(0.199825, abs=1e-6)
    assert found == pytest.approx(pairs.facing_squares(1.0), abs=1e-9)


def test_squares_with_a_side_in_common():
    side = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
    found = form_factor(square(), side)
    assert found == pytest.approx(0.200044, abs=1e-6)
    assert found == pytest.approx(pairs.joined_squares(), abs=1e-7)


@pytest.mark.parametrize("distance", [0.1, 0.5, 3.0, 20.0])
def test_facing_squares_near_and_far(distance):
    found = form_factor(square(), square(distance)[::-1])
    assert found == pytest.approx(pairs.facing_squares(distance), rel=2e-5)


def test_off_axis_and_tilted_against_brute_force():
    rng = np.random.default_rng(0)
    aside = square(1.3, shift=(1.5, 0.7))[::-1]
    tilted = np.array([[0.2, -0.5, 0.3], [1.2, -0.5, 1.4], [1.2, 0.5, 1.4], [0.2, 0.5, 0.3]])
    for q in (aside, tilted, tilted[::-1]):
        truth, error = brute(square(), q, rng)
        assert form_factor(square(), q) == pytest.approx(truth, abs=5 * error + 1e-6)


def test_a_polygon_astride_the_other_s_plane_counts_only_before_it():
    # a wall that goes through the plane of the floor: the part below sees nothing of it
    wall = np.array([[0, 0, -1], [0, 1, -1], [0, 1, 1], [0, 0, 1]], float)
    upper = np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], float)
    assert form_factor(square(), wall) == pytest.approx(form_factor(square(), upper), rel=1e-9)
    behind = square(-1)
    assert form_factor(square(), behind) == 0
    assert form_factor(square(), behind[::-1]) == 0


def test_reciprocity_and_additivity():
    p, q = square(), square(1.2, shift=(0.4, -0.3))[::-1]
    assert exchange(p[None], q[None])[0] == pytest.approx(exchange(q[None], p[None])[0], rel=1e-9)
    halves = [q[[0, 1, 2]], q[[0, 2, 3]]]
    total = sum(form_factor(p, half) for half in halves)
    assert total == pytest.approx(form_factor(p, q), rel=1e-6)


def test_a_polygon_without_an_area_is_refused():
    with pytest.raises(OptionError, match="without an area"):
        form_factor(square(), np.zeros((3, 3)))


def test_a_blocker_takes_its_share():
    scene = mi.load_dict(
        {
            "type": "scene",
            "blocker": {
                "type": "rectangle",
                "to_world": boxes.T().translate([0.25, 0.5, 0.5]).scale([0.25, 0.5, 1]),
            },
        }
    )
    low = np.stack([square()[[0, 1, 2]], square()[[0, 2, 3]]])
    high = np.stack([square(1)[::-1][[0, 1, 2]], square(1)[::-1][[0, 2, 3]]])
    corners = np.concatenate([low, high])
    normal = np.repeat([[0.0, 0, 1], [0, 0, -1]], 2, axis=0)
    a, b = np.array([0, 0, 1, 1]), np.array([2, 3, 2, 3])
    share = pairs.visible(scene, corners, normal, a, b, rays=(512, 8000))
    found = (exchange(corners[a], corners[b]) * share).sum()

    def blocked(x, y):
        middle = (x + y) / 2
        return (middle[:, 0] < 0.5) & (middle[:, 0] > 0) & (np.abs(middle[:, 1] - 0.5) < 0.5)

    truth, error = brute(square(), square(1)[::-1], np.random.default_rng(1), blocked=blocked)
    assert found == pytest.approx(truth, abs=0.01 * truth + 5 * error)
    free = form_factor(square(), square(1)[::-1])
    assert found < 0.7 * free
