"""Training on a data set that is still being made.

`lambent dataset make` adds crops while `lambent train` runs: a recipe with ``follow = true`` in its
``[options]`` takes them in as they come. Unpacking them would hold up the training process, so
processes of their own do it; they end with the process that started them, however that ended.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from lambent.errors import LambentError

#: Seconds from one look at the data set to the next.
PAUSE = 3.0


class Follower:
    """Keeps the cache below ``place`` up with the data sets in ``folders``."""

    def __init__(self, folders: Sequence[str], place: Path, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._processes = [
            context.Process(
                target=_unpacking, args=(Path(folder), place, os.getpid(), workers), daemon=True
            )
            for folder in folders
        ]
        for process in self._processes:
            process.start()

    def close(self) -> None:
        """Stop unpacking. What is half unpacked is unpacked again next time."""
        for process in self._processes:
            process.terminate()
            process.join()


def _unpacking(folder: Path, place: Path, parent: int, workers: int) -> None:
    """What the process of one data set does."""
    import signal

    from lambent.dataset.folder import writing
    from lambent.learn.cache import cached

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while os.getppid() == parent:
        # several runs may follow one set: one of them unpacks, the others find its lock; and there
        # may be no manifest yet, or an item that is just being replaced
        with suppress(LambentError), writing(place / f"{folder.name}.lock"):
            cached(folder, place, workers=workers)
        time.sleep(PAUSE)
