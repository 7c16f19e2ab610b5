"""The attack: damaged, crafted and interrupted work, counted. Zeros where zeros belong.

Each row of the table is a kind of attack, with so many tries at ``--scale 1``:

- exr (10,000): bytes flipped, cut, slipped; numbers in headers, tile sizes, offset tables and
  chunks that are huge or negative. Read, written with one channel replaced, read again.
- roundtrips (1,000): sound EXRs, every compression, storage, level mode and line order; one layer
  is denoised or replaced, and all others must keep every bit.
- pictures (4,000): PNG, JPEG, TIFF, Radiance HDR and PFM, damaged; PNGs with checksums that fit.
- models, solutions (100 each): archives whose checksums fit and whose values do not.
- kills (100): SIGINT, SIGTERM or SIGKILL at a random moment of a command. Nothing under the name of
  the output may be half-written, and nothing hidden be left by those that can tidy up; a data set
  that was interrupted must, resumed, be the one that is made without a break.
- exits (1,000): exit codes of commands beside other work on all processors.

Columns: a *clean error* is one of Lambent's own (of a command: the exit code and message that
belong there); *accepted* was done; *lost bytes* differ where they had to stay, or are in
half-written files; a *crash* is the end of a process, any other exception, a wrong exit code; a
*hang* is a try beyond ``--limit`` seconds. Each try depends on the seed, its kind and its number
alone (only kills on the clock, too), and what fails is printed with the line that repeats it. Tries
on files run in processes with a limit of memory (``--memory``), each of which tries many. Ctrl-C
ends a kind: its row counts the tries that were made.

Usage: python benchmarks/attack.py [--seed 1] [--scale 0.01] [--only exr,kills] [--jobs 2]
    [--number 17] [--keep DIR]; ends with 1 where a crash, a hang or a lost byte was counted.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib.util
import json
import os
import queue
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
LAMBENT = [sys.executable, "-m", "lambent"]
FULL = {
    "exr": 10_000,
    "roundtrips": 1_000,
    "pictures": 4_000,
    "models": 100,
    "solutions": 100,
    "kills": 100,
    "exits": 1_000,
}
#: Kinds that run in `attack_tries.py`; the others start commands.
FILES = ("exr", "roundtrips", "pictures", "models", "solutions")

SCENE = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective"><float name="fov" value="60"/>
  <transform name="to_world"><lookat origin="0,0,0.9" target="0,0,-1" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="24"/>
  <rfilter type="box"/></film></sensor>
<shape type="cube"><boolean name="flip_normals" value="true"/>
  <bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.4,0.6"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.4"/>
  <rotate x="1" angle="90"/><translate y="0.9"/></transform>
  <bsdf type="diffuse"/><emitter type="area"><rgb name="radiance" value="8"/></emitter></shape>
</scene>"""

RECIPE = """
name = "attack"
seed = 5
source = "procedural"
count = 2
clip_count = 0
items_per_scene = 1
cameras_per_scene = 1
view = [64, 48]
crop = 32
levels = 1
spp = [1, 2]
mean_spp = 1
target_spp = 4
target_most = 4
clips_per_scene = 1
clip_frames = 2
clip_target_spp = 4
depth = 3
"""


@dataclass
class Tally:
    """One row of the table, and the failures behind it."""

    tries: int = 0
    clean: int = 0
    accepted: int = 0
    lost: int = 0
    crashes: int = 0
    hangs: int = 0
    peak: int = 0
    failures: list[str] = field(default_factory=list)

    def add(self, number: int, end: str, lost: int, peak: int, words: str) -> bool:
        """Count a try; whether it failed."""
        self.tries += 1
        self.clean += end == "clean"
        self.accepted += end == "accepted"
        self.crashes += end in ("bug", "crash")
        self.hangs += end == "hang"
        self.lost += lost
        self.peak = max(self.peak, peak)
        failed = bool(lost) or end in ("bug", "crash", "hang")
        if failed:
            what = f"{lost} bytes lost" if lost else end
            self.failures.append(f"{what}, number {number}: {words.strip()[-1500:]}")
        if failed or self.tries % 100 == 0:
            print(f"{self.tries} tries, {len(self.failures)} failed", end="\r", file=sys.stderr)
        return failed


