"""The verb `render`: files in, frames out; pictures that grow, resume, and are never mixed."""

from __future__ import annotations

import numpy as np
import pytest

import lambent
from lambent.errors import DamagedFileError, FileError, OptionError, OutputError, UnknownNameError
from lambent.frame.role import Role, Stat
from lambent.render.accumulate import Goal, pass_seed, stamp_of
from lambent.render.job import render_all
from lambent.render.options import Effort, Listeners, Output, Shot

SCENE = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective" id="main"><float name="fov" value="45"/>
  <transform name="to_world"><lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/>
  <rfilter type="{filter}"/></film></sensor>
<sensor type="perspective" id="side"><film type="hdrfilm"><integer name="width" value="8"/>
  <integer name="height" value="8"/></film></sensor>
<emitter type="constant"><float name="radiance" value="{light}"/></emitter>
<shape type="sphere" id="ball"><bsdf type="diffuse"/></shape>
<shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>
  <scale value="5"/><translate y="-1"/></transform><bsdf type="plastic"/></shape>
</scene>"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "still.xml"
    path.write_text(SCENE.format(filter="box", light=1.0))
    return path


def frames(scene, pattern, numbers, **output):
    return render_all(scene, Shot(frames=numbers), Effort(spp=2), Output(str(pattern), **output))


def test_a_frame_with_every_layer(scene):
    frame = lambent.render(scene, spp=8)
    assert (frame.width, frame.height, frame.spp) == (24, 16, 8)
    for role in (Role.COLOUR, Role.ALBEDO, Role.NORMAL, Role.DEPTH, Role.POSITION, Role.ROUGHNESS,
                 Role.ALPHA, Role.DIFFUSE, Role.SPECULAR, Role.DIRECT, Role.INDIRECT,
                 Role.EMISSION, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO):  # fmt: skip
        assert frame.has(role), role
        assert frame.has(role, Stat.VARIANCE), role
    assert frame.has(Role.COLOUR, Stat.HALF_A)
    assert frame.has(Role.COLOUR, Stat.HALF_B)


def test_what_is_written_is_read_with_the_same_roles(scene, tmp_path):
    out = tmp_path / "out.exr"
    made = lambent.render(scene, out, spp=4)
    read = lambent.read(out)
    assert read.spp == 4
    assert set(read.layers) == set(made.layers)
    for key, layer in made.layers.items():
        np.testing.assert_array_equal(read.layers[key].data, layer.data, err_msg=str(key))


def test_an_option_that_is_none_is_named(scene):
    with pytest.raises(TypeError, match="'sppp'"):
        lambent.render(scene, sppp=8)
    assert Effort(spp="+8").goal(16).spp == 24
    assert Effort(spp="8").goal(16).spp == 8
    assert Effort().goal().spp == 64
    assert Effort(time=1.0).goal().spp is None


def test_a_picture_is_topped_up_and_never_begun_again(scene, tmp_path):
    out = tmp_path / "out.exr"
    first = lambent.render(scene, out, spp=8)
    with pytest.raises(OutputError, match="exists already"):
        lambent.render(scene, out, spp=16)
    (result,) = render_all(scene, effort=Effort(spp="+8"), output=Output(out, resume=True))
    assert (result.began_with, result.frame.spp) == (8, 16)
    # The first samples are in there: (8·first + 8·more)/16, so twice the whole less the first is
    # an independent render of 8 spp.
    more = 2 * result.frame.colour - first.colour
    assert np.abs(more - first.colour).max() > 1e-3
    assert more.min() > -1e-4
    ratio = result.frame["colour.variance"].mean() / first["colour.variance"].mean()
    assert 0.35 < ratio < 0.7
    (again,) = render_all(scene, effort=Effort(spp=16), output=Output(out, resume=True))
    assert again.skipped


def test_resuming_gives_the_moments_of_one_run(scene, tmp_path):
    """The EXR holds all that moments are made of: save, read, add equals add in memory."""
    from lambent.render.accumulate import resume, save
    from lambent.render.sampling import FrameSampler
    from lambent.render.scene import load

    loaded = load(scene)
    sampler = FrameSampler(loaded.scene, depth=3)
    a, b = sampler.sample(5, seed=1), sampler.sample(6, seed=2)
    from lambent.render.accumulate import Stamp

    stamp = Stamp("x", 24, 16, 3, 0, "c", tuple(g.name for g in sampler.groups))
    path = tmp_path / "kept.exr"
    save(path, a, stamp)
    total = resume(path, stamp, sampler.groups) + b
    direct = a + b
    np.testing.assert_allclose(total.mean, direct.mean, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(total.spread, direct.spread, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(total.half_b, direct.half_b, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"seed": 1}, "seed"),
        ({"depth": 7}, "depth"),
        ({"size": (12, 8)}, "width"),
        ({"features": "none"}, "layers"),
        ({"camera": "side", "size": (24, 16)}, "camera"),
    ],
)
def test_pictures_of_other_settings_are_refused(scene, tmp_path, change, word):
    out = tmp_path / "out.exr"
    lambent.render(scene, out, spp=2)
    before = out.read_bytes()
    with pytest.raises(OutputError, match=f"another {word}"):
        lambent.render(scene, out, spp="+2", resume=True, **change)
    assert out.read_bytes() == before


