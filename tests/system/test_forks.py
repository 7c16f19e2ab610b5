"""A fork of a process that has used Lambent: a result or a clear error, never a wait for ever."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

SCRIPT = """
    import os, sys, lambent
    from lambent.errors import EngineError
    path, model = sys.argv[1:]
    use = (lambda: lambent.denoise(path, model)) if model else (lambda: lambent.read(path).colour)
    if {before}:
        use()
    child = os.fork()
    if child == 0:
        try:
            use()
            print("done", flush=True)
        except EngineError as error:
            print("refused", error, flush=True)
        sys.exit(0) if {model_free} else os._exit(0)
    os.waitpid(child, 0)
    use()  # the parent goes on
"""


def run(path: Path, model: str, before: bool) -> str:
    code = textwrap.dedent(SCRIPT.format(before=before, model_free=not model))
    done = subprocess.run(
        [sys.executable, "-c", code, str(path), model], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    return renders.write(tmp_path / "frame.exr")


def test_reading_goes_on_in_a_fork(frame):
    assert run(frame, "", before=True) == "done\n"


@pytest.mark.parametrize("model", ["lambent", "nlm", "oidn", "kpcn"])
def test_models_refuse_in_a_fork_what_would_never_end(frame, model):
    out = run(frame, model, before=True)
    assert out.startswith("refused")
    assert "spawn" in out


@pytest.mark.parametrize("model", ["lambent", "nlm", "oidn"])
def test_a_fork_before_the_first_use_works(frame, model):
    assert run(frame, model, before=False) == "done\n"
