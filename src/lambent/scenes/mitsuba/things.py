"""Small things: what stands on tables, shelves and pedestals.

Each maker takes a random generator and returns parts that stand on z = 0 at the origin; sizes are
metres. `thing` picks one that fits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lambent.scenes.mitsuba import surfaces as sf
from lambent.scenes.mitsuba.geometry import (
    Array,
    Geometry,
    box,
    catmull_rom,
    extrude,
    grid,
    lathe,
    merge,
    quad,
    rotate,
    scale,
    sphere,
    super_ellipsoid,
    translate,
    tube,
)
from lambent.scenes.mitsuba.stage import Part

Rng = np.random.Generator


def hollow(outer: Array, wall: float) -> Array:
    """The profile of a vessel: up the outside ``outer (K, 2)``, over the rim, down the inside."""
    inner = outer[1:][::-1].copy()
    inner[:, 0] = np.maximum(inner[:, 0] - wall, 0.15 * wall)
    inner[-1, 1] += wall
    floor = np.array([[0, inner[-1, 1]]])
    return np.concatenate(
        [outer, [[outer[-1, 0] - wall / 2, outer[-1, 1] + wall / 2]], inner, floor]
    )


def _profile(rng: Rng, height: float, girth: float) -> Array:
    """A random vessel's outside ``(7, 2)``: foot, belly, neck, lip."""
    z = np.linspace(0, 1, 6) * height
    r = girth * np.array(
        [
            rng.uniform(0.4, 0.8),
            rng.uniform(0.7, 1.1),
            rng.uniform(0.8, 1.2),
            rng.uniform(0.4, 1.0),
            rng.uniform(0.25, 0.7),
            rng.uniform(0.35, 0.9),
        ]
    )
    return np.concatenate([[[0, 0]], np.stack([r, z], -1)])


def vase(rng: Rng, size: float) -> list[Part]:
    """A vase, sometimes with flowers or a branch."""
    height = size * rng.uniform(0.7, 1.3)
    profile = _profile(rng, height, height * rng.uniform(0.18, 0.4))
    role = str(
        rng.choice(
            ["ceramic", "glass", "metal", "frosted", "tinted"], p=[0.6, 0.15, 0.1, 0.08, 0.07]
        )
    )
    parts: list[Part] = [(lathe(hollow(profile, 0.025 * height), 40), role)]
    if rng.random() < 0.4:
        for piece, part_role in bouquet(rng, height * rng.uniform(0.7, 1.3)):
            parts.append((piece.moved(translate(0, 0, height * 0.75)), part_role))
    return parts


def bouquet(rng: Rng, height: float) -> list[Part]:
    """Stalks with leaf cards and blossoms."""
    stalks, blossoms = [], []
    leaves = []
    for _ in range(int(rng.integers(4, 10))):
        lean = rng.normal(0, 0.28, 2)
        t = np.linspace(-0.6, 1, 8)[:, None]
        path = np.concatenate([lean * height * np.maximum(t, 0) ** 1.6 + 0 * t, t * height], 1)
        path[:, :2] *= np.linspace(0.15, 1, 8)[:, None]
        stalks.append(tube(path, 0.006 * height, 5))
        if rng.random() < 0.75:
            petals = [
                sf.leaf_card(0.1 * height, 0.16 * height, 0.9).moved(
                    rotate("z", a) @ rotate("x", 0.5)
                )
                for a in np.linspace(0, 2 * np.pi, 7)[:-1]
            ]
            blossoms.append(merge(petals).moved(translate(*path[-1])))
        leaf = sf.leaf_card(0.16 * height, 0.35 * height, 0.6)
        leaves.append(
            leaf.moved(translate(*path[4]) @ rotate("z", rng.uniform(0, 6.3)) @ rotate("x", -0.7))
        )
    parts: list[Part] = [(merge(stalks), "trim"), (merge(leaves), "leaf")]
    if blossoms:
        parts.append((merge(blossoms), "petal"))
    return parts


