"""Makes the pictures of the pages on rendering, in ``docs/pictures/``.

    python docs/render_pictures.py SCENES_DIR [--spp 64] [--only layers,motion,scenes]

``render_layers.jpg``: layers of the scenes in SCENES_DIR (Bitterli's resources). ``motion.jpg``:
two frames of the test animation. ``procedural_scenes.jpg``: random scenes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.role import Role
from lambent.frame.tonemap import to_uint8

HERE = Path(__file__).resolve().parent
OUT = HERE / "pictures"
PAPER, INK, GAP, LETTERS = (250, 249, 246), (40, 40, 40), 4, 18
#: Scene -> width and height.
SCENES = {
    "cornell-box": (108, 108),
    "veach-bidir": (108, 108),
    "veach-mis": (192, 108),
    "living-room": (192, 108),
    "dining-room": (192, 108),
}
COLUMNS = ("colour", "diffuse", "specular", "direct", "indirect", "albedo", "normal", "depth",
           "roughness")  # fmt: skip


def cell(frame: Frame, name: str) -> Any:
    """One layer as a picture."""
    exposure = auto_exposure(frame.colour)
    image = frame[name]
    if name == "normal":
        return to_uint8(image * 0.5 + 0.5, 1.0)
    if name in ("albedo", "roughness"):
        return to_uint8(np.repeat(image, 3 // image.shape[2], axis=2), 1.0)
    if name == "depth":
        near, far = np.percentile(image[image > 0], [2, 98])
        grey = np.clip(1 - (image - near) / (far - near), 0, 1) * (image > 0)
        return to_uint8(np.repeat(grey, 3, axis=2), 1.0)
    return to_uint8(image, exposure)


def sheet(
    rows: list[list[Any]],
    path: Path,
    quality: int = 70,
    columns: Sequence[str] = (),
    names: Sequence[str] = (),
) -> None:
    """Pictures of one height a row as a JPEG, with ``columns`` above and ``names`` at the left.

    With columns, all are as wide as the widest picture, and the others stand in their middle.
    """
    font = ImageFont.load_default(LETTERS)
    widest = max(c.shape[1] for row in rows for c in row)
    left = max((int(font.getlength(name)) + 12 for name in names), default=0)
    top = LETTERS + 10 if columns else 0
    across = [[widest if columns else c.shape[1] for c in row] for row in rows]
    width = left + max(sum(row) + GAP * (len(row) - 1) for row in across)
    height = top + sum(row[0].shape[0] + GAP for row in rows) - GAP
    made = Image.new("RGB", (width, height), PAPER)
    pen = ImageDraw.Draw(made)
    for k, name in enumerate(columns):
        pen.text((left + k * (widest + GAP) + widest // 2, 3), name, INK, font, "ma")
    y = top
    for k, row in enumerate(rows):
        if names:
            pen.text((0, y + row[0].shape[0] // 2), names[k], INK, font, "lm")
        x = left
        for picture, wide in zip(row, across[k], strict=True):
            made.paste(Image.fromarray(picture), (x + (wide - picture.shape[1]) // 2, y))
            x += wide + GAP
        y += row[0].shape[0] + GAP
    made.save(path, quality=quality, optimize=True)
    print(path, path.stat().st_size // 1024, "KiB", flush=True)


def layers(folder: Path, spp: int) -> None:
    import lambent

    rows = []
    for name, size in SCENES.items():
        frame = lambent.render(folder / name / "scene.xml", spp=spp, size=size)
        rows.append([cell(frame, column) for column in COLUMNS])
    sheet(rows, OUT / "render_layers.jpg", columns=COLUMNS, names=tuple(SCENES))


def motion() -> None:
    from lambent.kernels.warp import warp
    from lambent.render.variant import mitsuba

    mi = mitsuba()
    sys.path.insert(0, str(HERE.parent))
    from tests.render import scenes
    from tests.render.test_motion import animation

    from lambent.render.animation import Stage, disoccluded
    from lambent.render.sampling import FrameSampler

    scene = scenes.moving(mi, 240)
    # Five times the test's speed, so that one sees it.
    stage = Stage(mi, scene, scene.sensors()[0], lambda f: animation(5 * f))
    frames = []
    for number in (1, 2):
        sampler = FrameSampler(scene, depth=2, motion=stage.motion(number, number - 1))
        frames.append(sampler.sample(32, seed=number).frame())
    before, now = frames
    warped, _ = warp(before["albedo"], now[Role.MOTION])
    hidden = disoccluded(now, before).astype(np.float32)[:, :, None]
    row = [before["albedo"], warped, now["albedo"], np.repeat(hidden, 3, axis=2)]
    columns = ("frame 1", "frame 1, warped to frame 2", "frame 2", "hidden in frame 1")
    pictures = [to_uint8(picture, 1.0) for picture in row]
    sheet([pictures], OUT / "motion.jpg", 80, columns)


def procedural(count: int = 40, spp: int = 48) -> None:
    import lambent
    from lambent.render.sampling import FrameSampler
    from lambent.render.variant import mitsuba
    from lambent.scenes.mitsuba import random_scene
    from lambent.scenes.mitsuba.build import build

    mi = mitsuba()
    cells = []
    for seed in range(count):
        plan = random_scene(seed)
        scene = build(plan, mi, camera=seed % len(plan.cameras), size=(192, 144))
        frame = FrameSampler(scene, depth=8, features="features").sample(spp, seed).frame()
        clean = lambent.denoise(frame)
        cells.append(to_uint8(clean.colour, auto_exposure(clean.colour)))
    rows = [cells[i : i + 8] for i in range(0, count, 8)]
    sheet(rows, OUT / "procedural_scenes.jpg", 60)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes_dir", type=Path)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--only", default="layers,motion,scenes")
    chosen = parser.parse_args()
    wanted = chosen.only.split(",")
    if "layers" in wanted:
        layers(chosen.scenes_dir, chosen.spp)
    if "motion" in wanted:
        motion()
    if "scenes" in wanted:
        procedural()


if __name__ == "__main__":
    main()
