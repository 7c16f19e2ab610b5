"""How many training crops an hour, and where the time goes.

    python benchmarks/data_rate.py [RECIPE] [--count 96] [--processes 1] [--device auto]

Makes crops of a recipe (default: ``recipes/mitsuba.toml``) into a folder that is thrown away,
from whole scenes, cold start and all; prints crops an hour, bytes a crop, the targets' worth,
and the share of each kind of work: planning a scene, building it (BVH and textures), the first pass
(tracing, and compiling what is not cached), pilots, noise levels, targets, encoding.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import platform
import statistics
import tempfile
import time
from pathlib import Path

from lambent.dataset.folder import read_lines
from lambent.dataset.make import make
from lambent.dataset.recipe import load_recipe

RECIPE = Path(__file__).parents[1] / "recipes" / "mitsuba.toml"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recipe", type=Path, nargs="?", default=RECIPE)
    parser.add_argument("--count", type=int, default=96)
    parser.add_argument("--clips", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--target-spp", type=int, default=0, help="instead of the recipe's")
    arguments = parser.parse_args()
    recipe = load_recipe(arguments.recipe)
    recipe = dataclasses.replace(recipe, count=arguments.count, clip_count=arguments.clips)
    if arguments.target_spp:
        recipe = dataclasses.replace(recipe, target_spp=arguments.target_spp)
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        outcome = make(
            recipe, folder, processes=arguments.processes, device=arguments.device,
            progress=lambda done, total, text: print(f"\r{done:.0f}/{total:.0f} {text}   ", end=""),
        )  # fmt: skip
        seconds = time.perf_counter() - start
        lines = list(read_lines(Path(folder)).values())
    pictures = sum(line["frames"] for line in lines)
    targets = [n for line in lines for n in line["target_spp"]]
    errors = [e for line in lines for e in line["target_error"]]
    levels = [sum(line["spp"]) for line in lines]
    print(
        f"\r{platform.machine()}, {os.cpu_count()} processors, {arguments.processes} process(es)\n"
    )
    print("| crops | an hour | target spp, mean | target relMSE, median | levels spp, mean | MB |")
    print("| --- | --- | --- | --- | --- | --- |")
    print(
        f"| {pictures} of {recipe.crop}x{recipe.crop} | {pictures / seconds * 3600:,.0f} "
        f"| {statistics.mean(targets):.0f} | {statistics.median(errors):.3g} "
        f"| {statistics.mean(levels):.0f} | {outcome.bytes / max(outcome.made, 1) / 1e6:.2f} |\n"
    )
    print("| work | seconds | share |")
    print("| --- | --- | --- |")
    busy = seconds * arguments.processes
    for name, spent in sorted(outcome.phases.items(), key=lambda entry: -entry[1]):
        print(f"| {name} | {spent:.1f} | {100 * spent / busy:.1f} % |")
    rest = busy - sum(outcome.phases.values())
    print(f"| start, writing, waiting | {rest:.1f} | {100 * rest / busy:.1f} % |")
    for failed in outcome.failed:
        print(f"failed: {failed.job.what} {failed.job.number}: {failed.reason}")


if __name__ == "__main__":
    main()