def bottle(rng: Rng, size: float) -> list[Part]:
    """A bottle with a cap, sometimes with a label."""
    h = size * rng.uniform(0.8, 1.3)
    r = h * rng.uniform(0.11, 0.2)
    neck = r * rng.uniform(0.25, 0.45)
    shoulder = rng.uniform(0.5, 0.7)
    p = np.array(
        [
            [0, 0],
            [r * 0.9, 0.0],
            [r, 0.03 * h],
            [r, 0.3 * h],
            [r, shoulder * h],
            [neck, (shoulder + 0.15) * h],
            [neck, 0.95 * h],
        ]
    )
    role = str(
        rng.choice(
            ["glass", "tinted", "plastic", "ceramic", "frosted"], p=[0.5, 0.2, 0.15, 0.1, 0.05]
        )
    )
    parts: list[Part] = [(lathe(hollow(p, 0.06 * r), 32), role)]
    cap = lathe(
        np.array([[0, 0], [neck * 1.15, 0], [neck * 1.15, 0.07 * h], [0, 0.07 * h]]), 24, smooth=1
    )
    parts.append(
        (cap.moved(translate(0, 0, 0.94 * h)), str(rng.choice(["metal", "rubber", "wood"])))
    )
    if rng.random() < 0.5:
        a = np.linspace(-1.2, 1.2, 17)
        z = np.array([0.12, shoulder - 0.08]) * h
        label = np.stack(
            np.broadcast_arrays(r * 1.012 * np.sin(a), -r * 1.012 * np.cos(a), z[:, None]), -1
        )
        uv = np.stack(np.broadcast_arrays((a / 2.4 + 0.5), np.array([0.0, 1])[:, None]), -1)
        parts.append((grid(label, uv), str(rng.choice(["paper", "poster"]))))
    return parts


def drinking_glass(rng: Rng, size: float) -> list[Part]:
    """A tumbler or a wine glass, sometimes with a drink (which overlaps the wall a little)."""
    h = size * rng.uniform(0.5, 0.9)
    r = h * rng.uniform(0.28, 0.4)
    if rng.random() < 0.5:
        p = np.array([[0, 0], [r * 0.75, 0], [r * 0.8, 0.02 * h], [r * 0.9, 0.5 * h], [r, h]])
        base, low = 0.06 * h, 0.78 * r
    else:
        p = np.array(
            [
                [0, 0],
                [r * 0.85, 0],
                [r * 0.8, 0.02 * h],
                [0.07 * r, 0.08 * h],
                [0.07 * r, 0.42 * h],
                [r * 0.75, 0.55 * h],
                [r, 0.75 * h],
                [r * 0.8, h],
            ]
        )
        outside = p[4:]
        inside = outside[::-1] * [0.95, 1]
        inside[-1] = [0, 0.46 * h]
        return [(lathe(np.concatenate([p, inside]), 40), "glass")]
    parts: list[Part] = [(lathe(hollow(p, 0.05 * r), 40), "glass")]
    if rng.random() < 0.5:
        level = rng.uniform(0.4, 0.8) * h
        top = low + (r - low) * level / h
        drink = np.array([[0, base], [low * 0.99, base], [top * 0.985, level], [0, level]])
        parts.append((lathe(drink, 32, smooth=1), "water" if rng.random() < 0.6 else "tinted"))
    return parts


def bowl(rng: Rng, size: float) -> list[Part]:
    """A bowl or a plate, sometimes with fruit."""
    r = size * rng.uniform(0.35, 0.7)
    h = r * rng.uniform(0.15, 0.75)
    p = np.array([[0, 0], [0.45 * r, 0], [0.5 * r, 0.04 * h], [0.8 * r, 0.45 * h], [r, h]])
    role = str(rng.choice(["ceramic", "glass", "metal", "wood"], p=[0.6, 0.15, 0.1, 0.15]))
    parts: list[Part] = [(lathe(hollow(p, 0.05 * r), 40), role)]
    if rng.random() < 0.55:
        count = int(rng.integers(3, 8))
        for k in range(count):
            s = r * rng.uniform(0.22, 0.34)
            a = 2 * np.pi * k / max(count - 1, 1)
            d = 0 if k == count - 1 else r * 0.5
            z = h * 0.35 + s + (s * 0.9 if k == count - 1 else 0)
            parts += [
                (g.moved(translate(d * np.cos(a), d * np.sin(a), z - s)), m)
                for g, m in fruit(rng, s * 2)
            ]
    return parts


def fruit(rng: Rng, size: float) -> list[Part]:
    """An apple, an orange, a pear, a lemon."""
    r = size / 2
    kind = rng.integers(3)
    if kind == 0:
        p = (
            np.array(
                [[0, 0.12], [0.3, 0.02], [0.85, 0.5], [1, 1.1], [0.75, 1.7], [0.3, 1.85], [0, 1.65]]
            )
            * r
        )
        body = lathe(p, 24)
    elif kind == 1:
        p = (
            np.array(
                [[0, 0], [0.5, 0.05], [1, 0.8], [0.8, 1.4], [0.45, 1.9], [0.25, 2.3], [0, 2.35]]
            )
            * r
        )
        body = lathe(p, 24)
    else:
        body = sf.displaced(rng, (r, r, r * rng.uniform(0.8, 1.2)), 0.03, 5, level=3).moved(
            translate(0, 0, r)
        )
    top = body.bounds[1][2]
    stalk = tube(
        np.array([[0, 0, top - 0.25 * r], [0.03 * r, 0, top], [0.12 * r, 0, top + 0.25 * r]]),
        0.04 * r,
        5,
    )
    return [(body.moved(rotate("z", rng.uniform(0, 6))), "fruit"), (stalk, "wood")]


