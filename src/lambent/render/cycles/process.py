"""The process that Blender runs in: started, given orders, ended.

Orders and answers are JSON lines (`inside.server`). What Blender prints goes to a log in the
scratch folder, and its last lines are shown when something fails. Whatever ends an order early
(Ctrl-C, an error) ends the process too: Blender cannot be trusted half way through a render. The
scratch folder goes with it, so that nothing is left behind.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from lambent.errors import EngineError
from lambent.progress import Progress
from lambent.render.cycles.find import Blender, find_blender

SERVER = Path(__file__).parent / "inside" / "server.py"


class Refusal(Exception):  # noqa: N818  (callers turn it into an error that names the file)
    """Blender's side said no. ``kind`` says which case it is; ``facts`` what it told besides."""

    def __init__(self, kind: str, message: str, facts: dict[str, Any]) -> None:
        super().__init__(message)
        self.kind, self.message, self.facts = kind, message, facts


class BlenderProcess:
    """A Blender in the background; started by the first order, and again after it died.

    A context manager: leaving it ends Blender and removes the scratch folder.
    """

    def __init__(self, blender: Blender | None = None, threads: int | None = None) -> None:
        self._blender = blender
        self._threads = threads
        self._process: subprocess.Popen[str] | None = None
        self._scratch: str | None = None
        self.version = ""

    def __enter__(self) -> BlenderProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def scratch(self) -> Path:
        """A folder for the pictures; gone when Blender ends. Starts Blender if need be."""
        self.start()
        assert self._scratch is not None
        return Path(self._scratch)

    @property
    def pid(self) -> int | None:
        """The number of Blender's process, or None while there is none."""
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start Blender unless it runs. Raises `EngineError`."""
        if self._process is not None and self._process.poll() is None:
            return
        self.close()
        blender = self._blender or find_blender()
        self._scratch = tempfile.mkdtemp(prefix="lambent-cycles-")
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}
        if self._threads:
            environment["OMP_NUM_THREADS"] = str(self._threads)
        try:
            with open(self._log, "wb") as log:
                self._process = subprocess.Popen(
                    blender.command(SERVER, self._scratch),
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    text=True,
                    encoding="utf-8",
                    errors="replace",
                    env=environment,
                    start_new_session=True,  # Ctrl-C reaches Lambent alone, which ends Blender
                )
        except OSError as error:
            self.close()
            raise EngineError(f"'{blender.program}' cannot be started: {error}") from error
        try:
            facts = self._answer(None)
        except Refusal as refusal:
            self.close()
            raise EngineError(f"Blender cannot be loaded: {refusal.message}") from refusal
        except BaseException:
            self.close()
            raise
        self.version = facts["text"]

    def order(self, what: dict[str, Any], progress: Progress | None = None) -> dict[str, Any]:
        """Send an order and wait until it is done; the facts of the answer.

        Raises `Refusal`, and `EngineError` where Blender died, with the end of its log.
        """
        self.start()
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(what) + "\n")
            self._process.stdin.flush()
            return self._answer(progress)
        except Refusal as refusal:
            if refusal.kind == "crash":
                text, log = refusal.message, self.log_end()
                self.close()
                raise EngineError(f"Blender failed: {text}", details=log) from refusal
            raise
        except BrokenPipeError:
            raise self._died() from None
        except BaseException:
            self.close()
            raise

    def log_end(self, lines: int = 12) -> list[str]:
        """The last lines that Blender printed."""
        with suppress(OSError):
            text = Path(self._log).read_text("utf-8", "replace")
            return text.splitlines()[-lines:]
        return []

    def close(self) -> None:
        """End Blender and remove the scratch folder."""
        process, self._process = self._process, None
        if process is not None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    if pipe is not None:
                        pipe.close()
        if self._scratch is not None:
            shutil.rmtree(self._scratch, ignore_errors=True)
            self._scratch = None

    # --------------------------------------------------------------- private

    @property
    def _log(self) -> str:
        return str(Path(self._scratch or "") / "blender.log")

    def _answer(self, progress: Progress | None) -> dict[str, Any]:
        assert self._process is not None
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if not line.startswith('{"lambent"'):
                continue  # a banner, or an add-on that prints
            facts: dict[str, Any] = json.loads(line)
            kind = facts.pop("lambent")
            if kind == "error":
                raise Refusal(facts.pop("kind"), facts.pop("message"), facts)
            if kind in ("done", "ready"):
                return facts
            if kind == "progress" and progress is not None:
                progress(facts["done"], facts["total"], facts["text"])
        raise self._died()

    def _died(self) -> EngineError:
        code = None if self._process is None else self._process.wait()
        log = self.log_end()
        self.close()
        text = f"killed by signal {-code}" if code is not None and code < 0 else f"exit code {code}"
        hint = "was it out of memory? Try a smaller --size" if code == -9 else None
        return EngineError(f"Blender ended before it was done ({text})", details=log, remedy=hint)
