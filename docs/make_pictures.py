"""Makes the pictures of the documentation, in ``docs/pictures/``.

    python docs/make_pictures.py [--cache DIR] [--models nlm,nfor] [--spp 16]

``before_after.jpg``: the example, noisy and denoised. ``filter_<model>.jpg``: two details of the
still life, noisy, filtered and reference. ``all_filters.jpg``: one detail under every filter.
``scene_<name>.jpg``: benchmark scenes under the public domain, noisy, NFOR, OIDN and reference.
DIR is the cache of ``benchmarks/frames.py``, where ``examples/still_life/make_scene.py --frames
DIR`` puts the still life with all its statistics; without it the example itself is taken and
filters that need more are left out. All images of a picture have the exposure of the reference.
"""

from __future__ import annotations

import argparse
import io
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError
from lambent.filters.denoiser import DENOISERS, create
from lambent.frame.exposure import auto_exposure
from lambent.frame.files import read
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat
from lambent.frame.tonemap import to_uint8
from lambent.metrics.relmse import relmse

HERE = Path(__file__).resolve().parent
EXAMPLE = HERE.parent / "examples" / "still_life"
OUT = HERE / "pictures"
LIMIT, STRIP_LIMIT = 145_000, 115_000  # bytes of a picture
GAP, CAPTION = 6, 26
PAPER, INK = (250, 249, 246), (40, 42, 46)

#: Details of the still life: left, top, width, height.
DETAILS = ((96, 194, 112, 84), (12, 10, 112, 84))
#: Details of the soft shadow (``benchmarks/shadows.py``), for filters that need its layers.
SHADOW_DETAILS = ((60, 150, 112, 84), (290, 160, 112, 84))
SHEET_DETAIL = (186, 140, 132, 100)
#: Details of benchmark scenes that are in the public domain (CC0).
SCENES = {
    "cornell-box": (130, 250, 160, 120),
    "veach-bidir": (150, 200, 160, 120),
    "veach-mis": (330, 120, 160, 120),
}

Pixels = NDArray[np.uint8]


def enlarged(pixels: Pixels, factor: int) -> Any:
    """A PIL image ``factor`` times as large; pixels stay squares, as denoisers see them."""
    from PIL import Image

    image = Image.fromarray(pixels)
    return image.resize((image.width * factor, image.height * factor), Image.Resampling.NEAREST)


def sheet(rows: list[list[Any]], captions: list[list[str]]) -> Any:
    """PIL images of equal size in rows, a caption under each (none where it is empty)."""
    from PIL import Image, ImageDraw, ImageFont

    width, height = rows[0][0].size
    heights = [height + (CAPTION if any(line) else GAP) for line in captions]
    columns = max(map(len, rows))
    paper = Image.new("RGB", (columns * (width + GAP) - GAP, sum(heights)), PAPER)
    pen, font = ImageDraw.Draw(paper), ImageFont.load_default(16)
    top = 0
    for row, line, step in zip(rows, captions, heights, strict=True):
        for k, (image, text) in enumerate(zip(row, line, strict=True)):
            left = k * (width + GAP)
            paper.paste(image, (left, top))
            pen.text((left + 2, top + height + 3), text, INK, font)
        top += step
    return paper


def save(image: Any, path: Path, limit: int = STRIP_LIMIT) -> None:
    """As JPEG of the best quality that stays below ``limit`` bytes; whole or not at all."""
    for quality in range(93, 20, -3):
        buffer = io.BytesIO()
        image.save(buffer, "JPEG", quality=quality, optimize=True, progressive=True, subsampling=0)
        if buffer.tell() <= limit:
            break
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(".tmp")
    beside.write_bytes(buffer.getvalue())
    os.replace(beside, path)
    print(f"{path.name}: {image.width}x{image.height}, {buffer.tell() // 1000} KB, q {quality}")


def cut(image: NDArray[Any], detail: tuple[int, int, int, int], exposure: float, by: int) -> Any:
    """A detail of radiance ``(H, W, 3)``, tone-mapped and enlarged."""
    x, y, w, h = detail
    return enlarged(to_uint8(image[y : y + h, x : x + w], exposure), by)


def filtered(model: str, frame: Frame) -> NDArray[Any] | None:
    """The beauty after a model, or None where the frame lacks what it needs."""
    denoiser = create(model)
    try:
        denoiser.check(frame)
    except LayerError as error:
        print(f"{model}: left out, {error.message}")
        return None
    return denoiser(frame, passes="beauty").colour


