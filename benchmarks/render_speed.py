"""Frames with every feature against Mitsuba's own integrators, side by side in one run.

    python benchmarks/render_speed.py SCENES_DIR [--rounds 5] [--json OUT]

For each scene, size and spp of `RUNS`, in turn, several rounds: Mitsuba's plain ``path``; its stock
``moment`` over ``aov`` over ``path`` (albedo, normal, depth, position and colour with the second
moments of all: the nearest it has to our frames); ours with every layer, variance and half buffers;
ours with the colour alone. The first call of each (compiling) is shown apart; ratios are of the
medians. Peak memory is that of a process of its own, at one spp and at many: it must not grow.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

#: Scene, size, spp, depth.
RUNS = (
    ("cornell-box", (256, 256), 64, 8),
    ("dining-room", (1280, 720), 8, 8),
    ("living-room", (1280, 720), 8, 8),
)
AOVS = "albedo:albedo,normal:sh_normal,depth:depth,position:position"


def calls(scene: Any, depth: int, spp: int) -> dict[str, Any]:
    """Name -> function of a seed that renders and waits."""
    import drjit as dr
    import mitsuba as mi

    from lambent.render.sampling import FrameSampler

    path = mi.load_dict({"type": "path", "max_depth": depth})
    aov = mi.load_dict({"type": "aov", "aovs": AOVS, "path": path})
    moment = mi.load_dict({"type": "moment", "nested": aov})

    def theirs(integrator: Any) -> Any:
        def call(seed: int) -> Any:
            image = mi.render(scene, integrator=integrator, spp=spp, seed=seed)
            dr.eval(image)
            return np.array(image)

        return call

    every = FrameSampler(scene, depth=depth)
    colour = FrameSampler(scene, depth=depth, features="none")
    return {
        "mitsuba path": theirs(path),
        "mitsuba moment(aov(path))": theirs(moment),
        "ours, every layer": lambda seed: every.sample(spp, seed).mean,
        "ours, colour alone": lambda seed: colour.sample(spp, seed).mean,
    }


def measure(folder: Path, run: Any, rounds: int) -> list[dict[str, Any]]:
    from lambent.render.scene import load

    name, size, spp, depth = run
    loaded = load(folder / name / "scene.xml", size=size)
    paths = size[0] * size[1] * spp
    table = calls(loaded.scene, depth, spp)
    first, seconds, channels = {}, {n: [] for n in table}, {}
    for n, call in table.items():
        began = time.perf_counter()
        channels[n] = call(0).shape[2]
        first[n] = time.perf_counter() - began
    for k in range(rounds):
        for n, call in table.items():  # in turn, so that a change of clock meets all
            began = time.perf_counter()
            call(k + 1)
            seconds[n].append(time.perf_counter() - began)
    base = statistics.median(seconds["mitsuba path"])
    return [
        {
            "scene": name,
            "size": f"{size[0]}x{size[1]}",
            "spp": spp,
            "method": n,
            "channels": channels[n],
            "first_s": first[n],
            "median_s": statistics.median(s),
            "least_s": min(s),
            "most_s": max(s),
            "mpaths": paths / statistics.median(s) / 1e6,
            "of_path": base / statistics.median(s),
        }
        for n, s in seconds.items()
    ]


def peak(folder: Path, spp: int) -> int:
    """Peak memory in MiB of a process that renders the Cornell box with every layer."""
    code = (
        "import sys, resource\n"
        "from lambent.render.scene import load\n"
        "s = load(sys.argv[1], size=(512, 512))\n"
        "from lambent.render.sampling import FrameSampler\n"
        "FrameSampler(s.scene, depth=8).sample(int(sys.argv[2]), 1)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)\n"
    )
    scene = str(folder / "cornell-box" / "scene.xml")
    done = subprocess.run(
        [sys.executable, "-c", code, scene, str(spp)], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes_dir", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    from lambent.render.variant import mitsuba

    mi = mitsuba()
    load = os.getloadavg()[0]
    machine = f"{platform.machine()}, {os.cpu_count()} cores, load {load:.1f}"
    print(f"Mitsuba {mi.__version__}, {mi.variant()}, {machine}; {arguments.rounds} rounds\n")
    print("| scene | spp | method | channels | first call s | median s (least, most) | "
          "M paths/s | of path |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    rows = []
    for run in RUNS:
        for row in measure(arguments.scenes_dir, run, arguments.rounds):
            rows.append(row)
            print(
                f"| {row['scene']} {row['size']} | {row['spp']} | {row['method']} "
                f"| {row['channels']} | {row['first_s']:.2f} | {row['median_s']:.2f} "
                f"({row['least_s']:.2f}, {row['most_s']:.2f}) | {row['mpaths']:.2f} "
                f"| {row['of_path']:.2f}x |",
                flush=True,
            )
    print("\n| spp at 512x512, every layer | peak memory of the process |\n|---|---|")
    memory = {}
    for spp in (1, 16, 256):
        memory[spp] = peak(arguments.scenes_dir, spp)
        print(f"| {spp} | {memory[spp]} MiB |", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps({"runs": rows, "memory": memory}, indent=1) + "\n")


if __name__ == "__main__":
    main()
