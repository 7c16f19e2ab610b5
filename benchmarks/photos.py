"""DnCNN on the test pictures of the papers: PSNR by noise level, and time.

    python benchmarks/photos.py IMAGES [--model dncnn] [--model MODEL.lambent] [--count N] [--out F]

IMAGES holds ``cbsd68`` and ``kodak``. Grey pictures are Rec. 601 luma, as the papers' test sets.
Noise is Gaussian with sigma of 255, not clipped and not rounded, the same for every model; PSNR is
of results held to [0, 1]. Beside them OIDN (for display values), which was not made for
this, and the figures of the paper (Zhang et al. 2017, table II): DnCNN-S for
one level in grey, DnCNN-B blind, in grey. Seconds are for one 481x321 picture, second call.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from filters import machine, markdown_table

SIGMAS = (15, 25, 35, 45, 50)
#: Zhang et al. 2017, table II, BSD68 grey.
PAPER = {
    "paper, DnCNN-S": {15: 31.73, 25: 29.23, 50: 26.23},
    "paper, DnCNN-B": {15: 31.61, 25: 29.16, 50: 26.23},
}


def by_oidn(noisy: Any) -> Any:
    """OIDN for display values."""
    from lambent.kernels import oidn

    image = np.ascontiguousarray(np.clip(noisy, 0, 1), np.float32)
    return oidn.clean({"color": image}, oidn.Options(hdr=False, srgb=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("images", type=Path)
    parser.add_argument("--model", action="append", default=[])
    parser.add_argument("--count", type=int, default=68, help="pictures of each set")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    from lambent.filters.denoiser import create
    from lambent.learn.photo import photographs, psnr

    models: dict[str, Any] = {}
    for name in arguments.model or ["dncnn"]:
        options = {} if name == "dncnn" else {"weights": name}
        models[Path(name).stem] = create("dncnn", **options)
    sections = []
    for kind, folder in (("grey", "cbsd68"), ("colour", "cbsd68"), ("colour", "kodak")):
        pictures = photographs(arguments.images / folder)[: arguments.count]
        sums: dict[str, dict[int, list[float]]] = {}
        for number, picture in enumerate(pictures):
            clean = picture.pixels.astype(np.float32) / 255
            if kind == "grey":
                luma = picture.pixels.astype(np.float32) @ np.array(
                    [0.299, 0.587, 0.114], np.float32
                )
                clean = (np.rint(luma) / 255).astype(np.float32)[:, :, None]
            for sigma in SIGMAS:
                rng = np.random.default_rng((number, sigma))
                noise = rng.standard_normal(clean.shape, np.float32) * np.float32(sigma / 255)
                noisy = clean + noise
                results = {"noisy": noisy, "oidn": by_oidn(noisy)}
                for name, model in models.items():
                    known = model.card()["options"]
                    if known["sigma_low"] <= sigma <= known["sigma_high"]:
                        results[name] = model.clean_display(noisy)
                for name, image in results.items():
                    sums.setdefault(name, {}).setdefault(sigma, []).append(psnr(image, clean))
        lines = [
            [name, *(f"{np.mean(by[s]):.2f}" if s in by else "" for s in SIGMAS)]
            for name, by in sums.items()
        ]
        if kind == "grey":
            lines += [
                [name, *(f"{by[s]:.2f}" if s in by else "" for s in SIGMAS)]
                for name, by in PAPER.items()
            ]
        title = f"{folder}, {kind}, {len(pictures)} pictures"
        sections.append(f"**{title}**\n\n{markdown_table([title, *map(str, SIGMAS)], lines)}")
        print(sections[-1], flush=True)
    seconds = []
    picture = np.random.default_rng(0).random((321, 481, 3), np.float32)
    for name, model in models.items():
        image = picture if int(model.card()["channels"]) == 3 else picture[:, :, :1]
        for _ in range(2):
            start = time.perf_counter()
            model.clean_display(image)
            took = time.perf_counter() - start
        seconds.append(f"{name} {took:.2f} s")
    text = "\n\n".join(sections)
    text += f"\n\n481x321: {', '.join(seconds)}. {machine()}. PSNR in dB by sigma.\n"
    print(text.rsplit("\n\n", 1)[1])
    if arguments.out is not None:
        arguments.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
