"""Names from files are shown, never obeyed: no command sends a control character to a terminal.

Each command gets a file whose own name, parts, views, layers and attributes hold escape sequences,
bells, line breaks, C1 controls and bidi overrides, and where it can fail, fails over them.
"""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "dataset")]
import renders

import lambent
from lambent.cli import main

#: Title, colours, clipboard, bell, cursor; C1; DEL; bidi; line and paragraph separators.
NASTY = "n\x1b]0;T\x07\x1b[31m\r\n\t\x9b2J\x85\x7f\u202ea\u2066\u2028\u200fz"
#: In a file's name also a byte that is no UTF-8.
NASTY_FILE = NASTY + "\udcff"

SCENE = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="70"/>
  <transform name="to_world"><lookat origin="0,0,0.95" target="0,0,-1" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
    <rfilter type="box"/></film></sensor>
<shape type="cube" id="{name}"><boolean name="flip_normals" value="true"/><bsdf type="{bsdf}"/>
</shape>
<shape type="rectangle" id="lamp{name}"><emitter type="area"/></shape></scene>
"""
#: What of it XML lets through.
IN_XML = "n\x9b2J\x85\x7f\u202ea\u2066"

#: How they are shown, whatever becomes of capitals.
SHOWN = (r"n\x1b]0;t\x07\x1b[31m\r\n\t\x9b2j\x85\x7f\u202ea", r"n\x9b2j\x85\x7f\u202ea\u2066")


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with a nasty name."""
    folder = tmp_path / NASTY_FILE
    folder.mkdir()
    return folder


@pytest.fixture
def nasty(place: Path, tmp_path: Path) -> Path:
    """An EXR of two views in three parts, everything in it with nasty names."""
    rng = np.random.default_rng(2)

    def part(name: str, view: str, *layers: str) -> OpenEXR.Part:
        channels = {
            f"{layer}{c}": rng.gamma(2.0, 0.5, (16, 20)).astype(np.float32)
            for layer in layers
            for c in "RGB"
        }
        header = {"view": view, "Software": f"Mitsuba {NASTY}", "comments": NASTY}
        return OpenEXR.Part(header, channels, name)

    raw = [
        part(f"rgba.left{NASTY}", f"left{NASTY}", "", f"{NASTY}."),
        part(f"rgba.right{NASTY}", f"right{NASTY}", "", "albedo."),
        part(f"crypto{NASTY}", f"right{NASTY}", f"crypto{NASTY}00."),
    ]
    path = place / f"{NASTY_FILE}.exr"
    OpenEXR.File(raw).write(str(tmp_path / "plain.exr"))
    (tmp_path / "plain.exr").rename(path)
    return path


class Screen:
    """Runs commands, and looks at every character that comes out."""

    def __init__(self, capfd: pytest.CaptureFixture[str]) -> None:
        self.capfd = capfd

    def __call__(self, *arguments: object, code: int = 0, names: bool = True) -> str:
        """What a command prints; it must end with ``code`` and show (``names``) the nasty name."""
        self.capfd.readouterr()
        assert main([str(a) for a in arguments]) == code, self.capfd.readouterr()
        captured = self.capfd.readouterr()
        text = captured.out + captured.err
        assert [c for c in text if not c.isprintable() and c != "\n"] == []
        if "--json" in arguments:
            json.loads(captured.out)
        elif names:
            assert any(name in text.lower() for name in SHOWN), text
        return text


