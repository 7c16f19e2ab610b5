"""Rooms: walls with windows and doors, a few pieces of furniture-like things, pictures, lamps."""

from __future__ import annotations

import math
from typing import Any

import bpy

from .dice import Colour, Dice
from .layout import Layout
from .lights import bulb, light, strip, world
from .materials import fog, lamp, make, poster
from .placing import copy, dress, place, spots
from .shapes import bevel, box, coil, plane, some_object, tube


def room(dice: Dice) -> Layout:
    """A room of 3 to 9 metres; one to three windows, or none and lamps."""
    palette = dice.palette()
    width, length, height = dice.uniform(3, 7), dice.uniform(3.5, 9), dice.uniform(2.4, 4.0)
    windows = dice.chance(0.75)
    _shell(dice.child("shell"), palette, width, length, height, windows)
    if windows:
        kind = world(dice.child("world"), dice.weighted(sky=4, gradient=2, clouds=2), 2.5)
        if kind != "sky" and dice.chance(0.6):
            angle = dice.uniform(-0.8, 0.8)
            light(
                "SUN",
                (-4, 4 * math.sin(angle), dice.uniform(1.5, 5)),
                (0, 0, 0),
                dice.log(2, 15),
                dice.warmth(),
                angle=math.radians(dice.log(0.3, 8)),
            )
    else:
        world(dice.child("world"), "dark")
    _lamps(dice.child("lamps"), width, length, height, 0.3 if windows else 1.0)
    _furniture(dice.child("furniture"), palette, width, length, height)
    _pictures(dice.child("pictures"), palette, width, length, height)
    if dice.chance(0.12):
        air = box((width * 0.99, length * 0.99, height * 0.99))
        dress(air, fog(dice, dice.log(0.01, 0.08)))
    inside = ((-width / 2, -length / 2, 0.0), (width / 2, length / 2, height))
    return Layout(
        "room", (0, 0, 0.9), 0.35 * min(width, length), inside, eye_height=(0.5, 0.8 * height)
    )


def _shell(dice: Dice, palette: list[Colour], w: float, d: float, h: float, windows: bool) -> None:
    thick = 0.2
    walls = make(dice, palette, dice.weighted(matte=5, stone=2, wood=1, gloss=0.5))
    floor = dress(
        box((w, d, thick), (0, 0, -thick / 2)),
        make(dice, palette, dice.weighted(wood=4, stone=3, gloss=1, fabric=1)),
    )
    floor.name = "floor"
    dress(
        box((w + 1, d + 1, thick), (0, 0, h + thick / 2)), make(dice, [(0.8, 0.8, 0.78)], "matte")
    )
    sides = [
        ((w / 2 + thick / 2, 0), d, True),
        ((0, -d / 2 - thick / 2), w, False),
        ((0, d / 2 + thick / 2), w, False),
    ]
    for (x, y), span, along_y in sides:
        size = (thick, span + 2 * thick, h) if along_y else (span + 2 * thick, thick, h)
        wall = dress(
            box(size, (x, y, h / 2)), walls if dice.chance(0.8) else make(dice, palette, "matte")
        )
        wall.name = "wall"
    x = -w / 2 - thick / 2
    if not windows:
        dress(box((thick, d + 2 * thick, h), (x, 0, h / 2)), walls)
        return
    _window_wall(dice, palette, walls, x, d, h, thick)


def _window_wall(
    dice: Dice, palette: list[Colour], walls: Any, x: float, d: float, h: float, thick: float
) -> None:
    """A wall along y with openings: pieces of wall around them, frames, bars, blinds."""
    count = dice.whole(1, 3)
    sill, top = dice.uniform(0.0, 1.0), h - dice.uniform(0.15, 0.6)
    share = dice.uniform(0.35, 0.8)
    cell = d / count
    dress(box((thick, d + 2 * thick, sill + 0.001), (x, 0, sill / 2)), walls)
    dress(box((thick, d + 2 * thick, h - top), (x, 0, (h + top) / 2)), walls)
    frame = make(dice, palette, dice.pick(("wood", "gloss", "metal")))
    blinds = dice.chance(0.3)
    for n in range(count):
        y = -d / 2 + (n + 0.5) * cell
        half = share * cell / 2
        for side in (-1, 1):
            piece = cell / 2 - half
            dress(
                box(
                    (thick, piece + 0.002, top - sill),
                    (x, y + side * (half + piece / 2), (top + sill) / 2),
                ),
                walls,
            )
            dress(
                box((thick * 0.6, 0.05, top - sill), (x, y + side * half, (top + sill) / 2)), frame
            )
        bars = dice.whole(0, 3)
        for k in range(bars):
            at = y - half + (k + 1) * 2 * half / (bars + 1)
            dress(box((0.05, 0.04, top - sill), (x, at, (top + sill) / 2)), frame)
        if dice.chance(0.6):
            dress(
                box((0.05, 2 * half, 0.04), (x, y, sill + dice.uniform(0.3, 0.8) * (top - sill))),
                frame,
            )
        if blinds:
            slat = dress(box((0.07, 2 * half, 0.006), (x + 0.16, y, top)), frame)
            slat.rotation_euler = (0, dice.uniform(-0.9, 0.9), 0)
            modifier = slat.modifiers.new("array", "ARRAY")
            modifier.use_relative_offset = False
            modifier.use_constant_offset = True
            # Offsets are in the slat's own turned space: straight down in the world's.
            a = slat.rotation_euler[1]
            modifier.constant_offset_displace = (0.07 * math.sin(a), 0, -0.07 * math.cos(a))
            modifier.count = max(2, int(dice.uniform(0.4, 1.0) * (top - sill) / 0.07))


