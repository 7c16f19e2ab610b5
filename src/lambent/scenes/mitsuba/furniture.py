"""Furniture: tables, chairs, shelves, sofas, beds, lamps, pictures, curtains.

Makers return parts that stand on z = 0 (or hang from the origin), the front towards −y; lengths
are metres and near those of real furniture.
"""

from __future__ import annotations

import itertools

import numpy as np

from lambent.scenes.mitsuba import surfaces as sf
from lambent.scenes.mitsuba.geometry import (
    box,
    extrude,
    lathe,
    merge,
    quad,
    rotate,
    super_ellipsoid,
    translate,
    tube,
)
from lambent.scenes.mitsuba.stage import Part
from lambent.scenes.mitsuba.things import books, pile, thing

Rng = np.random.Generator


def _legs(rng: Rng, x: float, y: float, h: float, thick: float) -> list[Part]:
    style = rng.integers(3)
    role = str(rng.choice(["wood", "metal", "black"], p=[0.6, 0.25, 0.15]))
    out = []
    for sx in (-1, 1):
        for sy in (-1, 1):
            place = translate(sx * (x / 2 - thick), sy * (y / 2 - thick), 0)
            if style == 0:
                leg = box(thick, thick, h, thick * 0.1)
            elif style == 1:
                leg = lathe(
                    np.array([[0, 0], [thick * 0.3, 0], [thick * 0.6, h], [0, h]]), 16, smooth=1
                )
                place = place @ rotate("x", 0.08 * sy) @ rotate("y", -0.08 * sx)
            else:
                p = [
                    [0, 0],
                    [0.3, 0],
                    [0.5, 0.08],
                    [0.3, 0.2],
                    [0.6, 0.5],
                    [0.35, 0.75],
                    [0.6, 0.85],
                    [0.6, 1],
                    [0, 1],
                ]
                leg = lathe(np.array(p) * [thick, h], 16)
            out.append(leg.moved(place))
    return [(merge(out), role)]


def table(rng: Rng, x: float, y: float, h: float) -> list[Part]:
    """A table with its top at ``h``: four legs, a foot, or trestles; round or square."""
    thick = rng.uniform(0.02, 0.05)
    top_role = str(
        rng.choice(
            ["wood", "marble", "lacquer", "window", "metal"], p=[0.6, 0.13, 0.15, 0.07, 0.05]
        )
    )
    if rng.random() < 0.25:
        a = np.linspace(0, 2 * np.pi, 49)[:-1]
        top = extrude(np.stack([np.cos(a) * x / 2, np.sin(a) * y / 2], -1), thick)
        foot = lathe(
            np.array(
                [
                    [0, 0],
                    [0.3 * y, 0],
                    [0.28 * y, 0.03],
                    [0.05, 0.08],
                    [0.04, h - 0.1],
                    [0.1, h - thick],
                ]
            ),
            24,
        )
        return [
            (top.moved(translate(0, 0, h - thick)), top_role),
            (foot, str(rng.choice(["metal", "wood", "black"]))),
        ]
    top = box(x, y, thick, 0.004).moved(translate(0, 0, h - thick))
    parts: list[Part] = [(top, top_role), *_legs(rng, x, y, h - thick, rng.uniform(0.04, 0.07))]
    if rng.random() < 0.6:
        rail = box(x * 0.86, y * 0.86, 0.07).moved(translate(0, 0, h - thick - 0.075))
        parts.append((rail, parts[1][1]))
    return parts


def chair(rng: Rng) -> list[Part]:
    """A chair or a stool; its front is −y."""
    w, d, h = rng.uniform(0.4, 0.5), rng.uniform(0.4, 0.48), rng.uniform(0.43, 0.48)
    role = str(rng.choice(["wood", "lacquer", "upholstery", "plastic"], p=[0.5, 0.15, 0.25, 0.1]))
    if role == "upholstery":
        seat = super_ellipsoid((w / 2, d / 2, 0.045), 0.4, 0.3, 14).moved(translate(0, 0, h))
    else:
        seat = box(w, d, 0.03, 0.008).moved(translate(0, 0, h - 0.015))
    parts: list[Part] = [(seat, role), *_legs(rng, w, d, h, 0.035)]
    if rng.random() < 0.1:
        return parts
    frame = parts[1][1]
    back = rng.uniform(0.38, 0.6)
    lean = translate(0, d / 2 - 0.02, h) @ rotate("x", -rng.uniform(0.08, 0.22))
    posts = [
        box(0.03, 0.03, back).moved(lean @ translate(s * (w / 2 - 0.02), 0, 0)) for s in (-1, 1)
    ]
    style = rng.integers(3)
    if style == 0:
        bars = [
            box(0.018, 0.018, back - 0.05).moved(lean @ translate(x, 0, 0))
            for x in np.linspace(-w / 3, w / 3, 5)
        ]
        bars.append(box(w - 0.04, 0.03, 0.06, 0.01).moved(lean @ translate(0, 0, back - 0.06)))
        parts.append((merge(bars), frame))
    elif style == 1:
        slats = [
            box(w - 0.05, 0.015, 0.06, 0.005).moved(lean @ translate(0, 0, z))
            for z in (back * 0.3, back * 0.6, back - 0.06)
        ]
        parts.append((merge(slats), frame))
    else:
        pad = super_ellipsoid((w / 2 - 0.02, 0.03, back * 0.35), 0.4, 0.3, 12)
        parts.append((pad.moved(lean @ translate(0, 0, back * 0.6)), role))
    parts.append((merge(posts), frame))
    return parts


