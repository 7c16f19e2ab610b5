"""The command line: one file a command; parsing, progress, exit codes. No algorithm lives here.

Reading order: `main` below, `process` (signals, start and end), `app` (the table of commands,
loaded only when asked for), `options` (types and completions that several commands share),
`terminal` (how lines are printed), `progress`, then the commands.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line ``lambent …``; return the exit code.

    0 success; 1 to 5 as in `lambent.errors`; 4 for a wrong option; 130 after Ctrl-C.
    ``LAMBENT_DEBUG=1`` lets exceptions through with their traceback. Without ``argv``, the whole
    process is this command line's: its signals are handled, and it may end here (`process`).
    """
    try:
        return _run(list(sys.argv[1:] if argv is None else argv), argv is None)
    except BrokenPipeError:  # the reader has seen enough
        return 0
    finally:
        _flush()


def _run(args: list[str], alone: bool) -> int:
    """``alone``: the process is this command line's."""
    if args in (["--version"], ["-V"]):  # the fastest answer: before anything is imported
        from lambent import __version__
        from lambent.cli.terminal import say

        say(f"lambent {__version__}")
        return 0
    if not alone:
        from lambent.cli.app import run

        return run(args)
    try:
        from lambent.cli.process import run_process
    except KeyboardInterrupt:
        os._exit(130)
    return run_process(args)


def _flush() -> None:
    """Write out what is buffered, or drop it where nobody reads it (`lambent … | head`).

    Python would try again as it ends, and make exit code 120 of a failure.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def command() -> Any:
    """The root command as an object, from which the pages of the documentation are made."""
    from lambent.cli.app import group

    return group()
