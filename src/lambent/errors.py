"""Every error that Lambent raises on purpose.

::

    LambentError                 exit code 1
    ├── FileError                2   a file is missing, unreadable, damaged or cannot be written
    │   ├── DamagedFileError         truncated, undecodable, or not what its name says
    │   ├── DeepFileError            a deep EXR: several samples a pixel, which nothing here filters
    │   └── OutputError              the result cannot be written (directory, permission, disk full)
    ├── LayerError               3   a layer is missing, unknown, or of the wrong size
    ├── UnknownNameError         4   no such model, role, pass, parameter (the nearest is suggested)
    ├── OptionError              4   an option has a value that makes no sense
    └── EngineError              5   an engine (LLVM, OIDN, a missing extra) cannot do the work

A message states three facts: which file, which layer, what remedy. The library raises; only the
command line turns an error into an exit code. Names in a message are shown as `lambent.escapes` has
it, so that it can be printed anywhere.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from lambent import interrupts
from lambent.escapes import escaped


class LambentError(Exception):
    """Base of all errors raised on purpose.

    ``file`` and ``layer`` say where; ``remedy`` says what to do; ``details`` are lines that belong
    to the message, such as the end of a log. They are all part of the text.
    """

    exit_code = 1

    def __init__(
        self,
        message: str,
        *,
        file: object = None,
        layer: str | None = None,
        remedy: str | None = None,
        details: Iterable[str] = (),
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.layer = layer
        self.remedy = remedy
        self.details = tuple(details)
        super().__init__(self.__str__())

    def __str__(self) -> str:
        where = self.file or ""
        if self.layer:
            where = f"{where}: layer '{self.layer}'" if where else f"layer '{self.layer}'"
        lines = [f"{where}: {self.message}" if where else self.message]
        lines += [f"  | {line}" for line in self.details]
        lines += [f"  → {self.remedy}"] if self.remedy else []
        return "\n".join(map(escaped, lines))


def by_interrupt(error: BaseException) -> bool:
    """Whether an error is Ctrl-C, or SIGTERM, in disguise (`lambent.interrupts`).

    Either a signal came, or the end of the process is among the error's causes: Dr.Jit turns what
    is raised while it records a loop into an error of its own, with the true one as its cause.
    """
    seen: BaseException | None = error
    while seen is not None:
        ending = isinstance(seen, SystemExit) and seen is not error
        if ending or isinstance(seen, KeyboardInterrupt):
            return True
        if isinstance(seen, ImportError) and "KeyboardInterrupt" in str(seen):
            return True  # a compiled module that was being imported keeps the text alone
        seen = seen.__cause__ or seen.__context__
    return interrupts.came()


def stop_by_interrupt(error: BaseException) -> None:
    """Raise `KeyboardInterrupt` in the place of an error that is one in disguise."""
    if by_interrupt(error):
        raise KeyboardInterrupt from error


class FileError(LambentError):
    """A file is missing, unreadable, damaged or cannot be written."""

    exit_code = 2


class DamagedFileError(FileError):
    """A file is truncated, cannot be decoded, or is not what its name says."""


class DeepFileError(FileError):
    """A deep EXR: every pixel holds a list of samples at several depths."""


class OutputError(FileError):
    """A result cannot be written."""


class LayerError(LambentError):
    """A layer is missing, unknown, or of the wrong size."""

    exit_code = 3


class OptionError(LambentError):
    """An option has a value that makes no sense."""

    exit_code = 4


class UnknownNameError(OptionError):
    """A name that is not known; the nearest known ones are suggested.

    ``kind`` is what was asked for ("model", "role"), ``known`` the names there are; ``owner``: what
    has no such thing ("nlm", of a parameter).
    """

    def __init__(
        self, kind: str, name: str, known: Iterable[str], *, file: object = None, owner: str = ""
    ) -> None:
        known = sorted(known)
        near = difflib.get_close_matches(name.lower(), known, n=3, cutoff=0.5)
        listing = ", ".join(known) if known else "none"
        remedy = f"did you mean {' or '.join(near)}? " if near else ""
        super().__init__(
            f"'{owner}' has no {kind} '{name}'" if owner else f"there is no {kind} '{name}'",
            file=file,
            remedy=f"{remedy}Known: {listing}.",
        )


class EngineError(LambentError):
    """An engine (LLVM for Dr.Jit, OIDN, an optional extra) cannot do the work."""

    exit_code = 5
