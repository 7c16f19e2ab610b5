"""Without its extra, a command names the extra; what needs none runs without any."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

#: What the extras bring.
PACKAGES = ("torch", "nncf", "tensorboard", "mitsuba", "scipy", "av", "plyfile", "pygltflib", "ray",
            "bpy", "skimage", "cv2")  # fmt: skip

#: Command, the package that is missing, and the extra that brings it.
MISSING = [
    ("render scene.xml -o r.exr", "mitsuba", "render"),
    ("solve scene.xml -o r.lambent", "mitsuba", "transport"),
    ("solve scene.xml -o r.lambent", "scipy", "transport"),
    ("view room.lambent -o v.exr", "mitsuba", "transport"),
    ("train recipe.toml", "torch", "train"),
    ("dataset make recipe.toml -o set --cluster local", "ray", "cluster"),
]

#: A program that cannot find the packages {missing}, as where they are not installed.
PROGRAM = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
PathFinder.find_spec = lambda name, *more: None if name in {missing} else find(name, *more)
from lambent.cli import main
sys.exit(main({arguments}))
"""


def run(folder: Path, command: str, *missing: str) -> subprocess.CompletedProcess[str]:
    """A command in a process that cannot find the packages ``missing``."""
    code = PROGRAM.format(missing=missing, arguments=command.split())
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=300
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    (tmp_path / "recipe.toml").write_text('name = "x"\nseed = 1\ncount = 1\n')
    return tmp_path


@pytest.mark.parametrize(("command", "package", "extra"), MISSING)
def test_the_extra_is_named(folder: Path, command: str, package: str, extra: str) -> None:
    done = run(folder, command, package)
    assert done.returncode == 5, done.stderr
    assert f"pip install 'lambent[{extra}]'" in done.stderr
    assert "unforeseen" not in done.stderr


@pytest.mark.parametrize("model", ["lambent", "dncnn", "oidn", "nfor-tuned", "bilateral"])
def test_denoising_needs_no_extra(tmp_path: Path, model: str) -> None:
    renders.write(tmp_path / "frame.exr")
    done = run(tmp_path, f"denoise frame.exr -o out.exr --model {model} --json", *PACKAGES)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    assert (tmp_path / "out.exr").exists()
