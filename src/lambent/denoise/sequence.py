"""Many frames: reading, filtering and writing overlap, and finished frames are skipped.

One thread reads ahead, the caller's thread filters, one thread writes; a semaphore bounds how many
frames are alive, so memory does not grow with the length of the sequence. (OpenEXR and the filters
release the interpreter while they work, so threads suffice.)

A frame is finished when its output exists, is not older than its input, and, for EXR, carries a
stamp of the same settings. Outputs appear atomically, so one that exists is complete; that makes a
command that was interrupted, even killed, resume when it is given again.
"""

from __future__ import annotations

import json
import queue
import re
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from lambent.denoise.files import (
    STAMP,
    SUFFIX,
    Loaded,
    Processed,
    Result,
    default_output,
    load,
    make_folder,
    number_of,
    process,
    roles_of,
    save,
)
from lambent.denoise.pipeline import Settings
from lambent.denoise.tiles import Progress
from lambent.errors import FileError, LambentError, OutputError

#: Frames alive at once: one being read, one filtered, one written.
ALIVE = 3

#: A place for a frame number in a name: hashes, printf, Houdini's $F.
_PLACE = re.compile(r"#|%0?\d*d|\$F\d?")
_GLOB = re.compile(r"[*?]|\[.*\]")

_IMAGE_SUFFIXES = frozenset({".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".hdr"})


class State(Enum):
    """What is to be done about a frame."""

    TODO = "to do"
    FINISHED = "finished"
    OUTDATED = "the input is newer than the result"
    OTHER_SETTINGS = "made with other settings"
    FOREIGN = "not written by lambent"


@dataclass(frozen=True)
class Job:
    """One frame: its number (None in a folder of unnumbered files), input and output."""

    number: int | None
    source: Path
    output: Path


@dataclass(frozen=True)
class SequenceResult:
    """What became of the frames of a sequence."""

    done: tuple[Result, ...]
    skipped: tuple[Job, ...]
    failed: tuple[tuple[Job, LambentError], ...]
    missing: tuple[int, ...] = ()


def is_sequence(source: str | Path) -> bool:
    """Whether a name stands for many files: a pattern, a glob, or a directory."""
    text = str(source)
    if Path(text).is_dir():
        return True
    if Path(text).exists():
        return False
    return bool(_PLACE.search(Path(text).name) or _GLOB.search(text))


def find_jobs(
    source: str | Path, frames: str | None = None, output: str | Path | None = None
) -> tuple[list[Job], tuple[int, ...]]:
    """The frames that a pattern and a range name, and the numbers that are missing.

    ``output``: a pattern with a place for the number, or a directory; None: beside the input,
    ``shot_clean.####.exr`` for a pattern and the folder ``NAME_clean`` for a folder.
    """
    from lambent.frame.sequence import Sequence as FrameSequence

    folder = Path(source)
    if not folder.name:  # "." and "/" have no name to put "_clean" behind
        folder = folder.resolve()
        source = folder
    if folder.is_dir() and frames is None:
        jobs = _folder_jobs(folder, output)
        numbered = FrameSequence.find_all(folder) if any(j.number for j in jobs) else []
        return jobs, numbered[0].missing if len(numbered) == 1 else ()
    sequence = FrameSequence.find(source, frames)
    jobs = [
        Job(number, Path(path), _output_for(Path(path), number, source, output))
        for number, path in sorted(sequence.items())
    ]
    return jobs, tuple(sequence.missing)


def listed_jobs(sources: Sequence[str | Path], output: str | Path | None = None) -> list[Job]:
    """Jobs for files that were named one by one; ``output`` is a directory or None (beside each).

    Raises `FileError` for one that does not exist.
    """
    jobs = []
    for text in sources:
        path = Path(text)
        if not path.is_file():
            raise FileError(
                "there is no such file",
                file=path,
                remedy="name files, or one pattern such as shot.####.exr in quotes",
            )
        if output is None:
            target = default_output(path)
        else:
            target = Path(output) / path.name
            _refuse_file_as_folder(Path(output), "many files cannot go into one file")
        jobs.append(Job(number_of(path), path, target))
    return jobs


def state_of(job: Job, settings: Settings) -> State:
    """Whether a frame is finished, and if not, why."""
    if not job.output.exists():
        return State.TODO
    inputs = [job.source, *(path for path in _guides(job, settings) if path.is_file())]
    older = job.output.stat().st_mtime < max(path.stat().st_mtime for path in inputs)
    if job.output.suffix.lower() != ".exr":
        return State.OUTDATED if older else State.FINISHED
    found = read_stamp(job.output)
    if found is None:
        return State.FOREIGN
    if older:
        return State.OUTDATED
    return State.FINISHED if found == settings.key() else State.OTHER_SETTINGS


def read_stamp(path: Path) -> dict[str, Any] | None:
    """The settings a file says it was made with; None for a file that is not ours."""
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            text = file.header(0).get(STAMP)
        found = json.loads(text) if text else None
    except (RuntimeError, ValueError, OSError, IndexError):
        return None
    return found if isinstance(found, dict) else None


def sort_out(
    jobs: Iterable[Job], settings: Settings, overwrite: bool
) -> tuple[list[Job], list[Job]]:
    """(jobs to do, jobs already finished).

    Raises `OutputError` before any work where files would be replaced that the user did not allow
    to: results of other settings, files that are not ours, and the frames' guides. A guide's file
    that lies among the frames is no job.
    """
    todo: list[Job] = []
    finished: list[Job] = []
    blocked: dict[State, list[Job]] = {}
    jobs = list(jobs)
    guides = {path.resolve() for job in jobs for path in _guides(job, settings)}
    for job in jobs:
        if job.source.resolve() in guides:
            continue  # a guide that lies among the frames
        if job.output.resolve() in guides:
            raise OutputError(
                "the output is the file of a guide",
                file=job.output,
                remedy="write elsewhere with -o NAME",
            )
        state = State.TODO if overwrite else state_of(job, settings)
        if state is State.FINISHED:
            finished.append(job)
        elif state in (State.FOREIGN, State.OTHER_SETTINGS):
            blocked.setdefault(state, []).append(job)
        else:
            todo.append(job)
    for state, held in blocked.items():
        count = "this file exists" if len(held) == 1 else f"this and {len(held) - 1} more exist"
        raise OutputError(
            f"{count} and would be replaced: {state.value}",
            file=held[0].output,
            remedy="write elsewhere with -o NAME, or allow it with --overwrite",
        )
    return todo, finished


def denoise_sequence(
    source: str | Path,
    output: str | Path | None = None,
    frames: str | None = None,
    *,
    settings: Settings | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    on_done: Callable[[Job, Processed, Result], None] | None = None,
    **options: Any,
) -> SequenceResult:
    """Denoise all frames of a pattern (``shot.####.exr``), glob or directory.

    A frame that fails does not stop the others; it is listed in the result. ``on_done`` is called
    in the writing thread after each frame. Raises `LambentError` where nothing can be begun.
    """
    settings = settings or Settings.checked(**options)
    jobs, missing = find_jobs(source, frames, output)
    if not jobs:
        raise FileError("no frame was found", file=source, remedy="check the pattern and --frames")
    todo, finished = sort_out(jobs, settings, overwrite)
    make_folders(todo)
    done, failed = run_jobs(todo, settings, progress, on_done)
    return SequenceResult(tuple(done), tuple(finished), tuple(failed), missing)


def make_folders(jobs: Sequence[Job]) -> None:
    """Make the output folder of a sequence where only its last part is missing."""
    for folder in dict.fromkeys(job.output.parent for job in jobs):
        make_folder(folder)


def run_jobs(
    jobs: Sequence[Job],
    settings: Settings,
    progress: Progress | None = None,
    on_done: Callable[[Job, Processed, Result], None] | None = None,
    keep: bool = False,
) -> tuple[list[Result], list[tuple[Job, LambentError]]]:
    """Run the three threads over ``jobs``; existing outputs are replaced.

    Returns results and failures. On Ctrl-C the frame being written is finished, nothing else is.
    """
    line = _Line(jobs, settings, on_done)
    line.start()
    try:
        for index, (job, loaded) in enumerate(line.loaded()):
            if progress is not None:
                progress(index, len(jobs), job.source.name)
            try:
                line.write(job, process(loaded, settings, keep=keep))
            except LambentError as error:
                line.fail(job, error)
            del loaded
        line.finish()
    except BaseException:
        line.stop()
        raise
    if progress is not None:
        progress(len(jobs), len(jobs), "done")
    return line.results, line.failures


# ------------------------------------------------------------------- private


class _Line:
    """The reading and the writing thread around the filter, and what they have to report."""

    def __init__(
        self,
        jobs: Sequence[Job],
        settings: Settings,
        on_done: Callable[[Job, Processed, Result], None] | None,
    ) -> None:
        self.results: list[Result] = []
        self.failures: list[tuple[Job, LambentError]] = []
        self._jobs, self._settings, self._on_done = jobs, settings, on_done
        # Simple queues: Ctrl-C may come in the middle of all others, with their lock held for ever.
        self._alive: queue.SimpleQueue[None] = queue.SimpleQueue()  # a place for a frame each
        for _ in range(ALIVE):
            self._alive.put(None)
        self._read: queue.SimpleQueue[tuple[Job, Loaded | BaseException] | None]
        self._read = queue.SimpleQueue()
        self._write: queue.SimpleQueue[tuple[Job, Processed] | None] = queue.SimpleQueue()
        self._stopped = threading.Event()
        self._crash: BaseException | None = None
        self._reader = threading.Thread(target=self._run_reader, name="reader", daemon=True)
        self._writer = threading.Thread(target=self._run_writer, name="writer", daemon=True)

    def start(self) -> None:
        self._reader.start()
        self._writer.start()

    def loaded(self) -> Iterable[tuple[Job, Loaded]]:
        """Frames as the reader delivers them; failures are noted and skipped."""
        while (item := self._read.get()) is not None:
            job, what = item
            if self._crash is not None:
                raise self._crash
            if isinstance(what, LambentError):
                self.fail(job, what)
            elif isinstance(what, BaseException):
                raise what
            else:
                del item
                yield job, what
                del what

    def write(self, job: Job, processed: Processed) -> None:
        self._write.put((job, processed))

    def fail(self, job: Job, error: LambentError) -> None:
        self.failures.append((job, error))
        self._alive.put(None)

    def finish(self) -> None:
        self._write.put(None)
        self._writer.join()
        if self._crash is not None:
            raise self._crash

    def stop(self) -> None:
        """Give up: let the frames that are being read and written be completed, and no more.

        Both threads have ended then: one in the midst of a library would crash a script that ends.
        """
        self._stopped.set()
        self._alive.put(None)
        self._write.put(None)
        self._writer.join()
        self._reader.join()

    def _run_reader(self) -> None:
        for job in self._jobs:
            self._alive.get()
            if self._stopped.is_set():
                break
            try:
                what: Loaded | BaseException = load(job.source, self._settings, job.number)
            except BaseException as error:  # handed to the filtering thread, which decides
                what = error
            self._read.put((job, what))
            del what
        self._read.put(None)

    def _run_writer(self) -> None:
        while (item := self._write.get()) is not None:
            job, processed = item
            try:
                if self._stopped.is_set():
                    continue
                result = save(processed, job.output, self._settings, overwrite=True)
                self.results.append(result)
                if self._on_done is not None:
                    self._on_done(job, processed, result)
            except LambentError as error:
                self.failures.append((job, error))
            except BaseException as error:  # re-raised in the filtering thread
                self._crash = error
            finally:
                self._alive.put(None)
                del item, processed


def _guides(job: Job, settings: Settings) -> list[Path]:
    """The files of a frame's guides."""
    from lambent.frame.guides import paths

    return paths(roles_of(job.source, settings, job.number))


def _folder_jobs(folder: Path, output: str | Path | None) -> list[Job]:
    target = Path(output) if output is not None else folder.with_name(folder.name + SUFFIX)
    _refuse_file_as_folder(target, "the input is a directory, so the output must be one too")
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".exr" and p.is_file())
    return [Job(number_of(path), path, target / path.name) for path in files]


def _refuse_file_as_folder(target: Path, why: str) -> None:
    if target.suffix.lower() in _IMAGE_SUFFIXES or target.is_file():
        raise OutputError(why, file=target, remedy="give -o a directory")


def _output_for(
    path: Path, number: int | None, source: str | Path, output: str | Path | None
) -> Path:
    """The output of one frame of a pattern."""
    if output is None:
        digits = re.search(r"([._-]?)(\d+)$", path.stem)
        if digits is None:
            return default_output(path)
        stem = f"{path.stem[: digits.start()]}{SUFFIX}{digits[0]}"
        return path.with_name(stem + path.suffix)
    target = Path(output)
    if not _PLACE.search(target.name):
        if target.suffix and not target.is_dir():
            raise OutputError(
                "many frames cannot go into one file",
                file=target,
                remedy=f"leave a place for the number: {target.stem}.####{target.suffix}",
            )
        return target / path.name
    from lambent.frame.sequence import put_number

    assert number is not None
    return target.with_name(put_number(target.name, number))