def books(rng: Rng, length: float, height: float, *, lying: bool = False) -> list[Part]:
    """A row of books along x (or a pile), with spines to −y."""
    covers, blocks = [], []
    x = 0.0
    while x < length:
        w, h = rng.uniform(0.012, 0.05), height * rng.uniform(0.7, 1)
        depth = rng.uniform(0.14, 0.2)
        one = box(w, depth, h)
        sheet = (int(rng.integers(32)) + 0.5) / 32
        # The spine shows one column of the sheet; the other faces its first pixels.
        spine = (one.normals[:, 1] < -0.9)[:, None]
        on_spine = np.stack([sheet + one.positions[:, 0] / w * 0.028, one.positions[:, 2] / h], -1)
        uv = np.where(spine, on_spine, [sheet + 0.012, 0.01])
        one = Geometry(one.positions, one.normals, uv, one.faces)
        block = box(w * 0.8, depth * 0.96, h * 0.985).moved(translate(0, 0.012, h * 0.012))
        block = block.with_uv(1.0)
        if lying:
            turn = (
                rotate("z", rng.normal(0, 0.25))
                @ translate(h / 2, 0, x)
                @ rotate("y", -np.pi / 2)
                @ translate(w / 2, 0, 0)
            )
        else:
            lean = rng.uniform(0.05, 0.2) if rng.random() < 0.08 else 0.0
            turn = translate(x + w / 2, 0, 0) @ rotate("y", lean)
        covers.append(one.moved(turn))
        blocks.append(block.moved(turn))
        x += w + 0.001
        if not lying and rng.random() < 0.04:
            x += rng.uniform(0.02, 0.12)
    return [(merge(covers), "book")]


def statue(rng: Rng, size: float) -> list[Part]:
    """An abstract sculpture: twisted column, blob, stacked solids, wire cage, letters."""
    kind = rng.integers(6)
    role = str(
        rng.choice(
            ["metal", "marble", "stone", "ceramic", "gloss", "mirror", "tinted", "glass", "rust"]
        )
    )
    if kind == 0:
        k = int(rng.integers(3, 8))
        a = np.linspace(0, 2 * np.pi, 2 * k + 1)[:-1]
        r = size * 0.25 * np.where(np.arange(2 * k) % 2, 1, rng.uniform(0.45, 0.95))
        outline = np.stack([r * np.cos(a), r * np.sin(a)], -1)
        return [
            (extrude(outline, size, taper=rng.uniform(0.3, 1), twist=rng.uniform(-2.5, 2.5)), role)
        ]
    if kind == 1:
        wide = size * 0.4
        amount, frequency = rng.uniform(0.1, 0.4), rng.uniform(1, 3)
        ridged = bool(rng.random() < 0.4)
        blob = sf.displaced(rng, (wide, wide, wide), amount, frequency, ridged=ridged, level=5)
        return [(blob.moved(translate(0, 0, wide * 0.95)), role)]
    if kind == 2:
        parts: list[Part] = []
        z = 0.0
        for _ in range(int(rng.integers(2, 5))):
            wide = size * rng.uniform(0.12, 0.22)
            rx, ry, rz = (wide * float(v) for v in rng.uniform([0.7, 0.7, 0.5], [1.2, 1.2, 1]))
            e1, e2 = (float(v) for v in rng.choice([0.15, 0.5, 1, 1.8], 2))
            solid = super_ellipsoid((rx, ry, rz), e1, e2).moved(translate(0, 0, z + rz))
            parts.append((solid, str(rng.choice([role, "wood", "marble", "metal", "gloss"]))))
            z += 2 * rz * 0.985
        return parts
    if kind == 3:
        return [
            (
                sf.cage(rng, size * 0.4, size * rng.uniform(0.006, 0.03)),
                str(rng.choice(["metal", "wire", "gloss"])),
            )
        ]
    if kind == 4:
        t = np.linspace(0, 2 * np.pi, 161)
        p, q = [(2, 3), (3, 2), (2, 5), (3, 4)][int(rng.integers(4))]
        path = np.stack(
            [
                (2 + np.cos(q * t)) * np.cos(p * t),
                (2 + np.cos(q * t)) * np.sin(p * t),
                np.sin(q * t),
            ],
            -1,
        )
        g = tube(path * size * 0.14, size * rng.uniform(0.03, 0.08), 12)
        g = g.moved(rotate("x", rng.uniform(0, 1.5)))
        return [(g.moved(translate(0, 0, -g.bounds[0][2])), role)]
    letters = int(rng.integers(2, 6))
    return [(sf.relief(rng, letters, size * 0.6, size * 0.12), role)]