@dataclass(frozen=True)
class Options:
    seed: int
    limit: float
    memory: int
    jobs: int
    keep: Path | None
    folder: Path


def in_turns(jobs: int, numbers: list[int], work: Callable[[int, Iterator[int]], None]) -> None:
    """``work(index, numbers)`` in so many threads, which take numbers off one queue."""
    todo: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number in numbers:
        todo.put(number)

    def each() -> Iterator[int]:
        with contextlib.suppress(queue.Empty):
            while True:
                yield todo.get_nowait()

    errors: list[BaseException] = []

    def run(index: int) -> None:
        try:
            work(index, each())
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(n,)) for n in range(min(jobs, len(numbers)))]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    except KeyboardInterrupt:  # what was counted is a row all the same
        with contextlib.suppress(queue.Empty):
            while True:
                todo.get_nowait()
        for thread in threads:
            thread.join()
    if errors:
        raise errors[0]


# ------------------------------------------------------------------- files


class Worker:
    """A process of `attack_tries.py`, begun again after it has died."""

    def __init__(self, kind: str, options: Options, folder: Path) -> None:
        self.kind, self.options, self.folder = kind, options, folder
        self.process: subprocess.Popen[bytes] | None = None

    def ask(self, number: int) -> tuple[str, int, int, str]:
        """End, lost bytes, peak of memory and words of a try."""
        if self.process is None:
            self._start()
        process = self.process
        assert process is not None
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(f"{number}\n".encode())
            process.stdin.flush()
        line = self._line(self.options.limit)
        if line is None:
            self.close(kill=True)
            return "hang", 0, 0, f"no answer after {self.options.limit:g} s"
        if not line:
            code = process.wait()
            said = (self.folder / "stderr").read_text(errors="replace")[-600:]
            self.close(kill=True)
            return "crash", 0, 0, f"the process ended with {code}\n{said}"
        found = json.loads(line)
        return found["end"], found["lost"], found["peak"], found["words"]

    def close(self, kill: bool = False) -> None:
        if self.process is not None:
            assert self.process.stdin is not None
            assert self.process.stdout is not None
            if kill:
                self.process.kill()
            with contextlib.suppress(BrokenPipeError):
                self.process.stdin.close()
            self.process.wait()
            self.process.stdout.close()
            self.process = None

    def _start(self) -> None:
        command = [sys.executable, str(HERE / "attack_tries.py"), self.kind]
        command += [str(self.options.seed), str(self.folder), str(self.options.memory)]
        with open(self.folder / "stderr", "wb") as stderr:
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, bufsize=0
            )
        if self._line(120) != b"ready\n":
            raise SystemExit((self.folder / "stderr").read_text(errors="replace"))

    def _line(self, seconds: float) -> bytes | None:
        """The next line of the process; empty at its end, None where none came in time."""
        assert self.process is not None
        assert self.process.stdout is not None
        deadline, line = time.monotonic() + seconds, b""
        while not line.endswith(b"\n"):
            wait = deadline - time.monotonic()
            if wait <= 0 or not select.select([self.process.stdout], [], [], wait)[0]:
                return None
            piece = os.read(self.process.stdout.fileno(), 1 << 16)
            if not piece:
                return b""
            line += piece
        return line


def attack_files(kind: str, numbers: list[int], options: Options) -> Tally:
    tally, lock = Tally(), threading.Lock()

    def work(index: int, mine: Iterator[int]) -> None:
        folder = options.folder / f"{kind}{index}"
        folder.mkdir()
        worker = Worker(kind, options, folder)
        for number in mine:
            found = worker.ask(number)
            with lock:
                end, lost, peak, words = found
                failed = tally.add(number, end, lost, peak, words)
            if failed and options.keep is not None:
                options.keep.mkdir(parents=True, exist_ok=True)
                for path in folder.glob("mutant*"):
                    shutil.copy(path, options.keep / f"{kind}_{number}{path.suffix}")
        worker.close()

    in_turns(options.jobs, numbers, work)
    return tally


