"""Lambent: path-traced pictures made clean, on an ordinary processor.

The verbs and records below are imported when first used: `import lambent` alone loads no
NumPy, Dr.Jit or OpenEXR, so that scripts and `lambent --help` start at once.

``lambent.denoise`` and ``lambent.render`` are functions, though there are packages of these names,
too: every form of ``import lambent.denoise.pipeline`` goes to the package.
"""

from __future__ import annotations

import importlib
import os
import sys
import types
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public name -> module that holds it.
_PUBLIC = {
    "denoise": "lambent.denoise.pipeline",
    "render": "lambent.render.job",
    "solve": "lambent.transport.solve",
    "open_solution": "lambent.transport.solution",
    "train": "lambent.learn.train",
    "read": "lambent.frame.files",
    "write": "lambent.frame.files",
    "Frame": "lambent.frame.frame",
    "Layer": "lambent.frame.layer",
    "Role": "lambent.frame.role",
    "Stat": "lambent.frame.role",
    "Space": "lambent.frame.role",
    "Sequence": "lambent.frame.sequence",
    "Denoiser": "lambent.filters.denoiser",
    "DENOISERS": "lambent.filters.denoiser",
    "compare": "lambent.metrics.compare",
    "explain": "lambent.filters.explain",
    "LambentError": "lambent.errors",
}

__all__ = [*_PUBLIC, "__version__"]

if TYPE_CHECKING:
    from lambent.denoise.pipeline import denoise
    from lambent.errors import LambentError
    from lambent.filters.denoiser import DENOISERS, Denoiser
    from lambent.filters.explain import explain
    from lambent.frame.files import read, write
    from lambent.frame.frame import Frame
    from lambent.frame.layer import Layer
    from lambent.frame.role import Role, Space, Stat
    from lambent.frame.sequence import Sequence
    from lambent.learn.train import train
    from lambent.metrics.compare import compare
    from lambent.render.job import render
    from lambent.transport.solution import open_solution
    from lambent.transport.solve import solve


def _name_llvm() -> None:
    """Tell Dr.Jit, which takes an LLVM as it is imported, the one that was installed with Lambent.

    `lambent.startup` searches everywhere; this is the usual place, and costs nothing.
    """
    path = os.path.join(sys.prefix, "lib", "libLLVM.so")
    if "drjit" not in sys.modules and os.path.exists(path):
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", path)


_name_llvm()


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'lambent' has no attribute {name!r}")
    value = getattr(importlib.import_module(_PUBLIC[name]), name)
    if f"{__name__}.{name}" in sys.modules:
        # ``import lambent.denoise.x as y`` looks for x in a module of the name that this has
        value.__name__ = f"{__name__}.{name}"
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


class _Package(types.ModuleType):
    """This module. Python binds a package to its name here as soon as anything in it is imported;
    verbs that have a package of their name stay the verbs.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _PUBLIC and isinstance(value, types.ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