def sofa(rng: Rng, seats: int) -> list[Part]:
    """An armchair (one seat) or a sofa with cushions."""
    w, d = 0.62 * seats, rng.uniform(0.75, 0.95)
    h, arm = rng.uniform(0.38, 0.46), rng.uniform(0.12, 0.22)
    soft = rng.uniform(0.25, 0.5)
    parts: list[Part] = []
    base = box(w + 2 * arm, d, h - 0.2, 0.03).moved(translate(0, 0, 0.1))
    parts.append((base, "upholstery"))
    for k in range(seats):
        x = (k - (seats - 1) / 2) * 0.62
        seat = sf.cushion(rng, 0.61, d - 0.2, 0.2, 14).moved(translate(x, -0.08, h - 0.05))
        rest = sf.cushion(rng, 0.6, 0.2, 0.5, 14).moved(
            translate(x, d / 2 - 0.22, h + 0.24) @ rotate("x", -0.2)
        )
        parts += [(seat, "upholstery"), (rest, "upholstery")]
        if rng.random() < 0.5:
            pillow = sf.cushion(rng, 0.42, 0.14, 0.42, 14)
            turn = (
                translate(x + rng.normal(0, 0.08), d / 2 - 0.38, h + 0.26)
                @ rotate("z", rng.normal(0, 0.3))
                @ rotate("x", -0.35)
            )
            parts.append((pillow.moved(turn), "cushion"))
    back = super_ellipsoid((w / 2 + arm, 0.09, 0.42), soft, 0.3, 14).moved(
        translate(0, d / 2 - 0.06, h - 0.02)
    )
    parts.append((back, "upholstery"))
    for s in (-1, 1):
        side = super_ellipsoid((arm / 2, d / 2, 0.3), soft, 0.3, 12)
        parts.append((side.moved(translate(s * (w + arm) / 2, 0, h - 0.1)), "upholstery"))
    return parts + _legs(rng, w + arm, d, 0.12, 0.05)


def bed(rng: Rng, width: float) -> list[Part]:
    """A bed, its head at +y."""
    parts: list[Part] = [(box(width + 0.08, 2.06, 0.28, 0.02).moved(translate(0, 0, 0.05)), "wood")]
    parts.append(
        (
            box(width + 0.1, 0.06, rng.uniform(0.8, 1.2), 0.02).moved(translate(0, 1.04, 0)),
            str(rng.choice(["wood", "upholstery"])),
        )
    )
    quilt = sf.cushion(rng, width + 0.1, 1.5, 0.3, 26).moved(translate(0, -0.27, 0.42))
    mattress = box(width, 2, 0.2, 0.05).moved(translate(0, 0, 0.3))
    parts += [(mattress, "ceiling"), (quilt, str(rng.choice(["cloth", "cushion", "upholstery"])))]
    for s in (-1, 1) if width > 1.2 else (0,):
        pillow = sf.cushion(rng, 0.65, 0.4, 0.18, 18)
        parts.append(
            (pillow.moved(translate(s * width / 4, 0.75, 0.6) @ rotate("x", 0.3)), "ceiling")
        )
    return parts


