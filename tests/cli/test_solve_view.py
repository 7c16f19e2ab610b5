"""lambent solve and lambent view: what they print, refuse and leave behind."""

import json

import av
import numpy as np
import plyfile
import pygltflib
import pytest
from PIL import Image

import lambent
from lambent.cli import main

SCENE = """<scene version="3.0.0">
<default name="res" value="48"/>
<sensor type="perspective" id="main"><float name="fov" value="70"/>
  <transform name="to_world"><lookat origin="0,0,0.95" target="0,0,-1" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="$res"/><integer name="height" value="$res"/>
    <rfilter type="box"/></film></sensor>
<shape type="cube"><boolean name="flip_normals" value="true"/>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.7,0.5,0.3"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.4"/>
  <rotate x="1" angle="90"/><translate y="0.9"/></transform>
  <emitter type="area"><rgb name="radiance" value="8,7,5"/></emitter></shape>
</scene>
"""

FLY = """frames = [1, 4]
[camera]
at = [1, 4]
origin = [[0, 0, 0.9], [0.4, 0, 0.9]]
target = [0, 0, -1]
up = [0, 1, 0]
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "room.xml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def solved(scene, tmp_path, capsys):
    path = tmp_path / "room.lambent"
    assert main(["solve", str(scene), "-o", str(path), "--patches", "300", "--rays", "64"]) == 0
    capsys.readouterr()
    return path


def run(capsys, *args):
    code = main([str(a) for a in args])
    out = capsys.readouterr()
    return code, out.out, out.err


def test_solve_says_what_it_did(capsys, scene, tmp_path):
    path = tmp_path / "a.lambent"
    code, out, _ = run(capsys, "solve", scene, "-o", path, "--patches", 200, "--report")
    assert code == 0
    assert "patches" in out
    assert "residual" in out
    assert f"lambent view {path}" in out
    page = path.with_suffix(".html").read_text()
    for words in ("room.xml, solved", "Residual", "Power", "watts", "Patches"):
        assert words in page
    assert page.count("<img") >= 4
    assert 'http-equiv="refresh"' not in page


def test_as_json(capsys, scene, tmp_path):
    code, out, _ = run(
        capsys, "solve", scene, "-o", tmp_path / "a.lambent", "--patches", 100, "--json"
    )
    assert code == 0
    found = json.loads(out)
    assert found["residual"] < 1e-5
    assert found["patches"] > 40


def test_pictures(capsys, solved, tmp_path):
    png, exr = tmp_path / "a.png", tmp_path / "a.exr"
    assert run(capsys, "view", solved, "-o", png)[0] == 0
    assert Image.open(png).size == (48, 48)
    assert np.asarray(Image.open(png)).mean() > 20
    assert run(capsys, "view", solved, "-o", exr, "--size", "40x30", "--show", "gather")[0] == 0
    frame = lambent.read(exr)
    assert frame.colour.shape == (30, 40, 3)
    assert {"albedo", "normal"} <= {key[0].value for key in frame.layers}
    # what a gathered view is for
    clean = lambent.denoise(frame)
    assert clean.colour.mean() == pytest.approx(frame.colour.mean(), rel=0.1)


def test_a_camera_of_one_s_own(capsys, solved, tmp_path):
    path = tmp_path / "a.png"
    options = ("--origin", "0.5,0,0", "--target", "-1,-0.2,0", "--fov", "60")
    assert run(capsys, "view", solved, "-o", path, *options)[0] == 0
    code, _, err = run(capsys, "view", solved, "-o", tmp_path / "b.png", "--origin", "1,2")
    assert code == 4
    assert "is not a point" in err
    code, _, err = run(capsys, "view", solved, "-o", tmp_path / "b.png", "--origin", "0,0,0")
    assert code == 4
    assert "--target" in err


def test_films_and_frames(capsys, solved, tmp_path):
    keys = tmp_path / "fly.toml"
    keys.write_text(FLY)
    film = tmp_path / "fly.mp4"
    options = ("--frames", "1-4", "--animation", keys)
    assert run(capsys, "view", solved, "-o", film, *options)[0] == 0
    with av.open(str(film)) as container:
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert len(frames) == 4
    assert frames[0].shape == (48, 48, 3)
    assert np.abs(frames[0].astype(int) - frames[3]).mean() > 1
    assert not list(tmp_path.glob(".*part*"))
    code, out, _ = run(capsys, "view", solved, "-o", tmp_path / "f.##.png", *options)
    assert code == 0
    assert len(out.split()) == 4
    assert (tmp_path / "f.03.png").exists()


def test_meshes_and_lightmaps(capsys, solved, tmp_path):
    ply, glb, exr = (tmp_path / f"a.{kind}" for kind in ("ply", "glb", "exr"))
    for path in (ply, glb):
        assert run(capsys, "view", solved, "-o", path)[0] == 0
    data = plyfile.PlyData.read(str(ply))
    vertex, face = data["vertex"], data["face"]
    assert len(face) > 100
    assert float(vertex["red"].max()) > 1  # the lamp, as it shines
    assert np.stack(face["vertex_indices"]).max() == len(vertex) - 1
    document = pygltflib.GLTF2().load(str(glb))
    assert document.accessors[0].count == 3 * len(face)
    assert document.accessors[2].count == len(vertex)
    assert run(capsys, "view", solved, "-o", exr, "--lightmap")[0] == 0
    image = lambent.read(exr).colour
    places = json.loads((tmp_path / "a.uv.json").read_text())
    assert len(places["primitives"]) == 14
    assert image.max() > 0
    uv = np.array([entry["uv"] for entry in places["primitives"]])
    corners = np.array([entry["corners"] for entry in places["primitives"]])
    assert np.abs(corners).max() == pytest.approx(1)
    assert uv.min() > 0
    assert uv.max() < 1


def test_wishes_that_cannot_be(capsys, scene, solved, tmp_path):
    for args, code, words in (
        (("solve", scene, "-o", tmp_path / "a.exr"), 4, ".lambent"),
        (("solve", scene, "-o", solved), 2, "exists"),
        (("solve", scene, "--solver", "magic", "-o", tmp_path / "a.lambent"), 4, "no solver"),
        (("solve", tmp_path / "none.xml", "-o", tmp_path / "a.lambent"), 2, "no such file"),
        (("solve", scene, "-o", tmp_path / "a.lambent", "--resume"), 2, "no such file"),
        (("view", solved, "-o", tmp_path / "a.gif"), 4, "no kind of view"),
        (("view", solved, "-o", tmp_path / "a.png", "--show", "magic"), 4, "no kind of view"),
        (("view", solved, "-o", tmp_path / "a.mp4"), 4, "needs frames"),
        (("view", solved, "-o", tmp_path / "a.png", "--frames", "1-3"), 4, "no place"),
        (("view", solved, "-o", tmp_path / "a.mp4", "--frames", "1-3"), 4, "keyframes"),
        (("view", solved, "-o", tmp_path / "a.png", "--camera", "7"), 4, "camera"),
        (("view", solved, "-o", tmp_path / "a.##.png"), 4, "no --frames"),
        (("view", solved, "-o", tmp_path / "a.png", "--animation", scene), 4, "needs --frames"),
        (("view", solved, "-o", tmp_path / "a.glb", "--fov", "40"), 4, "no camera"),
        (("solve", scene, "-o", solved, "--resume", "--rays", "32"), 4, "rays (64 there, 32 here)"),
        (("solve", scene, "-o", tmp_path / "b.lambent", "--patch-size", "0"), 4, "above 0"),
        (("solve", scene, "-o", tmp_path / "b.lambent", "--patch-size", "1e-6"), 4, "GiB"),
        (("view", scene, "-o", tmp_path / "a.png"), 2, "not a Lambent solution"),
        (("view", tmp_path / "none.lambent", "-o", tmp_path / "a.png"), 2, "there is no such file"),
    ):
        found, _, err = run(capsys, *args)
        assert (found, words in err) == (code, True), (args, err)


def test_a_scene_that_has_moved_or_changed(capsys, scene, solved, tmp_path):
    moved = tmp_path / "elsewhere.xml"
    scene.rename(moved)
    code, _, err = run(capsys, "view", solved, "-o", tmp_path / "a.png")
    assert code == 2
    assert "--scene" in err
    assert run(capsys, "view", solved, "-o", tmp_path / "a.png", "--scene", moved)[0] == 0
    moved.write_text(SCENE.replace('value="0.4"', 'value="0.3"'))
    code, _, err = run(capsys, "view", solved, "-o", tmp_path / "b.png", "--scene", moved)
    assert code == 2
    assert "another scene" in err


def test_going_on(capsys, scene, tmp_path):
    path = tmp_path / "a.lambent"
    rough = (
        "solve",
        scene,
        "-o",
        path,
        "--patches",
        100,
        "--solver",
        "jacobi",
        "--steps",
        1,
        "--json",
    )
    _, out, _ = run(capsys, *rough)
    before = json.loads(out)["residual"]
    code, out, _ = run(capsys, "solve", scene, "-o", path, "--resume", "--json")
    assert code == 0
    assert json.loads(out)["residual"] < before


def test_an_interrupt_keeps_the_solution(capsys, scene, tmp_path, monkeypatch):
    from lambent.transport.radiosity import solvers

    path = tmp_path / "a.lambent"
    whole = solvers.jacobi

    def stopped(eq, start=None):
        steps = whole(eq, start)
        yield next(steps)
        raise KeyboardInterrupt

    monkeypatch.setitem(solvers.SOLVERS, "jacobi", (stopped, ""))
    code, _, err = run(capsys, "solve", scene, "-o", path, "--patches", 100, "--solver", "jacobi")
    assert code == 130
    assert "is kept in" in err
    assert "--resume" in err
    assert lambent.open_solution(path).interrupted


def test_a_page_of_someone_else_s_is_kept(capsys, scene, tmp_path):
    page = tmp_path / "index.html"
    page.write_text("precious")
    code, _, _ = run(capsys, "solve", scene, "-o", tmp_path / "index.lambent", "--report")
    assert code == 2
    assert page.read_text() == "precious"


def test_values_of_names_are_remembered(capsys, tmp_path):
    scene = tmp_path / "named.xml"
    scene.write_text(
        SCENE.replace(
            '<default name="res"', '<default name="rho" value="0.7"/><default name="res"'
        ).replace('value="0.7,0.5,0.3"', 'value="$rho"')
    )
    path = tmp_path / "a.lambent"
    options = ("--patches", 100, "--rays", 32)
    assert run(capsys, "solve", scene, "-o", path, "-D", "rho=0.1", *options)[0] == 0
    plain, other = tmp_path / "a.exr", tmp_path / "b.exr"
    code, out, _ = run(capsys, "view", path, "-o", plain)
    assert code == 0
    assert "changed since" not in out
    assert lambent.read(plain)["albedo"].max() == pytest.approx(0.1, abs=0.01)
    code, out, _ = run(capsys, "view", path, "-o", other, "-D", "rho=0.7")
    assert code == 0
    assert "have changed since the light was solved" in out
