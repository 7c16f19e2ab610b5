"""The work of a data set on this machine, in this process or in several.

A worker gets a job, sends back each item when it is finished, and asks for the next. One that dies
(memory, a crash of the renderer) costs the items it was at: the rest of its job goes to another.
Workers ignore Ctrl-C and end when the process that started them has ended, however it did.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Generator, Iterable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from lambent.dataset.plan import Job
from lambent.dataset.produce import Failed, Made, attempt
from lambent.dataset.recipe import Recipe
from lambent.dataset.source import open_source
from lambent.phases import Phases
from lambent.render import plugins

#: A job is given up when so many workers have died of it.
DEATHS = 3


def in_this_process(
    recipe: Recipe, todo: Iterable[Job], device: str, phases: Phases
) -> Generator[Made | Failed, None, None]:
    """The items of all jobs, one after the other."""
    source = open_source(recipe, device, phases)
    for job in todo:
        yield from attempt(recipe, source, job, phases)


def in_processes(
    recipe: Recipe, todo: Iterable[Job], device: str, count: int, phases: Phases
) -> Generator[Made | Failed, None, None]:
    """The items of all jobs as they are finished by ``count`` processes."""
    waiting = deque(todo)
    deaths: dict[tuple[str, int], int] = {}
    crew = [_Worker(recipe, device, count) for _ in range(min(count, len(waiting)))]
    try:
        while waiting or any(worker.job for worker in crew):
            for worker in crew:
                if worker.job is None and waiting:
                    worker.begin(waiting.popleft())
            ready = wait([worker.pipe for worker in crew if worker.job])
            for worker in [w for w in crew if w.pipe in ready]:
                message = worker.receive()
                if isinstance(message, (Made, Failed)):
                    yield message
                elif isinstance(message, dict):
                    phases.add(message)
                else:  # it died; another takes what is left of its job
                    lost, code = worker.job, worker.end()
                    crew[crew.index(worker)] = _Worker(recipe, device, count)
                    if lost is None or not lost.items:
                        continue
                    key = (lost.what, lost.number)
                    deaths[key] = deaths.get(key, 0) + 1
                    if deaths[key] < DEATHS:
                        waiting.appendleft(lost)
                    else:
                        yield Failed(lost, f"{DEATHS} processes died of it (exit code {code})")
    finally:
        for worker in crew:
            worker.end()


class _Worker:
    """A process, the pipe to it, and the job it is at."""

    def __init__(self, recipe: Recipe, device: str, count: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.job: Job | None = None
        self.process = context.Process(
            target=_main, args=(theirs, recipe, device, count, plugins.allowed()), daemon=True
        )
        self.process.start()
        theirs.close()

    def begin(self, job: Job) -> None:
        """Give it a job. A dead worker shows at the next `receive`."""
        self.job = job
        with suppress(OSError):
            self.pipe.send(job)

    def receive(self) -> Any:
        """An item, a failure, the seconds of a finished job; None if it has died."""
        assert self.job is not None
        try:
            message = self.pipe.recv()
        except (EOFError, OSError):
            return None
        if isinstance(message, Made):
            self.job = replace(
                self.job, items=tuple(n for n in self.job.items if n != message.index)
            )
        elif isinstance(message, dict):
            self.job = None
        return message

    def end(self) -> int | None:
        """Stop the process; its exit code."""
        self.pipe.close()
        self.process.join(0.2)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        return self.process.exitcode


def _main(
    pipe: Connection, recipe: Recipe, device: str, count: int, folders: tuple[Path, ...]
) -> None:
    """What a worker does until nobody listens any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.environ["LAMBENT_THREADS"] = str(max(1, (os.cpu_count() or 1) // count))
    plugins.allow(folders)
    phases = Phases()
    source = open_source(recipe, device, phases)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            job = pipe.recv()
            for result in attempt(recipe, source, job, phases):
                pipe.send(result)
            pipe.send(dict(phases.seconds))
            phases.seconds.clear()
