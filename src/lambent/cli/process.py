"""The process of a command line: its signals from the first moment on, its warm-up, its end.

At its end Python takes itself and the loaded libraries apart. A thread that is still inside one of
them, importing or compiling, then ends in an abort or a segmentation fault, whatever the exit code
should have been. So a process with a warm-up, and one that was interrupted at an arbitrary moment,
ends without that: what was printed is flushed, and the system takes the rest.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

from lambent.interrupts import came, watched

#: Signals within so many seconds after one that was raised count as the same: Ctrl-C is often
#: pressed twice, and the second must not interrupt the tidying up after the first.
SAME_SIGNAL = 1.0

_raised = float("-inf")


def run_process(args: Sequence[str]) -> int:
    """Run the command line that this process was started with; return the exit code."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else the parent ignores it
        signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    code, abrupt = 130, True
    try:
        with watched():
            code, abrupt = _run(args)
            abrupt = abrupt or came()
    except KeyboardInterrupt:
        code, abrupt = 130, True
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, _end_interrupted)
    if abrupt:
        _end(code)
    return code


# ------------------------------------------------------------------- private


def _run(args: Sequence[str]) -> tuple[int, bool]:
    """The exit code, and whether a warm-up was begun."""
    warm = False
    try:
        if args[:1] == ["denoise"] and not {"--help", "-h", "--dry-run"} & set(args):
            from lambent.cli.warmup import start

            warm = True
            start(args)
        from lambent.cli.app import run

        code = run(args)
    except KeyboardInterrupt:
        say_interrupted()
        code = 130
    except Exception:  # LAMBENT_DEBUG
        sys.excepthook(*sys.exc_info())
        code = 1
    return code, warm


def say_interrupted() -> None:
    """The last line after Ctrl-C."""
    with contextlib.suppress(OSError):
        from lambent.cli.terminal import remark

        remark("interrupted: every file that was written is whole")


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Unwind, so that temporary files are removed; SIGTERM like Ctrl-C."""
    global _raised
    now = time.monotonic()
    if now - _raised > SAME_SIGNAL:
        _raised = now
        raise KeyboardInterrupt


def _end_interrupted(number: int, frame: FrameType | None) -> None:
    """All is done but the end."""
    os._exit(130)


def _end(code: int) -> NoReturn:
    """End now, without taking anything apart."""
    if "multiprocessing" in sys.modules:
        from multiprocessing import active_children

        for child in active_children():
            child.terminate()
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except BrokenPipeError:  # the reader has seen enough
            pass
        except (OSError, ValueError):
            code = code or 1
    os._exit(code)
