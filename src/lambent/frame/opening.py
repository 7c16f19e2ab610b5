"""Opening a file to read it: only a true file, and every refusal says what is there instead.

Pipes, sockets and devices are refused before anything waits for them: an EXR is read here and
there, not once from end to end.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from lambent.errors import FileError

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_REMEDIES = {
    errno.EACCES: "allow reading it, and entering its folder",
    errno.EPERM: "allow reading it, and entering its folder",
    errno.ENAMETOOLONG: "take a shorter name",
    errno.ELOOP: "its links lead in a circle: correct them",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EMFILE: "too many files are open: close some, or raise the limit (ulimit -n)",
    errno.EIO: "check the disk",
}


def open_file(path: Path) -> int:
    """A descriptor for reading. Raises `FileError` that says what is there instead of a file."""
    try:
        # Without O_NONBLOCK a pipe that nobody writes to would be waited for here.
        flags = os.O_RDONLY | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)
        refuse_special(path)
        descriptor = os.open(path, flags)
    except OSError as error:
        raise unreadable(path, error) from error
    except ValueError as error:  # a zero byte in the name
        raise FileError(f"is not a valid file name ({error})", file=path) from None
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        raise _special(path, mode)
    return descriptor


def read_file(path: Path) -> bytes:
    """All bytes of a file. Raises `FileError`."""
    with os.fdopen(open_file(path), "rb") as handle:
        try:
            return handle.read()
        except OSError as error:
            raise unreadable(path, error) from error


def refuse_special(path: Path) -> None:
    """Raise `FileError` for a directory, pipe, socket or device; nothing for a file or no file."""
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return  # whoever opens it learns why
    if not stat.S_ISREG(mode):
        raise _special(path, mode)


def exists(path: Path) -> bool:
    """Whether something has this name. Raises `FileError` where that cannot be known.

    That is a folder that may not be entered, a name that is too long, links in a circle.
    """
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise unreadable(path, error) from error
    except ValueError as error:
        raise FileError(f"is not a valid file name ({error})", file=path) from None
    return True


def unreadable(path: Path, error: OSError) -> FileError:
    """What to raise for a file that the system does not let us read."""
    if isinstance(error, FileNotFoundError):
        return FileError("there is no such file", file=path, remedy=_nearby(path))
    return FileError(
        f"cannot be read: {error.strerror or error}",
        file=path,
        remedy=_REMEDIES.get(error.errno or 0, "check the path and the disk"),
    )


# ------------------------------------------------------------------- private


def _special(path: Path, mode: int) -> FileError:
    if stat.S_ISDIR(mode):
        return FileError("is a directory", file=path, remedy="name a file in it")
    kind = next((words for test, words in _KINDS if test(mode)), "no file")
    return FileError(
        f"is {kind}, not a file", file=path, remedy="save the picture into a file, and name that"
    )


def _nearby(path: Path) -> str:
    if str(path) == "-":
        return "pictures are not read from standard input: save it into a file, and name that"
    try:
        near = sorted(p.name for p in path.parent.glob("*.exr"))[:5] if path.name else []
    except OSError:
        near = []
    return f"in its folder there are: {', '.join(near)}" if near else "check the path"
