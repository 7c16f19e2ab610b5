"""What people and programs write for Lambent as TOML and JSON, checked before it is used.

`read_toml` and `read_json` refuse what is no such file; `fits` and `wrong_key` tell whether values
have their types; `record_from` makes a frozen dataclass of a table: recipes of data sets and of
training. There, unknown keys are errors, answered with the nearest known one; every value has the
type of its field and lies in its range.

A frozen dataclass can also carry its own ranges and help: fields made by `setting`, read by
`settings_of` (the command line makes its options of them) and checked by `check_settings`.
"""

from __future__ import annotations

import difflib
import importlib
import json
import math
import stat
import sys
import types
import typing
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar

from lambent.errors import DamagedFileError, FileError, OptionError, UnknownNameError

#: Field, lowest and highest value (of each entry, where it is a list).
Range = tuple[str, float, float]
T = TypeVar("T")
#: Bytes of a text that is read whole.
_LARGEST = 256 << 20


def read_text(path: Path, what: str, remedy: str) -> str:
    """A text file. Raises `FileError`: missing, no regular file, too large, no UTF-8."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise FileError(f"is a folder, not a {what}", file=path, remedy=remedy)
        if not stat.S_ISREG(status.st_mode):
            raise FileError(f"is a pipe or a device, not a {what}", file=path, remedy=remedy)
        if status.st_size > _LARGEST:
            raise FileError(f"is too large for a {what}", file=path, remedy=remedy)
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise FileError(f"there is no such {what}", file=path, remedy=remedy) from None
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"cannot be read: {error}", file=path, remedy=remedy) from None


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text. Raises `ValueError`, whatever is wrong with it."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def read_json(path: Path, what: str, remedy: str) -> dict[str, Any]:
    """The object in a JSON file. Raises `FileError`."""
    try:
        found = parse_json(read_text(path, what, remedy))
    except ValueError as error:
        raise FileError(f"is not valid JSON: {error}", file=path, remedy=remedy) from None
    if not isinstance(found, dict):
        raise FileError(f"is not a {what}", file=path, remedy=remedy)
    return found


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of a type: a class, ``X | None``, ``list[X]`` or ``dict[str, X]``.

    A whole number counts as a float; floats must be finite, and a truth value is no number.
    """
    if kind is Any:
        return True
    if typing.get_origin(kind) in (types.UnionType, typing.Union):
        return any(fits(value, one) for one in typing.get_args(kind))
    if typing.get_origin(kind) is list:
        return isinstance(value, list) and all(fits(v, typing.get_args(kind)[0]) for v in value)
    if typing.get_origin(kind) is dict:
        inner = typing.get_args(kind)[1]
        return isinstance(value, dict) and all(fits(v, inner) for v in value.values())
    if kind is float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and abs(value) < 1e300  # neither NaN nor infinite, and no endless integer
    if kind is types.NoneType:
        return value is None
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def wrong_key(table: dict[str, Any], kinds: dict[str, Any]) -> str:
    """What is wrong with the keys of a table that must have these types, or ""."""
    for key, kind in kinds.items():
        if key not in table:
            return f"it has no '{key}'"
        if not fits(table[key], kind):
            name = kind.__name__ if isinstance(kind, type) else str(kind)
            return f"'{key}' is {shortened(table[key])}, not {name}"
    return ""


def shortened(value: Any) -> str:
    """A value for a message."""
    text = str(value) if isinstance(value, Exception) else repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def read_toml(path: Path, what: str = "recipe") -> dict[str, Any]:
    """The keys and values of a TOML file. Raises `FileError`: missing, unreadable, no TOML."""
    tomllib = importlib.import_module("tomllib" if sys.version_info >= (3, 11) else "tomli")
    try:
        found = tomllib.loads(read_text(path, what, "name a TOML file"))
    except (ValueError, RecursionError) as error:  # TOML's own error, or a number of endless digits
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise DamagedFileError(
            f"is not valid TOML: {reason}",
            file=path,
            remedy="one 'key = value' a line, texts in quotes",
        ) from None
    assert isinstance(found, dict)
    return found


