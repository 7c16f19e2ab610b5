"""`lambent dataset` as a person and a script use it."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "dataset"))

from lambent.cli import main
from lambent.cli.options import seconds_of
from lambent.errors import OptionError

ROOT = Path(__file__).parents[2]
RECIPE = """
name = "tiny"
seed = 5
source = "{source}"
count = {count}
clip_count = {clips}
items_per_scene = 2
cameras_per_scene = 2
view = [192, 96]
crop = 32
levels = 2
spp = [1, 8]
mean_spp = 3
target_spp = 16
target_most = 16
clips_per_scene = 1
clip_frames = 2
clip_target_spp = 16
depth = 4
"""


@pytest.fixture
def recipe(tmp_path) -> Path:
    return written(tmp_path, "fake:FakeSource", 4, 1)


def written(folder: Path, source: str, count: int, clips: int) -> Path:
    path = folder / "recipe.toml"
    path.write_text(RECIPE.format(source=source, count=count, clips=clips))
    return path


def run(capsys, *args: object) -> str:
    capsys.readouterr()
    assert main(["dataset", *map(str, args)]) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def test_from_recipe_to_sheet(recipe, tmp_path, capsys):
    folder = tmp_path / "set"
    text = run(capsys, "make", recipe, "-o", folder)
    assert "5 items made" in text
    assert "Time: " in text
    assert "nothing was missing" in run(capsys, "make", recipe, "-o", folder)
    text = run(capsys, "info", folder)
    assert "tiny: fake:FakeSource, seed 5" in text
    found = json.loads(run(capsys, "info", folder, "--json"))
    assert (found["crops"]["made"], found["clips"]["made"]) == (4, 1)
    assert found["bytes"] == sum(p.stat().st_size for p in folder.rglob("*.exr"))
    assert found["licences"] == ["CC0-1.0"]
    sheet = tmp_path / "sheet.png"
    assert run(capsys, "preview", folder, "-o", sheet).strip() == str(sheet)
    assert picture(sheet).std() > 20
    assert "5 of 5 items are there and sound" in run(capsys, "verify", folder)


def picture(path: Path) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB"), float)


def test_a_preview_is_not_replaced_unasked(recipe, tmp_path, capsys):
    sheet = tmp_path / "sheet.png"
    run(capsys, "preview", recipe, "-o", sheet, "--count", 3)
    before = sheet.read_bytes()
    assert main(["dataset", "preview", str(recipe), "-o", str(sheet), "--count", "3"]) == 2
    assert "exists already" in capsys.readouterr().err
    assert sheet.read_bytes() == before
    run(capsys, "preview", recipe, "-o", sheet, "--count", 3, "--overwrite")
    assert sheet.read_bytes() == before, "the same recipe shows other scenes"


def test_verify_names_what_is_wrong(recipe, tmp_path, capsys):
    folder = tmp_path / "set"
    run(capsys, "make", recipe, "-o", folder)
    shard = folder / "crops/000/000002.exr"
    content = bytearray(shard.read_bytes())
    content[-20] ^= 1
    shard.write_bytes(content)
    assert main(["dataset", "verify", str(folder)]) == 2
    out = capsys.readouterr().out
    assert "damaged   crops/000/000002.exr" in out
    assert "4 of 5 items" in out
    assert main(["dataset", "verify", str(folder), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["corrupt"].keys() == {"crops/000/000002.exr"}
    assert "1 items made" in run(capsys, "make", recipe, "-o", folder)
    run(capsys, "verify", folder)


def test_counts_on_the_command_line_and_time(recipe, tmp_path, capsys):
    folder = tmp_path / "set"
    run(capsys, "make", recipe, "-o", folder, "--count", 2, "--clips", 0)
    text = run(capsys, "make", recipe, "-o", folder, "--count", 6, "--time", "0.001s")
    assert "are still to be made: the same command goes on" in text
    done = json.loads(run(capsys, "make", recipe, "-o", folder, "--count", 6, "--json"))
    assert done["left"] == 0
    assert done["made"] + done["before"] == 7


@pytest.mark.parametrize(
    ("args", "code", "words"),
    [
        (["make", "none.toml"], 2, "no such recipe"),
        (["info", "nowhere"], 2, "not a data set"),
        (["verify", "nowhere"], 2, "not a data set"),
        (["make", "{recipe}", "--time", "soon"], 4, "45s, 90m or 2h"),
        (["make", "{recipe}", "--count", "0", "--clips", "0"], 4, "no items"),
        (["make", "{recipe}", "--processes", "-1"], 4, "makes no sense"),
        (["preview", "{recipe}", "-o", "nowhere/sheet.png"], 2, "does not exist"),
        (["mkae"], 4, "make"),
    ],
)
def test_nonsense_is_answered(recipe, tmp_path, capsys, monkeypatch, args, code, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LAMBENT_CACHE", str(tmp_path / "cache"))
    assert main(["dataset", *(a.format(recipe=recipe) for a in args)]) == code
    err = capsys.readouterr().err
    assert words in err
    assert "Traceback" not in err


def test_validation_scenes_are_refused(recipe, tmp_path, capsys):
    (tmp_path / "veach-mis").mkdir()
    (tmp_path / "veach-mis" / "scene.xml").write_text("<scene/>")
    text = recipe.read_text().replace("fake:FakeSource", "scenes")
    recipe.write_text(text + 'scenes = ["veach-mis/scene.xml"]\n')
    assert main(["dataset", "make", str(recipe), "-o", str(tmp_path / "set")]) == 4
    assert "'veach-mis' is a validation scene" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()
    recipe.write_text(text.replace("scenes", "cycles") + "seeds = [900003]\n")
    assert main(["dataset", "make", str(recipe), "-o", str(tmp_path / "set")]) == 4
    assert "seed 900003 is a validation scene's" in capsys.readouterr().err


def test_times():
    found = [seconds_of("--time", t) for t in ("90", "90s", "1.5 m", "30min", "2h")]
    assert found == [90, 90, 90, 1800, 7200]
    with pytest.raises(OptionError):
        seconds_of("--time", "-3s")


@pytest.mark.parametrize("command", [[], ["make"], ["preview"], ["info"], ["verify"]])
def test_help_loads_nothing_heavy(command):
    code = (
        "import sys\nfrom lambent.cli import main\n"
        f"main({['dataset', *command, '--help']!r})\n"
        "print(*sys.modules, sep='\\n', file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {line.partition(".")[0] for line in done.stderr.splitlines()}
    assert not loaded & {"mitsuba", "drjit", "numpy", "OpenEXR", "ray", "bpy", "rich"}
    assert done.stdout.startswith("Usage: ")


def test_the_recipes_that_come_along_are_sound(monkeypatch):
    from lambent.dataset.recipe import load_recipe

    found = {}
    for path in sorted((ROOT / "recipes").glob("*.toml")):
        if "LAMBENT_SCENES" not in path.read_text() and path.stem != "sets":
            found[path.stem] = load_recipe(path)
    assert {"mitsuba", "cycles", "small"} <= set(found)
    assert found["mitsuba"].count >= 4000
    assert found["mitsuba"].clip_count >= 300
    assert found["cycles"].count >= 800
    assert all(name == recipe.name for name, recipe in found.items())
    found.pop("first")  # a first look, in two minutes
    assert all(r.target_spp >= 128 and r.crop == 128 for r in found.values())


# ------------------------------------------------------------------- rendered


def test_random_scenes_rendered(tmp_path, capsys):
    """Mitsuba, one scene: an item made alone later is the one made along with the others."""
    if importlib.util.find_spec("mitsuba") is None:  # importing it here would come before LLVM
        pytest.skip("needs the extra 'render'")
    import lambent.dataset
    from lambent.frame.role import Role

    recipe = written(tmp_path, "procedural", 2, 1)
    recipe.write_text(recipe.read_text() + 'kinds = ["still_life"]\n')
    folder = tmp_path / "set"
    run(capsys, "make", recipe, "-o", folder)
    before = {p: p.read_bytes() for p in folder.rglob("*.exr")}
    assert len(before) == 3
    victim = folder / "crops/000/000001.exr"
    victim.unlink()
    run(capsys, "make", recipe, "-o", folder)
    assert victim.read_bytes() == before[victim]
    dataset = lambent.dataset.open(folder)
    for item in dataset:
        for still in item.stills:
            for frame in (*still.levels, still.target):
                assert frame.colour.shape == (32, 32, 3)
                assert np.isfinite(frame.colour).all()
                total = frame[Role.DIFFUSE] + frame[Role.SPECULAR]
                assert np.allclose(total, frame.colour, rtol=2e-3, atol=1e-5)
                assert np.linalg.norm(frame[Role.NORMAL], axis=2).max() < 1.01
            noisy, target = still.levels[0], still.target
            assert not np.array_equal(noisy.colour, target.colour)
            # The same place: albedo of few samples is near that of many.
            assert np.median(np.abs(noisy[Role.ALBEDO] - target[Role.ALBEDO])) < 0.05
    clip = dataset.find("clip", 0)
    assert all(frame.has(Role.MOTION) for s in clip.stills for frame in (*s.levels, s.target))
    assert json.loads((folder / "manifest.json").read_text())["versions"][0]["mitsuba"]
