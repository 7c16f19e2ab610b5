"""CONTRIBUTING's "how to add", walked through: the page's own files and lines in a copy of the
package, which then lists, uses and tests what was added.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text()


def section(title: str) -> str:
    return PAGE.split(f"### {title}\n")[1].split("\n### ")[0].split("\n## ")[0]


def files_of(text: str) -> Iterator[tuple[str, str]]:
    """Each block of Python with the file that is named last before it."""
    for before, body in re.findall(r"(.*?)```python\n(.*?)```", text, re.S):
        yield re.findall(r"`((?:src|tests)/[\w/]+\.py)`", before)[-1], body


@pytest.fixture
def checkout(tmp_path: Path):
    """``checkout(title)``: a copy of the package with what a section adds."""

    def made(title: str) -> Path:
        shutil.copytree(
            ROOT / "src" / "lambent", tmp_path / "src" / "lambent",
            ignore=shutil.ignore_patterns("__pycache__"),
        )  # fmt: skip
        shutil.copytree(ROOT / "tests" / "frame", tmp_path / "tests" / "frame")
        blocks = dict(files_of(section(title)))
        assert len(blocks) == 3  # the thing, its line in the registry, its test
        for name, body in blocks.items():
            path = tmp_path / name
            if path.exists():  # a line of the registry
                text = path.read_text()
                first = re.search(r'^        "\w[\w-]*": f?"[^"]+",\n', text, re.M)
                assert first is not None
                path.write_text(text[: first.start()] + body + text[first.start() :])
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(body)
        return tmp_path

    return made


def run(folder: Path, *arguments: str) -> str:
    """Python on the copy; what it printed."""
    environment = {**os.environ, "PYTHONPATH": str(folder / "src")}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_filter(checkout, tmp_path: Path) -> None:
    import lambent

    folder = checkout("A filter")
    noisy = np.random.default_rng(0).random((16, 20, 3)).astype(np.float32)
    lambent.write(folder / "noisy.exr", lambent.Frame.from_arrays(colour=noisy))
    assert "tent: Tent filter" in run(folder, "-m", "lambent", "models", "tent")
    run(folder, "-m", "lambent", "denoise", "noisy.exr", "-m", "tent", "--set", "radius=1")
    clean = lambent.read(folder / "noisy_clean.exr").colour
    taps = np.outer([1, 2, 1], [1, 2, 1]) / 16
    wanted = (noisy[3:6, 7:10] * taps[..., None]).sum((0, 1))
    np.testing.assert_allclose(clean[4, 8], wanted, rtol=1e-5)
    run(folder, "-m", "pytest", "-q", "tests/filters/test_tent.py")


def test_a_dialect(checkout) -> None:
    folder = checkout("A dialect")
    code = "from lambent.frame.dialects import DIALECTS; print(DIALECTS['lantern'].title)"
    assert run(folder, "-c", code).strip() == "Lantern"
    run(folder, "-m", "pytest", "-q", "tests/frame/test_lantern.py")
