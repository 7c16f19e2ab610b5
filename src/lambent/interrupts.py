"""Ctrl-C and SIGTERM, noticed even where a library takes them for a failure of its own.

Both arrive as `KeyboardInterrupt`, between any two lines of Python. Where C++ has called that
Python, the exception comes out as something else: Dr.Jit makes a `RuntimeError` of what is raised
while it records a loop, a module that is being imported an `ImportError` without a cause, and what
is raised in a destructor is printed and forgotten. So while `watched` lasts, that a signal came is
remembered beside the exception (`came`).
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

#: Watches that are open, one inside the other; whether a signal came since the first was opened.
_open = 0
_came = False


def came() -> bool:
    """Whether a signal came while `watched` lasts."""
    return _came


def stop_if_came() -> None:
    """Raise `KeyboardInterrupt` if a signal came and its exception was lost."""
    if _came:
        raise KeyboardInterrupt


@contextmanager
def watched() -> Iterator[None]:
    """While this lasts, Ctrl-C and SIGTERM are remembered; what they did before they do still.

    For the main thread; elsewhere, and for a signal that Python does not handle, it does nothing.
    """
    global _open, _came
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[signal.Signals, Any] = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        handler = signal.getsignal(number)
        if callable(handler):
            before[number] = handler
            signal.signal(number, _remembering(handler))
    _came = _came if _open else False
    _open += 1
    try:
        yield
    finally:
        _open -= 1
        if not _open:
            _came = False
        for number, handler in before.items():
            signal.signal(number, handler)


def _remembering(handler: Any) -> Any:
    def handle(number: int, frame: FrameType | None) -> None:
        global _came
        _came = True
        handler(number, frame)

    return handle
