"""Random scenes: the same for a seed, noise that falls as it should, targets apart from inputs."""

from __future__ import annotations

import numpy as np
import pytest

from lambent.frame.role import Role, Space, Stat
from lambent.scenes.cycles import CyclesWorker, RandomView
from lambent.scenes.cycles.worker import KINDS

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def worker(blender):
    with CyclesWorker(blender) as running:
        yield running


def small(worker: CyclesWorker, seed: int, **options) -> list[RandomView]:
    given = {"spp_list": (1, 4), "size": (32, 32), "reference_spp": 16, **options}
    return worker.render_random(seed, **given)


def test_same_seed_same_pictures(worker: CyclesWorker, blender) -> None:
    """After other scenes, and in another Blender."""
    first = small(worker, 5)[0]
    small(worker, 6)
    with CyclesWorker(blender) as other:
        for again in (small(worker, 5)[0], small(other, 5)[0]):
            assert (again.kind, again.window, again.to_world) == (
                first.kind, first.window, first.to_world,
            )  # fmt: skip
            np.testing.assert_array_equal(again.target.colour, first.target.colour)
            np.testing.assert_array_equal(again.noisy[0].colour, first.noisy[0].colour)


@pytest.mark.parametrize("seed", [873646366, 313665865])
def test_a_window_is_as_large_as_asked_for(worker: CyclesWorker, seed: int) -> None:
    """Windows whose shares of the picture do not fall on whole pixels in float32."""
    (view,) = small(worker, seed, spp_list=(1,), size=(128, 128), reference_spp=4)
    for made in (*view.noisy, view.target):
        assert (made.width, made.height) == (128, 128)


def test_levels(worker: CyclesWorker) -> None:
    """Each level's error against the target is its variance (and the target's), as told."""
    ratios = []
    for seed in (3, 7, 12):
        (view,) = small(worker, seed, spp_list=(2, 8), reference_spp=256, kind="still life")
        assert [f.spp for f in view.noisy] == [2, 8]
        assert view.target.spp == 256
        assert view.target.layer(Role.NORMAL).space is Space.WORLD
        for frame in (*view.noisy, view.target):
            assert frame.has(Role.COLOUR, Stat.HALF_A)
            both = frame[Role.DIFFUSE] + frame[Role.SPECULAR]
            np.testing.assert_allclose(both, frame.colour, atol=1e-3 * frame.colour.max() + 1e-6)
        for frame in view.noisy:
            told = frame[Role.COLOUR, Stat.VARIANCE] + view.target[Role.COLOUR, Stat.VARIANCE]
            squares = (frame.colour - view.target.colour) ** 2
            bright = np.quantile(squares, 0.99)  # a firefly must not decide
            keep = (squares <= bright) & (told <= np.quantile(told, 0.99))
            ratios.append(float(squares[keep].mean() / told[keep].mean()))
    assert 0.5 < np.median(ratios) < 2.0


def test_normals_face_the_camera_in_the_world(worker: CyclesWorker) -> None:
    """Where the surface is diffuse, the normal looks back along the ray from the eye."""
    (view,) = small(worker, 4, kind="still life", reference_spp=16)
    frame = view.target
    eye = np.array(view.to_world)[:3, 3]
    ray = frame[Role.POSITION] - eye
    hit = (frame[Role.POSITION] != 0).any(axis=2) & (frame[Role.DEPTH][..., 0] > 0)
    normal = frame[Role.NORMAL]
    facing = (ray * normal).sum(axis=2)[hit & (np.linalg.norm(normal, axis=2) > 0.5)]
    assert facing.size > 100
    assert (facing < 0).mean() > 0.9


def test_clip_moves(worker: CyclesWorker) -> None:
    """Frames of a clip differ, and motion says by how much."""
    moved = []
    for seed in (1, 2):
        views = small(worker, seed, frames=2, kind="still life", spp_list=(1,), reference_spp=4)
        assert [v.frame for v in views] == [1, 2]
        motion = views[1].target[Role.MOTION]
        assert motion.shape[2] == 4
        moved.append(float(np.abs(motion[..., :2]).mean()))
    assert max(moved) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_shows_something(worker: CyclesWorker, kind: str) -> None:
    """Most seeds of a kind give pictures that are neither black nor flat."""
    good = 0
    for seed in range(10):
        for view in small(worker, seed, kind=kind, cameras=1, crop=1.0):
            colour = view.target.colour
            assert np.isfinite(colour).all()
            level = float(np.median(colour.mean(axis=2)))
            good += level > 1e-4 and colour.std() > 0.1 * level
    assert good >= 8