def test_pictures_of_other_scenes_and_of_other_programs_are_refused(scene, tmp_path):
    out = tmp_path / "out.exr"
    lambent.render(scene, out, spp=2)
    scene.write_text(SCENE.format(filter="box", light=2.0))
    with pytest.raises(OutputError, match="another scene"):
        lambent.render(scene, out, spp="+2", resume=True)
    foreign = tmp_path / "foreign.exr"
    lambent.write(foreign, lambent.Frame.from_arrays(colour=np.ones((16, 24, 3), np.float32)))
    assert stamp_of(foreign) is None
    with pytest.raises(OutputError, match="not rendered by lambent"):
        lambent.render(scene, foreign, spp="+2", resume=True)


def test_an_error_ends_the_render(scene):
    (rough,) = render_all(scene, effort=Effort(target_error=0.05, spp=512))
    (fine,) = render_all(scene, effort=Effort(target_error=0.001, spp=512))
    assert rough.frame.spp < fine.frame.spp
    assert fine.frame.spp >= 8


def test_time_ends_the_render(scene):
    (result,) = render_all(scene, effort=Effort(time=0.5))
    assert result.frame.spp >= 1


@pytest.mark.parametrize("goal", [{"spp": 0}, {"spp": None}, {"seconds": -1.0}, {"error": 0.0}])
def test_goals_without_sense_are_refused(goal):
    with pytest.raises(OptionError):
        Goal(**goal)


def test_passes_have_random_numbers_of_their_own():
    seeds = {pass_seed(s, first) for s in range(50) for first in range(0, 640, 16)}
    assert len(seeds) == 50 * 40
    assert all(0 <= s < 2**32 for s in seeds)


def test_splatted_filters_are_told_and_not_used(scene):
    scene.write_text(SCENE.format(filter="gaussian", light=1.0))
    notes: list[str] = []
    render_all(scene, effort=Effort(spp=2), listeners=Listeners(note=notes.append))
    assert any("gaussian filter" in n and "box filter" in n for n in notes)


def test_frames_come_with_motion(scene, tmp_path):
    (tmp_path / "still.toml").write_text(
        'frames = [1, 3]\n[[object]]\nshape = "ball"\nat = [1, 3]\n'
        "translate = [[0, 0, 0], [1, 0, 0]]\n"
    )
    pattern = str(tmp_path / "shot.####.exr")
    done = frames(scene, pattern, (1, 2, 3))
    assert [r.path.name for r in done] == ["shot.0001.exr", "shot.0002.exr", "shot.0003.exr"]
    first, second = done[0].frame, lambent.read(done[1].path)
    assert np.abs(first[Role.MOTION]).max() < 1e-3
    assert np.abs(second[Role.MOTION]).max() > 0.5
    mask = second.extras["disocclusion_mask"]
    assert mask.role is Role.ID
    assert set(np.unique(mask.data)) == {0.0, 1.0}
    before = {r.path: r.path.read_bytes() for r in done}
    again = frames(scene, pattern, (1, 2, 3), resume=True)
    assert all(r.skipped for r in again)
    assert all(path.read_bytes() == content for path, content in before.items())


