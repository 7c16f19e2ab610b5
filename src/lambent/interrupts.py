"""Ctrl-C and SIGTERM, noticed even where a library takes them for a failure of its own.

Both arrive as `KeyboardInterrupt`, between any two lines of Python. Where C++ has called that
Python, the exception comes out as something else: Dr.Jit makes a `RuntimeError` of what is raised
while it records a loop, a module that is being imported an `ImportError` without a cause, and what
is raised in a destructor is printed and forgotten. So while `watched` lasts, that a signal came is
remembered beside the exception (`came`), and one that was forgotten is raised again.

A module whose import is cut short stays half-made, or its lock is kept for ever. So a signal that
comes during an import waits until that is over, for `PATIENCE` seconds at most.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

#: How long a signal waits for an import, and how often it looks, in seconds.
PATIENCE, LOOK = 10.0, 0.02

#: Watches that are open, one inside the other; whether a signal came since the first was opened.
_open = 0
_came = False
_alarm_set = False


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
    hook = sys.unraisablehook
    sys.unraisablehook = _raising_again(hook)
    _came = _came if _open else False
    _open += 1
    try:
        yield
    finally:
        _open -= 1
        if not _open:
            _came = False
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _remembering(handler: Any) -> Any:
    waits_since = 0.0

    def handle(number: int, frame: FrameType | None) -> None:
        global _came
        nonlocal waits_since
        _came = True
        if _imports(frame):
            waits_since = waits_since or time.monotonic()
            waits = time.monotonic() - waits_since < PATIENCE
            if waits and _soon(lambda: signal.raise_signal(number)):
                return
        waits_since = 0.0
        handler(number, frame)

    return handle


def _imports(frame: FrameType | None) -> bool:
    """Whether the main thread is inside an import."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _raising_again(
    hook: Callable[[UnraisableHookArgs], object],
) -> Callable[[UnraisableHookArgs], object]:
    """A hook for exceptions that nobody can catch, in which an interrupt is not lost."""

    def look(unraisable: UnraisableHookArgs) -> object:
        if issubclass(unraisable.exc_type, KeyboardInterrupt) and _soon(_interrupt):
            return None
        return hook(unraisable)

    return look


def _interrupt() -> None:
    raise KeyboardInterrupt


def _soon(action: Callable[[], None]) -> bool:
    """Do something after a moment, by the alarm, if nobody else uses that."""
    global _alarm_set
    if _alarm_set:
        return True
    if not hasattr(signal, "setitimer") or signal.getsignal(signal.SIGALRM) is not signal.SIG_DFL:
        return False

    def ring(_: int, frame: FrameType | None) -> None:
        global _alarm_set
        _alarm_set = False
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        action()

    _alarm_set = True
    signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, LOOK)
    return True
