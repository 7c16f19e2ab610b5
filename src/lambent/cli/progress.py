"""Progress with time left, for everything that takes longer than two seconds.

Library code gets a plain function ``progress(done, total, text)``. On a terminal a bar appears
after `PATIENCE` seconds (and only then is rich imported); elsewhere, in a log, a plain line is
printed now and then. All of it goes to stderr, so that stdout holds results alone.
"""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import Any

from lambent.cli.terminal import remark
from lambent.escapes import escaped

#: Seconds during which nothing is shown.
PATIENCE = 2.0

#: A log gets a line at most this often, in seconds.
LOG_EVERY = 15.0


class Progress:
    """A context manager whose `report` is the function to hand to library code.

    With ``quiet`` nothing is ever shown. ``what`` names the whole ("8 frames").
    """

    def __init__(self, what: str, quiet: bool = False) -> None:
        self.what = escaped(what)
        self._quiet = quiet
        self._start = time.monotonic()
        self._state: tuple[float, float, str] = (0.0, 1.0, "")
        self._begun = self._start
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="progress", daemon=True)

    def __enter__(self) -> Progress:
        if not self._quiet:
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def report(self, done: float, total: float, text: str = "") -> None:
        """``done`` of ``total`` are finished; now at ``text``. Cheap; call as often as you like."""
        if escaped(text) != self._state[2] and done == 0:
            self._begun = time.monotonic()
        self._state = (done, total, escaped(text))

    def seconds_left(self) -> float | None:
        """Seconds to go at the pace so far; None before there is a pace."""
        done, total, _ = self._state
        if done <= 0 or total <= 0:
            return None
        return (time.monotonic() - self._begun) * (total - done) / done

    # --------------------------------------------------------------- private

    def _watch(self) -> None:
        if self._over.wait(PATIENCE):
            return
        if sys.stderr.isatty():
            self._draw_bar()
        else:
            self._log_lines()

    def _draw_bar(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn
        from rich.progress import Progress as Bar

        def fields() -> dict[str, Any]:
            done, total, text = self._state
            share = f"{100 * done / total:3.0f} %" if done > 0 else "     "
            return {
                "completed": done if done > 0 else 0,
                "total": total if done > 0 else None,
                "note": text,
                "share": share,
                "left": self._time_text(),
            }

        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[share]}"),
            TextColumn("{task.fields[left]}"),
            TextColumn("{task.fields[note]}", style="dim", markup=False),
        )
        with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(self.what, **fields())
            while not self._over.wait(0.1):
                bar.update(task, **fields())

    def _log_lines(self) -> None:
        while True:
            done, total, text = self._state
            share = f"{100 * done / total:.0f} %" if done > 0 else ""
            words = ", ".join(filter(None, (text, share, self._time_text())))
            remark(f"{self.what}: {words}")
            if self._over.wait(LOG_EVERY):
                return

    def _time_text(self) -> str:
        left = self.seconds_left()
        if left is None:
            return f"{show_seconds(time.monotonic() - self._start)} so far"
        return f"{show_seconds(left)} left" if left >= 0.05 else ""


def show_seconds(seconds: float) -> str:
    """``"0.31 s"``, ``"12 s"``, ``"3 min 05 s"``, ``"2 h 10 min"``."""
    if seconds < 9.95:
        return f"{seconds:.1f} s" if seconds >= 1 else f"{seconds:.2f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
