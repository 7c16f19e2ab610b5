"""EXR reading and writing against the bare OpenEXR module, side by side in one run.

A frame of 10 float channels (R G B, albedo, normal, depth) in several compressions. In turns:

- decode: `lambent.frame.exr.decode` with all channels, against
  ``OpenEXR.File(path, separate_channels=True)``;
- encode: `lambent.frame.exr.encode` with all channels replaced, against ``File.write``;
- edit: read, replace three of ten channels, write; the bare module does the same (and loses what
  it does not understand, and packs lossy channels anew, which ours does not);
- frame: `lambent.read` with all layers (checked, roles found, interleaved), against the bare
  module and ``np.stack`` of the same layers;
- new file (ZIP only): `lambent.write` of a frame without a file, against ``File.write``.

Both sides have the same number of threads. Target: at most 1.2x for decode and encode. Factors of
processor time (user and system) hold on a busy machine too; those of wall time do not. Of each job
the least of many turns counts. The module does not flush to the disk, so ours is shown without the
flush too; ``--flush`` times it.
``--memory`` measures the peak of reading an 8192x4320 file in processes of their own.

Usage: python benchmarks/exr_io.py [--width 1280 --height 720 --rounds 12] [--flush] [--memory]
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
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


Times = dict[str, list[tuple[float, float]]]


def in_turns(rounds: int, jobs: dict[str, Callable[[], object]]) -> Times:
    """Seconds (wall, processor) of each job, in turns so that all see the same machine.

    Every other turn runs backwards: the allocator gives fresh pages (10 ms for 35 MiB) to one of
    two neighbours, and pages that are there already to the other.
    """
    times: Times = {name: [] for name in jobs}
    for turn in range(rounds + 1):
        order = list(jobs.items())
        for name, job in order[::-1] if turn % 2 else order:
            wall, cpu = time.perf_counter(), time.process_time()
            result = job()
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            del result
            if turn:  # the first warms up
                times[name].append((wall, cpu))
    return times


def cell(ours: list[tuple[float, float]], bare: list[tuple[float, float]]) -> str:
    """Ours in seconds, and the factors to the bare module by processor and wall time."""
    (wall, cpu), (bare_wall, bare_cpu) = (
        [min(column) for column in zip(*times, strict=True)] for times in (ours, bare)
    )
    return f"{cpu:6.3f} s {cpu / bare_cpu:5.2f}x ({wall / bare_wall:4.2f}x)"


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
          f"processor seconds (least of {rounds}), factor to the bare module, "
          "(factor by wall time)\n")  # fmt: skip
    columns = ["decode", "encode", "edit 3 of 10", "frame", "new file"]
    print(f"| {'compression':11} | " + " | ".join(f"{c:>24}" for c in columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.exr", Path(folder) / "out.exr"
        for name in COMPRESSIONS:
            if not hasattr(OpenEXR, f"{name}_COMPRESSION"):
                continue
            store(str(source), pixels, name)
            exr = decode(source)
            every = {(0, n): a for n, a in pixels.items()}
            three = {(0, n): pixels[n] for n in NAMES[:3]}
            jobs: dict[str, Callable[[], object]] = {
                "bare decode": lambda: bare_read(source),
                "decode": lambda: [c.data for c in decode(source).parts[0].channels.values()],
                "bare encode": lambda n=name: store(str(target), pixels, n),
                "encode": lambda e=exr, r=every: encode(target, e, r, overwrite=True),
                "bare edit 3 of 10": lambda n=name: store(
                    str(target), {**bare_read(source), **{k: pixels[k] for k in NAMES[:3]}}, n
                ),
                "edit 3 of 10": lambda r=three: encode(target, decode(source), r, overwrite=True),
                "bare frame": lambda: stacked(bare_read(source)),
                "frame": lambda: [layer.data for layer in read(source).all_layers()],
            }
            if name == "ZIP":
                jobs["new file"] = lambda: write(target, frame, overwrite=True)
                jobs["bare new file"] = jobs["bare encode"]
            times = in_turns(rounds, jobs)
            cells = [cell(times[c], times[f"bare {c}"]) if c in times else "" for c in columns]
            print(f"| {name:11} | " + " | ".join(f"{c:>24}" for c in cells) + " |", flush=True)


def bare_read(path: Path) -> dict[str, np.ndarray]:
    """All channels, by the bare module."""
    import OpenEXR

    found = OpenEXR.File(str(path), separate_channels=True).channels()
    return {name: channel.pixels for name, channel in found.items()}


def stacked(pixels: dict[str, np.ndarray]) -> list[np.ndarray]:
    """The layers as float32 images ``(H, W, C)``."""
    groups = (NAMES[:3], NAMES[3:6], NAMES[6:9], NAMES[9:])
    return [np.stack([pixels[n] for n in g], 2).astype(np.float32, copy=False) for g in groups]


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
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, default=720)
    parser.add_argument("--rounds", type=int, default=12)
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
