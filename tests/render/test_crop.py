"""A scene's crop window is written with its place in the picture; dropping it is told."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import lambent
from lambent.errors import LayerError
from lambent.frame.exr import decode
from lambent.frame.frame import Frame
from lambent.frame.windows import Windows
from lambent.render.variant import mitsuba

mi = mitsuba()

from lambent.render.integrator import LambentFrames
from lambent.render.scene import load

CROP = """<integer name="crop_width" value="10"/><integer name="crop_height" value="6"/>
<integer name="crop_offset_x" value="8"/><integer name="crop_offset_y" value="5"/>"""
SCENE = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="45"/>
  <transform name="to_world"><lookat origin="0,1,6" target="0,0.5,0" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/>
  {crop}<rfilter type="box"/></film></sensor>
<emitter type="constant"/>
<shape type="sphere"><bsdf type="diffuse"/></shape>
</scene>"""
WINDOWS = Windows((8, 5, 17, 10), (0, 0, 23, 15))


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "crop.xml"
    path.write_text(SCENE.format(crop=CROP))
    return path


def test_the_exr_has_the_crop_in_the_display_window(scene, tmp_path):
    out = tmp_path / "out.exr"
    made = lambent.render(scene, out, spp=4)
    (part,) = decode(out).parts
    assert part.data_window == WINDOWS.data
    assert part.display_window == WINDOWS.display
    read = lambent.read(out)
    assert made.windows == read.windows == WINDOWS
    assert made.colour.shape == (6, 10, 3)
    np.testing.assert_array_equal(read.colour, made.colour)
    assert lambent.render(scene, spp=1).windows == WINDOWS


def test_pixels_of_a_crop_are_those_of_the_whole_picture(scene, tmp_path):
    whole = tmp_path / "whole.xml"
    whole.write_text(SCENE.format(crop=""))
    there = lambent.render(whole, spp=256)
    crop = lambent.render(scene, spp=256)
    assert there.windows == Windows.of_size(24, 16)
    cut = there.crop(5, 11, 8, 18)
    assert cut.windows == WINDOWS
    np.testing.assert_allclose(crop["alpha"], cut["alpha"], atol=0.2)
    assert np.abs(crop["alpha"] - there["alpha"][:6, :10]).max() > 0.9


def test_a_crop_goes_on_and_is_cleaned_in_its_place(scene, tmp_path):
    out, clean = tmp_path / "out.exr", tmp_path / "clean.exr"
    lambent.render(scene, out, spp=4)
    grown = lambent.render(scene, out, spp="+4", resume=True)
    assert grown.spp == 8
    assert lambent.read(out).windows == WINDOWS
    lambent.write(clean, lambent.denoise(out, model="box"))
    assert lambent.read(clean).windows == WINDOWS
    lambent.write(clean, lambent.read(out).replace(origin=None), overwrite=True)
    assert lambent.read(clean).windows == WINDOWS


def test_a_size_that_drops_the_crop_says_so(scene, tmp_path):
    notes: list[str] = []
    frame = lambent.render(scene, spp=1, size=(12, 8), note=notes.append)
    assert frame.windows == Windows.of_size(12, 8)
    assert any("crop window" in note and "10x6 at (8, 5) of 24x16" in note for note in notes)
    notes.clear()
    lambent.render(scene, spp=1, note=notes.append)
    assert not notes


def test_the_command_says_so_too(scene, tmp_path):
    command = [sys.executable, "-m", "lambent", "render", str(scene), "--spp", "1", "--json"]
    done = subprocess.run(
        [*command, "--size", "12x8", "-o", str(tmp_path / "out.exr")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert any("crop window" in note for note in json.loads(done.stdout)["notes"])


def test_the_plug_in_and_views_of_solutions_have_the_windows(scene):
    loaded = load(scene)
    integrator = LambentFrames(mi.Properties("lambent_frames"))
    assert integrator.frame(loaded.scene, loaded.sensor, spp=1).windows == WINDOWS


def test_pixels_of_another_size_are_not_written_into_a_window(tmp_path):
    frame = Frame.from_arrays(colour=np.ones((4, 5, 3))).replace(windows=WINDOWS)
    with pytest.raises(LayerError, match=r"5x4.*10x6"):
        lambent.write(tmp_path / "wrong.exr", frame)
    assert not (tmp_path / "wrong.exr").exists()


@pytest.mark.parametrize("half", [False, True])
def test_windows_with_negative_corners_are_written(tmp_path, half):
    """Overscan: pixels beyond the picture."""
    windows = Windows((-3, -2, 12, 9), (0, 0, 9, 7))
    image = np.arange(12 * 16 * 3, dtype=np.float32).reshape(12, 16, 3)
    frame = Frame.from_arrays(colour=image).replace(windows=windows)
    lambent.write(tmp_path / "wide.exr", frame, half=half)
    read = lambent.read(tmp_path / "wide.exr")
    assert read.windows == windows
    np.testing.assert_array_equal(read.colour, image)
