"""Which files of a command would overwrite each other, found out before any work is done.

Two results with one name, a result (or its preview, its report) that is the input of another, the
same input twice: each is refused with both names. Names are compared as the file system does: links
are followed, and case counts only where the folder makes a difference. (Hard links are separate
names: writing replaces a name, and the content stays under the other one.)
"""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Callable, Hashable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from lambent.errors import OutputError

#: One input and its result.
Pair = tuple[Path, Path]
#: A result to what is written beside it, by kind (``{"preview": path}``).
Companions = Callable[[Path], Mapping[str, Path]]


def check_collisions(
    pairs: Iterable[Pair],
    companions: Companions | None = None,
    guides: Iterable[Path] = (),
) -> None:
    """Raise `OutputError`, with both names, where one file would take the place of another.

    ``companions``: what is written beside a result. ``guides``: files that are inputs too.
    A result that replaces its own input is no collision: that is what ``--overwrite`` allows.
    """
    pairs = list(pairs)
    inputs: dict[Hashable, Path] = {}
    for source, _ in pairs:
        inputs.setdefault(identity(source), source)
    guided = {identity(path) for path in guides}
    written: dict[Hashable, tuple[str, Path]] = {}
    for source, output in pairs:
        beside = companions(output) if companions is not None else {}
        for kind, path in {"result": output, **beside}.items():
            this = identity(path)
            if this in written:
                raise _same_name(path, written[this], (kind, source))
            written[this] = (kind, source)
            if this in guided:
                raise OutputError(
                    f"is the file of a guide, and would be replaced by the {kind} of '{source}'",
                    file=path,
                    remedy="write elsewhere with -o NAME",
                )
            replaced = inputs.get(this)
            if replaced is not None and not (kind == "result" and this == identity(source)):
                raise OutputError(
                    f"is an input, and would be replaced by the {kind} of '{source}'"
                    if replaced == path
                    else f"the {kind} of '{source}' would replace the input '{replaced}'",
                    file=path,
                    remedy="write elsewhere with -o NAME, or clean the two in separate commands",
                )


def identity(path: Path) -> Hashable:
    """What two ways to write one name have in common, whether there is such a file or not."""
    real = Path(os.path.realpath(path))
    name = _folded(real.name) if _ignores_case(real.parent) else real.name
    try:
        facts = os.stat(real.parent)
        return facts.st_dev, facts.st_ino, name
    except OSError:  # a folder that is still to be made
        return (identity(real.parent), name) if real.parent != real else name


# ------------------------------------------------------------------- private


def _same_name(path: Path, first: tuple[str, Path], second: tuple[str, Path]) -> OutputError:
    if identity(first[1]) == identity(second[1]):
        other = f" (as '{second[1]}')" if second[1] != first[1] else ""
        return OutputError(f"this file is named twice{other}", file=first[1], remedy="name it once")
    return OutputError(
        f"the {first[0]} of '{first[1]}' and the {second[0]} of '{second[1]}' would both be "
        "written here",
        file=path,
        remedy="clean them in separate commands, each with its own -o",
    )


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _ignores_case(folder: Path) -> bool:
    """Whether a folder takes ``a`` and ``A`` for one name, by something that exists.

    That is an entry of it, else the folder itself, or the nearest above it that exists.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.swapcase() != entry.name:
                return _same_in_other_case(Path(entry.path))
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return _same_in_other_case(folder)


def _same_in_other_case(path: Path) -> bool:
    if path.name.swapcase() == path.name:
        return False
    with suppress(OSError):
        return path.samefile(path.with_name(path.name.swapcase()))
    return False