# ------------------------------------------------------------------- commands


@dataclass(frozen=True)
class Ended:
    """How a command ended. ``code`` is None where it hung."""

    code: int | None
    stderr: str
    peak: int
    seconds: float


def heed_ctrl_c() -> None:
    """For a child: a shell's background jobs ignore SIGINT, and children inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def run(args: list[str], folder: Path, limit: float, number: int = 0, delay: float = 0.0) -> Ended:
    """A command of Lambent; with a signal after ``delay`` seconds, unless it ended before."""
    with tempfile.TemporaryFile() as stderr:
        begin = time.monotonic()
        process = subprocess.Popen(
            [*LAMBENT, *args],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            preexec_fn=heed_ctrl_c,
        )
        code, sent = None, not number
        while (seconds := time.monotonic() - begin) < limit:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                code = process.returncode = os.waitstatus_to_exitcode(status)
                break
            if not sent and seconds >= delay and _listens(process.pid):
                os.kill(process.pid, number)
                sent = True
            time.sleep(0.005)
        else:
            process.kill()
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        stderr.seek(0)
        text = stderr.read().decode(errors="replace")
    return Ended(code, text, usage.ru_maxrss * 1024, seconds)


def _listens(pid: int) -> bool:
    """Whether a process has a handler for SIGTERM: before, Python itself is not up yet."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            name, _, value = line.partition(":")
            if name == "SigCgt":
                return bool(int(value, 16) >> (signal.SIGTERM - 1) & 1)
    return False


