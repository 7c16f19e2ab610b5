"""Mitsuba's scenes as a source: what is set anew must be as if it had been built so."""

from __future__ import annotations

import dataclasses
import importlib.util

import numpy as np
import pytest

from lambent.dataset.mitsuba_source import FileSource, ProceduralSource, varied
from lambent.dataset.recipe import Recipe
from lambent.dataset.source import Draw, Window
from lambent.errors import OptionError, UnknownNameError
from lambent.frame.role import Role
from lambent.phases import Phases

needs_mitsuba = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason="needs the extra 'render'"
)
SCENE = """<scene version="3.0.0">
  <integrator type="path"/>
  <sensor type="perspective">
    <float name="fov" value="50"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="48"/>
      <rfilter type="box"/></film>
  </sensor>
  <shape type="sphere" id="ball">
    <bsdf type="diffuse"><rgb name="reflectance" value="0.6,0.4,0.2"/></bsdf></shape>
  <shape type="rectangle" id="wall">
    <transform name="to_world"><scale value="6"/><translate z="-2"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.5,0.5"/></bsdf></shape>
  <emitter type="point"><point name="position" value="2,3,3"/>
    <rgb name="intensity" value="20,20,20"/></emitter>
</scene>"""


@pytest.fixture
def files(tmp_path) -> Recipe:
    path = tmp_path / "ball.xml"
    path.write_text(SCENE)
    return Recipe(
        name="x", seed=1, source="scenes", scenes=(str(path),), view=(64, 48), crop=32, depth=3
    )


@needs_mitsuba
def test_a_file_s_variation_depends_on_its_seed_alone(files):
    source = FileSource(files, "auto", Phases())
    window = Window(8, 4, 32)

    def render(seed: int, camera: int = 0) -> np.ndarray:
        (view,) = source.scene(seed, 0, 1).views(camera)
        (made,) = view.sample([Draw(window, 16, 3)])
        return made.frame().colour

    first = render(7)
    other = render(8)
    assert np.array_equal(render(7), first), "a variation leaves traces in the next"
    assert not np.allclose(other, first, rtol=0.05)
    assert not np.allclose(render(7, 1), first, rtol=0.05), "all cameras are the same"


@needs_mitsuba
def test_a_window_is_that_part_of_the_view(files):
    """Depth and albedo of a window against those of the whole picture."""
    source = FileSource(dataclasses.replace(files, vary=False), "auto", Phases())
    (view,) = source.scene(3, 0, 1).views(0)
    whole = view.pilot((64, 48), 64, 1)
    part = view.sample([Draw(Window(20, 10, 32), 64, 2)])[0].frame()
    for role in (Role.DEPTH, Role.ALBEDO):
        error = np.abs(part[role] - whole[role][10:42, 20:52])
        assert np.median(error) < 0.01 * np.abs(part[role]).mean()
        assert error.mean() < 0.03 * np.abs(part[role]).mean()


@needs_mitsuba
@pytest.mark.slow
def test_a_camera_set_anew_is_the_camera_built(files):
    """Every camera of a random scene: through the parameters, and in a scene built for it."""
    from lambent.render.sampling import FrameSampler
    from lambent.scenes.mitsuba import random_scene
    from lambent.scenes.mitsuba.build import build

    recipe = Recipe(name="x", seed=1, kinds=("still_life",), view=(64, 48), crop=32, depth=4)
    source = ProceduralSource(recipe, "auto", Phases())
    scene = source.scene(12, 0, 1)
    plan = random_scene(12, "still_life")
    for camera in (2, 0, 3):
        (view,) = scene.views(camera)
        ours = view.pilot((64, 48), 32, 5)
        alone = build(plan, source.mi, camera, (64, 48))
        built = FrameSampler(alone, depth=recipe.depth, rr_depth=recipe.rr_depth)
        theirs = built.sample(32, 5).frame()
        for role in (Role.DEPTH, Role.ALBEDO, Role.COLOUR):
            a, b = ours[role], theirs[role]
            assert np.abs(a - b).mean() < 1e-2 * np.abs(b).mean(), (camera, role)


@needs_mitsuba
@pytest.mark.slow
def test_a_clip_s_motion_leads_to_the_still_before(files):
    """The wall is still and the camera drifts: positions, found again by the motion."""
    source = FileSource(dataclasses.replace(files, vary=False), "auto", Phases())
    views = source.scene(5, 0, 3).views(0)
    window = Window(8, 4, 32)
    before, now = (v.sample([Draw(window, 64, 1)])[0].frame() for v in views[1:])
    motion = now[Role.MOTION]
    assert np.abs(motion).max() > 0.05
    rows, columns = np.mgrid[6:26, 6:26]
    y = rows + motion[6:26, 6:26, 1]
    x = columns + motion[6:26, 6:26, 0]
    found = before[Role.POSITION][np.rint(y).astype(int), np.rint(x).astype(int)]
    error = np.linalg.norm(found - now[Role.POSITION][6:26, 6:26], axis=2)
    pixel = np.linalg.norm(np.diff(now[Role.POSITION], axis=1), axis=2)
    assert np.median(error) < np.median(pixel)


def test_variations_stay_plausible():
    random = np.random.default_rng(2)
    grey = np.array([0.5, 0.5, 0.5])
    for _ in range(200):
        colour = varied("a.reflectance.value", grey, random)
        assert colour.shape == (3,)
        assert (colour >= 0).all()
        assert (colour <= 0.9).all()
        assert 0.02 <= varied("a.alpha.value", 0.1, random) <= 0.8
        assert (varied("lamp.intensity.value", np.array([3.0, 2, 1]), random) > 0).all()


def test_a_recipe_without_files_is_refused(files):
    with pytest.raises(OptionError, match="names no scene"):
        FileSource(dataclasses.replace(files, scenes=()), "auto", Phases())


def test_an_unknown_kind_is_answered_with_the_known(files):
    with pytest.raises(UnknownNameError, match="still_life"):
        ProceduralSource(Recipe(name="x", seed=1, kinds=("still_live",)), "auto", Phases())


def test_versions_load_no_renderer():
    import subprocess
    import sys

    code = (
        "import sys\nfrom lambent.dataset.mitsuba_source import ProceduralSource as P\n"
        "from lambent.dataset.recipe import Recipe\nfrom lambent.phases import Phases\n"
        "print(P(Recipe(name='x', seed=1), 'auto', Phases()).versions()['mitsuba'])\n"
        "assert 'mitsuba' not in sys.modules and 'drjit' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
