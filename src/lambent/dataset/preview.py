"""A contact sheet: what a data set holds, or what a recipe will give.

Of a set: crops and clips spread over it, each as noisy picture, target, albedo and normal, with a
name on each picture. Of a recipe: whole views of its first scenes, rendered quickly.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.dataset.plan import CLIP, STILL, Job, number, per_scene, scene_seed
from lambent.dataset.reader import Dataset, open_dataset
from lambent.dataset.recipe import Recipe
from lambent.dataset.source import WholeScene, open_source
from lambent.errors import FileError, stop_by_interrupt
from lambent.frame.atomic import atomic
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.role import Role
from lambent.frame.tonemap import to_uint8
from lambent.phases import Phases
from lambent.progress import Progress, silent

Picture = NDArray[np.uint8]
_GAP, _PAPER, _INK, _LINE, _LETTERS = 4, 24, 215, 20, 15


@dataclass(frozen=True)
class Tile:
    """Pictures side by side ``(H, W, 3)``, a name above each (or none), and a line below all."""

    pictures: tuple[Picture, ...]
    text: str
    names: tuple[str, ...] = ()


def preview_set(
    folder: str | os.PathLike[str], output: Path, count: int = 24, overwrite: bool = False
) -> Path:
    """The contact sheet of a set. Raises `FileError` where there is nothing to show."""
    dataset = open_dataset(folder)
    if not len(dataset):
        raise FileError("the data set is empty", file=folder, remedy="lambent dataset make …")
    tiles = [_item_tile(dataset, i) for i in _spread(dataset, count)]
    return _write(output, tiles, 3, overwrite)


def preview_recipe(
    recipe: Recipe,
    output: Path,
    count: int = 24,
    spp: int = 32,
    device: str = "auto",
    overwrite: bool = False,
    progress: Progress = silent,
) -> Path:
    """The contact sheet of a recipe's first scenes, one view of each."""
    source = open_source(recipe, device, Phases())
    what, frames = (STILL, 1) if recipe.count or not recipe.clip_count else (CLIP, 2)
    width = 320
    size = (width, max(16, round(width * recipe.view[1] / recipe.view[0])))
    tiles = []
    for n in range(count):
        progress(n, count, f"scene {n + 1} of {count}")
        job = Job(what, n, (n * per_scene(recipe, what),))
        seed = scene_seed(recipe, job, 0)
        try:
            scene = source.scene(seed, n, frames)
            camera = number(recipe, "preview", n) % max(1, scene.cameras)
            if isinstance(scene, WholeScene):
                frame = scene.stills(camera, size[1], (1,), max(spp, 16))[-1].target
            else:
                frame = scene.views(camera)[-1].pilot(size, spp, seed)
        except Exception as error:  # a preview is to show that, too
            stop_by_interrupt(error)
            blank = np.full((size[1], size[0], 3), 60, np.uint8)
            tiles.append(Tile((blank,), f"{seed}: {type(error).__name__}: {error}"))
            continue
        kind = scene.about.get("kind") or scene.about.get("scene") or ""
        tiles.append(Tile((to_uint8(frame.colour),), f"{kind} {seed} camera {camera}"))
    return _write(output, tiles, 4, overwrite)


# ------------------------------------------------------------------- private


def _spread(dataset: Dataset, count: int) -> list[int]:
    """Places of items, evenly over the crops and, a quarter of them, over the clips."""
    clips = min(len(dataset.clips), max(count // 4, count - len(dataset.crops)))
    chosen: list[int] = []
    for places, wanted in ((dataset.crops, count - clips), (dataset.clips, clips)):
        wanted = min(wanted, len(places))
        chosen += [places[k * len(places) // wanted] for k in range(wanted)]
    return chosen


def _item_tile(dataset: Dataset, i: int) -> Tile:
    item, line = dataset.item(i), dataset.line(i)
    exposure = auto_exposure(item.target.colour)
    noisy, spp, target = item.levels[0], line["spp"], f"target, {line['target_spp'][0]} spp"
    if item.is_clip:
        shown = [s.levels[0].colour for s in item.stills[:: max(1, len(item.stills) - 1)]]
        last = item.stills[-1]
        pictures = [to_uint8(p, exposure) for p in (*shown, last.target.colour)]
        pictures.append(_motion(last.levels[0]))
        names = [f"{which}, {spp[0]} spp" for which in ("first", "last")[-len(shown) :]]
        names += [target, "motion"]
    else:
        pictures = [to_uint8(noisy.colour, exposure), to_uint8(item.target.colour, exposure)]
        pictures += [_albedo(noisy), _normal(noisy)]
        names = [f"{spp[0]} spp", target, "albedo", "normal"]
    text = f"{line['what']} {line['index']}"
    if kind := line.get("kind") or line.get("scene"):
        text += f", {kind}"
    if len(spp) > 1:
        text += f"; levels of {', '.join(map(str, spp))} spp"
    return Tile(tuple(pictures), text, tuple(names))


def _albedo(frame: Frame) -> Picture:
    image = frame.get(Role.ALBEDO)
    if image is None:
        return _blank(frame)
    return to_uint8(np.broadcast_to(image, (*image.shape[:2], 3)), 1.0)


def _normal(frame: Frame) -> Picture:
    image = frame.get(Role.NORMAL)
    return _blank(frame) if image is None else _signed(image)


def _motion(frame: Frame) -> Picture:
    """Motion as a colour: grey is rest, red right, green down; 8 pixels are full."""
    image = frame.get(Role.MOTION)
    if image is None:
        return _blank(frame)
    zero = np.zeros_like(image[:, :, :1])
    return _signed(np.concatenate([image[:, :, :2] / 8, zero], axis=2))


def _signed(image: NDArray[Any]) -> Picture:
    return (np.clip(image * 0.5 + 0.5, 0, 1) * 255 + 0.5).astype(np.uint8)


def _blank(frame: Frame) -> Picture:
    return np.full((frame.height, frame.width, 3), 60, np.uint8)


def _write(output: Path, tiles: Sequence[Tile], columns: int, overwrite: bool) -> Path:
    """Lay the tiles out and write a PNG, JPEG, … by the name's ending."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(_LETTERS)
    head = _LINE if any(t.names for t in tiles) else 0
    height = max(p.shape[0] for t in tiles for p in t.pictures)
    width = max(sum(p.shape[1] for p in t.pictures) for t in tiles)
    columns = min(columns, len(tiles))
    rows = -(-len(tiles) // columns)
    across, down = width + 2 * _GAP, head + height + _LINE + 2 * _GAP
    sheet = Image.new("RGB", (columns * across, rows * down), (_PAPER,) * 3)
    pen = ImageDraw.Draw(sheet)

    def write(x: int, y: int, text: str, room: int) -> None:
        text = " ".join(text.split())
        while pen.textlength(text, font) > room:
            text = text[:-1]
        pen.text((x, y), text, (_INK,) * 3, font)

    for n, tile in enumerate(tiles):
        left, top = _GAP + n % columns * across, _GAP + n // columns * down
        x = left
        for k, picture in enumerate(tile.pictures):
            sheet.paste(Image.fromarray(picture), (x, top + head))
            if tile.names:
                write(x + 2, top, tile.names[k], picture.shape[1] - 4)
            x += picture.shape[1]
        write(left, top + head + height, tile.text, width)
    kind = {".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}.get(output.suffix.lower(), "PNG")
    buffer = io.BytesIO()
    sheet.save(buffer, kind, **({"quality": 88} if kind == "JPEG" else {}))
    with atomic(output, overwrite) as out:
        out.write(buffer.getvalue())
    return output
