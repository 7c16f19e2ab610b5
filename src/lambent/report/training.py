"""The page of a training run: curves of loss and validation, and validation pictures."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lambent.report.curve import curve
from lambent.report.page import build, escape, picture, save, table

#: Seconds after which the page of a running training loads itself again.
RELOAD = 30

Line = Mapping[str, Any]


def write_training(
    path: str | os.PathLike[str],
    name: str,
    lines: Sequence[Line],
    pictures: Sequence[tuple[bytes, tuple[int, int]]],
    *,
    steps: int,
    running: bool,
) -> Path:
    """Write the page.

    ``lines``: the run's log (steps with a loss, validations with ``check``). ``pictures``: PNGs
    with their sizes, each noisy, cleaned and target side by side. ``steps``: of the whole run.
    Raises `OutputError`.
    """
    return save(path, training_page(name, lines, pictures, steps, running))


def training_page(
    name: str,
    lines: Sequence[Line],
    pictures: Sequence[tuple[bytes, tuple[int, int]]],
    steps: int,
    running: bool,
) -> str:
    """The text of the page."""
    losses = [(line["step"], line["loss"]) for line in lines if "loss" in line]
    checks = [(line["step"], line["check"]) for line in lines if "check" in line]
    reload = f'<meta http-equiv="refresh" content="{RELOAD}">' if running else ""
    step = lines[-1]["step"] if lines else 0
    facts = [("Step", f"{step} of {steps}")]
    if losses:
        facts.append(("Loss", f"{losses[-1][1]:.4f}"))
        pace = [line["steps_a_second"] for line in lines if "steps_a_second" in line][-1]
        facts.append(("Pace", f"{pace:.2f} steps/s"))
        if running and pace > 0:
            facts.append(("To go", f"about {(steps - step) / pace / 60:.0f} min"))
    if checks:
        best = min(checks, key=lambda check: check[1]["score"])
        facts.append(("Best score", f"{best[1]['score']:.3f} at step {best[0]}"))
    terms = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts)
    body = f'{reload}<section><dl class="facts">{terms}</dl></section>'
    if len(losses) > 1:
        body += f"<section><h2>Loss</h2>{curve({'loss': losses})}</section>"
    if checks:
        known = {key for _, check in checks for key in check}
        shown = sorted(k for k in known if k.endswith("/oidn") or k.startswith("psnr"))
        curves = {
            key: [(s, check[key]) for s, check in checks if key in check]
            for key in [*shown, "score"]
        }
        if len(checks) > 1:
            words = "On held-out data; errors as ratios to OIDN's where the name says so"
            body += f"<section><h2>{words}</h2>{curve(curves)}</section>"
        body += f"<section><h2>Validation</h2>{_table(checks)}</section>"
    if pictures:
        figures = "".join(
            f"<figure>{picture(png, f'validation {k}', *size)}"
            f"<figcaption>noisy, cleaned, target</figcaption></figure>"
            for k, (png, size) in enumerate(pictures)
        )
        body += f'<section><h2>Pictures</h2><div class="gallery">{figures}</div></section>'
    state = "training" if running else "trained"
    return build(f"{name}, {state}", body, subtitle=escape(f"{step} steps"))


def _table(checks: Sequence[tuple[int, Mapping[str, float]]]) -> str:
    """The newest validations, one a row; plain errors are left out where there is a ratio."""
    names = list(checks[-1][1])
    names = [n for n in names if f"{n}/oidn" not in names]
    rows = [
        [str(step), *(f"{check.get(name, math.nan):.3f}" for name in names)]
        for step, check in checks[-12:]
    ]
    return table(["step", *map(escape, names)], rows, caption="Validation scores", kind="sortable")
