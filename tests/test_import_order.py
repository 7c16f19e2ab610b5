"""`import lambent` before or after Dr.Jit or Mitsuba: a result or a clear error, no abort."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

import pytest

from lambent.errors import EngineError
from lambent.startup import OLDEST_LLVM, _check_version, find_llvm

DENOISE = """
    import numpy as np, lambent
    try:
        out = lambent.denoise(np.random.default_rng(0).random((32, 32, 3), np.float32), {model!r})
        print("cleaned", out.colour.shape)
    except lambent.LambentError as error:
        print("refused", error)
"""


@pytest.mark.parametrize("model", ["lambent", "nlm"])
@pytest.mark.parametrize("first", ["lambent", "drjit", "mitsuba"])
def test_whatever_is_imported_first(first, model):
    environment = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    script = f"import {first}\n" + textwrap.dedent(DENOISE.format(model=model))
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, (done.returncode, done.stderr)
    if first == "lambent":
        assert done.stdout.startswith("cleaned")
    else:  # by what the system has
        assert done.stdout.startswith("cleaned") or "import lambent before drjit" in done.stdout


def test_an_old_llvm_is_refused_by_its_version():
    with pytest.raises(EngineError, match=r"LLVM 15\.0\.6 of the system") as raised:
        _check_version((15, 0, 6), "/somewhere/libLLVM.so")
    assert "/somewhere/libLLVM.so" in str(raised.value)
    _check_version((OLDEST_LLVM, 1, 0), "/somewhere/libLLVM.so")


def test_importing_lambent_names_the_llvm_of_the_environment():
    path = os.path.join(sys.prefix, "lib", "libLLVM.so")
    if not os.path.exists(path):
        pytest.skip("LLVM is elsewhere here")
    environment = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    script = "import lambent, os; print(os.environ['DRJIT_LIBLLVM_PATH'])"
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == path
    assert os.path.samefile(path, find_llvm() or "")
