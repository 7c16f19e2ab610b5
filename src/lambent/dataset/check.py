"""Is the set what its list says? For `verify`, and for `make` before it goes on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lambent.dataset.folder import (
    SUBFOLDERS,
    ItemKey,
    Line,
    file_of,
    files_in,
    is_leftover,
    key_of,
    line_of,
    read_lines,
    read_manifest,
    recipe_of,
    sha256_of,
)
from lambent.dataset.pack import about_file, check_pixels
from lambent.dataset.plan import CLIP, STILL
from lambent.dataset.recipe import Recipe
from lambent.errors import FileError
from lambent.progress import Progress, silent


@dataclass(frozen=True)
class Verdict:
    """What `verify` found.

    ``good``: number of sound items. ``corrupt``: file and what is wrong with it; ``missing``: files
    that have a line but are not there; ``strangers``: files that have no line, save sound items
    whose line was lost when their process was killed. ``wanted``: how many items the recipe asks
    for; fewer is no error.
    """

    folder: Path
    good: int
    wanted: int
    corrupt: dict[str, str]
    missing: tuple[str, ...]
    strangers: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong."""
        return not (self.corrupt or self.missing or self.strangers)

    def as_dict(self) -> dict[str, Any]:
        """All of it, as JSON knows it."""
        return {
            "folder": str(self.folder),
            "sound": self.sound,
            "good": self.good,
            "wanted": self.wanted,
            "corrupt": self.corrupt,
            "missing": list(self.missing),
            "strangers": list(self.strangers),
        }


def verify(folder: Path, progress: Progress = silent) -> Verdict:
    """Hash and decode every file of a set. Raises `FileError` if the folder is none."""
    recipe = recipe_of(folder)
    lines = read_lines(folder)
    corrupt: dict[str, str] = {}
    missing = []
    for n, line in enumerate(lines.values()):
        file = str(line.get("file"))
        progress(n, len(lines), file)
        wrong = problem(folder, line, recipe.crop)
        if wrong == "":
            missing.append(file)
        elif wrong is not None:
            corrupt[file] = wrong
    known = {str(line.get("file")) for line in lines.values()}
    unlisted = [f for f in files_in(folder) if f not in known and not is_leftover(f)]
    strangers = tuple(f for f in unlisted if not _is_item(folder, f, recipe))
    good = len(lines) - len(corrupt) - len(missing) + len(unlisted) - len(strangers)
    wanted = recipe.count + recipe.clip_count
    return Verdict(folder, good, wanted, corrupt, tuple(missing), strangers)


def problem(folder: Path, line: Line, edge: int) -> str | None:
    """What is wrong with an item's file, in words; "" if it is missing, None if it is sound.

    ``edge``: of its crops, in pixels.
    """
    path = folder / str(line.get("file"))
    if not path.exists():
        return ""
    try:
        if path.stat().st_size != line["bytes"]:
            return f"has {path.stat().st_size} bytes in place of {line['bytes']}"
        if sha256_of(path) != line["sha256"]:
            return "its content is not what was written (sha256)"
        check_pixels(path, edge)
    except (FileError, OSError) as error:
        return getattr(error, "message", str(error))
    except KeyError as error:
        return f"its line has no {error}"
    return None


def settle(
    folder: Path, recipe: Recipe, trust: bool = False, progress: Progress = silent
) -> tuple[dict[ItemKey, Line], list[str]]:
    """The lines of the sound items of a set, after a process that may have been killed.

    Pieces are removed, whole files without a line get one, damaged files are named (in the list)
    and count as missing. With ``trust`` only the sizes of files are compared, not their hashes.
    """
    notes = []
    for file in list(files_in(folder)):
        if is_leftover(file):
            (folder / file).unlink(missing_ok=True)
    for path in folder.glob(".*.part"):
        path.unlink(missing_ok=True)
    lines = read_lines(folder)
    sound: dict[ItemKey, Line] = {}
    for n, (key, line) in enumerate(lines.items()):
        progress(n, len(lines), f"checking {line.get('file')}")
        wrong = _quick(folder, line) if trust else _hashed(folder, line)
        if key[0] not in SUBFOLDERS or line.get("file") != file_of(*key):
            continue
        if wrong is None:
            sound[key] = line
        else:
            notes.append(f"{line['file']} {wrong or 'is missing'}: made again")
    for file in files_in(folder):
        found = key_of(file)
        if found is not None and found not in lines:
            line_or_none = _adopted(folder, file, found, recipe)
            if line_or_none is None:
                notes.append(f"{file} is not a sound item of this set: made again")
            else:
                sound[found] = line_or_none
    return sound, notes


def missing_items(recipe: Recipe, lines: dict[ItemKey, Line]) -> dict[str, set[int]]:
    """The numbers of the items that are yet to be made."""
    return {
        what: {n for n in range(count) if (what, n) not in lines}
        for what, count in ((STILL, recipe.count), (CLIP, recipe.clip_count))
    }


def _is_item(folder: Path, file: str, recipe: Recipe) -> bool:
    key = key_of(file)
    return key is not None and _adopted(folder, file, key, recipe) is not None


def _quick(folder: Path, line: Line) -> str | None:
    path = folder / str(line.get("file"))
    if not path.exists():
        return ""
    same = path.stat().st_size == line.get("bytes")
    return None if same else f"has {path.stat().st_size} bytes in place of {line.get('bytes')}"


def _hashed(folder: Path, line: Line) -> str | None:
    wrong = _quick(folder, line)
    if wrong is None and sha256_of(folder / line["file"]) != line.get("sha256"):
        return "is not what was written (sha256)"
    return wrong


def _adopted(folder: Path, file: str, key: ItemKey, recipe: Recipe) -> Line | None:
    """The line of a whole file whose process died before it could write one."""
    path = folder / file
    try:
        check_pixels(path, recipe.crop)
        about = about_file(path)
    except FileError:
        return None
    if (about.get("what"), about.get("index")) != key or about.get("essence") != recipe.essence:
        return None
    return line_of(about, sha256_of(path), path.stat().st_size, None)


def is_dataset(folder: Path) -> bool:
    """Whether a folder holds a data set."""
    try:
        read_manifest(folder)
    except FileError:
        return False
    return True
