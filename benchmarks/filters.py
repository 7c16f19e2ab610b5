"""Quality, time and memory of every denoiser on the frames of ``benchmarks/frames.py``.

    python benchmarks/filters.py [--cache DIR] [--models nlm,nfor] [--scenes a,b] [--spp 4,16]
                                 [--no-memory] [--out docs/results/filters]

A model runs in a process of its own over all frames, alone on the machine; every frame is filtered
twice and the second call is timed, so that compiling does not count. Peak memory is the largest
resident size of that process after its first frame. Errors are measured afterwards, on all cores
(HDR-FLIP takes longer than any filter here). relMSE is as in `lambent.metrics.relmse`
with the variance of the reference subtracted. Means over scenes are geometric. Prints Markdown
and, with ``--out``, writes it to OUT.md and all single figures to OUT.json.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from frames import default_cache

Row = dict[str, Any]

NOISY = "noisy"
#: Column -> (title, format).
COLUMNS: dict[str, tuple[str, str]] = {
    "gain": ("noise ÷", "{:.1f}"),
    "relmse": ("relMSE", "{:.5f}"),
    "relmse_trimmed": ("relMSE −0.1 %", "{:.5f}"),
    "dssim": ("DSSIM", "{:.4f}"),
    "flip": ("HDR-FLIP", "{:.4f}"),
    "seconds": ("seconds", "{:.2f}"),
    "megabytes": ("peak MB", "{:.0f}"),
}
#: Scenes that stand in the table by scene only: made for one filter (``benchmarks/shadows.py``).
APART = ("soft-shadow",)
#: What is known from the papers: the first has the lower error. The papers leave out the worst
#: 0.1 % of the pixels.
KNOWN_ORDER = (
    ("nfor", "nlm"),
    ("nfor-tuned", "nlm"),
    ("statmc", "nlm"),
    ("statmc-tuned", "nlm"),
    ("nlm", "atrous"),
    ("nlm", "atrous-tuned"),
)


# ---------------------------------------------------------------------- worker


def work(model: str, paths: list[Path], memory: bool, results: Path) -> None:
    """Filter every frame with one model; one line of JSON for each on standard output.

    The filtered beauty is left in ``results`` as ``MODEL-FRAME.npy``.
    """
    import numpy as np

    from lambent.errors import LambentError, LayerError
    from lambent.filters.denoiser import create
    from lambent.frame.files import read

    denoiser = None if model == NOISY else create(model)
    megabytes: float | None = None
    for path in paths:
        scene, _, spp = path.stem.rpartition("-")
        row: Row = {"model": model, "scene": scene, "spp": int(spp.removesuffix("spp"))}
        try:
            frame = read(path)
            result = frame
            if denoiser is not None:
                denoiser.check(frame)
                denoiser(frame, passes="beauty")
                start = time.perf_counter()
                result = denoiser(frame, passes="beauty")
                row["seconds"] = time.perf_counter() - start
                if memory and megabytes is None:
                    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                row["megabytes"] = megabytes
            kept = results / f"{model}-{path.stem}.npy"
            np.save(kept, result.colour)
            row["result"] = str(kept)
        except LayerError as error:
            row["lacks"] = error.message
        except (LambentError, ImportError, RuntimeError, ValueError, TypeError) as error:
            row["failed"] = f"{type(error).__name__}: {error}"
        print(json.dumps(row), flush=True)


def with_errors(row: Row, cache: Path) -> Row:
    """A row with the errors of its result, in place of the path to it."""
    import numpy as np

    if "result" not in row:
        return row
    image = np.load(row["result"])
    rest = {key: value for key, value in row.items() if key != "result"}
    return rest | measured(image, cache / f"{row['scene']}-reference.exr")


def measured(image: Any, reference_path: Path) -> Row:
    """The errors of an image."""
    from lambent.frame.files import read
    from lambent.metrics.flip import flip_hdr
    from lambent.metrics.reference import reference_variance
    from lambent.metrics.relmse import TRIM, relmse
    from lambent.metrics.ssim import dssim

    reference = read(reference_path)
    truth, variance = reference.colour, reference_variance(reference)
    return {
        "relmse": relmse(image, truth, reference_variance=variance),
        "relmse_trimmed": relmse(image, truth, TRIM, reference_variance=variance),
        "dssim": dssim(image, truth),
        "flip": flip_hdr(image, truth),
        "reference_spp": reference.spp,
        "reference_noise_off": variance is not None,
    }


def run(model: str, paths: list[Path], memory: bool, results: Path) -> list[Row]:
    """The rows of one model, from a process of its own; problems go to standard error."""
    command = [sys.executable, str(Path(__file__).resolve()), "--worker", model, *map(str, paths)]
    command += ["--results", str(results)]
    if not memory:
        command.append("--no-memory")
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    for path in paths[len(rows) :]:
        rows.append({"model": model, "scene": path.stem, "failed": f"exit {done.returncode}"})
    problems = {r.get("failed") or r.get("lacks") for r in rows} - {None}
    told = "".join(f"\n    {p}" for p in sorted(problems))
    print(f"{model}: {len(rows)} frames{told}", file=sys.stderr, flush=True)
    return rows


def with_gain(rows: list[Row]) -> list[Row]:
    """The rows with how many times the error was lowered, where the noisy frame's is known."""
    noisy = {
        (r["scene"], r["spp"]): r["relmse"] for r in rows if r["model"] == NOISY and "relmse" in r
    }
    return [
        {**r, "gain": noisy[r["scene"], r["spp"]] / r["relmse"]}
        if "relmse" in r and (r["scene"], r["spp"]) in noisy
        else r
        for r in rows
    ]


# ---------------------------------------------------------------------- tables


