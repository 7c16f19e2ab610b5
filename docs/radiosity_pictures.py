"""Makes the pictures of the page on radiosity, in ``docs/pictures/``.

    python docs/radiosity_pictures.py SCENES_DIR [--only room,growing,living,curve]

``radiosity_room.jpg``: the Cornell box as patches, smooth, with final gather, and by path tracing.
``radiosity_growing.jpg``: progressive refinement, from the lamp's first shot on.
``radiosity_living.jpg``: ``living-room``, taken as diffuse. ``radiosity_error.svg``: error over
patches, from the JSON of ``benchmarks/radiosity.py accuracy`` (``--curve NAME=FILE.json``). The
film of the page is made by the command that the page shows.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lambent.frame.exposure import auto_exposure
from lambent.frame.tonemap import to_uint8
from lambent.render.variant import mitsuba

HERE = Path(__file__).resolve().parent
OUT = HERE / "pictures"
GAP, PAPER, INK = 4, (250, 249, 246), (40, 40, 40)
#: Shots of progressive refinement after which a picture is taken.
SHOTS = (1, 16, 200, 1000, 20000)


def strip(images: list[Any], exposure: float, names: list[str], path: Path) -> None:
    """Pictures side by side with a name of one or more lines under each."""
    cells = [Image.fromarray(to_uint8(image, exposure)) for image in images]
    width = sum(c.width + GAP for c in cells) - GAP
    lines = max(name.count("\n") + 1 for name in names)
    made = Image.new("RGB", (width, cells[0].height + 6 + 19 * lines), PAPER)
    draw, font, x = ImageDraw.Draw(made), ImageFont.load_default(15), 0
    for cell, name in zip(cells, names, strict=True):
        made.paste(cell, (x, 0))
        draw.text((x + 2, cell.height + 3), name, INK, font)
        x += cell.width + GAP
    made.save(path, quality=82)
    print(path)


def traced(loaded: Any, spp: int) -> Any:
    """The diffuse world by path tracing."""
    from lambent.render.sampling import FrameSampler

    path = mitsuba().load_dict({"type": "lambent_diffuse"})
    sampler = FrameSampler(loaded.scene, loaded.sensor, features="none", integrator=path)
    return sampler.sample(spp, 1).frame().colour


def room(scenes: Path) -> None:
    """The Cornell box in four ways."""
    from lambent.transport.radiosity.settings import Settings
    from lambent.transport.radiosity.solve import solve
    from lambent.transport.scene import load_for_light
    from lambent.transport.solution import picture

    loaded = load_for_light(scenes / "cornell-box" / "scene.xml", size=(240, 240))
    found = solve(loaded, Settings(patches=4000, adaptive=True))
    ways = (("mesh", 16), ("smooth", 64), ("gather", 256))
    images = [picture(found.integrator(w), loaded, spp, "none").colour for w, spp in ways]
    images.append(traced(loaded, 1024))
    names = ["patches (adaptive)", "smooth", "final gather, 256 spp", "path tracing, 1024 spp"]
    strip(images, 1.2 * auto_exposure(images[-1]), names, OUT / "radiosity_room.jpg")


def growing(scenes: Path) -> None:
    """Progressive refinement from the first shot on; all light, the lamp's too, goes through F."""
    from lambent.phases import Phases
    from lambent.transport.radiosity.settings import Settings
    from lambent.transport.radiosity.solve import solve
    from lambent.transport.radiosity.solvers import southwell
    from lambent.transport.radiosity.system import system_of
    from lambent.transport.scene import load_for_light
    from lambent.transport.solution import picture
    from lambent.transport.surfaces import surfaces_of

    loaded = load_for_light(scenes / "cornell-box" / "scene.xml", size=(200, 200))
    settings = Settings(patches=4000, direct="factors", factors="pairs")
    solved = solve(loaded, settings)
    patches = solved.patches_on(surfaces_of(loaded.scene))
    system = system_of(loaded, patches, settings, Phases(), lambda *_: None)
    at, rho, area = system.faces, system.equation.reflectance, system.equation.area
    emission = system.emission[at]
    eq = replace(system.equation, first=emission)
    whole = solved.reflected[at]
    images, names, shown = [], [], solved.integrator("smooth")
    for shots, x in enumerate(southwell(eq, every=1), 1):
        if shots not in SHOTS:
            continue
        reflected = x - emission
        irradiance = np.zeros_like(solved.direct)
        irradiance[at] = np.divide(reflected, rho, out=np.zeros_like(rho), where=rho > 0)
        shown.update(replace(solved, direct=np.zeros_like(solved.direct), indirect=irradiance))
        images.append(picture(shown, loaded, 64, "none").colour)
        light = float((area @ reflected).sum() / (area @ whole).sum())
        error = eq.norm(reflected - whole) / eq.norm(whole)
        shot = "shot" if shots == 1 else "shots"
        names.append(
            f"{shots:,} {shot}\n{100 * light:.0f} % of the light\nerror {100 * error:.2g} %"
        )
        print(names[-1].replace("\n", ", "))
        if len(images) == len(SHOTS):
            break
    strip(images, 1.2 * auto_exposure(images[-1]), names, OUT / "radiosity_growing.jpg")


