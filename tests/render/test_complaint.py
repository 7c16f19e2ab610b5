"""What Mitsuba complains of: its own cause, with the scene's file and a remedy."""

from __future__ import annotations

import pytest

import lambent
from lambent.errors import DamagedFileError, EngineError, FileError, OptionError
from lambent.render.complaint import complaint, explaining

SCENE = """<scene version="3.0.0">
<sensor type="perspective"><film type="hdrfilm">
<integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
{}
</scene>"""


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            '<emitter type="constant"><spectrum name="radiance" type="blackbody">'
            '<float name="temperature" value="5000"/></spectrum></emitter>',
            "non-spectral",
        ),
        ('<shape type="sphere"><float name="radius" value="big"/></shape>', "could not parse"),
        ('<shape type="sphere"><string name="colour" value="red"/></shape>', "colour"),
        ('<shape type="obj"><string name="filename" value="none.obj"/></shape>', "none.obj"),
        ('<bsdf type="bumpmap"/>', ""),
        ("<shape", "line"),
    ],
)
def test_a_scene_that_mitsuba_refuses(tmp_path, body, words):
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(body))
    with pytest.raises(FileError) as raised:
        lambent.render(path, spp=1)
    assert raised.value.file == str(path)
    assert words in raised.value.message
    assert raised.value.remedy


def test_a_blackbody_does_not_spoil_other_scenes(tmp_path):
    bad, good = tmp_path / "bad.xml", tmp_path / "good.xml"
    emitter = '<emitter type="constant"><{} name="radiance" {}/></emitter>'
    bad.write_text(SCENE.format(emitter.format("spectrum", 'type="blackbody"')))
    good.write_text(SCENE.format(emitter.format("rgb", 'value="2"')))
    with pytest.raises(DamagedFileError) as kept:  # with whatever its traceback holds
        lambent.render(bad, spp=1)
    assert lambent.render(good, spp=1).colour == pytest.approx(2)
    assert kept.value.file == str(bad)


def raising(error, cause=None):
    with explaining("a.xml"):
        raise error from cause


def test_errors_of_ours_and_faults_in_our_code_pass():
    with pytest.raises(OptionError, match="ours"):
        raising(OptionError("ours"))
    with pytest.raises(TypeError):
        raising(TypeError("a fault"))
    with pytest.raises(OptionError, match="ours"):
        raising(RuntimeError("while recording"), OptionError("ours"))
    with pytest.raises(KeyboardInterrupt):
        raising(RuntimeError("while recording"), KeyboardInterrupt())


def test_the_first_cause_is_what_counts():
    first = RuntimeError("[bitmap.cpp:12] the   first cause")
    with pytest.raises(DamagedFileError, match="the first cause") as raised:
        raising(RuntimeError("a loop failed"), first)
    assert "bitmap.cpp" not in raised.value.message
    with pytest.raises(EngineError, match="memory"):
        raising(RuntimeError("out of memory"))
    assert complaint(RuntimeError("")) == "RuntimeError"
