"""All methods in one table: classical filters, the networks of the papers, OIDN and our own.

    python benchmarks/papers.py [--cache DIR] [--spp 1,4,32] [--models kpcn,dpcn,...]
                                [--no-speed] [--int8 DATASET] [--rows JSON]
                                [--out docs/results/learned]

Errors on the validation frames of ``benchmarks/denoise_frames.py`` with all their layers, as
geometric means over the scenes: trimmed relMSE less the reference's variance, DSSIM, HDR-FLIP.
Seconds for 1280x720 with colour and its variance, lobes, albedo, normal and depth, one process a
model, the second call. Multiply-adds a pixel, parameters and hours of training are those of the
models' cards. Then what the papers say of the order, checked. ``--int8``: what int8 by measuring
alone (NNCF, ranges from crops of DATASET) does to the error of the networks whose runs are in the
cache, and to their time. Prints Markdown; with ``--out`` also writes it, and single figures as JSON
beside it. ``--rows``: take the errors from such a file, and measure the others only: errors can
be measured on a busy machine, seconds cannot.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from filters import geometric_mean, machine, markdown_table, measured
from frames import default_cache

Row = dict[str, Any]
ERRORS = ("relmse_trimmed", "dssim", "flip")
#: What is known from the papers: the first has the lower error.
KNOWN = (
    ("kpcn", "dpcn", "Bako 2017: kernels beat colours at equal training"),
    ("kpcn", "nfor", "Bako 2017: learned kernels beat regression"),
    ("modular", "kpcn", "Vogels 2018: residual blocks and scales beat plain stacks"),
    ("kpcn", "dncnn", "what knows features beats what sees colour alone"),
)


def everything() -> list[str]:
    """All models, the yardstick's variants that are no faster left out."""
    from lambent.filters.denoiser import DENOISERS

    return [name for name in DENOISERS if name != "oidn-balanced"]


def quality(models: list[str], cache: Path, levels: list[int]) -> list[Row]:
    """One row for each frame and model, the noisy frame among them."""
    from lambent.errors import LambentError
    from lambent.filters.denoiser import create
    from lambent.frame.files import read

    rows: list[Row] = []
    for path in sorted(cache.glob("*spp.exr")):
        scene, _, spp = path.stem.rpartition("-")
        level = int(spp.removesuffix("spp"))
        reference = cache / f"{scene}-reference.exr"
        if level not in levels or not reference.exists() or scene.endswith("-splat"):
            continue
        frame = read(path)
        for model in ("noisy", *models):
            try:
                image = frame.colour if model == "noisy" else create(model)(frame, "beauty").colour
            except LambentError as error:
                print(f"{path.name}, {model}: {error.message}", file=sys.stderr)
                continue
            rows.append(
                {"model": model, "scene": scene, "spp": level, **measured(image, reference)}
            )
        print(f"{path.name} done", file=sys.stderr, flush=True)
    return rows


def speed_worker(model: str) -> None:
    """Print the seconds of the second call."""
    from lambent.frame.frame import Frame

    rng = np.random.default_rng(0)

    def image(channels: int = 3) -> Any:
        return rng.random((720, 1280, channels), np.float32)

    colour, variance = image(), image()
    frame = Frame.from_arrays(
        colour=colour, albedo=image(), normal=image() * 2 - 1, depth=image(1) + 1, spp=4,
        colour_variance=variance, albedo_variance=image(), normal_variance=image(),
        depth_variance=image(1), diffuse=0.7 * colour, specular=0.3 * colour,
        diffuse_variance=variance, specular_variance=variance,
    )  # fmt: skip
    from lambent.denoise.pipeline import Settings, clean

    # the pipeline, since large frames go in tiles where memory is short
    settings = Settings.checked(model, "beauty", alpha=False)
    for _ in range(2):
        start = time.perf_counter()
        clean(frame, settings)
        seconds = time.perf_counter() - start
    print(json.dumps({"seconds": seconds}))


