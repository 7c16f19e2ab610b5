"""Many frames: reading, filtering and writing overlap, and finished frames are skipped.

One thread reads ahead, the caller's thread filters, one thread writes; a semaphore bounds how many
frames are alive, so memory does not grow with the length of the sequence. (OpenEXR and the filters
release the interpreter while they work, so threads suffice.)

A frame is finished when its output exists, is not older than its input, and, for EXR, carries a
stamp of the same settings. Outputs appear atomically, so one that exists is complete; that makes a
command that was interrupted, even killed, resume when it is given again.
"""

from __future__ import annotations

import os
import queue
import re
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lambent.denoise.collisions import Companions, check_collisions, identity
from lambent.denoise.files import (
    PREVIEW_SUFFIX,
    SUFFIX,
    Loaded,
    Processed,
    Result,
    default_output,
    guides_of,
    load,
    make_folder,
    number_of,
    process,
    save,
)
from lambent.denoise.pipeline import Settings, view_with_beauty
from lambent.errors import FileError, LambentError, OutputError
from lambent.frame.atomic import refuse_stdout
from lambent.frame.files import ENDINGS
from lambent.frame.opening import exists, refuse_special, unreadable
from lambent.frame.stamp import CHOSEN, stamp_in
from lambent.progress import Progress

if TYPE_CHECKING:
    from lambent.frame.sequence import Sequence as FrameSequence

#: Frames alive at once: one being read, one filtered, one written.
ALIVE = 3

#: A place for a frame number in a name: hashes, printf, Houdini's $F.
_PLACE = re.compile(r"#|%0?\d*d|\$F\d?")
_GLOB = re.compile(r"[*?]|\[.*\]")

#: Why a glob's match is left out.
_UNNUMBERED = "without a frame number"