def before_after() -> None:
    """The example at twice its size: the left half as rendered, the right half denoised."""
    from PIL import ImageDraw

    frame = read(EXAMPLE / "noisy.exr")
    exposure = auto_exposure(read(EXAMPLE / "reference.exr").colour)
    clean = filtered("lambent", frame)
    assert clean is not None
    both = to_uint8(clean, exposure)
    middle = both.shape[1] // 2
    both[:, :middle] = to_uint8(frame.colour, exposure)[:, :middle]
    image = enlarged(both, 2)
    pen = ImageDraw.Draw(image)
    pen.rectangle((2 * middle - 1, 0, 2 * middle, image.height), (255, 255, 255))
    save(image, OUT / "before_after.jpg", LIMIT)


def still_life(cache: Path, spp: int) -> tuple[Frame, Frame]:
    """The still life and its reference: with all statistics from the cache, or the example."""
    noisy, reference = cache / f"still-life-{spp}spp.exr", cache / "still-life-reference.exr"
    if noisy.exists() and reference.exists():
        return read(noisy), read(reference)
    print(f"{noisy} is not there: taking the example, which has no variance")
    return read(EXAMPLE / "noisy.exr"), read(EXAMPLE / "reference.exr")


def strip(model: str, image: NDArray[Any], frame: Frame, truth: Frame, details: Any) -> None:
    """The picture of one filter: details noisy, filtered, and in the reference."""
    exposure = auto_exposure(truth.colour)
    shown = (frame.colour, image, truth.colour)
    rows = [[cut(i, d, exposure, 3) for i in shown] for d in details]
    words = [f"noisy, {frame.spp} spp", model, f"reference, {truth.spp} spp"]
    save(sheet(rows, [["", "", ""], words]), OUT / f"filter_{model}.jpg")


def filters(models: list[str], cache: Path, spp: int) -> None:
    """A strip for every model, and the sheet of all."""
    frame, truth = still_life(cache, spp)
    exposure = auto_exposure(truth.colour)
    tiles, names = [], []

    def add(name: str, image: NDArray[Any]) -> None:
        tiles.append(cut(image, SHEET_DETAIL, exposure, 2))
        error = relmse(
            image, truth.colour, reference_variance=truth.get(Role.COLOUR, Stat.VARIANCE)
        )
        names.append(name if image is truth.colour else f"{name}  {error:.4f}")

    add(f"{frame.spp} spp", frame.colour)
    for model in models:
        image = filtered(model, frame)
        if image is not None:
            add(model, image)
            strip(model, image, frame, truth, DETAILS)
        elif (path := cache / f"soft-shadow-{spp}spp.exr").exists():
            shadow, sharp = read(path), read(cache / "soft-shadow-reference.exr")
            image = filtered(model, shadow)
            if image is not None:
                strip(model, image, shadow, sharp, SHADOW_DETAILS)
    add("reference", truth.colour)
    columns = 4
    rows = [tiles[k : k + columns] for k in range(0, len(tiles), columns)]
    lines = [names[k : k + columns] for k in range(0, len(names), columns)]
    save(sheet(rows, lines), OUT / "all_filters.jpg", LIMIT)


def scenes(cache: Path, spp: int) -> None:
    """A strip for every benchmark scene in the public domain that the cache holds."""
    for name, detail in SCENES.items():
        noisy, reference = cache / f"{name}-{spp}spp.exr", cache / f"{name}-reference.exr"
        if not (noisy.exists() and reference.exists()):
            print(f"{name}: left out, not in {cache}")
            continue
        frame, truth = read(noisy), read(reference)
        exposure = auto_exposure(truth.colour)
        images = {f"{spp} spp": frame.colour}
        for model in ("nfor", "oidn"):
            image = filtered(model, frame)
            if image is not None:
                images[model] = image
        images[f"reference, {truth.spp} spp"] = truth.colour
        row = [cut(i, detail, exposure, 2) for i in images.values()]
        save(sheet([row], [list(images)]), OUT / f"scene_{name}.jpg")


def main() -> None:
    """Make all pictures, or those of some models."""
    base = os.environ.get("LAMBENT_CACHE")
    cache = (Path(base) if base else Path.home() / ".cache" / "lambent") / "frames"
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cache", type=Path, default=cache)
    parser.add_argument("--models", default="", help="names; default all")
    parser.add_argument("--spp", type=int, default=16)
    arguments = parser.parse_args()
    before_after()
    models = [m for m in arguments.models.split(",") if m] or list(DENOISERS)
    filters(models, arguments.cache, arguments.spp)
    scenes(arguments.cache, arguments.spp)


if __name__ == "__main__":
    main()