def speed(models: list[str]) -> dict[str, float]:
    """Seconds by model; those that take more than five minutes are left out."""
    found = {}
    for model in models:
        command = [sys.executable, __file__, "--speed-worker", model]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        except subprocess.TimeoutExpired:
            continue
        if done.returncode:
            print(f"{model}: {done.stderr.strip()[-200:]}", file=sys.stderr)
            continue
        found[model] = json.loads(done.stdout.splitlines()[-1])["seconds"]
        print(f"{model}: {found[model]:.2f} s", file=sys.stderr, flush=True)
    return found


def int8(data: Path, cache: Path, levels: list[int]) -> str:
    """A line for each network: error and seconds in int8 over those in float."""
    from dataclasses import replace
    from tempfile import TemporaryDirectory

    from lambent.filters.denoiser import create
    from lambent.frame.files import read
    from lambent.learn.export import export_run
    from lambent.learn.recipe import train_recipe_from
    from lambent.learn.tasks import TASKS
    from lambent.startup import cache_folder
    from lambent.training.run import Run

    lines = []
    with TemporaryDirectory() as folder:
        for name in ("kpcn", "dpcn", "modular"):
            run = Run(cache_folder() / "runs" / name)
            recipe = replace(train_recipe_from(run.recipe()), data=(str(data),))
            task = TASKS[recipe.task].make(recipe, cache_folder() / "training", lambda *_: None)
            path = Path(folder) / f"{name}.lambent"
            export_run(run, task, path, int8=True)
            worse, faster = [], []
            for frame_path in sorted(cache.glob("*spp.exr")):
                scene, _, spp = frame_path.stem.rpartition("-")
                if int(spp.removesuffix("spp")) not in levels or scene.endswith("-splat"):
                    continue
                frame = read(frame_path)
                errors, seconds = [], []
                for denoiser in (create(name), create(name, weights=str(path))):
                    denoiser(frame, "beauty")
                    start = time.perf_counter()
                    image = denoiser(frame, "beauty").colour
                    seconds.append(time.perf_counter() - start)
                    found = measured(image, cache / f"{scene}-reference.exr")
                    errors.append(max(found["relmse_trimmed"], 1e-7))
                worse.append(errors[1] / errors[0])
                faster.append(seconds[1] / seconds[0])
            lines.append([f"`{name}`", f"{geometric_mean(worse):.3f}", f"{max(worse):.3f}",
                          f"{geometric_mean(faster):.2f}"])  # fmt: skip
    head = ["int8", "relMSE ÷ float", "at most", "time ÷ float"]
    return markdown_table(head, lines)


def means(rows: list[Row]) -> dict[tuple[str, int], dict[str, float]]:
    """Geometric means over the scenes, of models that did all of them."""
    scenes = {row["scene"] for row in rows}
    found = {}
    for model in dict.fromkeys(row["model"] for row in rows):
        for spp in sorted({row["spp"] for row in rows}):
            own = [r for r in rows if r["model"] == model and r["spp"] == spp]
            if {r["scene"] for r in own} == scenes:
                found[model, spp] = {
                    key: geometric_mean(max(r[key], 1e-7) for r in own) for key in ERRORS
                }
    return found


def our_cost(size: str) -> Row:
    """Parameters and multiply-adds of our own network."""
    import torch

    from lambent.denoise.inputs import CHANNELS
    from lambent.learn.export import cost_of
    from lambent.learn.networks.lambent import LambentNet
    from lambent.learn.task import Exportable

    inputs = (torch.zeros(1, CHANNELS, 64, 64),)
    return cost_of(Exportable(LambentNet(size), inputs, "signals"))


def card_cells(model: str) -> list[str]:
    """Thousand multiply-adds a pixel, thousand parameters, hours of training."""
    from lambent.filters.denoiser import create

    card = dict(create(model).card()) if model != "noisy" else {}
    if model == "lambent":  # its card is from before costs were noted
        card |= our_cost(card["recipe"]["size"])
    macs, weights = card.get("macs"), card.get("parameters")
    return [
        f"{macs / 1e3:.0f}" if macs else "",
        f"{weights / 1e3:.0f}" if weights else "",
        f"{card['hours']:.1f}" if "hours" in card else "",
    ]


