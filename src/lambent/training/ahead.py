"""Batches made ahead, so that the network does not wait for them."""

from __future__ import annotations

import itertools
import queue
import threading
from collections.abc import Callable, Generator
from typing import TypeVar

T = TypeVar("T")

#: Batches that may wait for the network.
WAITING = 3


def ahead(make: Callable[[int], T], first: int) -> Generator[T, None, None]:
    """``make(step)`` for step ``first`` and on, in order, made in a thread of its own.

    What ``make`` raises is raised where the batch is asked for.
    """
    waiting: queue.Queue[T | BaseException] = queue.Queue(WAITING)
    over = threading.Event()

    def put(thing: T | BaseException) -> None:
        while not over.is_set():
            try:
                return waiting.put(thing, timeout=0.2)
            except queue.Full:
                continue

    def fill() -> None:
        try:
            for step in itertools.count(first):
                if over.is_set():
                    return
                put(make(step))
        except BaseException as error:  # raised again below
            put(error)

    thread = threading.Thread(target=fill, name="batches", daemon=True)
    thread.start()
    try:
        while True:
            batch = waiting.get()
            if isinstance(batch, BaseException):
                raise batch
            yield batch
    finally:
        over.set()
        thread.join()  # no batch is being made while PyTorch is taken down
