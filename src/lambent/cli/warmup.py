"""Imports that a command will need, begun in a second thread while the options are parsed.

Loading a compiled library is mostly reading and relocating, during which Python runs on; so the
engine is ready by the time the file is decoded. Errors are left to the real import, which reports.

Nothing waits for the thread at the end: `lambent.cli.process` ends a process that has one without
taking Python apart under it.
"""

from __future__ import annotations

import contextlib
import importlib
import threading
from collections.abc import Callable, Sequence
from functools import partial


def start(args: Sequence[str]) -> threading.Thread:
    """Begin to import what ``lambent denoise ARGS`` will use."""
    model = ""
    for index, arg in enumerate(args):
        if arg in ("--model", "-m") and index + 1 < len(args):
            model = args[index + 1]
        elif arg.startswith("--model="):
            model = arg.partition("=")[2]
    thread = threading.Thread(
        target=_run, args=(_steps(model or _default()),), name="warmup", daemon=True
    )
    thread.start()
    return thread


def _default() -> str:
    from lambent.filters.denoiser import DEFAULT_MODEL

    return DEFAULT_MODEL


def _steps(model: str) -> list[Callable[[], object]]:
    """What to do for a model, in the order in which it is needed, the slow first."""
    learned = model == "auto" or model.startswith("lambent")
    steps: list[Callable[[], object]] = [partial(importlib.import_module, "numpy")]
    if model.startswith("oidn"):
        steps.append(partial(importlib.import_module, "mitsuba_oidn"))
    if learned:
        steps.append(_openvino)
    if model in ("auto", "lambent-oidn"):
        steps.append(partial(importlib.import_module, "mitsuba_oidn"))
    steps += [partial(importlib.import_module, name) for name in ("OpenEXR", "lambent.frame.files")]
    if learned:
        steps.append(partial(_prefetch, model))
    return steps


def _openvino() -> None:
    from lambent.denoise.openvino import openvino

    openvino()


def _prefetch(model: str) -> None:
    from lambent.denoise.learned import prefetch

    prefetch(model)


def _run(steps: Sequence[Callable[[], object]]) -> None:
    for step in steps:
        with contextlib.suppress(Exception):
            step()