def tables(figures: dict[str, Any]) -> str:
    """The table, sorted by relMSE at the middle number of samples, and the papers' order."""
    rows, seconds = figures["rows"], figures["seconds"]
    by = means(rows)
    levels = sorted({spp for _, spp in by})
    middle = levels[len(levels) // 2]
    models = sorted(
        {model for model, _ in by}, key=lambda m: by.get((m, middle), {}).get("relmse_trimmed", 9)
    )

    def values(model: str, key: str, form: str) -> list[str]:
        return [form.format(by[model, n][key]) if (model, n) in by else "" for n in levels]

    lines, more = [], []
    for model in models:
        time_ = f"{seconds[model]:.2f}" if model in seconds else ""
        name = f"`{model}`"
        lines.append(
            [name, *values(model, "relmse_trimmed", "{:.4f}"), time_, *figures["costs"][model]]
        )
        more.append([name, *values(model, "dssim", "{:.3f}"), *values(model, "flip", "{:.3f}")])
    head = ["model", *(f"relMSE, {n} spp" for n in levels)]
    head += ["s, 1280x720", "kMAC/pixel", "k parameters", "hours"]
    second = ["model", *(f"{what}, {n} spp" for what in ("DSSIM", "FLIP") for n in levels)]
    remarks = []
    for better, worse, why in KNOWN:
        words = []
        for spp in levels:
            if (better, spp) in by and (worse, spp) in by:
                a, b = (by[m, spp]["relmse_trimmed"] for m in (better, worse))
                words.append(f"{spp} spp {'holds' if a < b else '**does not hold**'} ({a / b:.2f})")
        if words:
            remarks.append(f"- {why}: {', '.join(words)}")
    scenes = sorted({row["scene"] for row in rows})
    return (
        f"{len(scenes)} scenes: {', '.join(scenes)}. {figures['machine']}.\n\n"
        f"{markdown_table(head, lines)}\n\n{markdown_table(second, more)}\n\n"
        + "\n".join(remarks)
        + "\n"
    )


def main() -> None:
    if len(sys.argv) > 2 and sys.argv[1] == "--speed-worker":
        speed_worker(sys.argv[2])
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, default=default_cache().parent / "validation")
    parser.add_argument("--spp", default="1,4,32")
    parser.add_argument("--models", default="", help="names, with commas; default all")
    parser.add_argument("--no-speed", action="store_true")
    parser.add_argument("--rows", type=Path, metavar="JSON")
    parser.add_argument("--int8", type=Path, metavar="DATASET")
    parser.add_argument("--out", type=Path, help="path without suffix for .md and .json")
    arguments = parser.parse_args()
    models = [m for m in arguments.models.split(",") if m] or everything()
    levels = [int(n) for n in arguments.spp.split(",")]
    rows: list[Row] = []
    if arguments.rows is not None:
        rows = [r for r in json.loads(arguments.rows.read_text())["rows"] if r["spp"] in levels]
    known = {row["model"] for row in rows}
    rows += [
        row
        for row in quality([m for m in models if m not in known], arguments.cache, levels)
        if row["model"] not in known
    ]
    seconds = {} if arguments.no_speed else speed(models)
    costs = {name: card_cells(name) for name in {row["model"] for row in rows}}
    figures = {"machine": machine(), "costs": costs, "rows": rows, "seconds": seconds}
    text = tables(figures)
    if arguments.int8 is not None:
        text += f"\n{int8(arguments.int8, arguments.cache, levels)}\n"
    print(text)
    if arguments.out is not None:
        arguments.out.with_suffix(".md").write_text(text, encoding="utf-8")
        arguments.out.with_suffix(".json").write_text(json.dumps(figures), encoding="utf-8")


if __name__ == "__main__":
    main()
