"""Scenes of a folder of models: what is found, what a seed gives, and that things stand on things.

The folder is made here: a GLB cube with a texture, a PLY ball, an environment map, a Mitsuba scene.
"""

from __future__ import annotations

import io
import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import lambent.dataset
from lambent.cli import main
from lambent.dataset.recipe import load_recipe
from lambent.dataset.validation import refuse_asset
from lambent.errors import DamagedFileError, FileError
from lambent.render.variant import mitsuba
from lambent.scenes.assets.arrange import SHARES, WHOLE, arrangement, kind_of, read_map
from lambent.scenes.assets.gltf import read_gltf
from lambent.scenes.assets.library import open_library
from lambent.scenes.assets.model import load_model
from lambent.scenes.assets.whole import Cameras
from lambent.scenes.mitsuba.geometry import box, sphere

SETTINGS = [kind for kind in SHARES if kind != WHOLE]


@pytest.fixture(scope="module")
def mi():
    return mitsuba("cpu")


def write_glb(path: Path, *, move=(0.0, 0.0, 0.0), scale=1.0) -> None:
    """A cube of 0.2 m, base at y = 0, red and green by a picture, on a node moved and scaled."""
    g = box(0.2, 0.2, 0.2)
    positions = g.positions[:, [0, 2, 1]] * [1, 1, -1]
    normals = g.normals[:, [0, 2, 1]] * [1, 1, -1]
    picture = io.BytesIO()
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:4, :, 0] = pixels[4:, :, 1] = 200
    Image.fromarray(pixels).save(picture, "PNG")
    blobs = [
        positions.astype("<f4").tobytes(),
        normals.astype("<f4").tobytes(),
        (g.uv / 0.2 + 0.5).astype("<f4").tobytes(),
        g.faces.astype("<u2").tobytes(),
        picture.getvalue(),
    ]
    views, data = [], b""
    for blob in blobs:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(blob)})
        data += blob + bytes(-len(blob) % 4)
    n = len(positions)
    kinds = [
        (n, "VEC3", 5126),
        (n, "VEC3", 5126),
        (n, "VEC2", 5126),
        (g.faces.size, "SCALAR", 5123),
    ]
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"children": [1], "scale": [scale] * 3},
            {"mesh": 0, "translation": list(move)},
        ],
        "meshes": [
            {
                "primitives": [
                    {
                        "attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2},
                        "indices": 3,
                        "material": 0,
                    }
                ]
            }
        ],
        "materials": [
            {
                "name": "paint",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "roughnessFactor": 0.25,
                    "metallicFactor": 0,
                },
            }
        ],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": k, "count": c, "type": t, "componentType": v}
            for k, (c, t, v) in enumerate(kinds)
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def write_ball(path: Path) -> None:
    g = sphere(1.0, 8)
    lines = ["ply", "format ascii 1.0", f"element vertex {len(g.positions)}"]
    lines += [f"property float {c}" for c in "xyz"]
    lines += [
        f"element face {len(g.faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    lines += [" ".join(f"{v:.6f}" for v in p) for p in g.positions]
    lines += ["3 " + " ".join(map(str, f)) for f in g.faces]
    path.write_text("\n".join(lines) + "\n")


SCENE = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="60"/>
<transform name="to_world"><lookat origin="0,1,-3" target="0,0.5,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="18"/></film>
</sensor>
<shape type="rectangle"><transform name="to_world"><scale value="5"/>
<rotate x="1" angle="-90"/></transform></shape>
<shape type="cube"><transform name="to_world"><scale value="0.4"/>
<translate y="0.4"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.6,0.2,0.1"/>
</bsdf></shape>
<shape type="sphere"><point name="center" x="1" y="0.5" z="0.5"/><float name="radius" value="0.5"/>
<bsdf type="roughplastic"/></shape>
<emitter type="constant"><rgb name="radiance" value="1,1,1"/></emitter>
</scene>"""


def write_map(path: Path) -> None:
    from lambent.render.variant import mitsuba

    image = np.full((16, 32, 3), 0.2, np.float32)
    image[3:5, 6:9] = 60
    mitsuba("cpu").Bitmap(image).write(str(path))


@pytest.fixture(scope="module")
def assets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("assets")
    for name in ("models", "env", "textures/wood", "scenes/still", "scenes_test/bathroom"):
        (folder / name).mkdir(parents=True)
    write_glb(folder / "models" / "cube.glb")
    write_ball(folder / "models" / "ball.ply")
    write_map(folder / "env" / "sky.hdr")
    pixels = np.random.default_rng(1).integers(60, 200, (16, 16, 3), np.uint8)
    Image.fromarray(pixels).save(folder / "textures" / "wood" / "albedo.png")
    (folder / "scenes" / "still" / "scene.xml").write_text(SCENE)
    (folder / "scenes_test" / "bathroom" / "scene.xml").write_text(SCENE)
    write_ball(folder / "scenes_test" / "bathroom" / "tub.ply")
    (folder / "SOURCES.md").write_text("- `models/cube.glb` — Cube, A. Person, CC0-1.0\n")
    return folder


@pytest.fixture(scope="module")
def library(assets):
    return open_library(assets, refuse_asset)


def test_a_folder_is_searched_by_file_ending(library, assets):
    names = {
        sort: [p.relative_to(assets).as_posix() for p in getattr(library, sort)]
        for sort in ("models", "textures", "environments", "scenes")
    }
    assert names == {
        "models": ["models/ball.ply", "models/cube.glb"],
        "textures": ["textures/wood/albedo.png"],
        "environments": ["env/sky.hdr"],
        "scenes": ["scenes/still/scene.xml"],
    }
    assert "models/cube.glb: Cube, A. Person, CC0-1.0" in library.licences
    assert f"unknown: {assets.name}/models/ball.ply" in library.licences
    assert [n for n in library.notes if "scenes_test/bathroom" in n and "test scene" in n]


def test_a_broken_glb_is_left_out_and_named(assets, tmp_path):
    folder = tmp_path / "assets"
    shutil.copytree(assets, folder)
    whole = (folder / "models" / "cube.glb").read_bytes()
    (folder / "models" / "short.glb").write_bytes(whole[: len(whole) // 2])
    (folder / "models" / "text.glb").write_text("no model at all")
    found = open_library(folder, refuse_asset)
    assert [p.name for p in found.models] == ["ball.ply", "cube.glb"]
    for name in ("short.glb", "text.glb"):
        assert any(name in note and "cannot be read" in note for note in found.notes)
    with pytest.raises(DamagedFileError, match=r"short\.glb"):
        read_gltf(folder / "models" / "short.glb")


def test_a_folder_that_is_not_there_or_empty_is_an_error(tmp_path):
    with pytest.raises(FileError, match="no such folder"):
        open_library(tmp_path / "none", refuse_asset)
    with pytest.raises(FileError, match="no model and no scene"):
        open_library(tmp_path, refuse_asset)


def test_gltf_meshes_stand_where_their_nodes_put_them(tmp_path, mi):
    write_glb(tmp_path / "cube.glb", move=(1.0, 2.0, 3.0), scale=2.0)
    model = load_model(tmp_path / "cube.glb", mi)
    ((geometry, surface),) = model.parts
    # y up becomes z up: (x, y, z) -> (x, -z, y). The child's move is scaled by its parent.
    assert np.allclose(model.bounds, [[1.8, -6.2, 4.0], [2.2, -5.8, 4.4]], atol=1e-6)
    assert model.metric
    centre = np.mean(model.bounds, 0)
    outwards = np.einsum("ij,ij->i", geometry.positions - centre, geometry.normals)
    assert (outwards > 0.1).all()
    corners = geometry.positions[geometry.faces]
    wound = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", wound, geometry.normals[geometry.faces[:, 0]]) > 0).all()
    assert surface.structure == "pbr"
    picture = surface.values["base_color"]
    assert picture[0, 0].tolist() == [200, 0, 0]  # row 0 is v = 0
    assert picture[-1, 0].tolist() == [0, 200, 0]
    assert surface.values["roughness"].ravel().tolist() == [64]
    assert surface.values["metallic"].ravel().tolist() == [0]


def test_a_map_keeps_its_light_and_its_lamp(library, mi):
    image = read_map(library.environments[0], mi)
    assert image.shape == (256, 512, 3)
    assert image.max() == pytest.approx(60, rel=0.01)
    assert image.mean() == pytest.approx(0.2 + 59.8 * 6 / 512, rel=0.02)


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_seed_gives_the_same_scene_and_things_stand_on_their_support(library, mi, setting):
    plan = arrangement(5, library, mi, setting)
    assert plan.digest() == arrangement(5, library, mi, setting).digest()
    assert plan.digest() != arrangement(6, library, mi, setting).digest()
    assert len(plan.cameras) >= 4
    models = [s for s in plan.shapes if s.movable and s.movable.startswith("model")]
    lowest = [float(s.geometry.moved(s.to_world).bounds[0][2]) for s in models]
    carriers = [s for s in plan.shapes if not s.movable and s.emitter is None]
    for shape, low in zip(models, lowest, strict=True):
        size = np.ptp(shape.geometry.moved(shape.to_world).bounds, axis=0).max()
        assert 0.01 < size < 8
        if setting in ("floor", "room", "table"):
            assert 0 <= low < 0.002
        elif setting == "shelf":
            assert low > 0.3
        else:
            x, y = shape.to_world[:2, 3]
            ground = max(carriers, key=lambda s: np.ptp(s.geometry.positions[:, 0]))
            p = ground.geometry.positions
            near = p[np.hypot(p[:, 0] - x, p[:, 1] - y).argsort()[:4], 2]
            assert near.min() - 0.15 < low < near.max() + 0.15


def test_all_kinds_come_up(library):
    assert {kind_of(seed, library) for seed in range(80)} == set(SHARES)


def test_cameras_in_a_whole_scene_see_it_from_other_places(library, mi):
    from lambent.render.scene import load

    cameras = Cameras(mi, load(library.scenes[0], device="cpu").scene)
    chosen = cameras.at(3, 4)
    again = cameras.at(3, 4)
    assert all(np.array_equal(a, b) for (a, _), (b, _) in zip(chosen, again, strict=True))
    places = np.array([m[:3, 3] for m, _ in chosen])
    assert (places[:, 1] > 0).all()  # above the floor
    assert len({tuple(p.round(3)) for p in places}) >= 2
    assert all(np.linalg.det(m[:3, :3]) == pytest.approx(1, abs=1e-6) for m, _ in chosen)
    assert all(m[1, 1] > 0 for m, _ in chosen)  # upright


# ------------------------------------------------------------------- as a data set

RECIPE = """
name = "things"
seed = 2
source = "assets"
count = 2
kinds = ["table", "whole"]
items_per_scene = 1
cameras_per_scene = 1
view = [48, 32]
crop = 32
levels = 2
spp = [1, 8]
mean_spp = 2
target_spp = 8
target_most = 8
depth = 4
"""


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    monkeypatch.delenv("LAMBENT_ASSETS", raising=False)
    path = tmp_path / "things.toml"
    path.write_text(RECIPE)
    return path


def test_two_items_from_an_arrangement_and_a_whole_scene(recipe, assets, tmp_path, capsys):
    command = ["dataset", "make", str(recipe), "--assets", str(assets), "-o", str(tmp_path / "set")]
    assert main(command) == 0
    assert "left out: scenes_test/bathroom/scene.xml" in capsys.readouterr().out
    data = lambent.dataset.open(tmp_path / "set")
    assert [item.about["kind"] for item in data] == ["table", "whole"]
    for item in data:
        assert item.target.colour.shape == (32, 32, 3)
        assert np.isfinite(item.target.colour).all()
        assert item.target.colour.mean() > 0.001
        assert len(item.levels) == 2
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert "models/cube.glb: Cube, A. Person, CC0-1.0" in manifest["licences"]
    assert any(line.startswith("unknown: ") for line in manifest["licences"])
    # The same files, wherever the folder lies; with others the set is not continued.
    other = assets.parent / f"{assets.name}-elsewhere"
    other.symlink_to(assets)
    assert main([*command[:4], str(other), *command[5:]]) == 0
    other.unlink()
    shutil.copytree(assets, other)
    (other / "models" / "cube.glb").unlink()
    assert main([*command[:4], str(other), *command[5:]]) == 4
    assert "another folder of assets" in capsys.readouterr().err


def test_without_a_folder_of_assets_the_ways_to_name_one_are_told(recipe, tmp_path, capsys):
    for extra, code, words in (
        ([], 4, "LAMBENT_ASSETS"),
        (["--assets", str(tmp_path / "none")], 2, "no such folder"),
    ):
        assert main(["dataset", "make", str(recipe), "-o", str(tmp_path / "set"), *extra]) == code
        err = capsys.readouterr().err
        assert words in err
        assert "Traceback" not in err


def test_the_recipe_may_name_the_folder(recipe, assets, tmp_path, monkeypatch):
    monkeypatch.setenv("LAMBENT_ASSETS", str(assets))
    assert load_recipe(recipe).assets == str(assets)
    recipe.write_text(RECIPE + 'assets = "here"\n')
    assert load_recipe(recipe).assets == str((tmp_path / "here").resolve())
    assert load_recipe(recipe, assets).assets == str(assets)
    assert load_recipe(recipe).essence == load_recipe(recipe, assets).essence
