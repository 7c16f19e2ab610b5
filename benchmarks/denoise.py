"""Our denoiser against OIDN, NFOR and StatMC: error by spp and kind of input, time, memory.

    python benchmarks/denoise.py [--cache DIR] [--models lambent,oidn,...] [--spp 1,4,16,64]
                                 [--no-speed] [--no-quality] [--out docs/results/denoise]
    python benchmarks/denoise.py --tables docs/results/denoise   # from the JSON, nothing measured

Quality: on every frame of ``benchmarks/denoise_frames.py``, with the layers of four kinds of file:
``full`` (every feature and variance), ``plain`` (colour, albedo, normal), ``colour`` alone, and
``splat`` (Mitsuba's film with the scene's own splatted filter; colour, albedo, normal, depth).
Trimmed relMSE less the reference's variance, HDR-FLIP, DSSIM; each as the geometric mean over the
scenes of the ratio to OIDN High. Speed: 1280x720, colour, albedo, normal, depth, from call to
result, second call and later; the same with four more layers; peak memory of the process. All in
one run, one model at a time. Every column says how many scenes are in it; a model that did not do
all of them, and one that failed, is marked. Prints Markdown; with ``--out`` also writes it, and
single figures as JSON beside it.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from filters import geometric_mean, machine, markdown_table, measured
from frames import default_cache

Row = dict[str, Any]
MODELS = (
    "oidn", "oidn-balanced", "oidn-fast", "oidn-best", "nfor-tuned", "statmc-tuned",
    "lambent", "lambent-fast", "lambent-best",
)  # fmt: skip
YARDSTICK = "oidn"
KINDS = ("full", "plain", "colour", "splat")
#: Instruction sets that our network is held to, as on processors without VNNI.
ISAS = {"AVX-512 without VNNI": "AVX512_CORE", "AVX2": "AVX2"}
#: Models that need a variance: only where the file has one.
NEED_VARIANCE = ("nfor-tuned", "statmc-tuned")
ERRORS = ("relmse_trimmed", "flip", "dssim")


def as_kind(frame: Any, kind: str) -> Any:
    """The frame with the layers that a kind of file has."""
    from lambent.frame.role import Role, Stat

    if kind in ("full", "splat"):
        return frame
    keep = {(Role.COLOUR, Stat.MEAN)}
    if kind == "plain":
        keep |= {(Role.ALBEDO, Stat.MEAN), (Role.NORMAL, Stat.MEAN)}
    layers = {key: layer for key, layer in frame.layers.items() if key in keep}
    return frame.replace(layers=layers, extras={}, spp=None)


def quality(models: list[str], cache: Path, levels: list[int]) -> list[Row]:
    """One row for each frame, kind and model."""
    from lambent.errors import LambentError
    from lambent.filters.denoiser import create
    from lambent.frame.files import read

    jobs: list[tuple[Row, Any, Path]] = []
    failed: list[Row] = []
    for path in sorted(cache.glob("*spp.exr")):
        scene, _, spp = path.stem.rpartition("-")
        if int(spp.removesuffix("spp")) not in levels:
            continue
        reference = cache / f"{scene}-reference.exr"
        if not reference.exists():
            continue
        frame = read(path)
        for kind in ("splat",) if scene.endswith("-splat") else KINDS[:3]:
            given = as_kind(frame, kind)
            about = {"scene": scene, "spp": int(spp.removesuffix("spp")), "kind": kind}
            jobs.append(({**about, "model": "noisy"}, frame.colour, reference))
            for model in models:
                if model in NEED_VARIANCE and kind != "full":
                    continue
                try:
                    image = create(model)(given, "beauty").colour
                except LambentError as error:
                    print(f"{path.name}, {kind}, {model}: {error}", file=sys.stderr)
                    failed.append({**about, "model": model, "failed": str(error)})
                    continue
                jobs.append(({**about, "model": model}, image, reference))
        print(f"{path.name} denoised", file=sys.stderr, flush=True)
    # fresh processes: a fork of one with the engines' threads would wait for ever
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        found = pool.map(measured, [j[1] for j in jobs], [j[2] for j in jobs])
        rows = [{**row, **errors} for (row, _, _), errors in zip(jobs, found, strict=True)]
    return rows + failed


def scenes_of(rows: list[Row], kind: str, model: str, spp: int) -> set[str]:
    """The scenes that a model did."""
    here = (r for r in rows if (r["kind"], r["model"], r["spp"]) == (kind, model, spp))
    return {r["scene"] for r in here if ERRORS[0] in r}


def ratios(rows: list[Row], kind: str, model: str, spp: int) -> dict[str, float]:
    """Geometric means over the scenes of a model's errors over the yardstick's."""
    by = {
        (r["scene"], r["model"]): r
        for r in rows
        if r["kind"] == kind and r["spp"] == spp and ERRORS[0] in r
    }
    found = {}
    for what in ERRORS:
        pairs = [
            (row[what], by[scene, YARDSTICK][what])
            for (scene, name), row in by.items()
            if name == model and (scene, YARDSTICK) in by
        ]
        if pairs:
            found[what] = geometric_mean(max(a, 1e-7) / max(b, 1e-7) for a, b in pairs)
    return found


def quality_tables(rows: list[Row]) -> str:
    """A table for each kind of file."""
    lines = []
    levels = sorted({row["spp"] for row in rows})
    for kind in KINDS:
        models = [m for m in ("noisy", *MODELS) if any(
            r["model"] == m and r["kind"] == kind for r in rows
        )]  # fmt: skip
        if not models:
            continue
        counts = {spp: len(scenes_of(rows, kind, YARDSTICK, spp)) for spp in levels}
        columns = [spp for spp in levels if counts[spp]]
        lines += [f"\n### {kind}\n"]
        table = [
            [model, *(_cell(rows, kind, model, spp, counts[spp]) for spp in columns)]
            for model in models
        ]
        head = ["model", *(f"{spp} spp, {counts[spp]} scenes" for spp in columns)]
        lines.append(markdown_table(head, table))
    return "\n".join(lines)


def _cell(rows: list[Row], kind: str, model: str, spp: int, count: int) -> str:
    """The errors of a model in a column of ``count`` scenes."""
    found = ratios(rows, kind, model, spp)
    if not found:
        return "failed" if _failures(rows, kind, model, spp) else "–"
    text = " / ".join(f"{found[e]:.2f}" for e in ERRORS)
    done = len(scenes_of(rows, kind, model, spp))
    return text if done == count else f"{text} ({done} scenes)"


def _failures(rows: list[Row], kind: str, model: str, spp: int) -> list[str]:
    here = (r for r in rows if (r["kind"], r["model"], r["spp"]) == (kind, model, spp))
    return [r["failed"] for r in here if "failed" in r]


# ----------------------------------------------------------------------- speed


def speed_worker(model: str, layers: int) -> None:
    """Print the median of five warm calls, and the peak memory, as JSON."""
    from lambent import memory
    from lambent.filters.denoiser import create
    from lambent.frame.frame import Frame

    rng = np.random.default_rng(0)
    height, width = 720, 1280

    def image(channels: int = 3) -> Any:
        return rng.random((height, width, channels), np.float32)

    frame = Frame.from_arrays(
        colour=image(), albedo=image(), normal=image() * 2 - 1, depth=image(1) + 1,
        lighting={f"light{n}": image() for n in range(layers)},
    )  # fmt: skip
    denoiser = create(model.partition("@")[0])
    seconds = []
    for _ in range(6):
        start = time.perf_counter()
        denoiser(frame)
        seconds.append(time.perf_counter() - start)
    print(json.dumps({"seconds": float(np.median(seconds[1:])), "peak": memory.peak()}))


def speed(models: list[str]) -> list[Row]:
    """Seconds and memory of each model, and of four more layers."""
    rows = []
    for model in models:
        row: Row = {"model": model}
        for layers in (0, 4):
            command = [sys.executable, __file__, "--speed-worker", model, str(layers)]
            isa = ISAS.get(model.partition("@")[2])
            environment = {**os.environ, **({"ONEDNN_MAX_CPU_ISA": isa} if isa else {})}
            done = subprocess.run(command, capture_output=True, text=True, env=environment)
            if done.returncode:
                print(done.stderr[-500:], file=sys.stderr)
                break
            figures = json.loads(done.stdout.splitlines()[-1])
            row[f"seconds_{layers}"] = figures["seconds"]
            if layers == 0:
                row["peak"] = figures["peak"]
        rows.append(row)
    return rows


def speed_table(rows: list[Row]) -> str:
    """As Markdown, with ratios to the yardstick."""
    base = next(r for r in rows if r["model"] == YARDSTICK)
    lines = []
    for row in rows:
        if "seconds_0" not in row:
            lines.append([row["model"], "failed", *[""] * 4])
            continue
        cells = [row["model"], f"{row['seconds_0']:.3f}"]
        cells.append(f"{row['seconds_0'] / base['seconds_0']:.2f}")
        if "seconds_4" in row:
            more = (row["seconds_4"] - row["seconds_0"]) / 4
            cells.append(f"{more / base['seconds_0']:.3f}")
        else:
            cells.append("")
        cells += [f"{row['peak'] / 1e6:.0f}", f"{row['peak'] / base['peak']:.2f}"]
        lines.append(cells)
    head = ["model", "seconds", "÷ OIDN High", "each further layer", "peak MB", "÷ OIDN High"]
    return markdown_table(head, lines)


def text_of(figures: dict[str, Any]) -> str:
    """All tables as Markdown."""
    text = f"{figures['machine']}\n"
    if "speed" in figures:
        text += f"\n### Time and memory, 1280x720\n\n{speed_table(figures['speed'])}\n"
    if "quality" in figures:
        text += "\nRatios to OIDN High: trimmed relMSE / HDR-FLIP / DSSIM; below 1 is better; "
        text += "geometric means over scenes.\n"
        text += quality_tables(figures["quality"]) + "\n"
    return text


def main() -> None:
    if len(sys.argv) > 2 and sys.argv[1] == "--speed-worker":
        speed_worker(sys.argv[2], int(sys.argv[3]))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, default=default_cache().with_name("validation"))
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--spp", default="1,4,16,64,256,1024")
    parser.add_argument("--no-speed", action="store_true")
    parser.add_argument("--no-quality", action="store_true")
    parser.add_argument("--out", type=Path, help="write OUT.md and OUT.json")
    parser.add_argument("--tables", type=Path, help="re-make TABLES.md from TABLES.json")
    arguments = parser.parse_args()
    if arguments.tables:
        figures = json.loads(arguments.tables.with_suffix(".json").read_text())
        arguments.tables.with_suffix(".md").write_text(text_of(figures))
        return
    models = arguments.models.split(",")
    figures: dict[str, Any] = {"machine": machine()}
    if not arguments.no_speed:
        timed = [*models, *(f"{m}@{isa}" for m in models if m == "lambent" for isa in ISAS)]
        figures["speed"] = speed(timed)
    if not arguments.no_quality:
        levels = [int(v) for v in arguments.spp.split(",")]
        figures["quality"] = quality(models, arguments.cache, levels)
    text = text_of(figures)
    print(text)
    if arguments.out:
        arguments.out.with_suffix(".md").write_text(text)
        arguments.out.with_suffix(".json").write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