def geometric_mean(values: Iterable[float]) -> float:
    """exp of the mean logarithm; not a number where a value is not positive."""
    values = list(values)
    if not values or min(values) <= 0:
        return math.nan
    return math.exp(sum(map(math.log, values)) / len(values))


def means(rows: list[Row], spp: int) -> dict[str, Row]:
    """Model -> geometric means over the scenes at one spp, for models that did all scenes."""
    here = [r for r in rows if r.get("spp") == spp and "relmse" in r and r["scene"] not in APART]
    scenes = {r["scene"] for r in here}
    result = {}
    for model in dict.fromkeys(r["model"] for r in here):
        own = [r for r in here if r["model"] == model]
        if {r["scene"] for r in own} != scenes:
            continue
        result[model] = {
            key: geometric_mean(r[key] for r in own)
            for key in COLUMNS
            if all(r.get(key) is not None for r in own)
        }
    return result


def markdown_table(head: list[str], lines: list[list[str]]) -> str:
    rule = [":--", *("--:" for _ in head[1:])]
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *lines))


def markdown(rows: list[Row], about: Row) -> str:
    """All tables, one for each spp and one of relMSE by scene, and the known order checked."""
    done = [r for r in rows if "relmse" in r]
    scenes = list(dict.fromkeys(r["scene"] for r in done))
    spps = sorted({r["spp"] for r in done})
    named = ", ".join(f"{s} ({about['reference_spp'][s]})" for s in scenes)
    parts = [f"Scenes (reference spp): {named}. {about['machine']}; Lambent {about['lambent']}."]
    for spp in spps:
        table = means(rows, spp)
        order = sorted(table, key=lambda m: table[m].get("relmse", math.inf))
        lines = [[f"`{m}`", *_cells(table[m])] for m in order]
        count = len({r["scene"] for r in done if r["spp"] == spp} - set(APART))
        parts.append(f"### {spp} spp, geometric means over {count} scenes")
        parts.append(markdown_table(["model", *(t for t, _ in COLUMNS.values())], lines))
        parts.append("\n".join(f"- {line}" for line in order_remarks(table)))
    parts.append("### relMSE lowered, by scene and spp (noisy ÷ filtered)")
    models = list(dict.fromkeys(r["model"] for r in done if r["model"] != NOISY))
    gain = {(r["model"], r["scene"], r["spp"]): f"{r['gain']:.1f}" for r in done if "gain" in r}
    columns = [(s, n) for s in scenes for n in spps]
    head = ["model", *(f"{s} {n}" for s, n in columns)]
    lines = [[f"`{m}`", *(gain.get((m, *c), "") for c in columns)] for m in models]
    parts.append(markdown_table(head, lines))
    return "\n\n".join(filter(None, parts)) + "\n"


def _cells(row: Row) -> list[str]:
    return [text.format(row[key]) if key in row else "" for key, (_, text) in COLUMNS.items()]


def order_remarks(table: dict[str, Row]) -> list[str]:
    """Sentences on the order that is known from the papers, in both forms of relMSE."""
    pairs = [*KNOWN_ORDER, *((m, "box") for m in table if m not in ("box", NOISY))]
    remarks = []
    for better, worse in pairs:
        if better not in table or worse not in table:
            continue
        for key in ("relmse_trimmed", "relmse"):
            a, b = table[better][key], table[worse][key]
            if (better, worse) in KNOWN_ORDER or not a < b:
                word = "ahead of" if a < b else "**behind**"
                remarks.append(f"{COLUMNS[key][0]}: {better} {word} {worse}, {a:.5f} and {b:.5f}")
    return remarks


def machine() -> str:
    """Processor and core count, in words."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    return f"{name}, {os.cpu_count()} cores"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("frames", nargs="*", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--results", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--cache", type=Path, default=default_cache())
    parser.add_argument("--models", default="", help="names; default all")
    parser.add_argument("--scenes", default="", help="names; default all with a reference")
    parser.add_argument("--spp", default="4,16,64")
    parser.add_argument("--no-memory", action="store_true")
    parser.add_argument("--out", type=Path, help="path without suffix for .md and .json")
    arguments = parser.parse_args()
    if arguments.worker:
        work(arguments.worker, arguments.frames, not arguments.no_memory, arguments.results)
        return
    import lambent
    from lambent.filters.denoiser import DENOISERS

    cache: Path = arguments.cache
    scenes = [s for s in arguments.scenes.split(",") if s] or sorted(
        p.stem.removesuffix("-reference") for p in cache.glob("*-reference.exr")
    )
    wanted = [cache / f"{s}-{n}spp.exr" for s in scenes for n in arguments.spp.split(",")]
    paths = [p for p in wanted if p.exists()]
    if not paths:
        sys.exit(f"no frames in {cache}: make them with benchmarks/frames.py")
    models = [m for m in arguments.models.split(",") if m] or list(DENOISERS)
    with tempfile.TemporaryDirectory(prefix="lambent-filters-") as folder:
        rows = [
            row
            for model in [NOISY, *models]
            for row in run(model, paths, not arguments.no_memory, Path(folder))
        ]
        print(f"measuring {len(rows)} results", file=sys.stderr, flush=True)
        with ProcessPoolExecutor() as pool:
            rows = with_gain(list(pool.map(partial(with_errors, cache=cache), rows)))
    about = {
        "machine": machine(),
        "lambent": lambent.__version__,
        "reference_spp": {r["scene"]: r["reference_spp"] for r in rows if "reference_spp" in r},
    }
    text = markdown(rows, about)
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.with_suffix(".md").write_text(text)
        both = json.dumps({**about, "rows": rows}, indent=1)
        arguments.out.with_suffix(".json").write_text(both)
    print(text)


if __name__ == "__main__":
    main()
