"""Finding a Blender: a Python that can ``import bpy``, or a ``blender`` program.

Asked in this order: ``$LAMBENT_BLENDER`` (a Python or a Blender, for who wants a certain one), the
Python that runs Lambent, a ``blender`` on the path. Blender is never loaded into Lambent's own
process: it brings its own versions of many libraries, and ends a process as it likes. Its Python
starts isolated (``-I``): neither the current folder nor the environment gives it modules.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lambent.errors import EngineError

VARIABLE = "LAMBENT_BLENDER"
HOW = (
    "pip install 'lambent[blender]' (the wheel of Blender 5.0 is for Python 3.11 only), put a "
    f"`blender` on the path, or name one, or a Python that has bpy, in {VARIABLE}"
)


@dataclass(frozen=True)
class Blender:
    """A Blender that was found. ``python``: a Python with bpy; else a ``blender`` program."""

    program: str
    python: bool

    def command(self, script: Path, scratch: str) -> list[str]:
        """The command line that runs a script with one argument."""
        if self.python:
            return [self.program, "-I", "-u", str(script), scratch]
        start = ["-b", "--factory-startup", "--disable-autoexec", "-noaudio"]
        start += ["--python-exit-code", "3"]
        return [self.program, *start, "--python", str(script), "--", scratch]


def find_blender() -> Blender:
    """The Blender to use. Raises `EngineError` that says how to get one."""
    chosen = os.environ.get(VARIABLE, "").strip()
    if chosen:
        return _chosen(chosen)
    if importlib.util.find_spec("bpy") is not None:
        return Blender(sys.executable, True)
    program = shutil.which("blender")
    if program:
        return Blender(program, False)
    raise EngineError("rendering a .blend needs Blender, and none was found", remedy=HOW)


def cycles_available() -> bool:
    """Whether a Blender is there to render with. Starts nothing unless a Python was named."""
    try:
        find_blender()
    except EngineError:
        return False
    return True


def _chosen(name: str) -> Blender:
    program = shutil.which(os.path.expanduser(name))
    if program is None:
        raise EngineError(f"{VARIABLE} names '{name}', which is not a program", remedy=HOW)
    if Path(program).name.lower().startswith("blender"):
        return Blender(program, False)
    if not _has_bpy(program):
        raise EngineError(
            f"{VARIABLE} names '{name}', a program that cannot `import bpy`", remedy=HOW
        )
    return Blender(program, True)


@lru_cache(maxsize=8)
def _has_bpy(program: str) -> bool:
    """Whether a Python knows bpy, found without loading it."""
    code = "import importlib.util as u; raise SystemExit(u.find_spec('bpy') is None)"
    try:
        done = subprocess.run(
            [program, "-I", "-c", code], capture_output=True, timeout=60, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0
