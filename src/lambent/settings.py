"""Settings in TOML files, read into frozen dataclasses: recipes of data sets and of training.

Unknown keys are errors, answered with the nearest known one; every value has the type of its field
and lies in its range.
"""

from __future__ import annotations

import difflib
import importlib
import sys
import typing
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from lambent.errors import FileError, OptionError

#: Field, lowest and highest value (of each entry, where it is a list).
Range = tuple[str, float, float]
T = TypeVar("T")


def read_toml(path: Path) -> dict[str, Any]:
    """The keys and values of a TOML file. Raises `FileError`: missing, unreadable, no TOML."""
    tomllib = importlib.import_module("tomllib" if sys.version_info >= (3, 11) else "tomli")
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileError("there is no such recipe", file=path, remedy="name a TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"cannot be read: {error}", file=path, remedy="name a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(
            f"is no TOML: {error}", file=path, remedy="one 'key = value' a line, texts in quotes"
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


def _typed(key: str, value: Any, kind: Any, file: object) -> Any:
    """The value in the type of its field."""
    if typing.get_origin(kind) is tuple:
        inner = typing.get_args(kind)
        if isinstance(value, (list, tuple)) and (inner[-1] is ... or len(value) == len(inner)):
            return tuple(_typed(key, v, inner[0], file) for v in value)
        wanted = "a list" if inner[-1] is ... else f"a list of {len(inner)}"
        raise OptionError(f"{key} = {value!r} should be {wanted}", file=file, remedy="see the docs")
    kind = dict if typing.get_origin(kind) is dict else kind
    good = isinstance(value, (int, float) if kind is float else kind)
    if not good or (isinstance(value, bool) and kind is not bool):
        words = {
            int: "a whole number",
            float: "a number",
            str: "a text",
            bool: "true or false",
            dict: "a table",
        }
        word = words[kind]
        raise OptionError(f"{key} = {value!r} should be {word}", file=file, remedy="see the docs")
    return kind(value)
