"""A Blender that stays alive over the tests, and .blend files made by it."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from lambent.render.cycles.find import Blender
from lambent.render.cycles.process import BlenderProcess

MAKE = Path(__file__).parent / "blend_files.py"


@pytest.fixture(scope="session")
def process(blender: Blender):
    """A Blender that stays alive over the tests."""
    with BlenderProcess(blender) as running:
        yield running


@pytest.fixture(scope="session")
def blend(blender: Blender, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """``blend(kind, name)``: a .blend file of that kind, made once."""
    folder = tmp_path_factory.mktemp("blend")

    def make(kind: str, name: str = "") -> Path:
        path = folder / f"{name or kind}.blend"
        if not path.exists():
            if blender.python:
                command = [blender.program, str(MAKE), kind, str(path)]
            else:
                command = [blender.program, "-b", "--python", str(MAKE), "--", kind, str(path)]
            subprocess.run(command, check=True, capture_output=True, timeout=120)
        return path

    return make
