"""The one place where Mitsuba is imported and its variant chosen.

Mitsuba compiles a scene for one of its variants: here spectral triples and the Dr.Jit backend that
`lambent.startup.engine` finds, so ``llvm_ad_rgb`` on a processor and ``cuda_ad_rgb`` on an NVIDIA
device. Dr.Jit looks for LLVM when it is first used: that is why `mitsuba` asks `engine` first.
"""

from __future__ import annotations

import importlib
from typing import Any

from lambent.errors import EngineError, stop_by_interrupt
from lambent.render.plugins import settle
from lambent.startup import engine

_VARIANTS = {"llvm": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}


def mitsuba(device: str = "auto") -> Any:
    """The module ``mitsuba`` with its variant set for ``device`` (auto, cpu, cuda).

    A variant of the same backend that a script has set already (``llvm_mono`` …) is kept; with
    "auto" one of any backend that Lambent can use, so that what was chosen once stays.
    Raises `EngineError` where Mitsuba or the device is missing, with what to install.
    """
    backend = engine(device)
    try:
        mi = importlib.import_module("mitsuba")
    except ImportError as error:
        stop_by_interrupt(error)
        raise EngineError(
            f"rendering needs Mitsuba, which cannot be imported ({error})",
            remedy="pip install 'lambent[render]'",
        ) from error
    now = mi.variant()
    if not _stays(now, device, backend):
        try:
            mi.set_variant(_VARIANTS[backend])
        except Exception as error:
            stop_by_interrupt(error)
            raise EngineError(
                f"Mitsuba has no variant {_VARIANTS[backend]}: {error}",
                remedy="pip install --force-reinstall 'lambent[render]'",
            ) from error
    settle(mi)  # before anything could load a plug-in from the current folder
    dr = importlib.import_module("drjit")
    if dr.thread_count() < 2:
        # with one processor Mitsuba 3.9 waits for ever while it loads a scene of many meshes
        dr.set_thread_count(2)
    return mi


# ------------------------------------------------------------------- private


def _stays(variant: str | None, device: str, backend: str) -> bool:
    """Whether the variant that Mitsuba has serves a device."""
    return variant is not None and variant.startswith(
        tuple(_VARIANTS) if device == "auto" else backend
    )