def shelf(rng: Rng, w: float, h: float, d: float = 0.3) -> list[Part]:
    """Shelves with books and things, the back at y = +d/2."""
    role = str(rng.choice(["wood", "lacquer", "trim", "metal"], p=[0.55, 0.15, 0.2, 0.1]))
    t = 0.022
    rows = max(1, int(h / rng.uniform(0.3, 0.42)))
    frame = [box(t, d, h).moved(translate(s * (w - t) / 2, 0, 0)) for s in (-1, 1)]
    levels = np.linspace(0.06, h - t, rows + 1)
    frame += [box(w - 2 * t, d, t).moved(translate(0, 0, z)) for z in levels]
    parts: list[Part] = []
    if rng.random() < 0.6:
        frame.append(box(w, 0.01, h).moved(translate(0, d / 2, 0)))
    parts.append((merge(frame), role))
    for z, above in itertools.pairwise(levels):
        x = -w / 2 + 0.04
        gap = above - z - t
        while x < w / 2 - 0.15:
            length = min(rng.uniform(0.15, 0.6), w / 2 - 0.04 - x)
            what = rng.random()
            if what < 0.55:
                group = books(rng, length - 0.03, gap * 0.9)
                parts += [(g.moved(translate(x, 0.02, z + t)), r) for g, r in group]
            elif what < 0.65:
                parts += [
                    (g.moved(translate(x + 0.12, 0, z + t)), r)
                    for g, r in pile(rng, gap * 0.5, 0.22)
                ]
            elif what < 0.88:
                size = min(gap * 0.62, 0.26)
                length = size
                item = thing(rng, size)
                lo, hi = (
                    np.min([g.bounds[0] for g, _ in item], 0),
                    np.max([g.bounds[1] for g, _ in item], 0),
                )
                if max(hi[0] - lo[0], hi[1] - lo[1]) < 0.4 and hi[2] < gap * 1.2:
                    parts += [(g.moved(translate(x + size / 2, 0, z + t)), r) for g, r in item]
            x += length + 0.02
    return parts


def cabinet(rng: Rng, w: float, h: float, d: float) -> list[Part]:
    """A sideboard, a chest of drawers or a kitchen front with handles."""
    role = str(rng.choice(["wood", "lacquer", "trim"]))
    parts: list[Part] = [(box(w, d, h - 0.08, 0.005).moved(translate(0, 0, 0.08)), role)]
    columns, rows = max(1, int(w / rng.uniform(0.4, 0.8))), int(rng.integers(1, 4))
    fronts, handles = [], []
    for i in range(columns):
        for j in range(rows):
            fw, fh = w / columns - 0.012, (h - 0.1) / rows - 0.012
            x, z = (i + 0.5) * w / columns - w / 2, 0.09 + j * (h - 0.1) / rows + 0.006
            fronts.append(box(fw, 0.02, fh, 0.003).moved(translate(x, -d / 2 - 0.01, z)))
            bar = tube(np.array([[-0.06, 0, 0], [0, -0.012, 0], [0.06, 0, 0]]), 0.005, 6)
            handles.append(bar.moved(translate(x, -d / 2 - 0.035, z + fh * 0.75)))
    parts += [(merge(fronts), role if rng.random() < 0.6 else "lacquer"), (merge(handles), "metal")]
    parts.append((box(w * 0.94, d * 0.8, 0.08), "black"))
    if rng.random() < 0.4:
        parts.append((box(w + 0.02, d + 0.03, 0.03, 0.004).moved(translate(0, 0, h)), "marble"))
    return parts


def picture(rng: Rng, w: float, h: float) -> list[Part]:
    """A framed picture in xz, centred on the origin, its back at y = 0; or a mirror."""
    f, t = rng.uniform(0.015, 0.07), rng.uniform(0.015, 0.04)
    bars = [
        box(w + 2 * f, t, f, f * 0.2).moved(translate(0, -t / 2, z)) for z in (h / 2, -h / 2 - f)
    ]
    bars += [box(f, t, h).moved(translate(s * (w + f) / 2, -t / 2, -h / 2)) for s in (-1, 1)]
    what = "mirror" if rng.random() < 0.12 else "poster"
    upright = translate(0, -t * 0.5, 0) @ rotate("x", np.pi / 2)
    parts: list[Part] = [(merge(bars), str(rng.choice(["wood", "metal", "black", "trim"])))]
    sheet = quad(w, h, (1, 1)).moved(upright)
    if what == "poster" and rng.random() < 0.4:
        mat = quad(w, h).moved(upright)
        sheet = quad(w * 0.72, h * 0.72, (1, 1)).moved(translate(0, -0.003, 0) @ upright)
        parts.append((mat, "ceiling"))
    parts.append((sheet, what))
    if what == "poster" and rng.random() < 0.25:
        parts.append((quad(w, h).moved(translate(0, -0.012, 0) @ upright), "window"))
    return parts


