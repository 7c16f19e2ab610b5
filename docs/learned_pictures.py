"""Makes the pictures of the pages about learned denoisers, in ``docs/pictures/``.

    python docs/learned_pictures.py SCENES [--runs DIR] [--frames DIR] [--only kpcn,...]

``kpcn.jpg``: two scenes noisy, by DPCN, KPCN and OIDN, and the reference. ``kpcn_curve.svg``: the
validation of both over steps, from the logs in DIR (`lambent train` leaves them in the cache).
``kpcn_kernels.jpg``: learned and classical weights at three pixels. ``modular_lambda.jpg`` and the
table that is printed: what the asymmetric loss's preference does to bias and variance, measured on
independent renders. ``dncnn.jpg``: a photograph. SCENES holds Mitsuba scenes; only those in the
public domain are shown. FRAMES is the folder of ``benchmarks/denoise_frames.py``.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from make_pictures import OUT, cut, save, sheet

from lambent.filters.denoiser import create
from lambent.frame.exposure import auto_exposure
from lambent.frame.files import read
from lambent.frame.tonemap import srgb
from lambent.metrics.relmse import relmse

#: Scenes in the public domain, and a detail of each at a third of its size: left, top, w, h.
SHOWN = {"veach-mis": (20, 20, 176, 92), "cornell-box": (0, 30, 148, 78)}
#: Renders of one view from which bias and variance are estimated.
RENDERS = 16


def kpcn(frames: Path) -> None:
    """Noisy, DPCN, KPCN, OIDN, reference; relMSE under each."""
    rows, words = [], []
    for name, detail in SHOWN.items():
        frame, truth = (read(frames / f"{name}-{n}.exr") for n in ("4spp", "reference"))
        exposure = auto_exposure(truth.colour)
        shown = [("noisy, 4 spp", frame.colour)]
        shown += [(m, create(m)(frame, "beauty").colour) for m in ("dpcn", "kpcn", "oidn")]
        shown += [("reference", truth.colour)]
        x, y, w, h = detail
        size = (176, 92)
        rows.append([cut(image, detail, exposure, 2).resize((2 * size[0], 2 * size[1]))
                     for _, image in shown])  # fmt: skip
        inside = (slice(y, y + h), slice(x, x + w))
        words.append(
            [
                f"{n}: {relmse(i[inside], truth.colour[inside], trim=0.001):.4f}"
                for n, i in shown[:-1]
            ]
            + ["reference"]
        )
    save(sheet(rows, words), OUT / "kpcn.jpg")


def kpcn_curve(runs: Path) -> None:
    """Validation error over steps."""
    from lambent.report.curve import curve

    found = {}
    for name in ("kpcn", "dpcn"):
        lines = [json.loads(ln) for ln in (runs / name / "log.jsonl").read_text().splitlines()]
        found[name] = [(ln["step"], ln["check"]["score"]) for ln in lines if "check" in ln]
    svg = curve(found)
    style = (
        "<style>text{font:12px system-ui,sans-serif;fill:#444}"
        "polyline{fill:none;stroke:#0b6e99;stroke-width:2}.grid{stroke:#ddd}</style>"
    )
    head, _, body = svg.partition(">")
    text = f'{head} xmlns="http://www.w3.org/2000/svg">{style}{body}\n'
    (OUT / "kpcn_curve.svg").write_text(text, encoding="utf-8")


def kernels(frames: Path) -> None:
    """Learned kernels beside classical ones: on a wall, at an edge, on a gloss."""
    from PIL import Image

    from lambent.filters.explain import CLASSICAL, explain, side_by_side

    frame = read(frames / "veach-mis-4spp.exr")
    rows = []
    for x, y, part in ((60, 20, "diffuse"), (52, 64, "diffuse"), (104, 66, "specular")):
        learned = explain(frame, "kpcn", x, y, part=part)
        others = [explain(frame, name, x, y) for name in ("modular", *CLASSICAL[1:])]
        rows.append(side_by_side([learned, *others], half=12))
    save(Image.fromarray(np.concatenate(rows)), OUT / "kpcn_kernels.jpg", 145_000)


def modular_lambda(scenes: Path, frames: Path) -> None:
    """Bias² and variance, relative, of the result for three preferences; and the pictures."""
    from lambent.render.job import render

    truth = read(frames / "cornell-box-reference.exr")
    height, width = truth.colour.shape[:2]
    scene = scenes / "cornell-box" / "scene.xml"
    renders = [render(scene, spp=4, size=(width, height), seed=500 + n) for n in range(RENDERS)]
    exposure, detail = auto_exposure(truth.colour), (0, 30, 148, 90)
    size = truth.colour.mean(axis=2) ** 2 + 0.01
    row, words = [cut(renders[0].colour, detail, exposure, 2)], ["noisy, 4 spp"]
    noisy = np.stack([r.colour for r in renders])
    print("| preference | bias² | variance | relMSE |\n| --: | --: | --: | --: |")
    for preference in (None, 0.0, 0.5, 1.0):
        images = noisy
        if preference is not None:
            model = create("modular", preference=preference)
            images = np.stack([model(r, "beauty").colour for r in renders])
            row.append(cut(images[0], detail, exposure, 2))
            words.append(f"preference {preference:g}")
        spread = images.var(axis=0, ddof=1).mean(axis=2)
        # the mean of so many renders has a variance of its own, which is no bias
        off = ((images.mean(axis=0) - truth.colour) ** 2).mean(axis=2) - spread / RENDERS
        bias, variance = float((off / size).mean()), float((spread / size).mean())
        name = "(noisy)" if preference is None else f"{preference:g}"
        print(f"| {name} | {bias:.5f} | {variance:.5f} | {bias + variance:.5f} |", flush=True)
    row.append(cut(truth.colour, detail, exposure, 2))
    words.append("reference")
    save(sheet([row], [words]), OUT / "modular_lambda.jpg")


def dncnn(photo: Path) -> None:
    """A photograph with noise of sigma 25, cleaned, and as it was."""
    from PIL import Image

    from lambent.learn.photo import psnr

    with Image.open(photo) as image:
        clean = np.asarray(image.convert("RGB"), np.float32)[120:376, 180:436] / 255
    rng = np.random.default_rng(0)
    noisy = np.clip(clean + rng.normal(0, 25 / 255, clean.shape), 0, 1).astype(np.float32)
    with TemporaryDirectory() as folder:  # as a user has it: a PNG in, a PNG out
        path = Path(folder) / "noisy.png"
        Image.fromarray((noisy * 255 + 0.5).astype(np.uint8)).save(path)
        found = srgb(create("dncnn")(read(path), "beauty").colour)
    row, words = [], []
    for name, picture in (("noisy", noisy), ("dncnn", found), ("clean", clean)):
        pixels = (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
        row.append(Image.fromarray(pixels))
        words.append(name if name == "clean" else f"{name}: {psnr(picture, clean):.2f} dB")
    save(sheet([row], [words]), OUT / "dncnn.jpg")


def main() -> None:
    base = os.environ.get("LAMBENT_CACHE")
    cache = Path(base) if base else Path.home() / ".cache" / "lambent"
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--runs", type=Path, default=cache / "runs")
    parser.add_argument("--frames", type=Path, default=cache / "validation")
    parser.add_argument("--photo", type=Path, help="a picture for dncnn.jpg, at least 436x376")
    parser.add_argument("--only", default="kpcn,curve,kernels,lambda,dncnn")
    arguments = parser.parse_args()
    only = arguments.only.split(",")
    steps: dict[str, Any] = {
        "kpcn": lambda: kpcn(arguments.frames),
        "curve": lambda: kpcn_curve(arguments.runs),
        "kernels": lambda: kernels(arguments.frames),
        "lambda": lambda: modular_lambda(arguments.scenes, arguments.frames),
    }
    for name, make in steps.items():
        if name in only:
            make()
    if "dncnn" in only and arguments.photo is not None:
        dncnn(arguments.photo)


if __name__ == "__main__":
    main()
