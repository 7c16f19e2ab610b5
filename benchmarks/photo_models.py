"""Which model to take for a photograph: PSNR of whole pipelines on crops, by noise level.

    python benchmarks/photo_models.py KODAK [--out docs/results/photo_models]

KODAK holds the pictures of `CROPS`. A crop of 288x288 gets Gaussian noise with sigma of 255, is
rounded and clipped as a PNG is, written, read and denoised as `lambent denoise photo.png --model M`
does. Prints Markdown; with ``--out`` also writes it, and single figures as JSON beside it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from filters import markdown_table

#: Picture -> top and left of the crop.
CROPS = {"kodim03": (100, 200), "kodim05": (200, 300), "kodim15": (60, 120), "kodim23": (120, 300)}
SIDE = 288
SIGMAS = (15, 25, 50)
MODELS = ("noisy", "oidn", "lambent", "lambent-best", "lambent-oidn", "dncnn")


def measure(folder: Path) -> list[dict[str, Any]]:
    """PSNR in dB of every model on every crop and level."""
    from PIL import Image

    import lambent
    from lambent.frame.tonemap import srgb
    from lambent.learn.photo import psnr

    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "noisy.png"
        for name, (y, x) in CROPS.items():
            with Image.open(folder / f"{name}.png") as image:
                clean = np.asarray(image.convert("RGB"))[y : y + SIDE, x : x + SIDE]
            for sigma in SIGMAS:
                noise = np.random.default_rng(sigma).normal(0, sigma, clean.shape)
                noisy = np.clip(np.rint(clean + noise), 0, 255).astype(np.uint8)
                Image.fromarray(noisy).save(path)
                row: dict[str, Any] = {"name": name, "sigma": sigma}
                row["noisy"] = psnr(noisy / np.float32(255), clean / np.float32(255))
                for model in MODELS[1:]:
                    cleaned = srgb(lambent.denoise(path, model=model).colour)
                    row[model] = psnr(cleaned, clean / np.float32(255))
                rows.append(row)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Means over the crops."""
    lines = [
        [f"`{m}`", *(f"{np.mean([r[m] for r in rows if r['sigma'] == s]):.2f}" for s in SIGMAS)]
        for m in MODELS
    ]
    crops = len({row["name"] for row in rows})
    return markdown_table([f"PSNR, dB, {crops} crops", *(f"sigma {s}" for s in SIGMAS)], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="path without suffix for .md and .json")
    arguments = parser.parse_args()
    rows = measure(arguments.folder)
    print(table(rows))
    if arguments.out is not None:
        arguments.out.with_suffix(".md").write_text(f"{table(rows)}\n")
        arguments.out.with_suffix(".json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