def test_a_later_part_of_a_shot_has_the_same_motion(scene, tmp_path):
    (tmp_path / "still.toml").write_text(
        'frames = [1, 3]\n[[object]]\nshape = "ball"\nat = [1, 3]\n'
        "translate = [[0, 0, 0], [1, 0, 0]]\nscale = 1.5\n"
    )
    whole = frames(scene, tmp_path / "a.####.exr", (1, 2, 3))
    frames(scene, tmp_path / "b.####.exr", (1,))
    later = frames(scene, tmp_path / "b.####.exr", (2, 3))
    alone = frames(scene, tmp_path / "c.####.exr", (2,))
    for one, other in zip(whole[1:], later, strict=True):
        np.testing.assert_array_equal(one.frame[Role.MOTION], other.frame[Role.MOTION])
        np.testing.assert_array_equal(
            one.frame.extras["disocclusion_mask"].data,
            other.frame.extras["disocclusion_mask"].data,
        )
    np.testing.assert_array_equal(whole[1].frame[Role.MOTION], alone[0].frame[Role.MOTION])
    assert "disocclusion_mask" not in alone[0].frame.extras  # nothing is known of frame 1
    gap = frames(scene, tmp_path / "d.####.exr", (1, 3))
    np.testing.assert_array_equal(gap[1].frame[Role.MOTION], whole[2].frame[Role.MOTION])
    assert "disocclusion_mask" not in gap[1].frame.extras  # nor of 2: 1 is not the one before


@pytest.mark.parametrize(
    "option",
    [
        {"resume": True}, {"spp": "+4"}, {"features": "none"}, {"integrator": "volpath"},
        {"light_groups": {"key": ["sun"]}}, {"target_error": 0.1}, {"parameters": {"a.b": 1}},
    ],
)  # fmt: skip
def test_what_cycles_cannot_do_is_refused(tmp_path, option):
    name = "spp" if "spp" in option else next(iter(option)).replace("_", "-")
    with pytest.raises(OptionError, match=name):
        lambent.render(tmp_path / "kitchen.blend", **option)


# ------------------------------------------------------------------- bad input


def _broken(tmp_path, old, new):
    path = tmp_path / "broken.xml"
    path.write_text(SCENE.format(filter="box", light=1.0).replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "error", "words"),
    [
        ('<shape type="sphere" id="ball">',
         '<shape type="ply" id="ball"><string name="filename" value="lost.ply"/>',
         FileError, "lost.ply"),
        ('<bsdf type="diffuse"/>',
         '<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
         '<string name="filename" value="lost.png"/></texture></bsdf>', FileError, "lost.png"),
        ('type="plastic"', 'type="unobtainium"', DamagedFileError, "unobtainium"),
        ("</scene>", "", DamagedFileError, "cannot be loaded"),
        ('<emitter type="constant"><float name="radiance" value="1.0"/></emitter>', "",
         OptionError, "no emitter"),
    ],
)  # fmt: skip
def test_broken_scenes_are_told(tmp_path, old, new, error, words):
    path = _broken(tmp_path, old, new)
    with pytest.raises(error, match=words) as told:
        lambent.render(path, spp=1)
    assert "broken.xml" in str(told.value)
    assert told.value.remedy


def test_missing_scenes_and_cameras_are_told(scene, tmp_path):
    with pytest.raises(FileError, match="there is no such file"):
        lambent.render(tmp_path / "no.xml")
    with pytest.raises(FileError, match="folder"):
        lambent.render(tmp_path)
    binary = tmp_path / "x.xml"
    binary.write_bytes(b"\x00\x01\x02")
    with pytest.raises(FileError, match="not a Mitsuba scene"):
        lambent.render(binary)
    with pytest.raises(UnknownNameError, match="'top'"):
        lambent.render(scene, camera="top")
    no_camera = tmp_path / "blind.xml"
    no_camera.write_text('<scene version="3.0.0"><emitter type="constant"/></scene>')
    with pytest.raises(OptionError, match="no sensor"):
        lambent.render(no_camera)


def test_scenes_of_old_versions_are_read(tmp_path):
    path = tmp_path / "old.xml"
    text = SCENE.format(filter="box", light=1.0)
    for new, old in (("3.0.0", "0.6.0"), ("max_depth", "maxDepth"), ("to_world", "toWorld")):
        text = text.replace(new, old)
    path.write_text(text)
    assert lambent.render(path, spp=1).width == 24


def test_outputs_that_cannot_be_are_refused_before_any_work(scene, tmp_path):
    with pytest.raises(OutputError, match="only an EXR"):
        lambent.render(scene, tmp_path / "out.png", spp=1)
    with pytest.raises(OutputError, match="does not exist"):
        lambent.render(scene, tmp_path / "no" / "out.exr", spp=1)
    with pytest.raises(OutputError, match="no place for a frame number"):
        lambent.render(scene, tmp_path / "out.exr", spp=1, frames=(1, 2), animation=lambda f: None)
    with pytest.raises(OptionError, match="nothing says what moves"):
        lambent.render(scene, tmp_path / "o.##.exr", spp=1, frames=(1, 2))
    with pytest.raises(OptionError, match="no integrator 'pathh'"):
        lambent.render(scene, spp=1, integrator="pathh")
