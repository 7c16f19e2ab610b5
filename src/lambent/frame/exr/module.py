"""OpenEXR's own module: how it is called, and what it says while it works.

The module raises many kinds of exceptions, and where pixels cannot be decoded it prints a remark
and leaves the part out. `parts_of` makes one thing of all that. The module prints with the
``print`` of the function that calls it; `parts_of` calls it from a function with a ``print`` of its
own, so that nothing that belongs to the whole process (``sys.stdout``, a file descriptor) is ever
touched and other threads print as they please.

What the C library writes to standard error about damaged pixels is left alone. To standard output
it prints nothing but with compressions of JPEG 2000; see `lambent.frame.exr.apart`.
"""

from __future__ import annotations

import builtins
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FunctionType
from typing import Any

from lambent.errors import FileError

#: The module's names for what it reads, which would tell a person nothing.
_AT = re.compile(r"<python_buffer>:? ?|\"?'?/proc/self/fd/\d+'?\"?:? ?")
#: The beginning of the remark about pixels that cannot be decoded; the reason follows.
_REMARK = re.compile(r"^Warning: Exception raised reading pixel data for part \d+ - ")
#: Where the system shows the open files of this process by name, if it does.
_OPEN_FILES = "/proc/self/fd"

_lock = threading.Lock()
#: The process whose threads the module has (none yet, or one; a fork copies the set).
_owners: set[int] = set()


def module() -> Any:
    """The OpenEXR module, with as many threads as there are processors."""
    import OpenEXR

    with _lock:
        if OpenEXR.global_thread_count() == 0:
            OpenEXR.set_global_thread_count(os.cpu_count() or 1)
            _owners.add(os.getpid())
    return OpenEXR


def threads() -> int:
    """How many threads the module may use: none in a fork, which has inherited a pool without."""
    module()
    return (os.cpu_count() or 1) if os.getpid() in _owners else 0


def name_of(descriptor: int) -> str | None:
    """A name by which C code can open an open file again, if the system has such names."""
    return f"{_OPEN_FILES}/{descriptor}" if os.path.isdir(_OPEN_FILES) else None


def memory_file() -> int | None:
    """A file in memory that can be opened by `name_of`, if there is such."""
    if hasattr(os, "memfd_create") and os.path.isdir(_OPEN_FILES):
        with suppress(OSError):
            return os.memfd_create("lambent")
    return None


def parts_of(place: Any, threads: int, file: object) -> tuple[list[Any], str]:
    """The parts that the module reads from a path or stream; if not all of them, none and why.

    Raises `FileError`, which names ``file``, where memory runs out.
    """
    remarks: list[str] = []
    try:
        with enough_memory(file):
            opened = _printing_to(remarks)(module().File, place, threads)
            found, reason = list(opened.parts), "; ".join(remarks)
    except FileError:
        raise
    except Exception as error:  # the module raises many kinds; all mean the same here
        found, reason = [], str(error)
    reason = plain(reason)
    if out_of_memory(reason):
        raise no_memory(file)
    return ([], reason) if reason else (found, "")


def plain(remark: str) -> str:
    """What the library says, without its names for what it reads."""
    return _AT.sub("", _REMARK.sub("", remark)).strip()


def _open(file: Any, place: Any, threads: int) -> Any:
    return file(place, separate_channels=True, num_threads=threads)


def _printing_to(remarks: list[str]) -> Callable[[Any, Any, int], Any]:
    """`_open` with builtins of its own, in which ``print`` keeps the line.

    C code looks ``print`` up in the builtins of the function that called it. Should a version of
    the module go by ``sys.stdout`` instead, it imports ``sys`` the same way, and gets none.
    """

    def keep(*words: object, **_: object) -> None:
        remarks.append(" ".join(map(str, words)))

    def importing(name: str, *rest: Any, **more: Any) -> Any:
        if name == "sys":
            raise ImportError("OpenEXR is not to print")
        return __import__(name, *rest, **more)

    own = {**vars(builtins), "print": keep, "__import__": importing}
    return FunctionType(_open.__code__, {"__builtins__": own})


@contextmanager
def enough_memory(file: object) -> Iterator[None]:
    """Tell in our own words where memory runs out. Raises `FileError`."""
    try:
        yield
    except MemoryError as error:
        raise no_memory(file) from error


def out_of_memory(reason: str) -> bool:
    """Whether this is how the library says that memory ran out."""
    return any(word in reason for word in ("bad_alloc", "Unable to allocate", "MemoryError"))


def no_memory(file: object) -> FileError:
    """The error for pixels that do not fit into the memory."""
    return FileError(
        "there is not enough memory to decode it",
        file=file,
        remedy="close other programs or lift the limit on this one's memory, then try again",
    )
