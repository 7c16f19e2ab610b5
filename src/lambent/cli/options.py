"""Options that several commands share: their types, help and completions, and how they parse.

One name means the same everywhere: ``-o`` the result, by default beside the input; ``--report``
a page, with or without a name; ``--time`` seconds or ``2h``; ``--from`` what to begin with.
"""

from __future__ import annotations

import functools
import inspect
import json
import os
import re
import typing
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

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
        metavar="NAME|FILE",
        help="The denoiser; 'lambent models' lists them. Or a model file: mine.lambent.",
        autocompletion=complete_models,
    ),
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="ROLE=LAYER",
        help="State which layer has a role: --map albedo=tex, --map colour=0,1,2; for a guide in "
        "another file, --map depth=depth.exr. Repeatable.",
        autocompletion=complete_roles,
    ),
]
SppOption = Annotated[
    int | None,
    typer.Option("--spp", metavar="N", help="Samples per pixel, if the file does not record them."),
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
        help="Allow scenes to load plug-ins (native code) from this folder. Repeatable.",
    ),
]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite", help="Replace outputs that already exist.")
]
ThreadsOption = Annotated[
    int | None, typer.Option("--threads", metavar="N", help="Use at most this many threads.")
]
DefineOption = Annotated[
    list[str] | None,
    typer.Option(
        "--define", "-D", metavar="NAME=VALUE", help="Set a $NAME of the scene. Repeatable."
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document on stdout, and nothing else.")
]


def with_settings(command: Callable[..., Any], kinds: Iterable[type]) -> Callable[..., Any]:
    """A command that takes ``**settings``, with an option for each setting of ``kinds``.

    ``kinds``: dataclasses of `lambent.settings.setting`; where two have a setting of one name, it
    is one option, with the words of the first. What is not given is not passed on.
    """
    from lambent.settings import settings_of

    own = inspect.signature(command).parameters
    hints = typing.get_type_hints(command, include_extras=True)
    hints = {name: hints[name] for name in own if name != "settings"}
    defaults = {name: own[name].default for name in hints}
    times: dict[str, str] = {}
    for kind in kinds:
        for name, (wanted, about) in settings_of(kind).items():
            if name in hints:
                continue
            default = getattr(kind, name)
            words = about.help
            if about.choices and about.metavar == "NAME":
                words += f" One of {', '.join(about.choices)}."
            if default not in (None, False):
                words += (
                    f" Default: {default:,}." if type(default) is int else f" Default: {default}."
                )
            if about.metavar == "TIME":  # `seconds_of` reads it
                wanted, words = str, f"{words.rstrip('.')}: 60 (seconds), 45s, 90m or 2h."
                times[name] = about.option or f"--{name}"
            option = typer.Option(
                about.option or f"--{name.replace('_', '-')}", metavar=about.metavar, help=words,
                autocompletion=_completing(about.choices),
            )  # fmt: skip
            hints[name] = Annotated[wanted | None, option]
            defaults[name] = None

    @functools.wraps(command)
    def run(**values: Any) -> Any:
        fixed = {name: value for name, value in values.items() if name in own}
        chosen = {k: v for k, v in values.items() if k not in own and v is not None}
        chosen |= {k: seconds_of(times[k], v) for k, v in chosen.items() if k in times}
        return command(**fixed, **chosen)

    run.__annotations__ = hints
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=defaults[name], annotation=hint
            )
            for name, hint in hints.items()
        ]
    )
    return run


def _completing(choices: Iterable[str]) -> Callable[[str], list[tuple[str, str]]] | None:
    """For the shell: the choices of a setting; those of a mapping with their words."""
    if not choices:
        return None
    words = dict(choices) if isinstance(choices, Mapping) else dict.fromkeys(choices, "")
    return lambda incomplete: [(n, w) for n, w in words.items() if n.startswith(incomplete)]


def report_option(what: str, beside: str = "the output") -> Any:
    """``--report [PAGE.html]``; ``what`` completes the help: "Write a page of before and after"."""
    return typer.Option(
        "--report", metavar="[PAGE.html]", help=f"{what}; without a name, beside {beside}."
    )


def time_option(what: str) -> Any:
    """``--time TIME``, to be read by `seconds_of`."""
    return typer.Option("--time", metavar="TIME", help=f"{what}: 60 (seconds), 45s, 90m or 2h.")


class Command(TyperCommand):
    """A command whose ``--report`` may come without a page.

    Only a word that ends in .html is taken as the page, so that in ``--report noisy.exr`` the file
    stays an input, and is never written to.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a bare ``--report`` the empty name, which `page_for` replaces."""
        end = args.index("--") if "--" in args else len(args)
        for at in range(end - 1, -1, -1):
            if args[at] == "--report" and not (at + 1 < end and _is_page(args[at + 1])):
                args[at] = "--report="
        return super().parse_args(ctx, args)


def page_for(report: str | None, default: Path) -> Path | None:
    """Where the page of ``--report`` goes; None without that option.

    Raises `OptionError` for a name that is not a page's.
    """
    if report is None:
        return None
    if report == "":
        return default
    if not _is_page(report):
        raise OptionError(
            f"--report '{report}' is not the name of a page", remedy="end it in .html"
        )
    return Path(report)


def _is_page(name: str) -> bool:
    return name.lower().endswith((".html", ".htm"))


def seconds_of(option: str, text: str | None) -> float | None:
    """``"60"``, ``"45s"``, ``"90m"``, ``"2h"`` to seconds. Raises `OptionError`."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?) *(s|m|min|h)?", text.strip())
    if match is None or float(match[1]) <= 0:
        raise OptionError(
            f"{option} '{text}' is not a time", remedy="for example 60 (seconds), 45s, 90m or 2h"
        )
    return float(match[1]) * {"h": 3600, "m": 60, "min": 60}.get(match[2], 1)


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
        raise OptionError(
            f"--size '{text}' is not a size in pixels", remedy="write --size 1280x720"
        )
    return int(width), int(height)


def point_of(option: str, text: str | None) -> tuple[float, float, float] | None:
    """``"1,2.5,-3"`` to three numbers. Raises `OptionError`."""
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise OptionError(
            f"{option} '{text}' is not a point", remedy=f"write {option} 1,2,3"
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
