"""How much memory denoising takes: a very large frame in tiles, and a long sequence.

1. 8192x4320, 10 channels, ``--max-memory 4G``: peak resident memory of the whole command.
2. The largest difference between the tiled and the untiled result, on a frame where both fit.
3. A sequence of 100 frames: resident memory while frame 10 and frame 100 are written.

Usage: python benchmarks/memory.py [--model oidn] [--limit 4G] [--half] [--only frame|seam|sequence]
Frames are made into ``$LAMBENT_CACHE`` (default ``~/.cache/lambent``) and kept there.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from cold_start import procedural_frame

CACHE = Path(os.environ.get("LAMBENT_CACHE", Path.home() / ".cache" / "lambent"))
WIDTH, HEIGHT = 8192, 4320


def large_frame(dtype: type) -> Path:
    """The 8192x4320 frame, made once."""
    path = CACHE / f"large_{WIDTH}x{HEIGHT}_{np.dtype(dtype).name}.exr"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        procedural_frame(partial, WIDTH, HEIGHT, dtype)
        partial.rename(path)
    return path


def run(arguments: list[str]) -> tuple[float, int]:
    """(seconds, peak resident bytes) of one `lambent` command."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "lambent", *arguments])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"lambent {' '.join(arguments)} failed with {process.returncode}")
    return time.perf_counter() - start, usage.ru_maxrss * 1024


def frame_table(model: str, limit: str, dtype: type) -> None:
    """Item 1."""
    source = large_frame(dtype)
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        output = Path(folder) / "clean.exr"
        wall, peak = run(
            ["denoise", str(source), "-o", str(output), "--model", model, "--max-memory", limit]
        )
    print(f"\n| {WIDTH}x{HEIGHT}, 10 {np.dtype(dtype).name} channels, {model} | seconds | peak |")
    print("|---|---:|---:|")
    print(f"| `--max-memory {limit}` | {wall:.1f} | {peak / 2**30:.2f} GiB |")


def seam_table(model: str) -> None:
    """Item 2: the same frame in one piece and in tiles of several sizes."""
    from lambent.denoise.pipeline import Settings
    from lambent.denoise.tiles import filter_tiles, plan_tiles
    from lambent.frame.files import read
    from lambent.frame.role import Role

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "noisy.exr"
        procedural_frame(path, 1920, 1080)
        frame = read(path)
        denoiser = Settings.checked(model=model).denoiser().fitted(frame)
        layers = [frame.layer(Role.COLOUR)]
        margin = denoiser.margin()
        whole = filter_tiles(denoiser, frame, layers, plan_tiles(1080, 1920, 1, margin, None))[0]
        print(f"\n| 1920x1080, {model}, margin {margin} | tiles | largest difference | relative |")
        print("|---|---:|---:|---:|")
        for side in (1024, 640, 448):
            plan = plan_tiles(1080, 1920, 1, margin, side * side)
            tiled = filter_tiles(denoiser, frame, layers, plan)[0]
            difference = np.abs(tiled - whole)
            relative = (difference / (np.abs(whole) + 1e-3)).max()
            print(
                f"| tiles of at most {side}² pixels | {len(plan.tiles)} "
                f"| {difference.max():.2e} | {relative:.2e} |"
            )


def sequence_table(model: str, frames: int = 100) -> None:
    """Item 3: the process is watched from outside while it writes the frames."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        procedural_frame(folder / "first.exr", 640, 360)
        for number in range(1, frames + 1):
            shutil.copy(folder / "first.exr", folder / f"shot.{number:04d}.exr")
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "lambent",
                "denoise",
                str(folder / "shot.####.exr"),
                "--model",
                model,
            ],
            stdout=subprocess.DEVNULL,
        )
        resident: dict[int, int] = {}
        watch = threading.Thread(target=_watch, args=(process, folder, resident))
        start = time.perf_counter()
        watch.start()
        process.wait()
        watch.join()
        wall = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    print(f"\n| 640x360, {frames} frames, {model} | resident after |")
    print("|---|---:|")
    for number in (10, 25, 50, 75, frames - 1):
        near = min(resident, key=lambda n: abs(n - number))
        print(f"| frame {near} | {resident[near] / 2**20:.0f} MiB |")
    print(
        f"\nPeak of any command of this run: {peak / 2**20:.0f} MiB; {wall / frames:.2f} s a frame"
    )


def _watch(process: subprocess.Popen, folder: Path, resident: dict[int, int]) -> None:
    """The highest resident memory seen while so many frames were finished."""
    while process.poll() is None:
        done = len(list(folder.glob("shot_clean.*.exr")))
        try:
            pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
        except (OSError, IndexError):
            break
        size = pages * os.sysconf("SC_PAGE_SIZE")
        resident[done] = max(resident.get(done, 0), size)
        time.sleep(0.02)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", default="oidn")
    parser.add_argument("--limit", default="4G")
    parser.add_argument("--half", action="store_true", help="half channels in the large frame")
    parser.add_argument("--only", choices=["frame", "seam", "sequence"])
    arguments = parser.parse_args()
    wanted = [arguments.only] if arguments.only else ["frame", "seam", "sequence"]
    if "frame" in wanted:
        frame_table(arguments.model, arguments.limit, np.float16 if arguments.half else np.float32)
    if "seam" in wanted:
        seam_table(arguments.model)
    if "sequence" in wanted:
        sequence_table(arguments.model)


if __name__ == "__main__":
    main()
