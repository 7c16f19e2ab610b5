"""Finding LLVM for Dr.Jit, before Dr.Jit looks for it.

Dr.Jit loads LLVM when it is first imported, from ``DRJIT_LIBLLVM_PATH`` or the usual system places.
`engine` looks first at what the user set, then at the wheel ``karellen-llvm-core`` (which puts its
library into the environment's ``lib`` folder), then leaves the search to Dr.Jit. Without any LLVM
Lambent says so once and runs on what there is: OIDN needs none. A script that imports Dr.Jit or
Mitsuba before Lambent leaves the choice to Dr.Jit; an old LLVM of the system would then end the
process in the midst of a kernel, so it is refused.
"""

from __future__ import annotations

import functools
import os
import sys
import sysconfig
from pathlib import Path

from lambent.device import choose_device
from lambent.errors import EngineError

#: The oldest LLVM that our kernels are tested with. 15 aborts the process in them.
OLDEST_LLVM = 20

#: Library with threads -> the process that uses it.
_users: dict[str, int] = {}

_LIBRARY = {"darwin": "libLLVM.dylib", "win32": "LLVM-C.dll"}.get(sys.platform, "libLLVM.so")


def find_llvm() -> str | None:
    """The LLVM library to use, or None if only the system's search is left."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    if chosen:
        return chosen
    prefixes = {sys.prefix, sysconfig.get_config_var("prefix") or sys.prefix, sys.exec_prefix}
    try:  # where pip put the wheel's files (a --user or --target install lies elsewhere)
        from importlib.metadata import PackageNotFoundError, distribution

        files = distribution("karellen-llvm-core").files or []
        for file in files:
            if file.name == _LIBRARY:
                path = Path(str(file.locate())).resolve()
                if path.exists():
                    return str(path)
    except PackageNotFoundError:
        pass
    for prefix in prefixes:
        path = Path(prefix) / "lib" / _LIBRARY
        if path.exists():
            return str(path)
    return None


@functools.lru_cache(maxsize=1)
def has_llvm() -> bool:
    """Whether Dr.Jit can compile for the processor. Imports Dr.Jit.

    Raises `EngineError` where Dr.Jit was imported before, and has taken an LLVM that is too old.
    """
    path = find_llvm()
    chosen = "DRJIT_LIBLLVM_PATH" in os.environ
    if path:
        os.environ["DRJIT_LIBLLVM_PATH"] = path
    import drjit as dr

    found = bool(dr.has_backend(dr.JitBackend.LLVM))
    if found and path and not chosen:
        _check_version(dr.detail.llvm_version(), path)
    return found


def _check_version(version: tuple[int, ...], path: str) -> None:
    if version[0] < OLDEST_LLVM:
        raise EngineError(
            f"Dr.Jit was imported before Lambent and has loaded LLVM {'.'.join(map(str, version))} "
            f"of the system, which is too old ({OLDEST_LLVM} and newer are tested)",
            remedy="import lambent before drjit and mitsuba, or set the environment variable "
            f"DRJIT_LIBLLVM_PATH={path}",
        )


@functools.lru_cache(maxsize=1)
def has_cuda() -> bool:
    """Whether Dr.Jit sees a CUDA device."""
    import drjit as dr

    return bool(dr.has_backend(dr.JitBackend.CUDA))


def engine(device: str = "auto") -> str:
    """The Dr.Jit backend for a device: ``"llvm"`` or ``"cuda"``.

    "auto" is the processor, and CUDA only where LLVM is missing.
    Raises `OptionError` for an unknown device, `EngineError` where the wish cannot be met, with
    what to install.
    """
    claim("Dr.Jit")
    if device == "auto" and has_llvm():
        return "llvm"
    if choose_device(device, has_cuda) == "cuda":
        return "cuda"
    if has_llvm():
        return "llvm"
    raise EngineError(
        "no LLVM library was found, which all models but oidn* are compiled with",
        remedy="pip install karellen-llvm-core, or set DRJIT_LIBLLVM_PATH to a libLLVM; "
        "the models named oidn* work without",
    )


def claim(library: str) -> None:
    """Note that this process uses a library with threads of its own.

    Raises `EngineError` in a fork of a process that has used it: a fork has the library's locks but
    none of its threads, and would wait for them for ever.
    """
    if _users.setdefault(library, os.getpid()) != os.getpid():
        raise EngineError(
            f"{library} was used before this process was forked, and cannot be used in the fork",
            remedy="start processes afresh, with multiprocessing.get_context('spawn'), or use "
            "Lambent only after the fork",
        )


def owns(library: str) -> bool:
    """Whether this very process uses a library, and no process that it was forked from."""
    return _users.get(library) == os.getpid()


def cache_folder() -> Path:
    """Where Lambent keeps what it can make again: ``$LAMBENT_CACHE`` or ``~/.cache/lambent``."""
    base = os.environ.get("LAMBENT_CACHE")
    return Path(base) if base else Path.home() / ".cache" / "lambent"
