"""A data set on disk, of which nothing is lost or doubled whenever the process is killed.

::

    manifest.json             recipe, versions, licences
    items.jsonl               one line for each item: file, sha256, bytes, what is known of it
    crops/000/000123.exr      one file an item, named by its number
    clips/000/000012.exr

A file appears whole or not at all, and then its line is appended. Whatever was between the two when
the process died is settled at the next start: a whole file without a line gets its line from what
the file says of itself; a torn last line is dropped; unnamed pieces are removed. One process at a
time writes to a folder: a lock of the system's, which dies with its holder.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from lambent.dataset.plan import CLIP, STILL
from lambent.dataset.recipe import Recipe
from lambent.errors import FileError, OptionError
from lambent.frame.atomic import atomic
from lambent.settings import fits, parse_json, read_json, wrong_key

MANIFEST, ITEMS, LOCK = "manifest.json", "items.jsonl", ".lock"
SUBFOLDERS = {STILL: "crops", CLIP: "clips"}
FORMAT = 1

Line = dict[str, Any]
ItemKey = tuple[str, int]


def file_of(what: str, index: int) -> str:
    """Where an item lies, from the folder of the set."""
    return f"{SUBFOLDERS[what]}/{index // 1000:03d}/{index:06d}.exr"


def key_of(file: str) -> ItemKey | None:
    """The item that a file must be by its place, or None."""
    for what in SUBFOLDERS:
        stem = Path(file).stem
        if stem.isdigit() and file_of(what, int(stem)) == file:
            return what, int(stem)
    return None


def sha256_of(path: Path) -> str:
    """The hash of a file's content."""
    with open(path, "rb") as handle:
        found = hashlib.sha256()
        while piece := handle.read(1 << 20):
            found.update(piece)
    return found.hexdigest()


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest. Raises `FileError` where the folder is no data set."""
    path = folder / MANIFEST
    if not path.exists():
        raise FileError(
            f"is not a data set: it has no {MANIFEST}",
            file=folder,
            remedy="make one: lambent dataset make RECIPE -o DIR",
        )
    manifest = read_json(path, "manifest", "copy it again")
    if manifest.get("format") != FORMAT:
        raise FileError(
            "is a data set of another version of Lambent", file=path, remedy="update Lambent"
        )
    wrong = wrong_key(manifest, {"recipe": dict[str, Any], "versions": list[Any]})
    if wrong:
        raise FileError(f"is damaged: {wrong}", file=path, remedy="copy it again")
    return manifest


def recipe_of(folder: Path) -> Recipe:
    """The recipe that a set was made from."""
    return Recipe.from_dict(read_manifest(folder)["recipe"], folder / MANIFEST)


#: The keys that every line of the list of items has.
_LINE = {"what": str, "index": int, "file": str, "sha256": str, "bytes": int}


def read_lines(folder: Path) -> dict[ItemKey, Line]:
    """The line of each item, the last one where there are several.

    Torn lines, and those that name no file of the item's own, are left out: it is made again.
    """
    lines: dict[ItemKey, Line] = {}
    with suppress(FileNotFoundError), open(folder / ITEMS, "rb") as handle:
        for raw in handle:
            with suppress(ValueError, KeyError, TypeError):
                line = parse_json(raw)
                if not raw.endswith(b"\n") or not fits(line, dict[str, Any]):
                    continue
                sound = not wrong_key(line, _LINE)
                if sound and line["file"] == file_of(line["what"], line["index"]):
                    lines[line["what"], line["index"]] = line
    return lines


def files_in(folder: Path) -> Iterator[str]:
    """Every file in the item folders, from the folder of the set."""
    for name in SUBFOLDERS.values():
        for path in sorted((folder / name).rglob("*")):
            if not path.is_dir():
                yield path.relative_to(folder).as_posix()


def is_leftover(file: str) -> bool:
    """Whether a file is a piece that a killed process left."""
    name = Path(file).name
    return name.startswith(".") and name.endswith(".part")


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Hold the folder's lock. Raises `FileError` if somebody else writes there now."""
    import fcntl

    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise FileError(
            f"cannot be written to: {error.strerror}", file=folder, remedy="take another with -o"
        ) from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileError(
                "another process is making this data set now",
                file=folder,
                remedy="let it finish, or make another set with -o",
            ) from None
        yield
    finally:
        os.close(descriptor)


def begin(folder: Path, recipe: Recipe, facts: dict[str, Any]) -> None:
    """Write the manifest, or the larger counts into the one there is.

    Raises `OptionError` if the folder holds a set of another recipe.
    """
    path = folder / MANIFEST
    if path.exists():
        old = read_manifest(folder)
        before = Recipe.from_dict(old["recipe"], path)
        if before.essence != recipe.essence:
            changed = [k for k, v in recipe.as_dict().items() if before.as_dict()[k] != v]
            raise OptionError(
                f"was made from another recipe; different: {', '.join(changed)}",
                file=folder,
                remedy="take another folder with -o, or the old recipe",
            )
        now = facts["versions"].get("assets")
        if any(v.get("assets") != now for v in old.get("versions", [])):
            raise OptionError(
                "was made from another folder of assets, or it has changed since",
                file=folder,
                remedy="take another folder for the set with -o, or the old assets",
            )
        versions = [v for v in old.get("versions", []) if v != facts["versions"]]
        facts = {**old, "versions": [*versions, facts["versions"]], "recipe": recipe.as_dict()}
        if facts == old:
            return
    else:
        facts = {"format": FORMAT, **facts, "versions": [facts["versions"]]}
        facts["recipe"] = recipe.as_dict()
    with atomic(path, overwrite=True) as out:
        out.write(json.dumps(facts, indent=2).encode() + b"\n")


def write_lines(folder: Path, lines: dict[ItemKey, Line]) -> None:
    """Replace the list of items by these, in the order of their numbers."""
    text = "".join(_text(lines[key]) for key in sorted(lines, key=lambda k: (k[0] == CLIP, k[1])))
    with atomic(folder / ITEMS, overwrite=True) as out:
        out.write(text.encode())


def add_item(folder: Path, line: Line, content: bytes) -> None:
    """Write an item's file, then its line; each is whole on the disk before the next begins."""
    path = folder / line["file"]
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic(path, overwrite=True) as out:
        out.write(content)
    descriptor = os.open(folder / ITEMS, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    try:
        os.write(descriptor, _text(line).encode())
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def line_of(about: dict[str, Any], sha256: str, size: int, seconds: float | None) -> Line:
    """The line of an item. ``seconds`` is the only value that chance has a hand in."""
    file = file_of(about["what"], about["index"])
    spent = None if seconds is None else round(seconds, 3)
    return {**about, "file": file, "sha256": sha256, "bytes": size, "seconds": spent}


def _text(line: Line) -> str:
    return json.dumps(line, sort_keys=True) + "\n"
