"""EXR reading and writing against the bare OpenEXR module, side by side in one run.

A frame of 10 float channels (R G B, albedo, normal, depth) in several compressions. In turns:

- read: ``OpenEXR.File(path, separate_channels=True)`` against `lambent.frame.exr.decode` with all
  channels, and against `lambent.read` with all layers (interleaved float32, checked, roles found);
- write: ``File.write`` against `encode` with all channels replaced, and with three (the others are
  decoded and packed again), and against `lambent.write` of a new file.

Both sides have the same number of threads. Target: at most 1.2x. The module does not flush to the
disk, so ours is shown without the flush too; ``--flush`` times it. ``--memory`` measures the peak
of reading an 8192x4320 file in processes of their own.

Usage: python benchmarks/exr_io.py [--width 1920 --height 1080 --rounds 7] [--flush] [--memory]
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

NAMES = ["R", "G", "B", *(f"albedo.{c}" for c in "RGB"), *(f"normal.{c}" for c in "XYZ"), "depth.Z"]
COMPRESSIONS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "DWAA", "ZSTD")


def channels(width: int, height: int, dtype: type) -> dict[str, np.ndarray]:
    """Smooth shapes with noise in the colour, as a render has."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / height
    found = {}
    for n, name in enumerate(NAMES):
        plane = 1 + np.sin(5 * x + n) * np.cos(3 * y - n)
        if n < 3:
            plane *= rng.exponential(1.0, plane.shape).astype(np.float32)
        found[name] = np.ascontiguousarray(plane, dtype)
    return found


def store(path: str, pixels: dict[str, np.ndarray], compression: str = "ZIP") -> None:
    """Write channels with the bare module."""
    import OpenEXR

    kind = getattr(OpenEXR, f"{compression}_COMPRESSION")
    header = {"compression": kind, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, dict(pixels)).write(path)


def in_turns(rounds: int, jobs: dict[str, Callable[[], object]]) -> dict[str, list[float]]:
    """Seconds of each job, the jobs in turns so that all see the same machine."""
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for turn in range(rounds + 1):
        for name, job in jobs.items():
            start = time.perf_counter()
            result = job()
            seconds = time.perf_counter() - start
            del result
            if turn:  # the first warms up
                times[name].append(seconds)
    return times