@pytest.fixture
def screen(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Screen:
    monkeypatch.setenv("COLUMNS", "400")
    return Screen(capfd)


def with_json(screen: Screen, *arguments: object, **expected: object) -> None:
    """The same command for a person, and for a script."""
    screen(*arguments, **expected)
    screen(*arguments, "--json", **expected)


def test_inspect(screen: Screen, nasty: Path, place: Path) -> None:
    with_json(screen, "inspect", nasty)
    screen("inspect", nasty, "--report")
    with_json(screen, "inspect", nasty, "--map", f"colour=no{NASTY}", code=4)
    with_json(screen, "inspect", nasty, "--map", f"{NASTY}=x", code=4)
    with_json(screen, "inspect", place / f"none{NASTY_FILE}.exr", code=2)
    with_json(screen, "inspect", place, code=2)
    whole = nasty.read_bytes()
    cut = place / f"cut{NASTY_FILE}.exr"
    for size in (300, len(whole) // 2, len(whole) - 20):
        cut.write_bytes(whole[:size])
        with_json(screen, "inspect", cut, code=2)


@pytest.mark.parametrize("ending", ["png", "jpg", "tif", "hdr", "exr"])
def test_broken_pictures(screen: Screen, place: Path, ending: str) -> None:
    """Libraries that read them may warn and log by themselves."""
    path = place / f"{NASTY_FILE}.{ending}"
    rng = np.random.default_rng(0)
    lambent.write(path, lambent.Frame.from_arrays(colour=rng.random((32, 32, 3), np.float32)))
    whole = path.read_bytes()
    screen("inspect", path)
    for size in (9, 200, len(whole) // 2):
        path.write_bytes(whole[:size])
        screen("inspect", path, code=2)


def test_denoise(screen: Screen, nasty: Path, place: Path, tmp_path: Path) -> None:
    model = ["--model", "box"]
    with_json(screen, "denoise", nasty, *model, "--dry-run")
    screen("denoise", nasty, *model, "--preview", "--report")
    screen("denoise", nasty, *model, "--json", "--overwrite")
    with_json(screen, "denoise", nasty, *model, code=2)  # it exists
    with_json(screen, "denoise", nasty, *model, "--passes", NASTY, "--overwrite", code=4)
    with_json(screen, "denoise", nasty, "--model", NASTY, code=4)
    with_json(screen, "denoise", nasty, *model, "--map", NASTY, code=4)
    screen("denoise", nasty, f"--{NASTY}", code=4, names=False)
    with_json(screen, "denoise", nasty, *model, "-o", place / f"x.{NASTY}", code=2)
    with_json(screen, "denoise", nasty, *model, "-o", place / "a" / "b" / NASTY / "x.exr", code=2)


def test_sequences(screen: Screen, nasty: Path, tmp_path: Path) -> None:
    folder = tmp_path / f"shot{NASTY}"
    folder.mkdir()
    content = nasty.read_bytes()
    for number in (1, 2, 4):
        (folder / f"{NASTY}.{number:04d}.exr").write_bytes(content[: -9 if number == 2 else None])
    model = ["--model", "box"]
    with_json(screen, "denoise", folder, *model, "--dry-run")
    screen("denoise", folder, *model, code=2)
    screen("denoise", folder, *model, "--json", code=2)
    pattern = folder / f"{NASTY}.####.exr"
    screen("denoise", pattern, *model, "--frames", "1-4", code=2)
    screen("denoise", folder / f"none{NASTY}.####.exr", *model, code=2)


def test_compare_and_explain(screen: Screen, nasty: Path, place: Path) -> None:
    other = place / f"other{NASTY_FILE}.exr"
    other.write_bytes(nasty.read_bytes())
    with_json(screen, "compare", nasty, other, nasty)
    screen("compare", nasty, other, "--report", place / f"{NASTY_FILE}.html")
    with_json(screen, "compare", nasty, place / f"none{NASTY_FILE}", code=2)
    with_json(screen, "compare", nasty, other, "--metrics", NASTY, code=4)
    picture = place / f"{NASTY_FILE}.png"
    with_json(screen, "explain", nasty, "--pixel", "3,4", "--model", "box", names=False)
    screen("explain", nasty, "--pixel", "3,4", "--model", "box", "-o", picture)
    with_json(screen, "explain", nasty, "--pixel", NASTY, code=4)


def test_render_solve_view(screen: Screen, tmp_path: Path) -> None:
    folder = tmp_path / NASTY  # of bytes that are no UTF-8 Mitsuba cannot make a path
    folder.mkdir()
    scene = folder / f"{NASTY}.xml"
    scene.write_text(SCENE.format(name=IN_XML, bsdf="diffuse"), encoding="utf-8")
    few = ["--spp", "2", "--depth", "2"]
    with_json(
        screen, "render", scene, "-o", folder / f"{NASTY}.exr", *few, "--overwrite",
        "--light-group", f"{NASTY}=lamp*",
    )  # fmt: skip
    with_json(screen, "render", scene, "-o", folder / f"b{NASTY}.exr", "--features", NASTY,
              code=4)  # fmt: skip
    with_json(screen, "render", scene, "--camera", NASTY, "-o", folder / "x.exr", code=4)
    light = folder / f"{NASTY}.lambent"
    solve = ["solve", scene, "-o", light, "--patches", "60", "--rays", "16", "--overwrite"]
    with_json(screen, *solve)
    screen(*solve, "--report")
    with_json(screen, "view", light, "-o", folder / f"{NASTY}.png", "--overwrite")
    with_json(screen, "view", light, "-o", folder / f"{NASTY}.nope", code=4)
    scene.write_text(SCENE.format(name=IN_XML, bsdf=IN_XML), encoding="utf-8")
    for command in ("render", "solve"):
        screen(command, scene, "-o", f"{light}{'' if command == 'solve' else '.exr'}",
               "--overwrite", code=2)  # fmt: skip


def test_data_sets(screen: Screen, place: Path) -> None:
    values = {
        "name": NASTY, "seed": 5, "source": "fake:FakeSource", "count": 2, "clip_count": 0,
        "items_per_scene": 2, "cameras_per_scene": 1, "view": [64, 48], "crop": 32, "levels": 2,
        "spp": [1, 4], "mean_spp": 2, "target_spp": 4, "target_most": 4,
    }  # fmt: skip
    recipe = place / f"{NASTY_FILE}.toml"
    lines = [f"{key} = {json.dumps(value)}" for key, value in values.items()]
    recipe.write_text("\n".join(lines).replace("\x7f", "\\u007f"))
    folder = place / f"set{NASTY_FILE}"
    with_json(screen, "dataset", "make", recipe, "-o", folder)
    with_json(screen, "dataset", "info", folder)
    screen("dataset", "preview", folder, "-o", place / f"{NASTY_FILE}.png", "--count", "2")
    one = next(folder.rglob("*.exr"))
    one.write_bytes(one.read_bytes()[:-30])
    (one.parent / f"{NASTY_FILE}.exr").write_bytes(b"")
    with_json(screen, "dataset", "verify", folder, code=2)
    recipe.write_text(f"{json.dumps(NASTY)} = 1\n".replace("\x7f", "\\u007f"))
    screen("dataset", "make", recipe, "-o", folder, code=4)
    with_json(screen, "dataset", "info", place / f"none{NASTY_FILE}", code=2)


@pytest.mark.heavy
def test_training(screen: Screen, place: Path) -> None:
    recipe = place / f"{NASTY_FILE}.toml"
    recipe.write_text(f"name = {json.dumps(NASTY)}\n".replace("\x7f", "\\u007f"))
    screen("train", recipe, code=4, names=False)
    screen("train", "--data", place / f"none{NASTY_FILE}.exr", "-o", place / "m.lambent", code=2)


def test_models_doctor_and_the_rest(
    screen: Screen, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_json(screen, "models", NASTY, code=4)
    screen(NASTY, code=4)
    monkeypatch.chdir(place)
    screen("doctor", "--no-speed")


# ------------------------------------------------------------------ the one way


def test_nothing_else_prints() -> None:
    """Commands print through `lambent.cli.terminal` alone, the library not at all."""
    package = Path(lambent.__file__).parent
    for path in package.rglob("*.py"):
        if path.name == "terminal.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(getattr(node, "func", None), "id", "")
            assert name != "print", f"{path}: {getattr(node, 'lineno', '')}"


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "cp1252", "utf-8"])
def test_any_encoding(encoding: str, tmp_path: Path) -> None:
    """Arrows, dots and names that it lacks are no reason to fail."""
    path = renders.write(tmp_path / "日本.exr", comments="x")
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    for arguments, code in (
        (["inspect", str(path)], 0),
        (["compare", str(path), str(path)], 0),
        (["denoise", str(path), "--dry-run"], 0),
        (["denoise", str(path), "--model", "日本"], 4),
        (["models"], 0),
        (["denoise", "--help"], 0),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "lambent", *arguments], env=environment, capture_output=True
        )
        assert done.returncode == code, done.stderr
        assert b"unforeseen" not in done.stderr
        (done.stdout + done.stderr).decode(encoding)


def test_names_that_are_too_long(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The system refuses them: an error about a file, with exit code 2, from every command."""
    path = renders.write(tmp_path / "in.exr", comments="x")
    long = tmp_path / ("x" * 300)
    for arguments in (
        ["inspect", f"{long}.exr"],
        ["denoise", f"{long}.exr"],
        ["denoise", str(path), "--model", "box", "-o", f"{long}.exr"],
        ["denoise", f"{long}.####.exr"],
        ["compare", str(path), f"{long}.exr"],
        ["compare", str(path), str(path), "--report", f"{long}.html"],
        ["dataset", "info", str(long)],
    ):
        assert main(arguments) == 2, arguments
        told = capsys.readouterr().err
        assert "unforeseen" not in told
        assert "xxx" in told


def test_pipes(tmp_path: Path) -> None:
    """A pipe cannot be read in any order: said so, whether or not anybody writes to it."""
    path = renders.write(tmp_path / "in.exr", comments="x")
    os.mkfifo(tmp_path / "waits.exr")
    for arguments in (
        ["inspect", "/dev/stdin"],
        ["denoise", "/dev/stdin", "-o", str(tmp_path / "out.exr")],
        ["compare", str(path), "/dev/stdin"],
        ["inspect", str(tmp_path / "waits.exr")],
    ):
        done = subprocess.run(
            [sys.executable, "-m", "lambent", *arguments],
            input=path.read_bytes(), capture_output=True, timeout=120,
        )  # fmt: skip
        assert done.returncode == 2, done.stderr
        assert b"is a pipe" in done.stderr
        assert b"save the picture into a file" in done.stderr