def clutter(rng: Rng, size: float) -> list[Part]:
    """Boxes, balls, dice, pebbles, a phone, keys on a ring."""
    kind = rng.integers(6)
    if kind == 0:
        return [
            (
                box(
                    size * rng.uniform(0.4, 1),
                    size * rng.uniform(0.3, 0.7),
                    size * rng.uniform(0.15, 0.5),
                    0.01 * size,
                ),
                str(rng.choice(["wood", "lacquer", "metal", "gloss"])),
            )
        ]
    if kind == 1:
        r = size * rng.uniform(0.15, 0.4)
        role = str(rng.choice(["glass", "mirror", "gloss", "metal", "rubber", "marble", "tinted"]))
        return [(sphere(r, 24).moved(translate(0, 0, r)), role)]
    if kind == 2:
        parts: list[Part] = []
        for _ in range(int(rng.integers(2, 6))):
            stone = sf.stone(rng, size * rng.uniform(0.08, 0.2))
            x, y = rng.normal(0, size * 0.3, 2)
            parts.append((stone.moved(translate(x, y, -stone.bounds[0][2])), "stone"))
        return parts
    if kind == 3:
        screen = box(size * 0.35, size * 0.7, size * 0.03, size * 0.01)
        return [
            (screen, "black"),
            (quad(size * 0.32, size * 0.64).moved(translate(0, 0, size * 0.0301)), "mirror"),
        ]
    if kind == 4:
        g = sf.chunk(rng, size * 0.25)
        return [
            (
                g.moved(translate(0, 0, -g.bounds[0][2])),
                str(rng.choice(["glass", "tinted", "stone", "frosted"])),
            )
        ]
    parts = []
    for _ in range(int(rng.integers(2, 5))):
        s = size * rng.uniform(0.12, 0.22)
        x, y = rng.normal(0, size * 0.3, 2)
        place = translate(x, y, 0) @ rotate("z", rng.uniform(0, 3))
        parts.append(
            (
                box(s, s, s, s * 0.08).moved(place),
                str(rng.choice(["gloss", "wood", "plastic", "metal"])),
            )
        )
    return parts


def candle(rng: Rng, size: float) -> list[Part]:
    """A candle in a holder (its flame is the stage's business)."""
    r, h = size * 0.1, size * rng.uniform(0.4, 0.9)
    holder = np.array(
        [
            [0, 0],
            [2.2 * r, 0],
            [2.4 * r, 0.3 * r],
            [1.2 * r, 0.5 * r],
            [1.2 * r, 1.5 * r],
            [0, 1.5 * r],
        ]
    )
    wax = np.array([[0, 0], [r, 0], [r, h], [0.8 * r, h - 0.05 * r], [0, h - 0.15 * r]])
    wick = tube(np.array([[0, 0, h - 0.2 * r], [0, 0, h], [0.05 * r, 0, h + 0.3 * r]]), 0.03 * r, 5)
    return [
        (lathe(holder, 32), "metal"),
        (lathe(wax, 24, smooth=1).moved(translate(0, 0, 0.5 * r)), "trim"),
        (wick, "rubber"),
    ]