_IMAGE_SUFFIXES = frozenset(ENDINGS)


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
class Selection:
    """The frames that the user's words mean.

    ``missing``: numbers of the range without a file. ``left_out``: files that the words cover and
    that are not cleaned all the same, each with the reason.
    """

    jobs: list[Job]
    missing: tuple[int, ...] = ()
    left_out: Mapping[Path, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SequenceResult:
    """What became of the frames of a sequence. ``left_out``: see `Selection`."""

    done: tuple[Result, ...]
    skipped: tuple[Job, ...]
    failed: tuple[tuple[Job, LambentError], ...]
    missing: tuple[int, ...] = ()
    left_out: Mapping[Path, str] = field(default_factory=dict)


def is_sequence(source: str | Path) -> bool:
    """Whether a name stands for many files: a pattern, a glob, or a directory."""
    text = str(source)
    if os.path.isdir(text):
        return True
    if os.path.exists(text):
        return False
    return bool(_PLACE.search(Path(text).name) or _GLOB.search(text))


def find_jobs(
    source: str | Path, frames: str | None = None, output: str | Path | None = None
) -> Selection:
    """The frames that a pattern and a range name.

    ``output``: a pattern with a place for the number, or a directory; None: beside the input,
    ``shot_clean.####.exr`` for a pattern and the folder ``NAME_clean`` for a folder. Results of
    earlier commands among the files are left out. Raises `FileError` and its kinds, `OptionError`.
    """
    folder = Path(source)
    if not folder.name:  # "." and "/" have no name to put "_clean" behind
        folder = folder.resolve()
        source = folder
    refuse_stdout(output)
    if os.path.isdir(folder) and frames is None:
        return _folder_jobs(folder, output)
    sequence, left_out = _sequence(source)
    sequence = sequence.within(frames)
    jobs = [
        Job(number, Path(path), _output_for(Path(path), number, source, output))
        for number, path in sorted(sequence.items())
    ]
    padding = "its number is padded otherwise" if _PLACE.search(folder.name) else _UNNUMBERED
    left_out = {path: padding for path in sequence.left_out if path not in left_out} | left_out
    return Selection(jobs, tuple(sequence.missing), left_out)


def listed_jobs(sources: Sequence[str | Path], output: str | Path | None = None) -> Selection:
    """Jobs for files that were named one by one; ``output`` is a directory or None (beside each).

    A result of another file of the list is left out (the shell's ``*.exr`` names it too). Raises
    `FileError` for one that does not exist.
    """
    refuse_stdout(output)
    jobs = []
    left_out = _earlier_results([Path(text) for text in sources])
    for text in sources:
        path = Path(text)
        refuse_special(path)
        if not exists(path):
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
        if path not in left_out:
            jobs.append(Job(number_of(path), path, target))
    return Selection(jobs, (), left_out)


def state_of(job: Job, settings: Settings) -> State:
    """Whether a frame is finished, and if not, why."""
    if not os.path.exists(job.output):
        return State.TODO
    guides = guides_of(job.source, settings, job.number)
    inputs = [job.source, *filter(os.path.isfile, guides)]
    older = job.output.stat().st_mtime < max(path.stat().st_mtime for path in inputs)
    if job.output.suffix.lower() != ".exr":
        return State.OUTDATED if older else State.FINISHED
    found = read_stamp(job.output)
    if found is None:
        return State.FOREIGN
    if older:
        return State.OUTDATED
    found.pop(CHOSEN, None)
    return State.FINISHED if found == settings.key() else State.OTHER_SETTINGS


def read_stamp(path: Path) -> dict[str, Any] | None:
    """The settings a file says it was made with; None for a file that is not ours."""
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            return stamp_in(file.header(0))
    except (RuntimeError, ValueError, OSError, IndexError):
        return None


def sort_out(
    jobs: Iterable[Job],
    settings: Settings,
    overwrite: bool,
    companions: Companions | None = None,
) -> tuple[list[Job], list[Job]]:
    """(jobs to do, jobs already finished).

    ``companions``: what will be written beside each result. A guide's file that lies among the
    frames is no job. Raises `OutputError` before any work where two files would have one name
    (`lambent.denoise.collisions`), or where files would be replaced that the user did not allow
    to: results of other settings, and files that are not ours.
    """
    jobs = list(jobs)
    guides = {
        identity(path): path for job in jobs for path in guides_of(job.source, settings, job.number)
    }
    jobs = [job for job in jobs if identity(job.source) not in guides]
    check_collisions([(job.source, job.output) for job in jobs], companions, guides.values())
    todo: list[Job] = []
    finished: list[Job] = []
    blocked: dict[State, list[Job]] = {}
    for job in jobs:
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
    found = find_jobs(source, frames, output)
    if not found.jobs:
        raise FileError("no frame was found", file=source, remedy="check the pattern and --frames")
    todo, finished = sort_out(found.jobs, settings, overwrite)
    make_folders(todo)
    done, failed = run_jobs(todo, settings, progress, on_done, finished=finished)
    return SequenceResult(
        tuple(done), tuple(finished), tuple(failed), found.missing, found.left_out
    )


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
    finished: Sequence[Job] = (),
) -> tuple[list[Result], list[tuple[Job, LambentError]]]:
    """Run the three threads over ``jobs``; existing outputs are replaced.

    Where the model is chosen by the file, the first frame of a shot chooses for all of it;
    ``finished`` are frames that were cleaned before and belong to the shots, too.
    Returns results and failures. On Ctrl-C the frame being written is finished, nothing else is.
    """
    line = _Line(jobs, settings, on_done)
    shots = _Shots([*finished, *jobs], settings)
    line.start()
    try:
        for index, (job, loaded) in enumerate(line.loaded()):
            if progress is not None:
                progress(index, len(jobs), job.source.name)
            try:
                line.write(job, process(loaded, shots.settings(job, loaded), keep=keep))
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


class _Shots:
    """The settings of each shot: files whose names differ by their number alone are one."""

    def __init__(self, jobs: Sequence[Job], settings: Settings) -> None:
        self._first: dict[object, Job] = {}
        for job in sorted(jobs, key=lambda job: job.number or 0):
            self._first.setdefault(_shot(job), job)
        self._settings = settings
        self._suited: dict[object, Settings] = {}

    def settings(self, job: Job, loaded: Loaded) -> Settings:
        """Those for a frame, by the first frame of its shot or, if that is damaged, by itself."""
        shot = _shot(job)
        if self._settings.model == "auto" and shot not in self._suited:
            first = self._first[shot]
            try:
                seen = loaded if first is job else load(first.source, self._settings, first.number)
                self._suited[shot] = self._by(seen)
            except LambentError:  # of the first frame; it is reported where that one is cleaned
                self._suited[shot] = self._by(loaded)
        return self._suited.get(shot, self._settings)

    def _by(self, loaded: Loaded) -> Settings:
        return self._settings.suited(loaded.views[view_with_beauty(loaded.views)])