def fill(folder: Path) -> Path:
    """A folder with a frame, a damaged one, a sequence, a picture, a scene and a recipe."""
    import OpenEXR

    import attack_files as files

    folder.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for n, name in enumerate(["frame", "shot.0001", "shot.0002", "shot.0003"]):
        pixels = files.planes(np.random.default_rng(n), 48, 64)
        OpenEXR.File(header, pixels).write(str(folder / f"{name}.exr"))
    content = (folder / "frame.exr").read_bytes()
    (folder / "cut.exr").write_bytes(content[: len(content) // 2])
    (folder / "photo.png").write_bytes(files.sound_pictures()["rgb.png"])
    (folder / "room.xml").write_text(SCENE)
    (folder / "recipe.toml").write_text(RECIPE)
    return folder


def has_mitsuba() -> bool:
    return importlib.util.find_spec("mitsuba") is not None


#: Arguments of commands that write, and the names under which they do.
WRITERS = {
    "denoise": (["denoise", "frame.exr", "-o", "out.exr"], "out*"),
    "sequence": (["denoise", "shot.####.exr", "-o", "new"], "new"),
    "box": (["denoise", "frame.exr", "-o", "out.exr", "--model", "box", "--report"], "out*"),
    "photo": (["denoise", "photo.png", "-o", "out.png", "--model", "dncnn"], "out*"),
    "compare": (["compare", "frame.exr", "shot.0001.exr", "--report", "out.html"], "out*"),
    "render": (
        ["render", "room.xml", "-o", "out.exr", "--spp", "64", "--checkpoint", "0.1"], "out*"
    ),
    "solve": (["solve", "room.xml", "-o", "out.lambent", "--patches", "60"], "out*"),
    "dataset": (["dataset", "make", "recipe.toml", "-o", "set"], "set"),
}  # fmt: skip
WITH_MITSUBA = ("render", "solve", "dataset")


def broken(path: Path) -> int:
    """How many bytes of a half-written file there are: 0 if it is whole."""
    size = max(1, path.stat().st_size)
    try:
        if path.suffix == ".exr":
            from lambent.frame.exr import decode

            for part in decode(path).parts:
                for channel in part.channels.values():
                    _ = channel.data
        elif path.suffix == ".png":
            from PIL import Image

            with Image.open(path) as image:
                image.load()
        elif path.suffix == ".lambent":
            with zipfile.ZipFile(path) as archive:
                return size if archive.testzip() else 0
        elif path.suffix == ".html":
            return 0 if path.read_text().rstrip().endswith("</html>") else size
        elif path.suffix == ".json":
            json.loads(path.read_text())
    except Exception:  # whoever reads it gets an error, whichever it is
        return size
    return 0


def digests(folder: Path) -> dict[str, str]:
    """The crops of a data set, by name."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*.exr"))
    }


def attack_kills(numbers: list[int], options: Options) -> Tally:
    tally, lock = Tally(), threading.Lock()
    names = [n for n in WRITERS if n not in WITH_MITSUBA or has_mitsuba()]
    template = fill(options.folder / "kills")
    used = [names[number % len(names)] for number in numbers]
    lengths: dict[str, float] = {}
    whole: dict[str, str] = {}
    for name in sorted(set(used)):
        folder = options.folder / f"unbroken_{name}"
        shutil.copytree(template, folder)
        done = run(WRITERS[name][0], folder, 10 * options.limit)
        if done.code != 0:
            raise SystemExit(f"{name} ended with {done.code}\n{done.stderr}")
        lengths[name] = done.seconds
        if name == "dataset":
            whole = digests(folder / "set")

    def once(number: int, name: str, folder: Path) -> tuple[str, int, int, str]:
        rng = np.random.default_rng([options.seed, 100, number])
        kind = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)[rng.integers(3)]
        delay = float(rng.uniform(0, lengths[name]))
        before = {p.name for p in folder.iterdir()}
        args, output = WRITERS[name]
        done = run(args, folder, 10 * options.limit, kind, delay)
        case = f"{name}, {kind.name} after {delay:.3f} s: {done.code}\n{done.stderr[-1000:]}"
        if done.code is None:
            return "hang", 0, done.peak, case
        lost = sum(
            broken(p) for o in folder.glob(output) for p in (o, *o.rglob("*")) if p.is_file()
        )
        for path in folder.rglob("*"):
            new = path.relative_to(folder).parts[0] not in before
            hidden = path.name.startswith(".") and path.name != ".lock"  # a data set keeps its lock
            if new and hidden and path.is_file() and kind != signal.SIGKILL:
                lost += max(1, path.stat().st_size)
                case += f"\nleft: {path.name}"
        right = (0, -kind if kind == signal.SIGKILL else 130)
        if done.code not in right or "Traceback" in done.stderr:
            return "crash", lost, done.peak, case
        if name == "dataset":
            again = run(args, folder, 10 * options.limit)
            if again.code != 0:
                return "crash", lost, done.peak, f"{case}\nresumed: {again.code} {again.stderr}"
            found = digests(folder / "set")
            changed = [n for n in whole | found if found.get(n) != whole.get(n)]
            lost += len(changed)
            case += f"\nresumed, it is another set: {changed}" if changed else ""
        return "accepted" if done.code == 0 else "clean", lost, done.peak, case

    def work(index: int, mine: Iterator[int]) -> None:
        for number in mine:
            folder = options.folder / f"kill{number}"
            shutil.copytree(template, folder)
            found = once(number, names[number % len(names)], folder)
            with lock:
                tally.add(number, *found)
            shutil.rmtree(folder)

    in_turns(options.jobs, numbers, work)
    return tally


#: Arguments and exit codes; ``{n}`` is the number of the try.
EXITS = {
    "option": (["denoise", "frame.exr", "--passes", "foo"], 4),
    "word": (["denoise", "frame.exr", "--strength", "strong"], 4),
    "missing": (["denoise", "absent.exr"], 2),
    "damaged": (["denoise", "cut.exr"], 2),
    "strength 0": (["denoise", "frame.exr", "-o", "out{n}.exr", "--strength", "0"], 0),
    "finished": (["denoise", "shot.####.exr", "-o", "done"], 0),
    "done": (["denoise", "frame.exr", "-o", "out{n}.exr"], 0),
    "exists": (["denoise", "frame.exr", "-o", "photo.png"], 2),
    "inspect": (["inspect", "frame.exr"], 0),
    "no layer": (["denoise", "frame.exr", "--map", "colour=absent"], 3),
    "no command": (["denoize"], 4),
    "no scene": (["render", "absent.xml", "-o", "r{n}.exr"], 2),
}


def attack_exits(numbers: list[int], options: Options) -> Tally:
    """Exit codes, beside as many other programs as there are processors."""
    tally, lock = Tally(), threading.Lock()
    folder = fill(options.folder / "exits")
    first = run(["denoise", "shot.####.exr", "-o", "done"], folder, 10 * options.limit)
    if first.code != 0:
        raise SystemExit(first.stderr)

    def work(index: int, mine: Iterator[int]) -> None:
        for number in mine:
            name = list(EXITS)[number % len(EXITS)]
            args, code = EXITS[name]
            args = [a.format(n=number) for a in args]
            done = run(args, folder, 10 * options.limit)
            end = "clean" if code else "accepted"
            if done.code != code or "Traceback" in done.stderr:
                end = "hang" if done.code is None else "crash"
            with lock:
                words = f"{' '.join(args)}: {done.code}, not {code}\n{done.stderr[-1000:]}"
                tally.add(number, end, 0, done.peak, words)

    code = f"import os\nwhile os.getppid() == {os.getpid()}: sum(range(100000))"
    busy = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(os.cpu_count() or 1)]
    try:
        in_turns(options.jobs, numbers, work)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    return tally


# ------------------------------------------------------------------- table


def attack(kind: str, numbers: list[int], options: Options) -> Tally:
    if kind == "kills":
        return attack_kills(numbers, options)
    if kind == "exits":
        return attack_exits(numbers, options)
    if kind == "solutions":
        (options.folder / "room.xml").write_text(SCENE)
        solve = ["solve", "room.xml", "-o", "room.lambent", "--patches", "60"]
        done = run(solve, options.folder, 10 * options.limit)
        if done.code != 0:
            raise SystemExit(done.stderr)
    return attack_files(kind, numbers, options)


def row(cells: list[str]) -> str:
    widths = (11, 7, 12, 9, 11, 8, 6, 12)
    first, *others = (f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))
    return " | ".join([f"| {first.strip():{widths[0]}}", *others]) + " |"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the full numbers")
    parser.add_argument("--only", default=",".join(FULL), help="kinds, with commas")
    parser.add_argument("--number", type=int, help="only the try of this number")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--limit", type=float, default=120.0, help="seconds for a file; "
                        "a command's limit is ten times as long")  # fmt: skip
    parser.add_argument("--memory", type=float, default=8.0, help="GiB of address space a process")
    parser.add_argument("--keep", type=Path, help="a folder for the files that failed")
    given = parser.parse_args(arguments)
    kinds = given.only.split(",")
    if unknown := set(kinds) - set(FULL):
        parser.error(f"no kind {', '.join(sorted(unknown))}; there are {', '.join(FULL)}")
    sys.path.insert(0, str(HERE))
    print(f"seed {given.seed}, scale {given.scale:g}\n")
    print(row(["attack", "tries", "clean errors", "accepted", "lost bytes", "crashes", "hangs",
               "peak memory"]))  # fmt: skip
    print("|---" + "|---:" * 7 + "|", flush=True)
    failures: list[str] = []
    for kind in kinds:
        if kind == "solutions" and not has_mitsuba():
            print("solutions are left out: Mitsuba is not installed", file=sys.stderr)
            continue
        count = max(1, round(FULL[kind] * given.scale))
        numbers = list(range(count)) if given.number is None else [given.number]
        with tempfile.TemporaryDirectory(prefix="attack") as folder:
            memory = int(given.memory * 2**30)
            options = Options(given.seed, given.limit, memory, given.jobs, given.keep, Path(folder))
            found = attack(kind, numbers, options)
        numbers_of = (found.tries, found.clean, found.accepted, found.lost, found.crashes,
                      found.hangs)  # fmt: skip
        print(row([kind, *(f"{n:,}" for n in numbers_of), f"{found.peak / 2**20:,.0f} MiB"]),
              flush=True)  # fmt: skip
        failures += [f"{kind}: {words}" for words in found.failures]
    for words in failures:
        print(f"\n{words}")
    if failures:
        print(f"\nTo repeat one: python {Path(__file__).name} --seed {given.seed} --only KIND "
              "--number N --keep DIR")  # fmt: skip
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