def lamp_stand(rng: Rng, height: float, radius: float) -> list[Part]:
    """Foot, pole and open shade of a lamp; the bulb belongs at ``height − radius·0.8``."""
    foot = lathe(np.array([[0, 0], [radius * 0.7, 0], [radius * 0.65, 0.02], [0, 0.03]]), 24)
    pole = tube(
        np.array([[0, 0, 0.02], [0, 0, height * 0.5], [0, 0, height - radius * 1.1]]), 0.012, 8
    )
    role = str(rng.choice(["metal", "wood", "black", "ceramic"]))
    top = radius * rng.uniform(0.45, 0.95)
    t = np.linspace(0, 1, 6)[:, None]
    profile = np.concatenate([radius + (top - radius) * t, height - radius * 1.6 * (1 - t)], 1)
    shade = lathe(profile, 32, smooth=1)
    shade_role = str(rng.choice(["shade", "metal", "frosted", "lacquer"], p=[0.75, 0.1, 0.05, 0.1]))
    return [(foot, role), (pole, role), (shade, shade_role)]


def pendant(rng: Rng, drop: float, radius: float) -> list[Part]:
    """A lamp that hangs ``drop`` below the origin; the bulb belongs at ``−drop − radius·0.4``."""
    cord = tube(np.array([[0, 0, 0], [0, 0, -drop / 2], [0, 0, -drop]]), 0.004, 5)
    kind = rng.integers(3)
    if kind == 0:
        p = np.array(
            [
                [radius, -0.9 * radius],
                [radius * 0.9, -0.4 * radius],
                [radius * 0.3, -0.05 * radius],
                [0.02, 0],
            ]
        )
    elif kind == 1:
        p = np.array([[radius, -radius], [radius * 0.98, -0.5 * radius], [radius * 0.95, 0.0]])
    else:
        a = np.linspace(-1.1, 1.45, 8)
        p = np.stack([radius * np.cos(a), radius * np.sin(a) - 0.4 * radius], -1)
    shade = lathe(p, 36).moved(translate(0, 0, -drop))
    role = str(rng.choice(["metal", "shade", "lacquer", "glass"], p=[0.35, 0.4, 0.15, 0.1]))
    return [(cord, "black"), (shade, role)]


def blinds(rng: Rng, w: float, h: float) -> list[Part]:
    """Venetian blinds in xz, their top edge at the origin."""
    tilt = rng.uniform(0.2, 1.2)
    n = int(h / 0.06)
    slats = [
        box(w, 0.05, 0.002).moved(translate(0, 0, -0.06 * (i + 1)) @ rotate("x", tilt))
        for i in range(n)
    ]
    return [(merge(slats), "trim")]


def rail(points: int, w: float, h: float) -> list[Part]:
    """A balustrade along x: thin bars and a hand rail."""
    bars = [
        box(0.02, 0.02, h).moved(translate(x, 0, 0)) for x in np.linspace(-w / 2, w / 2, points)
    ]
    bars.append(box(w, 0.06, 0.04, 0.01).moved(translate(0, 0, h)))
    return [(merge(bars), "metal")]


def stairs(w: float, steps: int, rise: float = 0.17, run: float = 0.28) -> list[Part]:
    """Steps that climb along +y from the origin."""
    blocks = [
        box(w, run * (steps - k), rise).moved(translate(0, run * (k + (steps - k) / 2), k * rise))
        for k in range(steps)
    ]
    return [(merge(blocks), "pedestal")]


def column(rng: Rng, h: float, r: float) -> list[Part]:
    """A column with base and capital, round or fluted."""
    base = box(2.6 * r, 2.6 * r, 0.3 * r, 0.05 * r)
    capital = base.moved(translate(0, 0, h - 0.3 * r))
    if rng.random() < 0.5:
        p = np.array(
            [
                [1.3, 0.3],
                [1.3, 0.5],
                [1, 0.8],
                [1.02, 1.2],
                [0.95, h / r - 1],
                [0.85, h / r - 0.7],
                [1.25, h / r - 0.4],
                [1.25, h / r - 0.3],
            ]
        )
        shaft = lathe(p * r, 40)
    else:
        k = 20
        a = np.linspace(0, 2 * np.pi, 4 * k + 1)[:-1]
        outline = (
            np.stack([np.cos(a), np.sin(a)], -1)
            * (r * (1 - 0.08 * (np.arange(4 * k) % 4 == 2)))[:, None]
        )
        shaft = extrude(outline, h, taper=0.85)
    return [(base, "pedestal"), (capital, "pedestal"), (shaft, "pedestal")]
