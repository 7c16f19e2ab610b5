"""What a run tells while it goes on: its log, TensorBoard's files, version and hardware."""

from __future__ import annotations

import json
import platform
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch

from lambent import __version__
from lambent.frame.atomic import atomic
from lambent.training.run import Run

#: Steps from one line of the log to the next.
LOG_EVERY = 50


class Log:
    """The log file, and TensorBoard's where it is installed."""

    def __init__(self, run: Run, step: int) -> None:
        # what was logged after the state that is resumed will be logged again
        kept = [line for line in run.lines() if line["step"] <= step]
        with atomic(run.log, overwrite=True) as handle:
            handle.write("".join(json.dumps(line) + "\n" for line in kept).encode())
        self._file = run.log.open("a", encoding="utf-8")
        self._sums: dict[str, Any] = {}
        self._count = 0
        self._since = time.monotonic()
        self._board: Any = None
        with suppress(ImportError):
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(run.folder / "tensorboard"), purge_step=step)

    def add(
        self,
        step: int,
        loss: torch.Tensor,
        terms: Mapping[str, Any],
        norm: torch.Tensor,
        rate: float,
    ) -> None:
        """Take a step into the means; write them now and then."""
        for name, value in {"loss": loss, **terms}.items():
            # sums stay on the device: to read one is to wait for it
            self._sums[name] = self._sums.get(name, 0.0) + value.detach().double()
        self._count += 1
        if step % LOG_EVERY and step != 1:
            return
        now = time.monotonic()
        line = {name: round(float(total) / self._count, 6) for name, total in self._sums.items()}
        line |= {"rate": rate, "norm": round(float(norm), 4)}
        line["steps_a_second"] = round(self._count / max(now - self._since, 1e-9), 3)
        self._write({"step": step, **line}, "train")
        self._sums, self._count, self._since = {}, 0, now

    def check(self, step: int, scores: Mapping[str, float]) -> None:
        """Write a validation."""
        rounded = {name: round(value, 6) for name, value in scores.items()}
        self._write({"step": step, "check": rounded}, "check")
        self._since = time.monotonic()

    def close(self) -> None:
        """Close the files."""
        self._file.close()
        if self._board is not None:
            self._board.close()

    def _write(self, line: Mapping[str, Any], kind: str) -> None:
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
        if self._board is not None:
            for name, value in line.get("check", line).items():
                if isinstance(value, float):
                    self._board.add_scalar(f"{kind}/{name}", value, line["step"])


def commit() -> str | None:
    """The commit of Lambent's own source, "+" after it where files differ; None if installed."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True)
        changed = subprocess.run([*git, "status", "--porcelain", "."], capture_output=True)
    except OSError:  # no git on this machine
        return None
    tracked = subprocess.run([*git, "ls-files", "log.py"], capture_output=True).stdout
    if head.returncode or not tracked:
        return None
    return head.stdout.strip() + ("+" if changed.stdout else "")


def note(run: Run, seconds: float) -> None:
    """Write ``run.json``."""
    about = {
        "lambent": __version__,
        "commit": commit(),
        "torch": torch.__version__,
        "machine": platform.machine(),
        "processor": _processor(),
        "threads": torch.get_num_threads(),
        "cuda": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "seconds": round(seconds, 1),
    }
    with atomic(run.folder / "run.json", overwrite=True) as handle:
        handle.write(json.dumps(about, indent=1).encode())


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()