def _lamps(dice: Dice, w: float, d: float, h: float, need: float) -> None:
    """Ceiling panels, hanging bulbs with shades, standing lamps, strips, small strong spots."""
    count = dice.whole(1, 3) if need >= 1 else dice.whole(0, 1)
    for _ in range(count):
        x, y = dice.uniform(-0.35, 0.35) * w, dice.uniform(-0.35, 0.35) * d
        power = need * dice.log(40, 160)
        kind = dice.weighted(panel=3, hanging=3, standing=2, strip=2, spot=2)
        if kind == "panel":
            panel = dress(
                box((dice.uniform(0.3, 1.2), dice.uniform(0.3, 1.2), 0.03), (x, y, h - 0.03)), None
            )
            panel.data.materials.clear()
            area = panel.dimensions[0] * panel.dimensions[1]
            dress(panel, lamp(dice.warmth(), power / (math.pi * max(area, 0.05))))
        elif kind == "hanging":
            z = h - dice.uniform(0.4, 1.2)
            bulb(dice, (x, y, z - 0.1), 0.12, power)
            dress(
                tube(dice, [(x, y, h), (x, y, z)], 0.008), make(dice, [(0.05, 0.05, 0.05)], "gloss")
            )
            _shade(dice, x, y, z - 0.08)
        elif kind == "standing":
            dress(
                tube(dice, [(x, y, 0), (x, y, 1.5)], 0.015), make(dice, [(0.1, 0.1, 0.1)], "metal")
            )
            bulb(dice, (x, y, 1.45), 0.1, power)
            _shade(dice, x, y, 1.5)
        elif kind == "strip":
            z = dice.uniform(0.2, h - 0.1)
            strip(dice, (x - 0.6, y, z), (x + 0.6, y + dice.uniform(-0.5, 0.5), z), power)
        else:
            light(
                "SPOT",
                (x, y, h - 0.1),
                (dice.uniform(-1, 1), dice.uniform(-1, 1), 0),
                6 * power,
                dice.warmth(),
                dice.log(0.005, 0.05),
                spot_size=dice.uniform(0.5, 1.4),
            )


def _shade(dice: Dice, x: float, y: float, z: float) -> None:
    """An open cone or ring around a bulb."""
    bpy.ops.mesh.primitive_cone_add(
        vertices=32,
        radius1=dice.uniform(0.15, 0.3),
        radius2=dice.uniform(0.05, 0.2),
        depth=0.25,
        end_fill_type="NOTHING",
        location=(x, y, z),
    )
    shade = bpy.context.object
    shade.modifiers.new("thick", "SOLIDIFY").thickness = 0.006
    dress(
        shade,
        make(
            dice,
            [(0.7, 0.6, 0.45), (0.8, 0.8, 0.8), (0.1, 0.1, 0.1)],
            dice.pick(("fabric", "metal", "wax")),
        ),
    )


def _furniture(dice: Dice, palette: list[Colour], w: float, d: float, h: float) -> None:
    materials = [make(dice.child("material", n), palette) for n in range(dice.whole(4, 8))]
    for n, (x, y) in enumerate(
        spots(dice, dice.whole(3, 9), (-w / 2 + 0.5, -d / 2 + 0.5), (w / 2 - 0.5, d / 2 - 0.5), 0.9)
    ):
        part = dice.child("piece", n)
        turn = part.pick((0.0, math.pi / 2, part.uniform(0, 6.3)))
        PIECES[part.weighted(table=3, chair=3, shelf=2.5, sofa=2, thing=3, chest=1.5, plant=1.5)](
            part, materials, palette, (x, y), turn, h
        )
    if dice.chance(0.6):
        rug = dress(
            box((dice.uniform(1.2, 2.5), dice.uniform(1.2, 3), 0.012)),
            make(dice, palette, "fabric"),
        )
        place(
            rug, (dice.uniform(-0.5, 0.5), dice.uniform(-0.5, 0.5), 0.002), 1, dice.pick((0, 0.3))
        )


