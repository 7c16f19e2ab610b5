"""Random scenes in Mitsuba: all kinds render, and all share one compiled kernel."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from lambent.render.variant import mitsuba
from lambent.scenes.mitsuba import KINDS, random_scene
from lambent.scenes.mitsuba.build import build
from lambent.scenes.mitsuba.motion import animate


@pytest.fixture(scope="module")
def mi():
    return mitsuba("cpu")


def render(mi, plan, **options):
    integrator = mi.load_dict({"type": plan.integrator, "max_depth": 6})
    scene = build(plan, mi, size=(32, 32), **options)
    return np.array(mi.render(scene, integrator=integrator, spp=32, seed=1))[..., :3]


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_renders_something(mi, kind):
    image = render(mi, random_scene(11, kind))
    assert image.shape == (32, 32, 3)
    assert np.isfinite(image).all()
    assert image.mean() > 1e-3
    assert image.std() > 0.05 * image.mean()


def test_ids_of_the_plan_are_those_of_the_scene(mi):
    plan = random_scene(2, "hall")
    scene = build(plan, mi, size=(8, 8))
    shapes = {s.id() for s in scene.shapes()}
    assert set(plan.shape_ids) <= shapes
    assert all(s.startswith("pad_") for s in shapes - set(plan.shape_ids))
    emitters = {e.id() for e in scene.emitters()}
    assert set(plan.light_groups) <= emitters
    assert all(e.startswith("pad_") for e in emitters - set(plan.light_groups))
    assert "BoxFilter" in str(scene.sensors()[0].film().rfilter())


def test_kernels_are_shared_between_scenes_of_all_kinds(mi):
    """Ten scenes, two of a kind: not more than two kernels (pads fill what differs)."""
    import drjit as dr

    kernels = set()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for kind in KINDS:
            for seed in (21, 22):
                plan = random_scene(seed, kind)
                if plan.media or any(e.kind == "sunsky" for e in plan.emitters):
                    continue
                dr.kernel_history_clear()
                render(mi, plan)
                history = dr.kernel_history()
                largest = max(history, key=lambda k: k.get("operation_count", 0))
                kernels.add(largest["hash"])
                gc.collect()
    assert len(kernels) <= 2


def test_lens_and_position_of_a_moving_thing_are_in_the_scene(mi):
    """A mesh is stored where it is in the frame, so that p' = T_{t-1} T_t⁻¹ p."""
    clip = animate(random_scene(4, "still_life"), 3, seed=1)
    moving = next(s for s in clip.shapes if s.path is not None and s.emitter is None)
    stored = []
    for time in (1, 2):
        scene = build(clip, mi, camera=1, size=(8, 8), time=time)
        mesh = next(s for s in scene.shapes() if s.id() == moving.id)
        stored.append(np.array(mi.traverse(mesh)["vertex_positions"]).reshape(-1, 3))
        sensor = mi.traverse(scene.sensors()[0])
        found = np.array(sensor["to_world"].matrix).reshape(4, 4)
        np.testing.assert_allclose(found, clip.camera_transform(1, time), atol=1e-5)
        radius = max(clip.cameras[1].aperture_radius, 1e-5)
        np.testing.assert_allclose(np.array(sensor["aperture_radius"]), radius, rtol=1e-5)
    back = clip.transforms(1)[moving.id] @ np.linalg.inv(clip.transforms(2)[moving.id])
    earlier = stored[1] @ back[:3, :3].T + back[:3, 3]
    np.testing.assert_allclose(earlier, stored[0], atol=1e-5)
    assert np.abs(stored[1] - stored[0]).max() > 1e-4