def living(scenes: Path) -> None:
    """A furnished room lit through its windows."""
    from lambent.transport.radiosity.settings import Settings
    from lambent.transport.radiosity.solve import solve
    from lambent.transport.scene import load_for_light
    from lambent.transport.solution import picture

    loaded = load_for_light(scenes / "living-room" / "scene.xml", size=(480, 270))
    found = solve(loaded, Settings(patches=64000, samples=2048))
    images = [picture(found.integrator(w), loaded, 32, "none").colour for w in ("mesh", "smooth")]
    names = [f"{len(found):,} patches", "smooth"]
    strip(images, 1.5 * auto_exposure(images[-1]), names, OUT / "radiosity_living.jpg")


def curve(files: dict[str, Path]) -> None:
    """relMSE over patches, both logarithmic."""
    width, height, left, bottom, right = 640, 300, 64, 36, 150
    lines = {}
    for name, path in files.items():
        for row in json.loads(path.read_text()):
            for kind in ("smooth", "gather"):
                key = f"{name}, {row['cut']}, {kind}"
                lines.setdefault(key, []).append((row["patches"], max(row[kind], 1e-5)))
    xs = [math.log10(x) for points in lines.values() for x, _ in points]
    ys = [math.log10(y) for points in lines.values() for _, y in points]
    x0, x1, y0, y1 = min(xs), max(xs), math.floor(min(ys)), math.ceil(max(ys))

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            left + (math.log10(x) - x0) / (x1 - x0) * (width - left - right),
            12 + (y1 - math.log10(y)) / (y1 - y0) * (height - bottom - 12),
        )

    marks = [
        "<style>text{font:12px sans-serif;fill:#333}.g{stroke:#ddd}polyline{fill:none;"
        "stroke-width:1.6}</style>"
    ]
    for k in range(y0, y1 + 1):
        _, y = at(10**x0, 10.0**k)
        marks.append(
            f'<line class="g" x1="{left}" x2="{width - right}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )
        marks.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">1e{k}</text>')
    for n in (1000, 4000, 16000, 64000):
        if x0 - 0.1 <= math.log10(n) <= x1 + 0.1:
            x, _ = at(n, 10.0**y0)
            text = f"{n // 1000}k"
            marks.append(f'<text x="{x:.1f}" y="{height - 12}" text-anchor="middle">{text}</text>')
    marks.append(f'<text x="{width - right}" y="{height - 12}" dx="18">patches</text>')
    colours = ("#0b5fa5", "#b3541e", "#2e7d32", "#7b1fa2")
    ends = []
    for k, (key, points) in enumerate(lines.items()):
        points.sort()
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in (at(*p) for p in points))
        dash = ' stroke-dasharray="5 3"' if "adaptive" in key else ""
        marks.append(f'<polyline points="{path}" stroke="{colours[k % 4]}"{dash}/>')
        ends.append([at(*points[-1])[1], key, colours[k % 4]])
    ends.sort()
    last = 0.0
    for y, key, colour in ends:
        last = max(y + 4, last + 14)
        words = key.partition(", ")[2] if len(files) == 1 else key
        marks.append(f'<text x="{width - right + 6}" y="{last:.1f}" fill="{colour}" '
                     f'style="fill:{colour}">{words}</text>')  # fmt: skip
    path = OUT / "radiosity_error.svg"
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
        f"{''.join(marks)}</svg>\n"
    )
    print(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--only", default="room,growing,living,curve")
    parser.add_argument("--curve", action="append", default=[], metavar="NAME=FILE")
    arguments = parser.parse_args()
    np.seterr(all="ignore")
    only = arguments.only.split(",")
    for make in (room, growing, living):
        if make.__name__ in only:
            make(arguments.scenes)
    if "curve" in only and arguments.curve:
        curve({n: Path(f) for n, _, f in (text.partition("=") for text in arguments.curve)})


if __name__ == "__main__":
    main()