def _shot(job: Job) -> tuple[Path, str, str]:
    """What the names of a shot's frames have in common; a name without a number is its own."""
    number = re.search(r"\d+(?=\D*$)", job.source.stem)
    begin, end = number.span() if number else (0, 0)
    return job.source.parent, job.source.stem[:begin], job.source.name[end:]


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


def _folder_jobs(folder: Path, output: str | Path | None) -> Selection:
    from lambent.frame.sequence import grouped

    target = Path(output) if output is not None else folder.with_name(folder.name + SUFFIX)
    _refuse_file_as_folder(target, "the input is a directory, so the output must be one too")
    try:
        entries = sorted(folder.iterdir())
        pictures = [p for p in entries if p.suffix.lower() in _IMAGE_SUFFIXES and not p.is_dir()]
        no_files = {p: "no file" for p in pictures if not p.is_file()}  # pipes, broken links
    except OSError as error:
        raise unreadable(folder, error) from error
    left_out = no_files
    # "._shot.exr" is what macOS keeps beside shot.exr: never a picture, and nothing to speak of.
    visible = [p for p in pictures if not p.name.startswith("._")]
    left_out |= {p: "hidden" for p in visible if p.name.startswith(".")}
    left_out |= _earlier_results([p for p in visible if p not in left_out])
    left_out |= {p: "no EXR" for p in visible if p not in left_out and p.suffix.lower() != ".exr"}
    files = [p for p in visible if p not in left_out]
    numbered = grouped(files)
    missing = numbered[0].missing if len(numbered) == 1 else ()
    return Selection([Job(number_of(p), p, target / p.name) for p in files], missing, left_out)


def _sequence(source: str | Path) -> tuple[FrameSequence, dict[Path, str]]:
    """The one sequence that is meant, and the earlier results that the words cover too."""
    from lambent.frame.sequence import Sequence as FrameSequence

    found = FrameSequence.find_all(source)
    if len(found) == 1:
        return found[0], {}
    results = _earlier_results([path for sequence in found for path in sequence.values()])
    others = [s for s in found if any(path not in results for path in s.values())]
    if len(others) != 1:
        FrameSequence.find(source)  # raises: it lists the sequences
    return others[0], results


def _earlier_results(paths: Sequence[Path]) -> dict[Path, str]:
    """Which of these files an earlier command made from others of them.

    The default name tells, and for an EXR the stamp too: ``room_clean.exr`` may be a clean plate.
    """
    made: set[Path] = set()
    for path in paths:
        outputs = {default_output(path), _numbered_output(path)}
        stems = [path.stem, *(output.stem for output in outputs)]
        made |= outputs | {path.with_name(f"{stem}{PREVIEW_SUFFIX}") for stem in stems}
    return {
        path: "made by an earlier command"
        for path in paths
        if path in made and (path.suffix.lower() != ".exr" or read_stamp(path) is not None)
    }


def _refuse_file_as_folder(target: Path, why: str) -> None:
    if target.suffix.lower() in _IMAGE_SUFFIXES or os.path.isfile(target):
        raise OutputError(why, file=target, remedy="give -o a directory")


def _numbered_output(path: Path) -> Path:
    """``shot.0001.exr`` to ``shot_clean.0001.exr``."""
    digits = re.search(r"([._-]?)(\d+)$", path.stem)
    if digits is None:
        return default_output(path)
    return path.with_name(f"{path.stem[: digits.start()]}{SUFFIX}{digits[0]}{path.suffix}")


def _output_for(
    path: Path, number: int | None, source: str | Path, output: str | Path | None
) -> Path:
    """The output of one frame of a pattern."""
    if output is None:
        return _numbered_output(path)
    target = Path(output)
    if not _PLACE.search(target.name):
        if target.suffix and not os.path.isdir(target):
            raise OutputError(
                "many frames cannot go into one file",
                file=target,
                remedy=f"leave a place for the number: {target.stem}.####{target.suffix}",
            )
        return target / path.name
    from lambent.frame.sequence import put_number

    assert number is not None
    return target.with_name(put_number(target.name, number))
