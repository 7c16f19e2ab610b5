"""Plans of random scenes: the same everywhere, varied, and looked at from good places."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from lambent.errors import OptionError, UnknownNameError
from lambent.scenes.mitsuba import KINDS, random_scene
from lambent.scenes.mitsuba.motion import animate
from lambent.scenes.mitsuba.palette import LIGHTS, SHAPES, SLOTS

#: The digests of `seed` 0 of every kind. They change when what the generator makes changes, which
#: makes data sets of before and after different: then write the new ones here, knowingly.
DIGESTS = json.loads((Path(__file__).parent / "mitsuba_digests.json").read_text())


@pytest.fixture(scope="module")
def sixty():
    return [random_scene(seed) for seed in range(60)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_the_same_scene_on_every_machine(kind):
    assert random_scene(0, kind).digest() == DIGESTS[kind]


def test_the_digest_sees_what_differs():
    plans = [random_scene(seed, "studio") for seed in range(4)]
    assert len({p.digest() for p in plans}) == 4
    assert animate(plans[1], 3, seed=1).digest() != animate(plans[1], 3, seed=2).digest()


def test_a_plan_is_made_without_mitsuba_and_drjit():
    code = (
        "import sys; from lambent.scenes.mitsuba import random_scene; random_scene(3, 'studio');"
        "print([m for m in ('mitsuba', 'drjit', 'torch') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_all_structures_and_lights_of_the_palette_come_up(sixty):
    structures = Counter(m.structure for p in sixty for m in p.materials)
    assert set(structures) >= set(SLOTS) - {"null"}
    lights = Counter(e.kind for p in sixty for e in p.emitters)
    assert set(lights) >= set(LIGHTS) | {"envmap"}
    assert {p.kind for p in sixty} == set(KINDS)


def test_media_and_analytic_skies_come_up():
    plans = (random_scene(seed, "open") for seed in range(10, 60))
    skies = (e for p in plans for e in p.emitters if e.kind == "sunsky")
    assert next(skies, None) is not None
    foggy = next((p for s in range(10, 60) if (p := random_scene(s, "open")).media), None)
    assert foggy is not None
    assert foggy.integrator == "volpath"
    assert "null" in {m.structure for m in foggy.materials}


def test_plans_fit_the_palette(sixty):
    for p in sixty:
        for structure, count in Counter(m.structure for m in p.materials).items():
            assert count <= SLOTS[structure], (p.seed, structure)
        for kind, count in Counter(e.kind for e in p.emitters).items():
            assert count <= LIGHTS.get(kind, 1), (p.seed, kind)
        assert sum(s.emitter is None for s in p.shapes) <= SHAPES, p.seed
        assert len(set(p.shape_ids)) == len(p.shape_ids), p.seed
        assert len(set(p.light_groups)) == len(p.light_groups), p.seed


def test_meshes_are_sound(sixty):
    for p in sixty[:20]:
        for s in p.shapes:
            g = s.geometry
            assert g.faces.min() >= 0, (p.seed, s.id)
            assert g.faces.max() < len(g.positions), (p.seed, s.id)
            assert np.isfinite(g.positions).all(), (p.seed, s.id)
            assert np.isfinite(g.uv).all(), (p.seed, s.id)
            length = np.linalg.norm(g.normals, axis=1)
            assert np.mean(np.abs(length - 1) < 1e-6) > 0.98, (p.seed, s.id)
    triangles = sorted(p.triangles for p in sixty)
    assert 20_000 < triangles[30] < 300_000
    assert triangles[-1] < 500_000


def test_cameras_stand_outside_of_things(sixty):
    """No camera has a movable thing around it, and lenses vary."""
    lenses, focal = 0, []
    for p in sixty:
        assert len(p.cameras) >= 4, p.seed
        for c in p.cameras:
            eye = c.to_world[:3, 3]
            np.testing.assert_allclose(np.linalg.det(c.to_world[:3, :3]), 1, atol=1e-9)
            lenses += c.aperture_radius > 0
            focal.append(c.focal_length)
            for s in p.shapes:
                if s.movable:
                    low, high = s.geometry.moved(s.to_world).bounds
                    assert not ((eye > low) & (eye < high)).all(), (p.seed, s.id)
    assert 0.15 < lenses / len(focal) < 0.6
    assert max(focal) / min(focal) > 3


def test_unknown_kinds_and_negative_seeds_are_refused():
    with pytest.raises(UnknownNameError, match="room"):
        random_scene(1, "rooom")
    with pytest.raises(OptionError, match="-1"):
        random_scene(-1)
    plan = random_scene(1, "studio")
    with pytest.raises(OptionError, match="frame 1"):
        plan.transforms(1)
    with pytest.raises(OptionError, match="camera 99"):
        plan.camera_transform(99)
    with pytest.raises(OptionError, match="0 frames"):
        animate(plan, 0)


# --- motion ----------------------------------------------------------------------------------


def test_clips_move_some_things_and_keep_ids_and_the_rest():
    moving_cameras = moving_things = 0
    for seed in range(8):
        still = random_scene(seed, "still_life")
        clip = animate(still, 5, seed=seed)
        assert clip.shape_ids == still.shape_ids
        assert clip.frames == 5
        for before, after in zip(still.shapes, clip.shapes, strict=True):
            assert after.geometry is before.geometry
            if before.movable is None:
                assert after.path is None
        first, last = clip.transforms(0), clip.transforms(4)
        assert set(first) == set(still.shape_ids)
        for shape_id, start in still.transforms(0).items():
            np.testing.assert_allclose(first[shape_id], start, atol=1e-9)
        moving_things += any(not np.allclose(first[k], last[k]) for k in first)
        travel = clip.camera_transform(0, 4) - clip.camera_transform(0, 0)
        moving_cameras += np.abs(travel).max() > 1e-4
    assert moving_things >= 6
    assert moving_cameras >= 4


def test_parts_of_a_thing_move_together_and_rigidly():
    clips = [animate(random_scene(seed, "still_life"), 4, seed=seed) for seed in range(6)]
    checked = 0
    for clip in clips:
        groups: dict[str, list] = {}
        for s in clip.shapes:
            if s.path is not None:
                groups.setdefault(s.movable, []).append(s.path)
        for paths in groups.values():
            for path in paths:
                np.testing.assert_array_equal(path, paths[0])
                turn = path[:, :3, :3] @ path[0, :3, :3].T
                np.testing.assert_allclose(
                    turn @ turn.transpose(0, 2, 1), np.eye(3)[None].repeat(4, 0), atol=1e-9
                )
                checked += 1
    assert checked > 6


def test_the_same_clip_seed_gives_the_same_clip():
    plan = random_scene(5, "room")
    a, b = animate(plan, 3, seed=9), animate(plan, 3, seed=9)
    for time in range(3):
        for shape_id, matrix in a.transforms(time).items():
            np.testing.assert_array_equal(matrix, b.transforms(time)[shape_id])
        np.testing.assert_array_equal(a.camera_transform(1, time), b.camera_transform(1, time))
