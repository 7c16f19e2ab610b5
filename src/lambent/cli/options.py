"""Options that several commands share: their types, help and completions, and how they parse."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from lambent.cli.terminal import say
from lambent.errors import OptionError


def complete_models(incomplete: str) -> list[tuple[str, str]]:
    """For the shell: names of models that begin like this, with what each is."""
    from lambent.filters.denoiser import DENOISERS

    return [(name, "") for name in DENOISERS if name.startswith(incomplete)]


def complete_roles(incomplete: str) -> list[str]:
    """For the shell: ``role=`` for every role that begins like this."""
    from lambent.frame.role import Role

    return [f"{role.value}=" for role in Role if role.value.startswith(incomplete)]


def complete_devices(incomplete: str) -> list[str]:
    """For the shell: the devices."""
    from lambent.device import DEVICES

    return [name for name in DEVICES if name.startswith(incomplete)]


ModelOption = Annotated[
    str,
    typer.Option(
        "--model",
        "-m",
        metavar="NAME",
        help="The denoiser; 'lambent models' lists them.",
        autocompletion=complete_models,
    ),
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="ROLE=LAYER",
        help="Say yourself which layer has a role: --map albedo=tex, --map colour=0,1,2; or, for a "
        "guide, which file: --map depth=depth.exr. Repeatable.",
        autocompletion=complete_roles,
    ),
]
SppOption = Annotated[
    int | None,
    typer.Option("--spp", metavar="N", help="Samples per pixel, where the file does not tell."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PARAM=VALUE",
        help="Set a parameter of the model; 'lambent models NAME' lists them. Repeatable.",
    ),
]
DeviceOption = Annotated[
    str,
    typer.Option(
        "--device",
        metavar="auto|cpu|cuda",
        help="Where to compute.",
        autocompletion=complete_devices,
    ),
]
PluginsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--allow-plugins",
        metavar="DIR",
        help="Let scenes load the plug-ins (native code) in this folder. Repeatable.",
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on stdout and nothing else there.")
]


def pairs(option: str, texts: Iterable[str] | None) -> dict[str, str]:
    """``["albedo=tex", …]`` to ``{"albedo": "tex"}``.

    Raises `OptionError` for a text without ``=`` and for a name given twice.
    """
    found: dict[str, str] = {}
    for text in texts or ():
        name, sign, value = text.partition("=")
        name, value = name.strip(), value.strip()
        if not (sign and name and value):
            form = "ROLE=LAYER" if option == "--map" else "PARAM=VALUE"
            raise OptionError(
                f"{option} '{text}' is not of the form {form}",
                remedy=f"for example {option} "
                + ("albedo=tex" if option == "--map" else "radius=7"),
            )
        if name in found:
            raise OptionError(f"{option} names '{name}' twice", remedy="give it once")
        found[name] = value
    return found


def size_of(text: str | None) -> tuple[int, int] | None:
    """``"1280x720"`` to ``(1280, 720)``. Raises `OptionError`."""
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise OptionError(f"--size '{text}' is no size in pixels", remedy="write --size 1280x720")
    return int(width), int(height)


def point_of(option: str, text: str | None) -> tuple[float, float, float] | None:
    """``"1,2.5,-3"`` to three numbers. Raises `OptionError`."""
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise OptionError(
            f"{option} '{text}' is no point", remedy=f"write {option} 1,2,3"
        ) from None
    return x, y, z


def definitions(texts: Iterable[str] | None) -> dict[str, str]:
    """``["resx=320", …]`` to a table. Raises `OptionError`."""
    found = {}
    for text in texts or ():
        name, sign, value = text.partition("=")
        if not (sign and name.strip()):
            raise OptionError(f"--define '{text}' is not of the form NAME=VALUE")
        found[name.strip()] = value.strip()
    return found


def light_groups(texts: Iterable[str] | None) -> dict[str, list[str]]:
    """``["key=sun,lamp*", …]`` to patterns by name. Raises `OptionError`."""
    found: dict[str, list[str]] = {}
    for text in texts or ():
        name, _, patterns = text.partition("=")
        named = [p.strip() for p in patterns.split(",") if p.strip()]
        if not (name.strip() and named):
            raise OptionError(
                f"--light-group '{text}' is not of the form NAME=ID,...",
                remedy="for example --light-group key=sun,lamp*",
            )
        found.setdefault(name.strip(), []).extend(named)
    return found


def check_output(path: Path | None, overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse a file that cannot be written, or that is an input, before any work is done.

    Raises `OutputError`. ``path`` None: nothing will be written.
    """
    if path is None:
        return
    from lambent.errors import OutputError
    from lambent.frame.atomic import check_target

    target = check_target(path, overwrite)
    for source in inputs:
        if os.path.realpath(source) == str(target):
            raise OutputError(
                "is an input, and is never replaced by what is made from it",
                file=path,
                remedy="name another file",
            )


def print_json(document: Any) -> None:
    """One JSON document on stdout; what JSON does not know becomes text."""
    text = json.dumps(document, indent=2, default=_plain, allow_nan=False)
    say(*text.replace("\x7f", "\\u007f").split("\n"))  # the one control character left as it is


def _plain(thing: Any) -> Any:
    if hasattr(thing, "as_dict"):
        return thing.as_dict()
    if hasattr(thing, "tolist"):  # NumPy numbers and arrays
        return thing.tolist()
    return str(thing)