def record_from(
    kind: type[T],
    settings: dict[str, Any],
    ranges: Sequence[Range] = (),
    file: object = None,
    required: Iterable[str] = (),
) -> T:
    """A dataclass from keys and values.

    Raises `OptionError` for unknown and missing keys, wrong types and values out of range, and
    passes on what the dataclass itself refuses, with the file's name.
    """
    kinds = typing.get_type_hints(kind)
    known = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    ready = {}
    for key, value in settings.items():
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
            names = f"known: {', '.join(known)}"
            raise OptionError(
                f"a recipe has no key '{key}'",
                file=file,
                remedy=f"did you mean '{near[0]}'? ({names})" if near else names,
            )
        ready[key] = _typed(key, value, kinds[key], file)
    for key in required:
        if key not in ready:
            raise OptionError(
                f"the recipe has no '{key}'", file=file, remedy=f"add a line: {key} = …"
            )
    try:
        record = kind(**ready)
        check_ranges(record, ranges)
    except OptionError as error:
        raise OptionError(error.message, file=file, remedy=error.remedy) from None
    return record


def check_ranges(record: Any, ranges: Sequence[Range]) -> None:
    """Raise `OptionError` for a field that is out of its range."""
    for name, low, high in ranges:
        value = getattr(record, name)
        for number in value if isinstance(value, tuple) else (value,):
            if not low <= number <= high:
                raise OptionError(
                    f"{name} = {number} is out of range",
                    remedy=f"take a value from {low:g} to {high:g}",
                )


@dataclass(frozen=True)
class Setting:
    """What a field of a settings dataclass is for.

    ``low`` and ``high``: its range. ``choices``: the names that it may have. ``option``: its name
    on the command line, where that is not the field's own. ``resumed``: in work that is gone on
    with it is "fixed", "kept" unless another value is given, or chosen "anew" each time.
    """

    help: str
    low: float = -math.inf
    high: float = math.inf
    choices: Collection[str] = ()
    option: str = ""
    metavar: str = "N"
    resumed: Literal["fixed", "kept", "anew"] = "fixed"


def setting(default: Any, help: str, **more: Any) -> Any:
    """A dataclass field with a `Setting`, made from ``help`` and ``more``."""
    return field(default=default, metadata={"setting": Setting(help, **more)})


def settings_of(kind: type) -> dict[str, tuple[Any, Setting]]:
    """Name -> type and `Setting` of every field made by `setting`."""
    hints = typing.get_type_hints(kind)
    found = ((f.name, f.metadata.get("setting")) for f in fields(kind))
    return {name: (hints[name], about) for name, about in found if about is not None}


def check_settings(record: Any) -> None:
    """Raise `UnknownNameError` for a name that is no choice, `OptionError` for a wrong number."""
    for name, (_, about) in settings_of(type(record)).items():
        value = getattr(record, name)
        if about.choices and value not in about.choices:
            raise UnknownNameError(name, value, about.choices)
        if isinstance(value, (int, float)):
            check_ranges(record, [(name, about.low, about.high)])


def _typed(key: str, value: Any, kind: Any, file: object) -> Any:
    """The value in the type of its field."""
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)
        if isinstance(value, (list, tuple)) and (inner[-1] is ... or len(value) == len(inner)):
            return tuple(_typed(key, v, inner[0], file) for v in value)
        wanted = "a list" if inner[-1] is ... else f"a list of {len(inner)}"
        raise OptionError(
            f"{key} = {shortened(value)} should be {wanted}", file=file, remedy="see the docs"
        )
    kind = dict if typing.get_origin(kind) is dict else kind
    good = isinstance(value, (int, float) if kind is float else kind)
    if good and kind in (int, float) and not isinstance(value, bool):
        good = fits(value, float)
    if not good or (isinstance(value, bool) and kind is not bool):
        words = {
            int: "a whole number",
            float: "a number",
            str: "a text",
            bool: "true or false",
            dict: "a table",
        }
        word = words[kind]
        raise OptionError(
            f"{key} = {shortened(value)} should be {word}", file=file, remedy="see the docs"
        )
    return kind(value)
