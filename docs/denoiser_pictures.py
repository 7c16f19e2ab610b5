"""The pictures of the denoiser's page: noisy, OIDN High, Lambent, reference.

    python docs/denoiser_pictures.py [--cache DIR]

From the frames of ``benchmarks/denoise_frames.py`` (CC0 scenes): ``denoiser.jpg``, what it does
at 4 samples a pixel, with the error of each; ``denoiser_splat.jpg``, the same for files whose
renderer splats its samples.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from make_pictures import OUT, cut, save, sheet

from lambent.filters.denoiser import create
from lambent.frame.exposure import auto_exposure
from lambent.frame.files import read
from lambent.frame.role import Role, Stat
from lambent.metrics.relmse import TRIM, relmse

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
from frames import default_cache

MODELS = ("oidn", "lambent")
#: Width and height of what is shown, in the middle of a frame.
DETAIL = (84, 84)


def strip(cache: Path, name: str, spp: int) -> tuple[list[Any], list[str]]:
    """One row of pictures, and their captions."""
    frame = read(cache / f"{name}-{spp}spp.exr")
    truth = read(cache / f"{name}-reference.exr")
    exposure = auto_exposure(truth.colour)
    variance = truth.get(Role.COLOUR, Stat.VARIANCE)
    images = {"noisy": frame.colour}
    for model in MODELS:
        images[model] = create(model)(frame, "beauty").colour
    images["reference"] = truth.colour
    height, width = truth.colour.shape[:2]
    detail = ((width - DETAIL[0]) // 2, (height - DETAIL[1]) // 2, *DETAIL)
    pictures, words = [], []
    for kind, image in images.items():
        pictures.append(cut(np.asarray(image), detail, exposure, 3))
        error = relmse(image, truth.colour, TRIM, reference_variance=variance)
        told = f"{name}, {spp} spp" if kind == "noisy" else f"{kind} {error:.4f}"
        words.append("reference" if kind == "reference" else told)
    return pictures, words


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, default=default_cache().with_name("validation"))
    arguments = parser.parse_args()
    for target, names in (
        ("denoiser.jpg", ("cornell-box", "veach-mis", "cycles-900002", "cycles-900004")),
        ("denoiser_splat.jpg", ("cornell-box-splat", "veach-mis-splat")),
    ):
        rows = [strip(arguments.cache, name, 4) for name in names]
        made = sheet([row for row, _ in rows], [words for _, words in rows])
        save(made, OUT / target, limit=400_000)


if __name__ == "__main__":
    main()