def potted(rng: Rng, size: float) -> list[Part]:
    """A plant in a pot: cards on a ball, blades from the earth, or a little tree."""
    r = size * rng.uniform(0.12, 0.2)
    h = r * rng.uniform(1.2, 2)
    pot = np.array([[0, 0], [0.75 * r, 0], [0.8 * r, 0.05 * h], [r, h]])
    earth = lathe(np.array([[0.93 * r, 0.86 * h], [0, 0.88 * h]]), 20, smooth=1)
    parts: list[Part] = [
        (lathe(hollow(pot, 0.06 * r), 32), str(rng.choice(["ceramic", "stone", "metal", "wood"])))
    ]
    parts.append((earth, "rubber"))
    crown = size - h
    kind = rng.integers(3)
    if kind == 0:
        green = sf.foliage(
            rng, int(rng.integers(60, 220)), crown * 0.45, crown * rng.uniform(0.15, 0.3)
        )
        parts.append((green.moved(translate(0, 0, h + crown * 0.4)), "leaf"))
    elif kind == 1:
        spots = np.concatenate([rng.normal(0, r * 0.35, (40, 2)), np.full((40, 1), h * 0.85)], 1)
        parts.append((sf.blades(rng, spots, crown, crown * 0.12, 0.7), "leaf"))
    else:
        t = np.linspace(0, 1, 9)[:, None]
        for _ in range(int(rng.integers(1, 4))):
            lean = rng.normal(0, 0.15, 2)
            path = np.concatenate([lean * crown * t**2, h * 0.8 + t * crown * 0.65], 1)
            parts.append((tube(path, 0.02 * size * (1.3 - t[:, 0]), 7), "wood"))
            green = sf.foliage(rng, int(rng.integers(40, 120)), crown * 0.28, crown * 0.2)
            parts.append((green.moved(translate(*path[-1])), "leaf"))
    return parts


def wire_thing(rng: Rng, size: float) -> list[Part]:
    """Grass-like wires in a base."""
    base = lathe(np.array([[0, 0], [0.2, 0], [0.18, 0.1], [0, 0.1]]) * size, 24, smooth=1)
    tuft = sf.wires(rng, int(rng.integers(12, 50)), size, size * rng.uniform(0.002, 0.008))
    return [(base, "wood"), (tuft.moved(translate(0, 0, size * 0.08)), "wire")]


def cup(rng: Rng, size: float) -> list[Part]:
    """A cup with a handle on a saucer."""
    h = size * rng.uniform(0.35, 0.5)
    r = h * rng.uniform(0.45, 0.65)
    p = np.array([[0, 0.04 * h], [0.6 * r, 0.04 * h], [0.9 * r, 0.4 * h], [r, h]])
    t = np.linspace(-1.3, 1.3, 12)[:, None]
    handle = np.concatenate(
        [r * 0.85 + 0.5 * r * np.cos(t), 0 * t, h * 0.52 + 0.33 * h * np.sin(t)], 1
    )
    saucer = np.array(
        [
            [0, 0],
            [1.1 * r, 0],
            [1.6 * r, 0.12 * h],
            [1.55 * r, 0.15 * h],
            [1.05 * r, 0.04 * h],
            [0, 0.04 * h],
        ]
    )
    drink = lathe(np.array([[0.93 * r, 0.8 * h], [0, 0.8 * h]]), 24, smooth=1)
    return [
        (lathe(hollow(p, 0.06 * r), 32), "ceramic"),
        (tube(handle, 0.08 * r, 8), "ceramic"),
        (lathe(saucer, 36), "ceramic"),
        (drink, "black"),
    ]


def fragments(rng: Rng, size: float) -> list[Part]:
    """A broken block."""
    pieces = sf.fractured(
        rng, (size * 0.3, size * 0.25, size * 0.3), int(rng.integers(8, 18)), size * 0.03
    )
    whole = merge(pieces)
    role = str(rng.choice(["stone", "marble", "glass", "ceramic", "tinted"]))
    return [(whole.moved(translate(0, 0, -whole.bounds[0][2])), role)]


def curved_cord(rng: Rng, size: float) -> list[Part]:
    """A cable that lies in loops."""
    p = rng.normal(0, size * 0.35, (7, 3))
    p[:, 2] = size * 0.012
    return [(tube(catmull_rom(p, 10), size * 0.012, 6), "rubber")]


_MAKERS: list[tuple[Callable[[Rng, float], list[Part]], float]] = [
    (vase, 2.0),
    (bottle, 1.5),
    (drinking_glass, 1.3),
    (bowl, 1.6),
    (statue, 1.8),
    (clutter, 1.5),
    (candle, 0.5),
    (potted, 0.8),
    (wire_thing, 0.4),
    (cup, 0.9),
    (fragments, 0.5),
    (curved_cord, 0.2),
]


def thing(rng: Rng, size: float) -> list[Part]:
    """Any small thing, about ``size`` metres high, turned at random."""
    weights = np.array([w for _, w in _MAKERS])
    maker = _MAKERS[int(rng.choice(len(_MAKERS), p=weights / weights.sum()))][0]
    turn = rotate("z", rng.uniform(0, 2 * np.pi)) @ scale(1.0)
    return [(g.moved(turn), role) for g, role in maker(rng, size)]


def pile(rng: Rng, length: float, height: float) -> list[Part]:
    """A pile of lying books."""
    return books(rng, length, height, lying=True)
