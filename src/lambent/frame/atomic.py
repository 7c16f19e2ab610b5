"""Writing a file so that its name holds either the old content or the new, never a piece.

The bytes go to a file without a name in the target's folder (Linux: ``O_TMPFILE``; elsewhere a
hidden file beside the target), are flushed to the disk, and get their name in one step. A process
that is killed on the way leaves the target as it was.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from lambent.errors import OutputError

#: How to have a file replaced, on the command line and in Python.
OVERWRITE = "allow it with --overwrite (in Python: overwrite=True), or name another file"

_REMEDIES = {
    errno.ENOSPC: "make room on the disk, or write elsewhere with -o",
    errno.EDQUOT: "your quota on this disk is used up; write elsewhere with -o",
    errno.EFBIG: "this disk takes no files of that size; write elsewhere with -o",
    errno.EACCES: "allow writing there, or write elsewhere with -o",
    errno.EPERM: "allow writing there, or write elsewhere with -o",
    errno.EROFS: "the disk is read-only; write elsewhere with -o",
    errno.EIO: "check the disk",
    errno.ENAMETOOLONG: "take a shorter name with -o",
    errno.ELOOP: "its links lead in a circle: correct them, or write elsewhere with -o",
}


def check_target(path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """The real target of a write, after finding out early that it cannot be written.

    Links are followed. Raises `OutputError`: the folder is missing or not writable, the target is
    a directory, a pipe or a device, has a name that is too long, or exists and ``overwrite`` is
    false.
    """
    refuse_stdout(path)
    target = Path(os.path.realpath(path))
    folder = target.parent
    try:
        if not stat.S_ISDIR(os.stat(folder).st_mode):
            raise OutputError(
                f"'{folder}' is not a folder", file=path, remedy="write elsewhere with -o"
            )
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        if not os.path.lexists(folder):
            raise OutputError(
                f"the folder '{folder}' does not exist", file=path, remedy=f"mkdir -p '{folder}'"
            ) from None
    except OSError as error:
        raise _unwritable(path, error) from error
    except ValueError as error:  # a zero byte in the name
        raise OutputError(f"is not a valid file name ({error})", file=path) from None
    else:
        if stat.S_ISDIR(mode):
            raise OutputError("is a directory", file=path, remedy="name a file in it")
        if not stat.S_ISREG(mode):
            raise OutputError(
                "is a pipe, a socket or a device, not a file",
                file=path,
                remedy="name a file; results are written in one step, which only files allow",
            )
        if not overwrite:
            raise OutputError(
                "exists already",
                file=path,
                remedy=OVERWRITE,
            )
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(
            f"the folder '{folder}' is not writable", file=path, remedy=_REMEDIES[errno.EACCES]
        )
    return target


def refuse_stdout(path: str | os.PathLike[str] | None) -> None:
    """Raise `OutputError` for ``-``, by which other programs mean standard output."""
    if path is not None and os.fspath(path) == "-":
        raise OutputError(
            "results are not written to standard output",
            file="-",
            remedy="name a file with -o (a file that is really called '-' is './-')",
        )


@contextmanager
def atomic(path: str | os.PathLike[str], overwrite: bool = False) -> Iterator[BinaryIO]:
    """A binary file, open for reading and writing, that becomes ``path`` if the block ends well.

    Whatever the block raises (Ctrl-C too), nothing is left behind. Operating system errors become
    `OutputError` with a remedy.
    """
    target = check_target(path, overwrite)
    start = os.fsdecode(os.fsencode(target.name)[:100])  # names are limited in bytes
    temporary = target.with_name(f".{start}.{secrets.token_hex(6)}.part")
    try:
        descriptor, nameless = _create(target.parent, temporary)
        try:
            with os.fdopen(descriptor, "w+b", buffering=1 << 20) as handle:
                yield handle
                handle.flush()
                if target.exists():
                    os.fchmod(descriptor, stat.S_IMODE(target.stat().st_mode))
                os.fsync(descriptor)
                _name_it(descriptor if nameless else None, temporary, target, overwrite)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
        _sync_folder(target.parent)
    except FileExistsError:
        raise OutputError("exists already", file=path, remedy=OVERWRITE) from None
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: str | os.PathLike[str], error: OSError) -> OutputError:
    return OutputError(
        f"cannot be written: {error.strerror or error}",
        file=path,
        remedy=_REMEDIES.get(error.errno or 0, "write elsewhere with -o"),
    )


def _create(folder: Path, temporary: Path) -> tuple[int, bool]:
    """A new file in the folder, without a name where the system can do that."""
    if hasattr(os, "O_TMPFILE") and os.path.isdir("/proc/self/fd"):
        with suppress(OSError):
            return os.open(folder, os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o666), True
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0)
    return os.open(temporary, flags, 0o666), False


def _name_it(descriptor: int | None, temporary: Path, target: Path, overwrite: bool) -> None:
    """Give the finished file its name; without ``overwrite`` never over another one."""
    if descriptor is not None:
        _link(descriptor, temporary if overwrite else target)
    elif not overwrite:
        try:
            os.link(temporary, target)
        except FileExistsError:
            raise
        except OSError:  # a file system without links; `check_target` has looked
            overwrite = True
        else:
            temporary.unlink()
    if overwrite:
        os.replace(temporary, target)


def _link(descriptor: int, name: Path) -> None:
    """Name an open file. Python asks the system to follow the link only if a folder is given."""
    folder = os.open(name.parent, os.O_RDONLY)
    try:
        os.link(f"/proc/self/fd/{descriptor}", name, src_dir_fd=folder, follow_symlinks=True)
    finally:
        os.close(folder)


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):  # some file systems cannot; the file itself is safe
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
