"""The page of a solve: the light as it grows, the residual, the patches, where the power goes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.exposure import auto_exposure
from lambent.frame.tonemap import to_png
from lambent.metrics.compare import number
from lambent.report.curve import curve
from lambent.report.page import build, escape, picture, save, table
from lambent.transport.radiosity.solution import RadiositySolution

#: Seconds after which a page of a running solve loads itself again.
RELOAD = 4
#: How many pictures of the growing light the strip shows.
STRIP = 8

Image = NDArray[np.float32]
_WORDS = {
    "smooth": "irradiance interpolated, times the texture",
    "mesh": "the patches",
    "irradiance": "light that arrives, without textures",
    "residual": "where the solution does not yet agree with itself",
}


def write_solving(
    path: str | os.PathLike[str],
    name: str,
    solution: RadiositySolution,
    pictures: Mapping[str, Image],
    grown: Sequence[tuple[int, Image]],
    *,
    balance: Mapping[str, float],
    areas: NDArray[np.float64],
    running: bool,
) -> Path:
    """Write the page.

    ``pictures``: kind of view -> ``(H, W, 3)`` radiance; ``grown``: after which step, and the
    smooth view; ``balance``: watts; ``areas``: of the patches. Raises `OutputError`.
    """
    history = solution.history
    exposure = auto_exposure(pictures["smooth"])
    reload = f'<meta http-equiv="refresh" content="{RELOAD}">' if running else ""
    residual = history.residuals[-1] if history.residuals else float("nan")
    facts = [
        ("Patches", f"{len(solution):,}"),
        ("Faces that see light", f"{int(solution.live.sum()):,}"),
        ("Solver", f"{solution.settings.get('solver')}, step {len(history.steps)}"),
        ("Residual", f"{residual:.1e}"),
    ]
    if solution.error is not None:
        facts.append(("Error of a patch's indirect light", f"{100 * solution.error:.1f} %"))
    facts += [(f"Time, {what}", f"{s:.1f} s") for what, s in solution.seconds.items()]
    terms = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts)
    body = f'{reload}<section><dl class="facts">{terms}</dl></section>'
    body += (
        f'<section class="growing">{_shown(pictures["smooth"], exposure, "the light")}</section>'
    )
    if len(history.steps) > 1:
        points = list(zip(history.steps, history.residuals, strict=True))
        body += f"<section><h2>Residual</h2>{curve({'residual': points}, across='step')}</section>"
    if len(grown) > 1:
        chosen = np.unique(
            np.linspace(0, len(grown) - 1, min(STRIP, len(grown))).round().astype(int)
        )
        strip = "".join(_figure(grown[k][1], exposure, f"step {grown[k][0]}") for k in chosen)
        body += f'<section><h2>How it grew</h2><div class="gallery">{strip}</div></section>'
    others = [kind for kind in pictures if kind != "smooth"]
    if others:
        made = "".join(
            _figure(
                pictures[kind],
                exposure if kind == "mesh" else auto_exposure(pictures[kind]),
                f"{kind}: {_WORDS.get(kind, '')}",
            )
            for kind in others
        )
        body += f'<section><h2>Views</h2><div class="gallery">{made}</div></section>'
    body += f"<section><h2>Patches</h2>{_patches(areas)}</section>"
    body += f"<section><h2>Power</h2>{_power(balance)}</section>"
    body += "".join(f'<p class="note">{escape(note)}</p>' for note in solution.notes)
    if solution.interrupted:
        body += '<p class="note">The solver was interrupted; --resume goes on.</p>'
    state = "solving" if running else "solved"
    return save(path, build(f"{name}, {state}", body, subtitle="radiosity"))


def _shown(image: Image, exposure: float, words: str) -> str:
    return picture(to_png(image, exposure), words, image.shape[1], image.shape[0])


def _figure(image: Image, exposure: float, words: str) -> str:
    made = _shown(image, exposure, words)
    return f"<figure>{made}<figcaption>{escape(words)}</figcaption></figure>"


def _patches(areas: NDArray[np.float64]) -> str:
    length = np.sqrt(areas)
    rows = [
        [name, number(float(value))]
        for name, value in (
            ("smallest", length.min()), ("median", np.median(length)), ("largest", length.max()),
            ("all, area", areas.sum()),
        )
    ]  # fmt: skip
    return table(["", "length (area: square)"], rows, caption="Sizes of the patches")


def _power(balance: Mapping[str, Any]) -> str:
    words = {
        "emitted": "leaves lamps that are surfaces",
        "direct": "arrives straight from emitters",
        "reflected": "leaves by reflection, all bounces",
        "absorbed": "stays in the surfaces",
        "escaped": "leaves the scene, or ends on something black, after a reflection",
    }
    rows = [[escape(words[k]), number(v)] for k, v in balance.items()]
    return table(["", "watts"], rows, caption="Power, mean of the channels")
