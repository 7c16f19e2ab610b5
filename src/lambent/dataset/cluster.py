"""The work of a data set on a Ray cluster.

Workers are Ray actors, spread over the nodes. Each streams back the items of its job as they are
finished, bytes and all, so that nodes need no common disk; the driver writes. A worker that is lost
(its process killed, its node gone) costs the item it was at: the rest of its job goes to the next
worker that is free, and Ray starts another in its place.
"""

from __future__ import annotations

import importlib
import os
import queue
import socket
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from lambent.dataset.plan import Job
from lambent.dataset.produce import Failed, Made, attempt
from lambent.dataset.recipe import Recipe
from lambent.dataset.source import open_source
from lambent.dataset.workers import DEATHS
from lambent.errors import EngineError, stop_by_interrupt
from lambent.phases import Phases
from lambent.render import plugins

#: Processors that one worker takes where nothing is said.
PROCESSORS = 2


class Renderer:
    """What runs on the cluster: a source, kept from job to job."""

    def __init__(self, recipe: Recipe, device: str, folders: tuple[Path, ...] = ()) -> None:
        plugins.allow(folders)
        self.recipe, self.phases = recipe, Phases()
        self.source = open_source(recipe, device, self.phases)

    def work(self, job: Job) -> Iterator[Made | Failed | dict[str, float]]:
        """The items of a job, then the seconds they took by kind of work."""
        self.phases.seconds.clear()
        yield from attempt(self.recipe, self.source, job, self.phases, batch=1)
        yield dict(self.phases.seconds)


def on_cluster(
    recipe: Recipe, todo: Iterable[Job], device: str, count: int, address: str, phases: Phases
) -> Generator[Made | Failed, None, None]:
    """The items of all jobs as ``count`` workers (0: as many as fit) finish them.

    Raises `EngineError` where Ray is missing or there is no cluster at the address.
    """
    ray = _connected(address)
    crew = _Crew(ray, recipe, device, count, deque(todo))
    try:
        yield from crew.results(phases)
    finally:
        crew.end()
        if address == "local":
            ray.shutdown()


def _connected(address: str) -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster begun here reports to nobody
    try:
        ray = importlib.import_module("ray")
    except ImportError as error:
        stop_by_interrupt(error)
        raise EngineError(
            f"a cluster needs Ray, which cannot be imported ({error})",
            remedy="pip install 'lambent[cluster]'",
        ) from error
    if not ray.is_initialized():
        try:
            _knock(address)
            ray.init(
                address=None if address == "local" else address,
                log_to_driver=False,
                configure_logging=False,
            )
        except (Exception, SystemExit) as error:  # Ray ends the process where nobody answers
            if not isinstance(error, SystemExit):
                stop_by_interrupt(error)
            raise EngineError(
                f"there is no Ray cluster at '{address}': {error}",
                remedy="start one with 'ray start --head', or use --cluster local",
            ) from error
    return ray


def _knock(address: str) -> None:
    """Raise `OSError` soon where nobody listens: Ray itself tries for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=5).close()


class _Crew:
    """One thread for each actor, which waits for its items and puts them into one queue."""

    def __init__(
        self, ray: Any, recipe: Recipe, device: str, count: int, waiting: deque[Job]
    ) -> None:
        self.ray, self.recipe, self.device = ray, recipe, device
        self.waiting, self.lock = waiting, threading.Lock()
        self.deaths: dict[tuple[str, int], int] = {}
        self.stopped = threading.Event()
        self.found: queue.Queue[Any] = queue.Queue(maxsize=64)
        nodes = [n["Resources"].get("CPU", 0) for n in ray.nodes() if n["Alive"]]
        total = int(sum(nodes))
        self.count = min(count or max(1, total // PROCESSORS), max(1, len(waiting)))
        self.processors = min(PROCESSORS, max(1, total // self.count))
        if any(0 < n < self.processors for n in nodes):
            self.processors = 1
        self.actors: dict[int, Any] = {}
        self.threads = [
            threading.Thread(target=self._run, args=(n,), daemon=True) for n in range(self.count)
        ]

    def results(self, phases: Phases) -> Generator[Made | Failed, None, None]:
        """Everything that comes in until all jobs are done."""
        for thread in self.threads:
            thread.start()
        running = len(self.threads)
        while running:
            result = self.found.get()
            if result is None:
                running -= 1
            elif isinstance(result, dict):
                phases.add(result)
            else:
                yield result

    def end(self) -> None:
        """Stop what still runs."""
        self.stopped.set()
        for actor in list(self.actors.values()):
            with suppress(Exception):
                self.ray.kill(actor)

    def _actor(self, n: int) -> Any:
        if n not in self.actors:
            kind = self.ray.remote(num_cpus=self.processors, scheduling_strategy="SPREAD")(Renderer)
            self.actors[n] = kind.remote(self.recipe, self.device, plugins.allowed())
        return self.actors[n]

    def _run(self, n: int) -> None:
        """One actor's thread: job after job until there is none."""
        try:
            while not self.stopped.is_set():
                with self.lock:
                    job = self.waiting.popleft() if self.waiting else None
                if job is None:
                    return
                left = self._work(n, job)
                if left is not None:
                    with self.lock:
                        self.waiting.appendleft(left)
        finally:
            self._put(None)

    def _work(self, n: int, job: Job) -> Job | None:
        """Let an actor do a job; what is left of it if the actor was lost."""
        try:
            stream = self._actor(n).work.options(num_returns="streaming").remote(job)
            for reference in stream:
                result = self.ray.get(reference)
                if isinstance(result, Made):
                    job = replace(job, items=tuple(i for i in job.items if i != result.index))
                self._put(result)
        except Exception as error:  # Ray has many kinds; all mean that this worker is gone
            self.actors.pop(n, None)
            key = (job.what, job.number)
            self.deaths[key] = self.deaths.get(key, 0) + 1
            if not job.items or self.stopped.is_set():
                return None
            if self.deaths[key] < DEATHS:
                return job
            self._put(Failed(job, f"{DEATHS} workers were lost over it: {error}"))
        return None

    def _put(self, result: Any) -> None:
        while not self.stopped.is_set():
            with suppress(queue.Full):
                self.found.put(result, timeout=0.2)
                return
