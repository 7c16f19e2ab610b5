"""The commands and the Python of README.md, and the examples of the packages, run as they stand."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: The packages whose examples need nothing but the base install and the shipped example.
PACKAGES = ("cli", "denoise", "filters", "frame", "kernels", "metrics", "models", "report")
PAGES = ["README.md", *(f"src/lambent/{name}/README.md" for name in PACKAGES)]


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The pages are run from the root of the repository; what they write to /tmp comes here."""
    monkeypatch.chdir(ROOT)
    return tmp_path


@pytest.mark.parametrize("page", PAGES)
def test_python_runs(page: str, elsewhere: Path) -> None:
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.S)
    assert blocks
    for block in blocks:
        exec(block.replace("/tmp/", f"{elsewhere}/"), names)
    assert names.get("code", 0) == 0


def test_the_three_commands_run_as_typed(elsewhere: Path) -> None:
    from lambent.cli import main

    section = (ROOT / "README.md").read_text().partition("## Three commands")[2]
    section = section.partition("\n## ")[0].replace("\\\n", "")
    commands = re.findall(r"^\$ (lambent .*)", section, re.M)
    assert len(commands) == 3
    for command in commands:
        arguments = shlex.split(command.replace("/tmp/", f"{elsewhere}/"))[1:]
        assert main(arguments) == 0, command
    assert {path.name for path in elsewhere.iterdir()} == {
        "clean.exr",
        "clean.html",
        "clean_preview.png",
        "compare.html",
    }
