"""The table of commands and the one place where errors become messages and exit codes.

``lambent --help`` prints from this table and imports no command; a command's module is imported
when that command runs. Typer's own dressing with rich costs 0.1 s at every start and is left off.
"""

from __future__ import annotations

import difflib
import importlib
import os
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from lambent.cli.options import Command
from lambent.cli.process import say_interrupted
from lambent.cli.terminal import remark, say
from lambent.errors import (
    DamagedFileError,
    EngineError,
    FileError,
    LambentError,
    OptionError,
    by_interrupt,
)
from lambent.interrupts import came, watched

#: Command -> what `lambent --help` says of it. The module is ``lambent.cli.<command>``.
COMMANDS = {
    "denoise": "Clean a noisy render, or a sequence of them.",
    "inspect": "Show what is in a file: parts, layers, roles, suspicious pixels.",
    "compare": "Measure images against a reference, as a table or a page.",
    "dataset": "Make training data, look at it, verify it.",
    "explain": "Show the weights with which a filter averages around one pixel.",
    "train": "Train a denoiser, or fine-tune one to your own renders.",
    "render": "Render a Mitsuba scene or a .blend, with every feature.",
    "solve": "Solve the light of a scene once, to look at it from anywhere.",
    "view": "Look at a solved scene: pictures, films, meshes, lightmaps.",
    "models": "List the denoisers, or describe one.",
    "doctor": "Check this machine: processor, engines, memory, speed; say what to fix.",
}

_EPILOG = (
    "Exit codes: 0 success, 1 other failure, 2 file, 3 layer, 4 name or option, 5 engine, "
    "130 interrupted. Begin with: lambent denoise noisy.exr"
)


class LazyCommands(TyperGroup):
    """A group that knows its commands by name and imports each only to run it."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names, in the order of use."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command, its module imported now; None if there is no such command."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"lambent.cli.{cmd_name}")
        found = getattr(module, cmd_name)
        if isinstance(found, typer.Typer):  # a command with commands of its own
            for one in found.registered_commands:
                _look_at_no_file(one.callback)
            return typer.main.get_command(found)
        if hasattr(module, "settings_kinds"):
            from lambent.cli.options import with_settings

            found = with_settings(found, module.settings_kinds())
        _look_at_no_file(found)
        single = typer.Typer(
            add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False
        )
        single.command(
            name=cmd_name,
            cls=Command,
            help=module.__doc__,
            epilog=getattr(module, "EPILOG", None),
        )(found)
        return typer.main.get_command(single)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that the arguments name; an unknown one is answered with the nearest."""
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            raise _unknown_command(args[0])
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The list of commands, from the table alone."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


def run(args: Sequence[str]) -> int:
    """Run one command line; print what goes wrong; return the exit code."""
    as_json = "--json" in args
    with watched():
        return _run(args, as_json)


def group() -> Any:
    """The root command, with its options and all commands."""
    app = typer.Typer(
        cls=LazyCommands,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
        epilog=_EPILOG,
    )
    app.callback()(_root)
    return typer.main.get_command(app)


# ------------------------------------------------------------------- private


def _run(args: Sequence[str], as_json: bool) -> int:
    try:
        # Without a word, the help: what a newcomer types first.
        code = group().main(list(args) or ["--help"], prog_name="lambent", standalone_mode=False)
        if code == 130 or came():  # it may have come where nobody can raise: in a destructor
            say_interrupted()
            return 130
        return code if isinstance(code, int) else 0
    except LambentError as error:
        interrupted = by_interrupt(error)
        # an engine that was being imported is not broken, pixels that were being decoded neither
        if not (interrupted and isinstance(error, (EngineError, DamagedFileError))):
            if _debugging():
                raise
            _print_error(error, as_json)
        if interrupted:
            say_interrupted()
        return 130 if interrupted else error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        say_interrupted()
        return 130
    except SystemExit as leaving:
        # Typer turns a closed pipe (`lambent … | head`) into this; the reader has seen enough.
        return 0 if isinstance(leaving.__context__, BrokenPipeError) else _code_of(leaving)
    except Exception as error:
        if by_interrupt(error):
            say_interrupted()
            return 130
        if _debugging():
            raise
        known = _usage_error(error) or _system_error(error)
        _print_error(known, as_json)
        return known.exit_code


def _root(
    version: Annotated[
        bool, typer.Option("--version", "-V", is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Makes path-traced pictures clean, on an ordinary processor."""
    if version:
        from lambent import __version__

        say(f"lambent {__version__}")
        raise typer.Exit


def _look_at_no_file(callback: Any) -> None:
    """Keep Typer from testing paths: to it, a file that may not be read is a wrong option."""
    hints = typing.get_type_hints(callback, include_extras=True)
    for hint in hints.values():
        for parameter in getattr(hint, "__metadata__", ()):
            parameter.readable = False
    callback.__annotations__ = hints  # they were texts, which would be read afresh


def _code_of(leaving: SystemExit) -> int:
    return leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)


def _unknown_command(name: str) -> OptionError:
    near = difflib.get_close_matches(name, COMMANDS, n=1, cutoff=0.5)
    if os.path.exists(name):
        remedy = f"to clean this file: lambent denoise {name}"
    elif near:
        remedy = f"did you mean 'lambent {near[0]}'?"
    else:
        remedy = f"there are: {', '.join(COMMANDS)}"
    return OptionError(f"there is no command '{name}'", remedy=remedy)


def _usage_error(error: Exception) -> LambentError | None:
    """Typer's complaint about an option, in our form. (Its class moved between versions.)"""
    format_message = getattr(error, "format_message", None)
    if format_message is None:
        return None
    context = getattr(error, "ctx", None)
    where = getattr(context, "command_path", None) or "lambent"
    text = " ".join(str(format_message()).split()).rstrip(".")
    return OptionError(text[:1].lower() + text[1:], remedy=f"see {where} --help")


def _system_error(error: Exception) -> LambentError:
    """What no code of ours foresaw, still without a traceback."""
    if isinstance(error, MemoryError):
        return LambentError("out of memory", remedy="set a limit to work within: --max-memory 2G")
    if isinstance(error, OSError) and error.filename is not None:
        from lambent.frame.opening import unreadable

        return unreadable(Path(os.fsdecode(error.filename)), error)
    if isinstance(error, OSError) and error.strerror:
        return FileError(
            f"the system refused it: {error.strerror}",
            remedy="check the names, their folders and the permissions",
        )
    return LambentError(
        f"something unforeseen: {type(error).__name__}: {error}",
        remedy="LAMBENT_DEBUG=1 shows where; please report it with that output",
    )


def _print_error(error: LambentError, as_json: bool) -> None:
    if as_json:
        from lambent.cli.options import print_json

        print_json({"error": _as_dict(error)})
    remark(*f"error: {error}".split("\n"))


def _as_dict(error: LambentError) -> dict[str, Any]:
    return {
        "kind": type(error).__name__,
        "message": error.message,
        "file": error.file,
        "layer": error.layer,
        "remedy": error.remedy,
        "details": list(error.details),
        "exit_code": error.exit_code,
    }


def _debugging() -> bool:
    return os.environ.get("LAMBENT_DEBUG", "") not in ("", "0")
