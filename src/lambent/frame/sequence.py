"""Frames by number: which files a pattern means, with the holes known. Nothing is read before time.

Patterns: ``shot.####.exr`` (a ``#`` a digit), ``shot.%04d.exr``, ``shot.$F4.exr``, globs
(``shot.*.exr``), a directory, or one file of the sequence. Ranges: ``1-50``, ``1-50x2`` (every
second), ``1,3,7``, and any mixture; numbers may be negative (``-5--1``). A number is padded as
``printf`` does: ``%04d`` of -1 is ``-001``.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from lambent.errors import FileError, OptionError
from lambent.frame.opening import unreadable

if TYPE_CHECKING:
    from lambent.frame.frame import Frame

#: A place for a number in a pattern: hashes, printf, or Houdini's $F.
_PLACE = re.compile(r"(?P<hashes>#+)|%(?P<zero>0?)(?P<width>\d*)d|\$F(?P<houdini>\d?)")
_GLOB = re.compile(r"[*?]|\[.*\]")
#: The last digits of a name (before its ending); a minus counts after a separator only.
_NUMBER = re.compile(r"(?P<head>.*?)(?P<number>(?:(?<=[._ ])-|^-)?\d+)(?P<tail>[^\d/]*)$")
_RANGE = re.compile(r"^(-?\d+)(?:-(-?\d+)(?:x(\d+))?)?$")
#: What a directory is searched for.
_PICTURES = (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".hdr", ".pfm")
_MOST = 1_000_000


@dataclass(frozen=True, eq=False)
class Sequence(Mapping[int, Path]):
    """Frame numbers to paths, in order. Only numbers whose file exists are in it.

    ``pattern`` is the name with hashes in place of the number. ``wanted``: the numbers asked for
    (without a range: from the first to the last there is). ``twins``: numbers that two files have
    (``shot.1.exr`` beside ``shot.0001.exr``), with the second file. ``left_out``: files that the
    pattern nearly means, such as numbers with other padding, and glob matches without a number.
    """

    pattern: str
    files: Mapping[int, Path] = field(repr=False)
    wanted: tuple[int, ...] = field(repr=False)
    twins: Mapping[int, Path] = field(repr=False, default_factory=dict)
    left_out: tuple[Path, ...] = field(repr=False, default=())

    @classmethod
    def find(cls, pattern: str | os.PathLike[str], frames: str | None = None) -> Sequence:
        """The sequence that a pattern means, limited to a range.

        Raises `FileError` where nothing matches, where a glob or directory holds several
        sequences (they are listed; see `find_all`), or where two files have one number;
        `OptionError` for a bad range or pattern.
        """
        found = cls.find_all(pattern)
        if len(found) > 1:
            raise FileError(
                f"{len(found)} sequences are here: "
                + ", ".join(f"{Path(s.pattern).name} ({s.span})" for s in found[:8]),
                file=pattern,
                remedy="name one of them",
            )
        return found[0].within(frames)

    def within(self, frames: str | None) -> Sequence:
        """This sequence limited to a range; None is all of it.

        Raises `FileError` where no frame of the range is there, or two files have one number of it;
        `OptionError` for a bad range.
        """
        wanted = self.wanted if frames is None else parse_range(frames)
        files = {n: self.files[n] for n in wanted if n in self.files}
        if not files:
            raise FileError(
                f"no frame of {frames} is there",
                file=self.pattern,
                remedy=f"there are {self.span}",
            )
        for number in files:
            if number in self.twins:
                raise FileError(
                    f"'{files[number].name}' and '{self.twins[number].name}' are both "
                    f"frame {number}",
                    file=self.pattern,
                    remedy="rename or move one of them, or leave the number out with --frames",
                )
        return Sequence(self.pattern, MappingProxyType(files), wanted, self.twins, self.left_out)

    @classmethod
    def find_all(cls, pattern: str | os.PathLike[str]) -> list[Sequence]:
        """Every sequence that a pattern, glob or directory means, by name.

        Raises `FileError` where nothing matches or the folder cannot be read, `OptionError`.
        """
        text = os.fspath(pattern)
        path = Path(text)
        try:
            return cls._search(path, text)
        except OSError as error:
            raise unreadable(path, error) from error

    @staticmethod
    def _search(path: Path, text: str) -> list[Sequence]:
        if path.is_dir():
            names = [p for p in path.iterdir() if p.suffix.lower() in _PICTURES]
            found = grouped(p for p in names if p.is_file() and not p.name.startswith("."))
        elif path.is_file():
            found = _siblings(path)
        elif _PLACE.search(path.name):
            found = _matching(path)
        elif _GLOB.search(text):
            found = grouped(p for p in map(Path, sorted(glob.glob(text))) if p.is_file())
        elif _PLACE.search(text):
            raise OptionError(
                f"'{text}' has the frame number in a folder's name",
                remedy="the number belongs into the file's name: shot.####.exr",
            )
        else:
            raise FileError(
                "there is no such file",
                file=text,
                remedy="a sequence is shot.####.exr, shot.%04d.exr, 'shot.*.exr' or a directory",
            )
        if not found:
            nothing = "no file matches, or none has a frame number"
            raise FileError(
                "no numbered picture is in it" if path.is_dir() else nothing,
                file=text,
                remedy=_nearby(path),
            )
        return found

    # --------------------------------------------------------------- looking

    def __getitem__(self, number: int) -> Path:
        return self.files[number]

    def __iter__(self) -> Iterator[int]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)

    @property
    def missing(self) -> tuple[int, ...]:
        """The numbers that were asked for and are not there."""
        return tuple(n for n in self.wanted if n not in self.files)

    @property
    def span(self) -> str:
        """The numbers there are, as a range: ``1-20,25-50``."""
        return format_range(self.files)

    def complete(self) -> Sequence:
        """This sequence. Raises `FileError` that names the missing numbers if it has holes."""
        if self.missing:
            raise FileError(
                f"frames {format_range(self.missing)} are missing",
                file=self.pattern,
                remedy=f"render them, or leave them out: --frames {self.span}",
            )
        return self

    def read(self, number: int, **options: Any) -> Frame:
        """Read one frame (`lambent.frame.files.read`). Raises `FileError` for a missing number."""
        from lambent.frame.files import read

        if number not in self.files:
            raise FileError(
                f"frame {number} is missing", file=self.pattern, remedy=f"there are {self.span}"
            )
        return read(self.files[number], **options)

    def path_for(self, number: int, out_pattern: str | os.PathLike[str]) -> Path:
        """Where the result of a frame goes.

        ``out_pattern``: a name with a place for the number, or a directory (which keeps the
        frame's own name). Raises `OptionError` for a name without a place.
        """
        text = os.fspath(out_pattern)
        path = Path(text)
        if _PLACE.search(path.name):
            return path.with_name(put_number(path.name, number))
        if path.is_dir() or text.endswith(("/", os.sep)):
            name = self.files[number].name if number in self.files else None
            return path / (name or put_number(Path(self.pattern).name, number))
        raise OptionError(
            f"'{text}' has no place for the frame number",
            remedy=f"write {path.stem}.####{path.suffix or '.exr'}, or name a directory",
        )


# -------------------------------------------------------------------- ranges


def parse_range(text: str) -> tuple[int, ...]:
    """``"1-50x2,60"`` to frame numbers, in order and once each. Raises `OptionError`."""
    numbers: set[int] = set()
    for piece in text.replace(" ", "").split(","):
        match = _RANGE.match(piece)
        if match is None:
            raise OptionError(
                f"'{piece or text}' is not a range of frames", remedy="write 1-50, 1-50x2 or 1,3,7"
            )
        first = int(match[1])
        last = first if match[2] is None else int(match[2])
        step = 1 if match[3] is None else int(match[3])
        if last < first:
            raise OptionError(f"the range {piece} runs backwards", remedy=f"write {last}-{first}")
        if step < 1 or (last - first) // step >= _MOST:
            raise OptionError(f"the range {piece} makes no sense", remedy="write 1-50 or 1-50x2")
        numbers.update(range(first, last + 1, step))
    return tuple(sorted(numbers))


def format_range(numbers: Iterable[int]) -> str:
    """Frame numbers as a person writes them: ``1-20,25``."""
    pieces: list[str] = []
    run: list[int] = []
    for n in [*sorted(numbers), None]:
        if run and (n is None or n != run[-1] + 1):
            pieces.append(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}")
            run = []
        if n is not None:
            run.append(n)
    return ",".join(pieces)


def has_place(pattern: str) -> bool:
    """Whether a name has a place for a frame number."""
    return _PLACE.search(pattern) is not None


def put_number(pattern: str, number: int) -> str:
    """A name from a pattern and a number; the last place in the pattern takes it."""
    place = list(_PLACE.finditer(pattern))[-1]
    return pattern[: place.start()] + _padded(number, _width(place)) + pattern[place.end() :]


def _padded(number: int, width: int) -> str:
    return f"{number:0{width}d}"


def _width(place: re.Match[str]) -> int:
    if place["hashes"]:
        return len(place["hashes"])
    if place["houdini"] is not None:
        return int(place["houdini"] or 1)
    return int(place["width"] or 1) if place["zero"] else 1


# ------------------------------------------------------------------ matching


def _matching(path: Path) -> list[Sequence]:
    """The files of a pattern with a place for the number."""
    place = list(_PLACE.finditer(path.name))[-1]
    head, tail = path.name[: place.start()], path.name[place.end() :]
    width = _width(place)
    name = re.compile(re.escape(head) + r"(-?\d+)" + re.escape(tail) + "$")
    found: dict[int, Path] = {}
    twins: dict[int, Path] = {}
    left_out: list[Path] = []
    folder = path.parent
    for entry in sorted(os.listdir(folder)) if folder.is_dir() else []:
        match = name.match(entry)
        if match is None:
            continue
        number = int(match[1])
        digits = match[1].lstrip("-")
        # Exactly as printf writes it, or the digits alone padded (some programs write -0001).
        exact = match[1] == _padded(number, width)
        if not exact and not (number < 0 and len(digits) == width):
            left_out.append(folder / entry)
        elif number in found:
            twins[number] = folder / entry
        else:
            found[number] = folder / entry
    pattern = str(folder / f"{head}{'#' * width}{tail}")
    return [_sequence(pattern, found, twins, left_out)] if found else []


def _siblings(path: Path) -> list[Sequence]:
    """The sequence that one file belongs to; a file without a number is one of its own."""
    if _split(path) is None:
        return [_sequence(str(path), {1: path}, {}, [])]
    head, _, tail = _split(path) or ("", "", "")
    same = [
        p
        for p in path.parent.iterdir()
        if (parts := _split(p)) is not None and (parts[0], parts[2]) == (head, tail)
    ]
    return grouped(same)


def grouped(paths: Iterable[Path]) -> list[Sequence]:
    """Files by what their names have in common beside the last number."""
    groups: dict[tuple[Path, str, str], dict[int, Path]] = {}
    twins: dict[tuple[Path, str, str], dict[int, Path]] = {}
    digits: dict[tuple[Path, str, str], list[str]] = {}
    left_out: list[Path] = []
    for path in sorted(paths):
        parts = _split(path)
        if parts is None:
            left_out.append(path)
            continue
        key = (path.parent, parts[0], parts[2])
        group, number = groups.setdefault(key, {}), int(parts[1])
        (twins.setdefault(key, {}) if number in group else group)[number] = path
        digits.setdefault(key, []).append(parts[1])
    return [
        _sequence(
            str(folder / f"{head}{'#' * _common(digits[folder, head, tail])}{tail}"),
            files,
            twins.get((folder, head, tail), {}),
            left_out,
        )
        for (folder, head, tail), files in sorted(groups.items())
    ]


def _split(path: Path) -> tuple[str, str, str] | None:
    """The name before its last number, the number, and the rest with the ending."""
    match = _NUMBER.match(path.stem)
    return None if match is None else (match["head"], match["number"], match["tail"] + path.suffix)


def _common(numbers: list[str]) -> int:
    """The padding of these numbers: the shortest there is, if any starts with a zero."""
    shortest = min(map(len, numbers))
    padded = any(n.lstrip("-").startswith("0") and len(n.lstrip("-")) > 1 for n in numbers)
    return shortest if padded or shortest == max(map(len, numbers)) else 1


def _sequence(
    pattern: str, files: Mapping[int, Path], twins: Mapping[int, Path], left_out: Iterable[Path]
) -> Sequence:
    ordered = {n: files[n] for n in sorted(files)}
    first, last = min(ordered), max(ordered)
    # Numbers that are dates or ids are no range.
    wanted = tuple(range(first, last + 1)) if last - first < _MOST else tuple(ordered)
    return Sequence(
        pattern, MappingProxyType(ordered), wanted, MappingProxyType(dict(twins)), tuple(left_out)
    )


def _nearby(path: Path) -> str:
    """What a person may have meant."""
    folder = path if path.is_dir() else path.parent
    if not folder.is_dir():
        return f"the folder '{folder}' does not exist"
    found = grouped(p for p in folder.iterdir() if p.suffix.lower() in _PICTURES)
    if not found:
        return f"'{folder}' holds no numbered pictures"
    names = ", ".join(f"{Path(s.pattern).name} ({s.span})" for s in found[:4])
    return f"in '{folder}' there are {names}"
