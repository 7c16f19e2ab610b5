"""What Mitsuba and Dr.Jit complain of, as errors that name the scene, the cause and the remedy.

Both raise `RuntimeError`, with the place in their own source in front; Dr.Jit, while it records,
puts an error of its own around whatever its callbacks raise.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from lambent.errors import (
    DamagedFileError,
    EngineError,
    FileError,
    LambentError,
    stop_by_interrupt,
)


@contextmanager
def explaining(file: object, doing: str = "rendered") -> Iterator[None]:
    """Raise what Mitsuba complains of in the block as `explained`, for the scene ``file``.

    An error of ours, or in our own code, is raised as it is.
    """
    try:
        yield
    except LambentError:
        raise
    except Exception as error:
        stop_by_interrupt(error)
        cause = _first(error)
        if isinstance(cause, LambentError):
            raise cause from None
        # while a scene is loaded only Mitsuba works; while one is rendered our code does, too
        if doing != "loaded" and type(cause) is not RuntimeError:
            raise
        raise explained(error, file, doing) from error


def explained(error: Exception, file: object, doing: str) -> LambentError:
    """The error for a complaint about the scene ``file``, which could not be ``doing``."""
    text = complaint(error)
    lost = re.search(r'"([^"]+)"[^"]*(?:file not found|No such file|does not exist)', text)
    if lost:
        return FileError(
            f"needs a file that is not there: '{lost.group(1)}' ({_place(text)})",
            file=file,
            remedy="put it where the scene looks for it (paths count from the scene's folder)",
        )
    if "out of memory" in text:
        return EngineError(
            f"there is not enough memory: {text[:200]}", file=file, remedy="take a smaller --size"
        )
    if "non-spectral" in text:
        remedy = "Lambent renders in RGB: give the colour as <rgb value=…>, or as a <spectrum>"
    elif doing == "loaded":
        remedy = "Mitsuba 3 reads scenes of version 0.4 to its own; older ones need its converter"
    else:
        remedy = "correct what Mitsuba complains of in the scene"
    return DamagedFileError(f"cannot be {doing}: {text[:500]}", file=file, remedy=remedy)


def complaint(error: BaseException) -> str:
    """The first cause of an error in one line, without its place in C++."""
    error = _first(error)
    text = re.sub(r"\[[\w.]+:\d+\]\s*", "", str(error))
    return re.sub(r"\s+", " ", text).strip() or type(error).__name__


# ------------------------------------------------------------------- private


def _first(error: BaseException) -> BaseException:
    while error.__cause__ is not None:
        error = error.__cause__
    return error


def _place(text: str) -> str:
    found = re.search(r"line \d+(?:, col \d+)?", text)
    return found.group(0) if found else "in a nested file"