def table(width: int, height: int, rounds: int, dtype: type) -> None:
    import OpenEXR

    from lambent.frame.exr import decode, encode
    from lambent.frame.files import read, write
    from lambent.frame.frame import Frame

    pixels = channels(width, height, dtype)
    frame = Frame.from_arrays(
        colour=np.stack([pixels[n] for n in NAMES[:3]], 2),
        albedo=np.stack([pixels[n] for n in NAMES[3:6]], 2),
        normal=np.stack([pixels[n] for n in NAMES[6:9]], 2),
        depth=pixels["depth.Z"],
    )
    megabytes = sum(a.nbytes for a in pixels.values()) / 2**20
    print(f"\n{width}x{height}, 10 channels {np.dtype(dtype)}, {megabytes:.0f} MiB; "
          "median seconds (spread), factor to the bare module\n")  # fmt: skip
    columns = ["bare read", "decode", "read", "bare write", "encode 10", "encode 3", "new file"]
    print(f"| {'compression':11} | " + " | ".join(f"{c:>20}" for c in columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.exr", Path(folder) / "out.exr"

        def read_all() -> list[np.ndarray]:
            return [layer.data for layer in read(source).all_layers()]

        for name in COMPRESSIONS:
            kind = getattr(OpenEXR, f"{name}_COMPRESSION", None)
            if kind is None:
                continue
            header = {"compression": kind, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, dict(pixels)).write(str(source))
            exr = decode(source)
            every = {(0, n): a for n, a in pixels.items()}
            three = {(0, n): pixels[n] for n in NAMES[:3]}
            jobs: dict[str, Callable[[], object]] = {
                "bare read": lambda: OpenEXR.File(str(source), separate_channels=True),
                "decode": lambda: [c.data for c in decode(source).parts[0].channels.values()],
                "read": read_all,
                "bare write": lambda h=header: OpenEXR.File(h, dict(pixels)).write(str(target)),
                "encode 10": lambda e=exr, r=every: encode(target, e, r, overwrite=True),
                "encode 3": lambda e=exr, r=three: encode(target, e, r, overwrite=True),
            }
            if name == "ZIP":
                jobs["new file"] = lambda: write(target, frame, overwrite=True)
            times = in_turns(rounds, jobs)
            cells = []
            for column in columns:
                if column not in times:
                    cells.append(f"{'':>20}")
                    continue
                base = times["bare read" if column in columns[:3] else "bare write"]
                middle = statistics.median(times[column])
                factor = middle / statistics.median(base)
                spread = (max(times[column]) - min(times[column])) / middle * 100
                cells.append(f"{middle:7.3f} ({spread:3.0f} %) {factor:5.2f}x")
            print(f"| {name:11} | " + " | ".join(cells) + " |", flush=True)


MEMORY = {
    "nothing": "",
    "bare module": "import OpenEXR; f = OpenEXR.File(path, separate_channels=True)",
    "decode": "from lambent.frame.exr import decode\n"
    "e = decode(path); a = [c.data for c in e.parts[0].channels.values()]",
    "read": "from lambent.frame.files import read\n"
    "f = read(path); a = [layer.data for layer in f.all_layers()]",
    "read, colour doubled, write": "from lambent.frame.files import read, write\n"
    "f = read(path); c = f.layer(__import__('lambent').Role.COLOUR)\n"
    "write(path + '.out.exr', f.with_layer(c.with_data(c.data * 2)), overwrite=True)",
}


def memory(width: int, height: int) -> None:
    """Peak memory of reading a large file, each way in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "large.exr")
        # Made by another process: a child's peak counts what its parent held when it was born.
        here = str(Path(__file__).resolve().parent)
        make = (
            f"import sys; sys.path.insert(0, {here!r}); import exr_io, numpy\n"
            f"exr_io.store({path!r}, exr_io.channels({width}, {height}, numpy.float32))"
        )
        subprocess.run([sys.executable, "-c", make], check=True)
        raw = len(NAMES) * width * height * 4 / 2**20
        print(f"\n{width}x{height}, 10 float channels, raw {raw:.0f} MiB\n")
        print("| way | seconds | peak MiB | over raw |\n|---|---|---|---|")
        for name, code in MEMORY.items():
            script = f"path = {path!r}\nimport numpy\n{code}"
            start = time.perf_counter()
            process = subprocess.Popen([sys.executable, "-c", script])
            _, status, usage = os.wait4(process.pid, 0)
            seconds = time.perf_counter() - start
            if status:
                raise SystemExit(f"{name} failed")
            peak = usage.ru_maxrss / 1024
            print(f"| {name} | {seconds:.2f} | {peak:.0f} | {peak / raw:.2f}x |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--half", action="store_true", help="half channels in place of float")
    parser.add_argument("--flush", action="store_true", help="time the flush to the disk too")
    parser.add_argument("--memory", action="store_true", help="only the peak memory, 8192x4320")
    options = parser.parse_args()
    import OpenEXR

    print(f"OpenEXR {OpenEXR.__version__}, numpy {np.__version__}, {platform.machine()}, "
          f"{os.cpu_count()} cores, limit of open files "
          f"{resource.getrlimit(resource.RLIMIT_NOFILE)[0]}")  # fmt: skip
    if options.memory:
        memory(8192, 4320)
        return
    OpenEXR.set_global_thread_count(os.cpu_count() or 1)
    if not options.flush:
        os.fsync = lambda _: None
    table(options.width, options.height, options.rounds, np.float16 if options.half else np.float32)


if __name__ == "__main__":
    main()