def _parts(pieces: list[Any], x: float, y: float, turn: float) -> None:
    """Hang pieces on an empty and put that in its place."""
    root = bpy.data.objects.new("group", None)
    bpy.context.scene.collection.objects.link(root)
    for piece in pieces:
        piece.parent = root
    root.location, root.rotation_euler = (x, y, 0), (0, 0, turn)


def _table(
    dice: Dice, materials: list[Any], palette: list[Colour], at: Any, turn: float, h: float
) -> None:
    w, d, z = dice.uniform(0.6, 1.8), dice.uniform(0.5, 1.0), dice.uniform(0.4, 0.8)
    top, legs = dice.pick(materials), dice.pick(materials)
    slab = dress(box((w, d, 0.05), (0, 0, z)), top)
    bevel(slab, 0.008)
    pieces = [slab]
    for i in (-1, 1):
        for j in (-1, 1):
            pieces.append(
                dress(
                    box((0.05, 0.05, z), (i * (w / 2 - 0.05), j * (d / 2 - 0.05), z / 2 - 0.03)),
                    legs,
                )
            )
    for n in range(dice.whole(0, 4)):
        thing = dress(some_object(dice.child("on", n)), make(dice.child("stuff", n), palette))
        place(
            thing,
            (dice.uniform(-0.4, 0.4) * w, dice.uniform(-0.35, 0.35) * d, z + 0.03),
            dice.uniform(0.15, 0.4),
            dice.uniform(0, 6),
        )
        pieces.append(thing)
    _parts(pieces, at[0], at[1], turn)


def _chair(
    dice: Dice, materials: list[Any], palette: list[Colour], at: Any, turn: float, h: float
) -> None:
    seat, frame = dice.pick(materials), dice.pick(materials)
    pieces = [dress(box((0.45, 0.45, 0.06), (0, 0, 0.45)), seat)]
    bevel(pieces[0], 0.02)
    for i in (-1, 1):
        for j in (-1, 1):
            top = 0.95 if j > 0 else 0.45
            pieces.append(
                dress(
                    tube(dice, [(0.2 * i, 0.2 * j, 0), (0.2 * i, 0.2 * j * 1.05, top)], 0.018),
                    frame,
                )
            )
    for n in range(dice.whole(1, 4)):
        pieces.append(dress(box((0.42, 0.02, 0.05), (0, 0.21, 0.6 + 0.1 * n)), seat))
    _parts(pieces, at[0], at[1], turn)


def _shelf(
    dice: Dice, materials: list[Any], palette: list[Colour], at: Any, turn: float, h: float
) -> None:
    w, rows, step = dice.uniform(0.6, 1.4), dice.whole(2, 5), dice.uniform(0.3, 0.45)
    wood = dice.pick(materials)
    pieces = [
        dress(box((0.03, 0.3, rows * step), (s * w / 2, 0, rows * step / 2)), wood) for s in (-1, 1)
    ]
    pieces += [dress(box((w, 0.3, 0.03), (0, 0, n * step + 0.015)), wood) for n in range(rows + 1)]
    covers = [
        make(dice.child("cover", n), palette, dice.pick(("matte", "gloss", "fabric")))
        for n in range(4)
    ]
    for n in range(rows):
        x = -w / 2 + 0.05
        while x < w / 2 - 0.1:
            if dice.chance(0.8):
                thick, tall = dice.uniform(0.015, 0.06), dice.uniform(0.5, 0.85) * step
                book = dress(
                    box(
                        (thick, dice.uniform(0.15, 0.25), tall), (x, 0, n * step + 0.03 + tall / 2)
                    ),
                    dice.pick(covers),
                )
                book.rotation_euler = (0, dice.pick((0.0, 0.0, 0.0, 0.08)), 0)
                pieces.append(book)
                x += thick + 0.003
            else:
                thing = dress(some_object(dice.child("on", n, x)), dice.pick(materials))
                place(thing, (x + 0.12, 0, n * step + 0.03), 0.22, dice.uniform(0, 6))
                pieces.append(thing)
                x += 0.3
    _parts(pieces, at[0], at[1], turn)


