"""Making a data set: what is missing is made, by one process, several, or a cluster.

Workers only compute; every byte is written here, by one process (`lambent.dataset.folder`). The
same call again goes on where the last one stopped.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from lambent.dataset import workers
from lambent.dataset.check import missing_items, settle
from lambent.dataset.folder import add_item, begin, line_of, write_lines, writing
from lambent.dataset.plan import CLIP, STILL, jobs
from lambent.dataset.produce import Failed, Made
from lambent.dataset.recipe import Recipe
from lambent.dataset.source import Source, open_source
from lambent.errors import OptionError
from lambent.interrupts import stop_if_came, watched
from lambent.phases import Phases
from lambent.progress import Progress, silent
from lambent.startup import cache_folder


@dataclass
class Outcome:
    """What a call of `make` did.

    ``made``: new items, ``before``: items that were there, ``left``: items still to be made;
    ``failed``: what could not be made and why; ``notes``: what a person should know; ``phases``:
    seconds by kind of work, of all workers together.
    """

    folder: Path
    made: int = 0
    before: int = 0
    left: int = 0
    bytes: int = 0
    seconds: float = 0.0
    failed: list[Failed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    phases: dict[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """All of it, as JSON knows it."""
        return {
            "folder": str(self.folder),
            "made": self.made,
            "before": self.before,
            "left": self.left,
            "bytes": self.bytes,
            "seconds": round(self.seconds, 2),
            "failed": [f"{f.job.what} {list(f.job.items)}: {f.reason}" for f in self.failed],
            "notes": self.notes,
            "phases": {k: round(v, 2) for k, v in self.phases.items()},
        }


def default_folder(recipe: Recipe) -> Path:
    """``$LAMBENT_CACHE`` or ``~/.cache/lambent``, and in it ``datasets/NAME``."""
    return cache_folder() / "datasets" / recipe.name


def make(
    recipe: Recipe,
    folder: str | os.PathLike[str] | None = None,
    *,
    processes: int = 1,
    cluster: str | None = None,
    device: str = "auto",
    seconds: float | None = None,
    trust: bool = False,
    first: int = 0,
    first_clip: int = 0,
    progress: Progress = silent,
) -> Outcome:
    """Make the items of a set that are missing. Returns what was done.

    ``first``, ``first_clip``: the numbers from which on they are wanted; those below are made
    elsewhere, or by another call. An item is the same whoever makes it.

    ``cluster``: the address of a Ray cluster, ``"auto"`` or ``"local"``; then ``processes`` workers
    there (0: one for two processors). ``seconds``: stop after the item at hand when they are over.
    ``trust``: do not hash the files that are there. Raises `OptionError`, `FileError`,
    `EngineError`; Ctrl-C leaves a sound set behind.
    """
    place = Path(folder) if folder is not None else default_folder(recipe)
    if recipe.count + recipe.clip_count == 0:
        raise OptionError("the recipe asks for no items", remedy="give --count or --clips")
    if first < 0 or first_clip < 0:
        raise OptionError("items are numbered from 0", remedy="give --first 0 or more")
    if cluster is None and not 1 <= processes <= 256:
        raise OptionError(f"--processes {processes} makes no sense", remedy="take 1 or more")
    start = time.monotonic()
    outcome = Outcome(place)
    with watched(), writing(place):
        source = open_source(recipe, device, Phases())
        begin(place, recipe, _facts(recipe, source))
        lines, notes = settle(place, recipe, trust, progress)
        outcome.notes = [*getattr(source, "notes", ()), *notes]
        write_lines(place, lines)
        lowest = {STILL: first, CLIP: first_clip}
        missing = {
            what: {i for i in numbers if i >= lowest[what]}
            for what, numbers in missing_items(recipe, lines).items()
        }
        outcome.left = sum(map(len, missing.values()))
        wanted = max(0, recipe.count - first) + max(0, recipe.clip_count - first_clip)
        outcome.before = wanted - outcome.left
        if not outcome.left:
            return outcome
        phases = Phases()
        todo = jobs(recipe, missing)
        with closing(_work(recipe, todo, device, processes, cluster, phases)) as results:
            _collect(results, lines, outcome, start, seconds, progress)
        outcome.phases = phases.seconds
        write_lines(place, lines)
    outcome.seconds = time.monotonic() - start
    return outcome


# ------------------------------------------------------------------- private


def _work(
    recipe: Recipe, todo: Any, device: str, processes: int, cluster: str | None, phases: Phases
) -> Generator[Made | Failed, None, None]:
    if cluster is not None:
        from lambent.dataset.cluster import on_cluster

        return on_cluster(recipe, todo, device, processes, cluster, phases)
    if processes == 1:
        return workers.in_this_process(recipe, todo, device, phases)
    return workers.in_processes(recipe, todo, device, processes, phases)


def _collect(
    results: Iterator[Made | Failed],
    lines: dict[Any, Any],
    outcome: Outcome,
    start: float,
    seconds: float | None,
    progress: Progress,
) -> None:
    """Write what comes in until all is there or the time is over."""
    total = outcome.left
    begun = time.monotonic()
    progress(0, total, "the first scene")
    for result in results:
        stop_if_came()
        if isinstance(result, Failed):
            outcome.failed.append(result)
            continue
        line = line_of(result.about, result.sha256, len(result.content), result.seconds)
        add_item(outcome.folder, line, result.content)
        lines[result.what, result.index] = line
        outcome.made += 1
        outcome.left -= 1
        outcome.bytes += len(result.content)
        pace = outcome.made / (time.monotonic() - begun) * 3600
        progress(outcome.made, total, f"{result.what} {result.index}, {pace:,.0f} an hour")
        if seconds is not None and time.monotonic() - start >= seconds and outcome.left:
            break


def _facts(recipe: Recipe, source: Source) -> dict[str, Any]:
    """What the manifest says beside the recipe."""
    import numpy

    from lambent import __version__

    versions = {
        "lambent": __version__,
        "numpy": numpy.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **source.versions(),
    }
    return {
        "name": recipe.name,
        "essence": recipe.essence,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "licences": sorted({*source.licences, *recipe.licences}),
        "versions": versions,
    }
