"""Imports that a command will need, begun in a second thread while the options are parsed.

Loading a compiled library is mostly reading and relocating, during which Python runs on; so the
engine is ready by the time the file is decoded. Errors are left to the real import, which reports.
"""

from __future__ import annotations

import contextlib
import importlib
import threading
from collections.abc import Sequence

_FOR_ALL = ("numpy", "OpenEXR", "lambent.frame.files")


def start(args: Sequence[str]) -> threading.Thread:
    """Begin to import what ``lambent denoise ARGS`` will use."""
    model = ""
    for index, arg in enumerate(args):
        if arg in ("--model", "-m") and index + 1 < len(args):
            model = args[index + 1]
        elif arg.startswith("--model="):
            model = arg.partition("=")[2]
    model = model or _default()
    modules = [*_FOR_ALL]
    if model.startswith("oidn"):
        modules.insert(1, "mitsuba_oidn")
    if model.startswith("lambent"):
        modules.insert(1, "openvino")
    learned = model if model.startswith("lambent") else ""
    thread = threading.Thread(target=_import, args=(modules, learned), name="warmup", daemon=True)
    thread.start()
    return thread


def _default() -> str:
    from lambent.filters.denoiser import DEFAULT_MODEL

    return DEFAULT_MODEL


def _import(modules: Sequence[str], learned: str) -> None:
    for name in modules:
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    if learned:
        with contextlib.suppress(Exception):
            importlib.import_module("lambent.denoise.learned").prefetch(learned)