def _sofa(
    dice: Dice, materials: list[Any], palette: list[Colour], at: Any, turn: float, h: float
) -> None:
    cloth = make(dice, palette, dice.pick(("fabric", "gloss", "matte")))
    w = dice.uniform(0.8, 2.0)
    sizes = [
        ((w, 0.8, 0.4), (0, 0, 0.22)),
        ((w, 0.2, 0.45), (0, 0.35, 0.6)),
        ((0.2, 0.8, 0.25), (-w / 2, 0, 0.5)),
        ((0.2, 0.8, 0.25), (w / 2, 0, 0.5)),
    ]
    pieces = [dress(box(size, centre), cloth) for size, centre in sizes]
    for piece in pieces:
        bevel(piece, 0.07)
        piece.modifiers["bevel"].segments = 4
    _parts(pieces, at[0], at[1], turn)


def _thing(
    dice: Dice, materials: list[Any], palette: list[Colour], at: Any, turn: float, h: float
) -> None:
    thing = dress(some_object(dice), make(dice, palette))
    place(thing, (*at, 0), dice.uniform(0.5, 1.3), turn)


def _chest(
    dice: Dice, materials: list[Any], palette: list[Colour], at: Any, turn: float, h: float
) -> None:
    w, z = dice.uniform(0.5, 1.2), dice.uniform(0.5, 1.1)
    pieces = [dress(box((w, 0.45, z)), dice.pick(materials))]
    bevel(pieces[0], 0.01)
    front, knob = dice.pick(materials), dice.pick(materials)
    for n in range(dice.whole(2, 4)):
        rows = 4
        pieces.append(
            dress(box((w * 0.94, 0.02, z / rows * 0.85), (0, -0.23, (n + 0.5) * z / rows)), front)
        )
        pieces.append(dress(box((0.12, 0.03, 0.02), (0, -0.25, (n + 0.6) * z / rows)), knob))
    _parts(pieces, at[0], at[1], turn)


def _plant(
    dice: Dice, materials: list[Any], palette: list[Colour], at: Any, turn: float, h: float
) -> None:
    """A pot with stems and leaf cards."""
    from .open_air import leaf_card

    pot = place(dress(some_object(dice, "lathe"), dice.pick(materials)), (0, 0, 0), 0.45)
    pieces = [pot]
    green = make(dice, palette, "leaf")
    card = dress(leaf_card(dice), green)
    for _ in range(dice.whole(14, 40)):
        leaf = copy(card)
        a, r, z = dice.uniform(0, 6.3), dice.uniform(0.05, 0.35), dice.uniform(0.4, 1.3)
        leaf.location = (r * math.cos(a), r * math.sin(a), z)
        leaf.rotation_euler = (dice.uniform(-0.8, 0.8), dice.uniform(-0.9, 0.3), a)
        leaf.scale = (dice.uniform(0.15, 0.4),) * 3
        pieces.append(leaf)
    bpy.data.objects.remove(card)
    if dice.chance(0.3):
        pieces.append(place(dress(coil(dice), green), (0, 0, 0.4), 0.8))
    _parts(pieces, at[0], at[1], turn)


PIECES = {
    "table": _table,
    "chair": _chair,
    "shelf": _shelf,
    "sofa": _sofa,
    "thing": _thing,
    "chest": _chest,
    "plant": _plant,
}


def _pictures(dice: Dice, palette: list[Colour], w: float, d: float, h: float) -> None:
    for n in range(dice.whole(1, 5)):
        part = dice.child(n)
        wide, tall = part.uniform(0.3, 1.3), part.uniform(0.3, 1.1)
        glow = part.log(1, 5) if part.chance(0.12) else 0.0
        picture = dress(plane(wide, tall), poster(part, palette, glow))
        frame = dress(
            box((wide + 0.06, tall + 0.06, 0.03), (0, 0, -0.018)),
            make(part, palette, part.pick(("wood", "metal", "gloss"))),
        )
        frame.parent = picture
        z = part.uniform(0.4, 0.7) * h
        side = part.pick(("east", "north", "south"))
        if side == "east":
            picture.location = (w / 2 - 0.05, part.uniform(-0.4, 0.4) * d, z)
            picture.rotation_euler = (math.pi / 2, 0, -math.pi / 2)
        else:
            sign = 1 if side == "north" else -1
            picture.location = (part.uniform(-0.4, 0.4) * w, sign * (d / 2 - 0.05), z)
            picture.rotation_euler = (math.pi / 2, 0, 0 if sign > 0 else math.pi)
