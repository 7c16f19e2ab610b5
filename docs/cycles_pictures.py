"""Makes ``docs/pictures/cycles_scenes.jpg``: a contact sheet of random Cycles scenes.

    python docs/cycles_pictures.py [--first 200] [--count 40] [--spp 24] [--out FILE]

Needs a Blender (extra ``blender``, or ``LAMBENT_BLENDER``). Each picture has its own exposure,
and its kind and seed below it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from lambent.frame.exposure import auto_exposure
from lambent.frame.tonemap import to_uint8
from lambent.scenes.cycles import CyclesWorker

OUT = Path(__file__).resolve().parent / "pictures" / "cycles_scenes.jpg"
SIDE, COLUMNS, GAP, LINE, LETTERS = 128, 8, 4, 18, 14


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=200)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--spp", type=int, default=24)
    parser.add_argument("--out", type=Path, default=OUT)
    chosen = parser.parse_args()
    rows = -(-chosen.count // COLUMNS)
    across, down = SIDE + GAP, SIDE + LINE + GAP
    sheet = Image.new("RGB", (COLUMNS * across - GAP, rows * down - GAP), (250, 249, 246))
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(LETTERS)
    with CyclesWorker() as worker:
        for n in range(chosen.count):
            (view,) = worker.render_random(
                chosen.first + n, spp_list=(1,), size=(SIDE, SIDE), crop=1.0,
                reference_spp=chosen.spp, reference_blocks=2,
            )  # fmt: skip
            colour = view.target.colour
            picture = Image.fromarray(to_uint8(colour, auto_exposure(colour)))
            x, y = n % COLUMNS * across, n // COLUMNS * down
            sheet.paste(picture, (x, y))
            pen.text((x + 2, y + SIDE), f"{view.kind} {view.seed}", (40, 40, 40), font)
            print(view.seed, view.kind, f"{view.seconds:.1f} s", flush=True)
    sheet.save(chosen.out, quality=55, optimize=True)
    print("wrote", chosen.out)


if __name__ == "__main__":
    main()
