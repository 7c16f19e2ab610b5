"""Measure images against a reference, as a table or as one self-contained page.

REF is the noise-free reference, the others are measured against it. All are shown at the exposure
of the reference. relMSE is printed with and without the worst 0.1 % of pixels (fireflies).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lambent.cli.options import (
    JsonOption,
    OverwriteOption,
    check_output,
    page_for,
    print_json,
    report_option,
)
from lambent.cli.progress import Progress
from lambent.cli.terminal import say

if TYPE_CHECKING:
    from lambent.metrics.compare import Comparison

EPILOG = "Example: lambent compare reference.exr noisy.exr clean.exr --report page.html"


def complete_metrics(incomplete: str) -> list[str]:
    """For the shell: names of metrics that begin like this."""
    from lambent.metrics.metric import METRICS

    return [name for name in METRICS if name.startswith(incomplete)]


def compare(
    reference: Annotated[Path, typer.Argument(metavar="REF", help="The reference.")],
    images: Annotated[list[Path], typer.Argument(metavar="A B C...", help="What to measure.")],
    metrics: Annotated[
        str | None,
        typer.Option(
            "--metrics",
            metavar="NAME,...",
            help="Only these metrics; 'flip' stands for both FLIPs.",
            autocompletion=complete_metrics,
        ),
    ] = None,
    report: Annotated[
        str | None, report_option("Write a page to compare by eye", "the first image")
    ] = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Typer's view of the command; the module docstring is its help."""
    from lambent.metrics.compare import compare as measure
    from lambent.metrics.metric import chosen

    chosen(metrics)  # a wrong name before files are read
    _check_inputs([reference, *images])
    page = page_for(report, images[0].with_name(f"{images[0].stem}_comparison.html"))
    check_output(page, overwrite, [reference, *images])
    with Progress("comparing", quiet=as_json) as progress:
        comparison = measure(
            reference,
            _named(images),
            metrics,
            progress=progress.report,
        )
        if page is not None:
            from lambent.report import write_report

            progress.report(0, 1, "writing the page")
            write_report(page, comparison)
    if as_json:
        found = comparison.as_dict()
        print_json({**found, "report": None if page is None else str(page)})
        return
    _print_table(comparison)
    if page is not None:
        say("", page)


# ------------------------------------------------------------------- private


def _named(images: list[Path]) -> dict[str, Path]:
    """Names for the table: stems, or as much of the paths as it takes to tell them apart."""
    names = [path.stem for path in images]
    if len(set(names)) < len(names):
        names = [str(path) for path in images]
    unique: dict[str, Path] = {}
    for name, path in zip(names, images, strict=True):
        count = 1
        while (name if count == 1 else f"{name} ({count})") in unique:
            count += 1
        unique[name if count == 1 else f"{name} ({count})"] = path
    return unique


def _check_inputs(paths: list[Path]) -> None:
    """All missing files in one message, before any is read."""
    from lambent.errors import FileError
    from lambent.frame.opening import exists

    missing = [path for path in paths if not exists(path)]
    if missing:
        others = ", ".join(str(path) for path in missing[1:])
        raise FileError(
            "there is no such file" + (f" (nor {others})" if others else ""),
            file=missing[0],
            remedy="check the path; the reference comes first",
        )


def _print_table(comparison: Comparison) -> None:
    """Images down, metrics across; a star at the best; turned round where it does not fit."""
    import shutil

    from lambent.escapes import escaped
    from lambent.metrics.compare import number
    from lambent.metrics.metric import METRICS

    kinds = [METRICS[name] for name in comparison.metrics]
    arrows = {"lower": "↓", "higher": "↑"}
    heads = [f"{kind.title} {arrows[kind.better]}" for kind in kinds]
    best = {kind.name: comparison.best(kind.name) for kind in kinds}
    names = [escaped(row.name) for row in comparison.rows]
    cells = [
        [
            number(row.values[kind.name]) + ("*" if row.name in best[kind.name] else " ")
            for kind in kinds
        ]
        for row in comparison.rows
    ]
    width = shutil.get_terminal_size((100, 24)).columns
    table = [["", *heads], *([name, *line] for name, line in zip(names, cells, strict=True))]
    if _table_width(table) > width:
        table = [list(column) for column in zip(*table, strict=True)]
    size = f"{comparison.size[0]}x{comparison.size[1]}"
    reference = comparison.reference
    spp = f", {reference.spp} spp" if reference is not None and reference.spp else ""
    if reference is not None:
        say(f"Against {reference.path} ({size}{spp}), exposure {comparison.exposure:.3g}", "")
    for line in _lined_up(table):
        say(line)
    if any(best.values()):
        say("", "* the best of these")
    for note in comparison.notes():
        say(f"note: {note}")


def _table_width(table: list[list[str]]) -> int:
    columns = zip(*table, strict=True)
    return sum(max(map(len, column)) + 2 for column in columns) - 2


def _lined_up(table: list[list[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for row in table:
        first, *rest = row
        line = first.ljust(widths[0])
        line += "".join(f"  {c:>{w}}" for c, w in zip(rest, widths[1:], strict=True))
        lines.append(line.rstrip())
    return lines
