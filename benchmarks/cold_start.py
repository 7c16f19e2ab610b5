"""How long a cold command takes, from the shell and back, against a minimal script.

`lambent denoise` of a 1280x720 EXR with 10 channels (colour, albedo, normal, depth) against
`oidn_minimal.py`, which only reads the file, calls OIDN High and writes the result. Both run in
turns, each a new process, so that both see the same machine. Target: at most 1.2x. Also
`lambent --help` (target: 0.25 s) and `--version`.

Usage: python benchmarks/cold_start.py [--rounds 7] [--models oidn,lambent]
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent


def procedural_frame(path: Path, width: int = 1280, height: int = 720, dtype=np.float32) -> None:
    """An EXR with R G B, albedo, normal, depth: smooth shapes, exponential noise in the colour."""
    import OpenEXR

    rng = np.random.default_rng(7)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) / height
    albedo = [0.5 + 0.4 * np.sin(9 * x + i) * np.cos(7 * y - i) for i in range(3)]
    nx, ny = 0.5 * np.sin(6 * x), 0.5 * np.cos(6 * y)
    normal = [nx, ny, np.sqrt(1 - nx * nx - ny * ny)]
    light = 0.2 + np.maximum(normal[2] * 0.9 + normal[0] * 0.3, 0)
    channels = {
        name: a * light * rng.exponential(1.0, light.shape)
        for name, a in zip("RGB", albedo, strict=True)
    }
    channels |= {f"albedo.{n}": a for n, a in zip("RGB", albedo, strict=True)}
    channels |= {f"normal.{n}": a for n, a in zip("XYZ", normal, strict=True)}
    channels["depth.Z"] = 2 + x + y
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    arrays = {name: np.ascontiguousarray(a, dtype=dtype) for name, a in channels.items()}
    with OpenEXR.File(header, arrays) as file:
        file.write(str(path))


def seconds(command: list[str]) -> float:
    """Wall time of one process, which must succeed."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--models", default="oidn,lambent,lambent-fast,lambent-best")
    arguments = parser.parse_args()
    rounds = arguments.rounds
    lambent = [sys.executable, "-m", "lambent"]
    with tempfile.TemporaryDirectory() as folder:
        noisy, clean = Path(folder) / "noisy.exr", Path(folder) / "clean.exr"
        procedural_frame(noisy)
        commands = {
            "minimal script, OIDN High": [
                sys.executable,
                str(HERE / "oidn_minimal.py"),
                str(noisy),
                str(clean),
            ],
            **{
                f"lambent denoise --model {model}": [
                    *lambent,
                    "denoise",
                    str(noisy),
                    "-o",
                    str(clean),
                    "--overwrite",
                    "--model",
                    model,
                ]
                for model in arguments.models.split(",")
            },
            "lambent --help": [*lambent, "--help"],
            "lambent --version": [*lambent, "--version"],
            "python -c pass": [sys.executable, "-c", "pass"],
        }
        times: dict[str, list[float]] = {name: [] for name in commands}
        for command in commands.values():
            seconds(command)  # the first run fills the disk cache and compiles to bytecode
        for _ in range(rounds):
            for name, command in commands.items():
                times[name].append(seconds(command))
    base = statistics.median(times["minimal script, OIDN High"])
    print(f"1280x720, 10 float channels, ZIP; {rounds} rounds in turns, new processes\n")
    print("| command | median s | min s | max s | against minimal |")
    print("|---|---:|---:|---:|---:|")
    for name, values in times.items():
        middle = statistics.median(values)
        against = f"{middle / base:.2f}x" if "denoise" in name else ""
        print(f"| {name} | {middle:.2f} | {min(values):.2f} | {max(values):.2f} | {against} |")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(f"\n{platform.machine()}, {cores} cores, Python {platform.python_version()}")


if __name__ == "__main__":
    main()
