"""Nothing of Lambent's sends anything, or writes outside its output and the caches.

OpenVINO's Python package would: a look-up of an analytics host, a sender in a process of its own,
an id in the home folder. Watched from outside, with strace.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import renders

# .ci/run installs it: there its absence is a failure
pytestmark = pytest.mark.skipif(
    shutil.which("strace") is None and "CI" not in os.environ, reason="needs strace"
)


def traced(arguments: list[str], home: Path) -> str:
    """The system calls of a command that have to do with networks, programs and new files."""
    log = home / "calls.txt"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("XDG_")}
    environment |= {"HOME": str(home), "LAMBENT_CACHE": str(home / "cache")}
    done = subprocess.run(
        ["strace", "-f", "-e", "trace=network,execve", "-o", str(log),
         sys.executable, "-m", "lambent", *arguments],
        env=environment, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    if "ptrace" in done.stderr.lower():
        pytest.skip("strace may not trace here")
    assert done.returncode == 0, done.stderr
    text = log.read_text(errors="replace")
    log.unlink()
    return text


@pytest.mark.parametrize("command", ["denoise", "doctor"])
def test_no_command_talks_to_anybody(tmp_path, command):
    home = tmp_path / "home"
    home.mkdir()
    frame = renders.write(tmp_path / "frame.exr")
    more = [str(frame), "-o", str(tmp_path / "out.exr")] if command == "denoise" else []
    calls = traced([command, *more], home)
    assert not re.findall(r"AF_INET6?\b.*", calls)
    programs = {Path(p).name for p in re.findall(r'execve\("([^"]+)"', calls)}
    assert not {p for p in programs if "python" in p} - {Path(sys.executable).name}
    assert calls.count(f'["{sys.executable}"') <= 1, "a Python process besides"
    written = {p.relative_to(home).parts[0] for p in home.rglob("*") if p.is_file()}
    assert written <= {"cache", ".drjit"}, "only caches"
