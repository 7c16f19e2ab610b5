"""OpenEXR's own module: how it is called, and what it says while it works.

The module prints to Python's and C's standard output and error, raises many kinds of exceptions,
and returns an empty list for some files. `parts_of` makes one thing of all that.
"""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import IO, Any, TextIO

from lambent.errors import FileError

#: The module's names for what it reads, which would tell a person nothing.
_AT = re.compile(r"<python_buffer>:? ?|'?/proc/self/fd/\d+'?:? ?")
#: Where the system shows the open files of this process by name, if it does.
_OPEN_FILES = "/proc/self/fd"


def module() -> Any:
    """The OpenEXR module, with as many threads as there are processors."""
    import OpenEXR

    if OpenEXR.global_thread_count() == 0:
        OpenEXR.set_global_thread_count(os.cpu_count() or 1)
    return OpenEXR


def name_of(descriptor: int) -> str | None:
    """A name by which C code can open an open file again, if the system has such names."""
    return f"{_OPEN_FILES}/{descriptor}" if os.path.isdir(_OPEN_FILES) else None


def memory_file() -> int | None:
    """A file in memory that can be opened by `name_of`, if there is such."""
    if hasattr(os, "memfd_create") and os.path.isdir(_OPEN_FILES):
        with suppress(OSError):
            return os.memfd_create("lambent")
    return None


def parts_of(
    place: Any, threads: int, file: object, talkative: bool = False
) -> tuple[list[Any], str]:
    """The parts that the module reads from a path or stream; if none, what it said about it.

    ``talkative``: it prints remarks to C's stdout, which would show up at any later time.
    Raises `FileError`, which names ``file``, where memory runs out.
    """
    exr = module()
    reason = ""
    with quiet() as said:
        try:
            with enough_memory(file):
                found = list(exr.File(place, separate_channels=True, num_threads=threads).parts)
        except FileError:
            raise
        except Exception as error:  # the module raises many kinds; all mean the same here
            found, reason = [], _AT.sub("", str(error))
        if "bad_alloc" in reason or "OUT_OF_MEMORY" in reason:
            raise no_memory(file)
        if not found or talkative:
            _flush_c()
    return found, "" if found else "; ".join(filter(None, [reason, *said]))


@contextmanager
def enough_memory(file: object) -> Iterator[None]:
    """Tell in our own words where memory runs out. Raises `FileError`."""
    try:
        yield
    except MemoryError as error:
        raise no_memory(file) from error


def no_memory(file: object) -> FileError:
    """The error for pixels that do not fit into the memory."""
    return FileError(
        "there is not enough memory to decode it",
        file=file,
        remedy="close other programs or lift the limit on this one's memory, then try again",
    )


_lock = threading.Lock()


class _OwnThread:
    """Stands in for ``sys.stdout``: keeps what this thread prints, passes on the others' text."""

    def __init__(self, other: TextIO | None) -> None:
        self.other, self.thread, self.kept = other, threading.get_ident(), [""]

    def write(self, text: str) -> int:
        if threading.get_ident() == self.thread:
            self.kept.append(text)
        elif self.other is not None:
            self.other.write(text)
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.other, name)


@contextmanager
def quiet() -> Iterator[list[str]]:
    """Collect what OpenEXR prints: Python warnings, and C messages on descriptors 1 and 2.

    The list is filled when the block ends. Text of others on the descriptors is passed on then.
    """
    said: list[str] = []
    with _lock, ExitStack() as stack:
        stdout = _OwnThread(sys.stdout)
        sys.stdout = stdout  # type: ignore[assignment]
        try:
            for number in (1, 2):
                stack.enter_context(_diverted(number, said))
            yield said
        finally:
            stack.close()
            if sys.stdout is stdout:
                sys.stdout = stdout.other  # type: ignore[assignment]


def _flush_c() -> None:
    """Make C's own buffers write out what was printed, while somebody listens."""
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)


@contextmanager
def _diverted(number: int, said: list[str]) -> Iterator[None]:
    """Send a file descriptor to a temporary file; sort its lines when the block ends."""
    try:
        saved = os.dup(number)
    except OSError:  # there is no such descriptor: nothing can be printed
        yield
        return
    with _scratch() as kept:
        os.dup2(kept.fileno(), number)
        try:
            yield
        finally:
            os.dup2(saved, number)
            os.close(saved)
            kept.seek(0)
            for line in kept.read().splitlines(keepends=True):
                text = line.decode("utf-8", errors="replace").strip()
                if "EXR_ERR" in text or text.startswith("ojph "):
                    said.append(_AT.sub("", text))
                else:
                    with suppress(OSError):
                        os.write(number, line)


def _scratch() -> IO[bytes]:
    """A file for a moment: in memory if possible, which also spares an import."""
    descriptor = memory_file()
    if descriptor is not None:
        return os.fdopen(descriptor, "w+b")
    import tempfile

    return tempfile.TemporaryFile()
