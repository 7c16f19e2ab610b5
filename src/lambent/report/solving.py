"""The page of a solve: the light as it grows, its residual, views, and what the method lists."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.exposure import auto_exposure
from lambent.frame.tonemap import to_png
from lambent.metrics.compare import number
from lambent.render.scene import LoadedScene
from lambent.report.curve import curve
from lambent.report.page import build, escape, picture, save, table
from lambent.transport.methods import View
from lambent.transport.scene import load_for_light
from lambent.transport.solution import Solution, method_of
from lambent.transport.solution import picture as render

#: Seconds after which a page of a running solve loads itself again.
RELOAD = 4
#: How many pictures of the growing light the strip shows.
STRIP = 8
#: Longer side of its pictures in pixels, at most; samples a pixel.
SIDE, SPP = 640, 8

Image = NDArray[np.float32]


class SolvingPage:
    """The page, written again while the light grows; the solver says how often.

    ``parameters``: values of the scene's ``$names``. `show` and `finish` raise `OutputError`.
    """

    def __init__(
        self, scene: str | os.PathLike[str], path: Path, parameters: dict[str, Any]
    ) -> None:
        self.scene, self.path, self.parameters = Path(scene), path, parameters
        self._loaded: LoadedScene | None = None
        self._views: dict[str, View] = {}
        #: The default view after which step.
        self._grown: list[tuple[int, Image]] = []

    def show(self, solution: Solution) -> None:
        """After a step of the solver."""
        self._grow(solution)
        self._write(solution, {}, running=True)

    def finish(self, solution: Solution) -> None:
        """With the final pictures, and no more reloading; after Ctrl-C without new ones."""
        if solution.interrupted:
            if self._grown:
                self._write(solution, {}, running=False)
            return
        self._grow(solution)
        views = {kind: self._picture(solution, kind) for kind in method_of(solution).page}
        self._write(solution, views, running=False)

    # --------------------------------------------------------------- private

    def _grow(self, solution: Solution) -> None:
        steps = solution.residuals()
        shown = self._picture(solution, method_of(solution).show(None))
        self._grown.append((steps[-1][0] if steps else 0, shown))

    def _scene(self) -> LoadedScene:
        if self._loaded is None:
            loaded = load_for_light(self.scene, parameters=self.parameters)
            width, height = loaded.sensor.film().crop_size()
            scale = min(1.0, SIDE / max(width, height))
            size = max(1, round(width * scale)), max(1, round(height * scale))
            self._loaded = load_for_light(self.scene, parameters=self.parameters, size=size)
        return self._loaded

    def _picture(self, solution: Solution, kind: str) -> Image:
        if kind in self._views:
            self._views[kind].update(solution)
        else:
            self._views[kind] = solution.integrator(kind)
        return render(self._views[kind], self._scene(), spp=SPP, features="none").colour

    def _write(self, solution: Solution, views: dict[str, Image], running: bool) -> None:
        method = method_of(solution)
        light = self._grown[-1][1]
        exposure = auto_exposure(light)
        reload = f'<meta http-equiv="refresh" content="{RELOAD}">' if running else ""
        facts = ((name[:1].upper() + name[1:], text) for name, text in solution.facts().items())
        terms = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts)
        body = f'{reload}<section><dl class="facts">{terms}</dl></section>'
        body += f'<section class="growing">{_shown(light, exposure, "the light")}</section>'
        steps = solution.residuals()
        if len(steps) > 1:
            made = curve({"residual": list(steps)}, across="step")
            body += f"<section><h2>Residual</h2>{made}</section>"
        if len(self._grown) > 1:
            body += _gallery(
                "How it grew",
                [(image, exposure, f"step {k}") for k, image in _some(self._grown)],
            )
        if views:
            body += _gallery(
                "Views",
                [
                    (image, auto_exposure(image), f"{kind}: {method.shows[kind]}")
                    for kind, image in views.items()
                ],
            )
        for title, (heading, numbers) in solution.tables(self._scene().scene).items():
            rows = [[escape(name), number(float(value))] for name, value in numbers.items()]
            listed = table(["", escape(heading)], rows, caption=escape(title))
            body += f"<section><h2>{escape(title)}</h2>{listed}</section>"
        notes = list(solution.notes)
        if solution.interrupted:
            notes.append("The solver was interrupted; --resume goes on.")
        body += "".join(f'<p class="note">{escape(note)}</p>' for note in notes)
        state = "solving" if running else "solved"
        page = build(f"{self.scene.name}, {state}", body, subtitle=escape(method.name))
        save(self.path, page)


def _some(grown: list[tuple[int, Image]]) -> list[tuple[int, Image]]:
    """At most `STRIP`, evenly, with the first and the last."""
    chosen = np.linspace(0, len(grown) - 1, min(STRIP, len(grown))).round().astype(int)
    return [grown[k] for k in np.unique(chosen)]


def _gallery(title: str, images: list[tuple[Image, float, str]]) -> str:
    figures = "".join(
        f"<figure>{_shown(image, exposure, words)}<figcaption>{escape(words)}</figcaption></figure>"
        for image, exposure, words in images
    )
    return f'<section><h2>{title}</h2><div class="gallery">{figures}</div></section>'


def _shown(image: Image, exposure: float, words: str) -> str:
    return picture(to_png(image, exposure), words, image.shape[1], image.shape[0])
