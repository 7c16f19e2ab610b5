"""What each choice does: the same small network trained again with one thing changed.

    python benchmarks/ablations.py blocks --data DATASET [--steps 400] [--out docs/results/blocks]
    python benchmarks/ablations.py dncnn --data PICTURES [--steps 500] [--out docs/results/dncnn]
    python benchmarks/ablations.py source --data DATASET --start RUN [--out docs/results/source]

``blocks``: the small denoiser of `lambent.learn.networks.blocks` on crops of a data set made by
``lambent dataset make``: activation, batch normalisation, optimiser, loss, kind of block, one
changed at a time from (ReLU, none, Adam, L1, plain); all at equal multiply-adds a pixel. The score
is that of held-out crops: the geometric mean of trimmed relMSE and SMAPE over those of OIDN High.

``dncnn``: the ablation of Zhang et al. 2017, fig. 2: residual learning on and off, batch
normalisation on and off, Adam and stochastic gradient descent with momentum; PSNR on held-out
pictures, grey, sigma 25, in a narrower and shorter network than the paper's (``--depth 9 --width
32``), so that they fit into minutes. Weights begin as in the paper; ``small``: the last layer's
near 0, so that the first result is the noisy picture.

``source``: how much data another renderer needs (Vogels et al. 2018, sec. 4.2): the network of RUN
(`lambent train recipes/train/modular.toml`) on a small data set of another renderer as it is, with
a fresh source encoder on its frozen trunk, all of it trained on, and a fresh network.

Every optimiser runs at each of its learning rates (``RATES``) for a quarter of the steps first and
goes on with the best of them. Runs are kept in the cache and go on where they were stopped. Prints
a table; ``--out`` writes it as Markdown, all curves as JSON, and a plot as SVG.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from filters import machine, markdown_table

Row = dict[str, Any]

#: Learning rates that are tried, by optimiser.
RATES = {"adam": (1e-3, 3e-3), "momentum": (1e-2, 1e-1), "sgd": (3e-2, 3e-1)}
#: The same for `dncnn`, whose loss is a sum over a patch; gradients are held to norm 1, as the
#: authors' code holds them to some norm.
SUM_RATES = {"adam": (1e-3,), "momentum": (3e-3, 3e-2, 3e-1)}
#: Groups of runs, each with the key that changes and its values; the first of each is the base.
BLOCKS: dict[str, list[tuple[str, Row]]] = {
    "activation": [
        (name, {"options": {"activation": name}})
        for name in ("relu", "sigmoid", "tanh", "leaky-relu", "elu", "maxout")
    ],
    "normalisation": [
        ("relu, batch norm", {"options": {"norm": True}}),
        ("sigmoid, batch norm", {"options": {"norm": True, "activation": "sigmoid"}}),
    ],
    "optimiser": [("momentum", {"optimiser": "momentum"}), ("sgd", {"optimiser": "sgd"})],
    "loss": [("l2", {"options": {"loss": "l2"}}), ("smape", {"options": {"loss": "smape"}})],
    "block": [
        ("residual", {"options": {"block": "residual"}}),
        ("attention", {"options": {"block": "attention"}}),
    ],
}


def dncnn_runs() -> Iterator[tuple[str, Row]]:
    """Eight runs, and those with residual learning once more from a small last layer."""
    for optimiser in ("adam", "momentum"):
        for residual in (True, False):
            for norm in (True, False):
                words = ["residual" if residual else "direct", "BN" if norm else "no BN"]
                words.append("Adam" if optimiser == "adam" else "SGD")
                options = {"residual": residual, "norm": norm}
                yield ", ".join(words), {"optimiser": optimiser, "options": options}
                if residual:
                    small = {**options, "small_start": True}
                    yield ", ".join([*words, "small"]), {"optimiser": optimiser, "options": small}


def learned(label: str, settings: Row, task_of: Any, folder: Path, start: Any = None) -> Row:
    """Train one variant, or go on; its curve ``[[step, score], …]``, seconds and learning rate.

    A curve that leaves the numbers is kept up to there, and said to have diverged.
    """
    from lambent.learn.recipe import train_recipe_from
    from lambent.learn.train import train_task as train
    from lambent.training.run import Run

    rates = settings.pop("rates")
    steps = int(settings["steps"])
    found: list[tuple[float, float, Run]] = []
    for rate in rates:
        recipe = train_recipe_from({**settings, "rate": rate})
        short = steps if len(rates) == 1 else max(int(settings["check_every"]), steps // 4)
        place = folder / recipe.name / f"{rate:g}"
        task = task_of(recipe)
        begin = task.started(start) if start is not None else None
        run = train(
            recipe, task, place, "cpu", start=begin, steps=short, check_first=begin is not None
        )
        scores = [ln["check"]["score"] for ln in run.lines() if "check" in ln]
        last = scores[-1] if scores and math.isfinite(scores[-1]) else math.inf
        found.append((last, rate, run))
    _, rate, run = min(found, key=lambda f: f[0])
    recipe = train_recipe_from({**settings, "rate": rate})
    run = train(recipe, task_of(recipe), run.folder, "cpu")
    curve = [[ln["step"], ln["check"]["score"]] for ln in run.lines() if "check" in ln]
    seconds = json.loads((run.folder / "run.json").read_text())["seconds"]
    sound = [point for point in curve if math.isfinite(point[1])]
    row = {"label": label, "rate": rate, "seconds": seconds, "curve": sound}
    print(f"{label}: {sound[-1][1] if sound else 'diverged'}", file=sys.stderr, flush=True)
    return row


def blocks(arguments: argparse.Namespace) -> list[Row]:
    """Train the building blocks."""
    from lambent.learn.cache import cached
    from lambent.learn.rendered import RenderedTask
    from lambent.startup import cache_folder

    stills = cached(arguments.data, cache_folder() / "training")
    tasks: dict[str, Any] = {}

    def task_of(recipe: Any) -> Any:
        key = json.dumps(recipe.as_dict(), sort_keys=True)
        if key not in tasks:
            tasks.clear()
            tasks[key] = RenderedTask(recipe, stills)
        return tasks[key]

    rows = []
    for group, variants in BLOCKS.items():
        for label, change in variants:
            optimiser = change.get("optimiser", "adam")
            settings = {
                "name": f"blocks-{label.replace(', ', '-').replace(' ', '-')}",
                "task": "blocks", "data": [str(arguments.data)], "steps": arguments.steps,
                "batch": 4, "warmup": 20, "decay": 0.99, "checked": 40,
                "check_every": max(1, arguments.steps // 10), "optimiser": optimiser,
                "options": {"width": arguments.width or 16, **change.get("options", {})},
                "rates": RATES[optimiser],
            }  # fmt: skip
            rows.append({"group": group, **learned(label, settings, task_of, arguments.runs)})
    return rows


def dncnn(arguments: argparse.Namespace) -> list[Row]:
    """Train the eight of the paper's figure."""
    from lambent.learn.photo import PhotoTask, photographs

    pictures = photographs(arguments.data)
    rows = []
    for label, change in dncnn_runs():
        settings = {
            "name": "dncnn-" + label.lower().replace(", ", "-").replace(" ", "-"),
            "task": "photo", "data": [str(arguments.data)], "steps": arguments.steps,
            "batch": 16, "warmup": 20, "decay": 0.98, "clip": 1.0, "checked": 3,
            "check_every": max(1, arguments.steps // 8), "optimiser": change["optimiser"],
            "options": {
                "sigma_low": 25.0, "sigma_high": 25.0, "colour": False, "patch": 40,
                "depth": arguments.depth, "width": arguments.width or 32, "small_start": False,
                **change["options"],
            },
            "rates": SUM_RATES[change["optimiser"]],
        }  # fmt: skip
        row = learned(label, settings, lambda r: PhotoTask(r, pictures), arguments.runs)
        # a score is an error in 255ths
        row["curve"] = [[step, -20 * math.log10(score / 255)] for step, score in row["curve"]]
        rows.append({"group": change["optimiser"], **row})
    return rows


def source(arguments: argparse.Namespace) -> list[Row]:
    """Another renderer's frames on a network that knows one."""
    from lambent.learn.cache import cached
    from lambent.learn.rendered import RenderedTask
    from lambent.startup import cache_folder
    from lambent.training.run import Run

    stills = cached(arguments.data, cache_folder() / "training")
    run = Run(arguments.start or cache_folder() / "runs" / "modular")
    own = run.recipe()["options"]
    rows = []
    for label, begins, frozen in (
        ("fresh encoder, frozen trunk", True, True),
        ("trained on as a whole", True, False),
        ("fresh network", False, False),
    ):
        settings = {
            "name": f"source-{label.replace(', ', '-').replace(' ', '-')}", "task": "modular",
            "data": [str(arguments.data)], "steps": arguments.steps, "batch": 8, "warmup": 20,
            "decay": 0.98, "check_every": max(1, arguments.steps // 10), "checked": 40,
            "held_out": 0.3, "options": {**own, "frozen": frozen}, "rates": (2e-3,),
        }  # fmt: skip
        start = run.weights() if begins else None
        row = learned(label, settings, lambda r: RenderedTask(r, stills), arguments.runs, start)
        rows.append({"group": "", **row})
        if begins and not frozen:  # its first validation is that of the network as it came
            first = [row["curve"][0], *([step, row["curve"][0][1]] for step, _ in row["curve"][1:])]
            rows.append({**row, "group": "", "label": "as it is", "seconds": 0, "curve": first})
    return rows


def table(rows: list[Row], what: str) -> str:
    """As Markdown, in the order of the runs."""
    word = "PSNR, dB" if what == "dncnn" else "score (1 = OIDN High)"
    lines = []
    for row in rows:
        values = dict((step, value) for step, value in row["curve"])
        steps = sorted(values)
        form = "{:.2f}" if what == "dncnn" else "{:.3f}"
        at = [steps[len(steps) // 4], steps[len(steps) // 2], steps[-1]] if steps else []
        cells = [form.format(values[s]) for s in at] or ["diverged"] * 3
        lines.append([row["group"], row["label"], *cells, f"{row['rate']:g}",
                      f"{row['seconds']:.0f}"])  # fmt: skip
    steps = sorted({step for row in rows for step, _ in row["curve"]})
    named = [steps[len(steps) // 4], steps[len(steps) // 2], steps[-1]]
    head = ["", "variant", *(f"{word}, step {s}" for s in named), "learning rate", "seconds"]
    return markdown_table(head, lines)


def plot(rows: list[Row], what: str) -> str:
    """The curves as SVG, one colour a group: PSNR goes up, a score, logarithmic, down."""
    width, height, left, right, top, bottom = 860, 430, 56, 210, 16, 34
    rows = [row for row in rows if row["curve"]]
    rises = what == "dncnn"
    scale = (lambda v: v) if rises else math.log10
    ys = sorted(scale(y) for row in rows for _, y in row["curve"])
    x1 = max(x for row in rows for x, _ in row["curve"])
    # the worst tenth may leave the picture, or the others could not be told apart
    y0, y1 = (ys[len(ys) // 10], ys[-1]) if rises else (ys[0], ys[-1 - len(ys) // 10])
    colours = ["#0b6e99", "#c2410c", "#15803d", "#7e22ce", "#a16207", "#be123c"]
    groups = list(dict.fromkeys(row["group"] for row in rows))

    def at(x: float, y: float) -> tuple[float, float]:
        share = min(max((scale(y) - y0) / (y1 - y0), 0), 1)
        across = left + x / x1 * (width - left - right)
        return across, height - bottom - share * (height - bottom - top)

    marks = [
        "<style>text{font:12px system-ui,sans-serif;fill:#333}polyline{fill:none;stroke-width:1.7}"
        "line{stroke:#ddd}rect{fill:#fff}</style>",
        f'<rect width="{width}" height="{height}"/>',
    ]
    for k in range(6):
        y = y0 + (y1 - y0) * k / 5
        value = y if rises else 10**y
        _, v = at(0, value)
        marks.append(f'<line x1="{left}" x2="{width - right}" y1="{v:.1f}" y2="{v:.1f}"/>')
        marks.append(f'<text x="{left - 6}" y="{v + 4:.1f}" text-anchor="end">{value:.3g}</text>')
    word = "PSNR in dB" if rises else "error over OIDN High's, logarithmic"
    marks.append(f'<text x="{left}" y="{height - 10}">{word}, over steps (to {x1:g})</text>')
    ends = []
    for row in rows:
        colour = colours[groups.index(row["group"]) % len(colours)]
        there = [at(x, y) for x, y in row["curve"]]
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in there)
        marks.append(f'<polyline points="{line}" stroke="{colour}"/>')
        ends.append((there[-1][1], row["label"], colour))
    ends.sort()
    places = [end[0] for end in ends]
    for k in range(1, len(places)):  # names do not lie on one another
        places[k] = max(places[k], places[k - 1] + 14)
    places[-1] = min(places[-1], height - bottom)
    for k in range(len(places) - 2, -1, -1):  # nor below the picture
        places[k] = min(places[k], places[k + 1] - 14)
    for place, (_, label, colour) in zip(places, ends, strict=True):
        x, y = width - right + 8, place + 4
        marks.append(f'<text x="{x}" y="{y:.1f}" style="fill:{colour}">{label}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
        f"{''.join(marks)}</svg>\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("blocks", "dncnn", "source"))
    parser.add_argument("--data", type=Path, required=True, help="a data set, or pictures")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--width", type=int, default=0)
    parser.add_argument("--depth", type=int, default=9)
    parser.add_argument("--start", type=Path, help="for source: the run to begin with")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--runs", type=Path, help="folder of the runs; default in the cache")
    parser.add_argument("--out", type=Path, help="path without suffix for .md, .json and .svg")
    arguments = parser.parse_args()
    from lambent.startup import cache_folder
    from lambent.training.process import use_threads

    use_threads(arguments.threads)
    arguments.runs = arguments.runs or cache_folder() / "runs" / "ablations"
    make = {"blocks": blocks, "dncnn": dncnn, "source": source}[arguments.what]
    rows = make(arguments)
    text = f"{machine()}; {arguments.steps} steps.\n\n{table(rows, arguments.what)}\n"
    print(text)
    if arguments.out is not None:
        arguments.out.with_suffix(".md").write_text(text, encoding="utf-8")
        arguments.out.with_suffix(".json").write_text(json.dumps(rows), encoding="utf-8")
        arguments.out.with_suffix(".svg").write_text(plot(rows, arguments.what), encoding="utf-8")


if __name__ == "__main__":
    main()
