"""How far work is: the one signature with which everything that takes time reports it.

``progress(done, total, text)``: ``done`` of ``total``, in any unit, is finished; ``text`` names
what is being worked at. It is called as often as is convenient; what it raises ends the work. The
display is the command line's (`lambent.cli.progress`).
"""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, float, str], None]


def silent(done: float, total: float, text: str) -> None:
    """Progress that nobody watches."""


def part_of(progress: Progress, first: float, size: float, total: float) -> Progress:
    """Progress of a part of the work, as progress of the whole.

    The part is ``size`` of ``total`` and begins when ``first`` of it is done.
    """

    def report(done: float, of: float, text: str) -> None:
        progress(first + size * done / of, total, text)

    return report
