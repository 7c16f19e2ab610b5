"""Rooms that people live in: walls with windows, furniture by a theme, daylight or lamps."""

from __future__ import annotations

import numpy as np

from lambent.scenes.mitsuba import cameras, exposure, sky
from lambent.scenes.mitsuba import furniture as fu
from lambent.scenes.mitsuba import surfaces as sf
from lambent.scenes.mitsuba.geometry import (
    Array,
    Geometry,
    box,
    frame_to,
    merge,
    quad,
    rotate,
    translate,
)
from lambent.scenes.mitsuba.lamps import along, neon, white
from lambent.scenes.mitsuba.layout import Floor, extent
from lambent.scenes.mitsuba.plan import CameraPlan, MediumPlan
from lambent.scenes.mitsuba.stage import Part, Stage
from lambent.scenes.mitsuba.textures import screen, to_bytes
from lambent.scenes.mitsuba.things import potted, thing

Hole = tuple[float, float, float, float]

_WALL = 0.22


def wall_with_holes(length: float, height: float, holes: list[Hole]) -> Geometry:
    """A wall in xz with its inner face at y = 0, thickness to +y; holes are (x0, x1, z0, z1)."""
    pieces: list[Geometry] = []

    def block(x0: float, x1: float, z0: float, z1: float) -> None:
        if x1 - x0 > 1e-4 and z1 - z0 > 1e-4:
            g = box(x1 - x0, _WALL, z1 - z0)
            pieces.append(_planar(g.moved(translate((x0 + x1) / 2, _WALL / 2, z0))))

    x = -length / 2
    for x0, x1, z0, z1 in sorted(holes):
        block(x, x0, 0, height)
        block(x0, x1, 0, z0)
        block(x0, x1, z1, height)
        x = x1
    block(x, length / 2, 0, height)
    return merge(pieces)


def _planar(g: Geometry) -> Geometry:
    """Texture coordinates from x and z, so that patterns run on across pieces."""
    depth = np.abs(g.normals[:, 0]) > 0.5
    across = np.where(depth, g.positions[:, 1], g.positions[:, 0])
    up = np.where(np.abs(g.normals[:, 2]) > 0.5, g.positions[:, 1], g.positions[:, 2])
    return Geometry(g.positions, g.normals, np.stack([across, up], -1), g.faces)


def window_frame(rng: np.random.Generator, hole: Hole) -> list[Part]:
    """Frame, bars, sill and perhaps a pane for a hole of a wall."""
    x0, x1, z0, z1 = hole
    w, h, t = x1 - x0, z1 - z0, 0.05
    mid, low = (x0 + x1) / 2, z0
    y = _WALL * 0.6
    bars = [box(w, t, t).moved(translate(mid, y, z)) for z in (low, z1 - t)]
    bars += [box(t, t, h).moved(translate(x, y, low)) for x in (x0 + t / 2, x1 - t / 2)]
    nx, nz = max(1, round(w / rng.uniform(0.5, 1.2))), max(1, round(h / rng.uniform(0.6, 1.6)))
    bars += [box(0.03, 0.04, h).moved(translate(x0 + w * k / nx, y, low)) for k in range(1, nx)]
    bars += [box(w, 0.04, 0.03).moved(translate(mid, y, low + h * k / nz)) for k in range(1, nz)]
    parts: list[Part] = [(merge(bars), "trim")]
    if z0 > 0.3:
        parts.append(
            (box(w + 0.1, 0.3, 0.03, 0.005).moved(translate(mid, -0.02, z0 - 0.03)), "trim")
        )
    if rng.random() < 0.3:
        pane = quad(w, h).moved(translate(mid, y, (z0 + z1) / 2) @ rotate("x", np.pi / 2))
        parts.append((pane, "window"))
    return parts


def holes_for(rng: np.random.Generator, length: float, height: float) -> list[Hole]:
    """Windows of one wall: a row of equal ones, or one wide one down to the floor."""
    count = int(rng.choice([1, 1, 2, 3]))
    width = min(rng.uniform(0.8, 2.4), (length - 0.6) / count - 0.3)
    if width < 0.5:
        return []
    z0 = 0.05 if rng.random() < 0.25 else rng.uniform(0.7, 1.0)
    z1 = min(height - 0.25, z0 + rng.uniform(1.2, 2.2))
    step = (length - 0.4) / count
    return [
        (
            (k + 0.5) * step - length / 2 + 0.2 - width / 2,
            (k + 0.5) * step - length / 2 + 0.2 + width / 2,
            z0,
            z1,
        )
        for k in range(count)
    ]


def shell(stage: Stage, w: float, d: float, h: float, lit_by_day: bool) -> tuple[float, set[int]]:
    """Floor, ceiling, four walls with windows, skirting, curtains; returns the area of the
    windows and the numbers of the walls that have them."""
    rng = stage.rng
    stage.add([(quad(w + 2 * _WALL, d + 2 * _WALL), "floor")])
    stage.add([(quad(w + 1, d + 1).moved(translate(0, 0, h) @ rotate("x", np.pi)), "ceiling")])
    glazed, open_sides = 0.0, set[int]()
    order = rng.permutation(4)
    windows = int(rng.integers(1, 4)) if lit_by_day else int(rng.random() < 0.6)
    accent = int(rng.integers(4)) if rng.random() < 0.4 else -1
    for k, side in enumerate(order):
        length, away = (w, d / 2) if side % 2 == 0 else (d, w / 2)
        pose = rotate("z", side * np.pi / 2) @ translate(0, away, 0)
        holes = holes_for(rng, length, h) if k < windows else []
        role = "wall_accent" if side == accent else "wall"
        # Two more thicknesses close the corners.
        wall = wall_with_holes(length + 2 * _WALL, h, holes)
        stage.add([(wall, role)], pose, solid=False)
        _note_wall(stage, length, h, pose)
        skirting = box(length, 0.015, rng.uniform(0.06, 0.12)).moved(translate(0, -0.008, 0))
        if not holes or holes[0][2] > 0.2:
            stage.add([(skirting, "trim")], pose, solid=False)
        for hole in holes:
            stage.add(window_frame(rng, hole), pose, solid=False)
            glazed += (hole[1] - hole[0]) * (hole[3] - hole[2])
        if holes:
            open_sides.add(int(side))
            _dress_windows(stage, holes, pose, h)
        elif rng.random() < 0.4:
            _door(stage, length, pose)
    return glazed, open_sides


def _note_wall(stage: Stage, length: float, h: float, pose: Array) -> None:
    """Obstacle boxes for cameras, in strips so that views of one wall do not count as many."""
    slab = box(length, _WALL, h).moved(pose @ translate(0, _WALL / 2, 0))
    stage.boxes.append(slab.bounds)


def _dress_windows(stage: Stage, holes: list[Hole], pose: Array, h: float) -> None:
    rng = stage.rng
    style = rng.random()
    for x0, x1, z0, z1 in holes:
        w = x1 - x0
        if style < 0.45:
            top = min(z1 + 0.15, h - 0.02)
            length = top - (0.02 if rng.random() < 0.7 else z0 - 0.1)
            for s in (-1, 1):
                cloth = sf.cloth(
                    rng, w * rng.uniform(0.2, 0.4), length, int(rng.integers(3, 6)), 0.04
                )
                x = (x0 + x1) / 2 + s * w * 0.5
                stage.add([(cloth.moved(translate(x, -0.1, top)), "curtain")], pose, solid=False)
            pole = fu.tube(
                np.array([[x0 - 0.3, -0.1, top], [x0, -0.1, top], [x1 + 0.3, -0.1, top]]), 0.012
            )
            stage.add([(pole, "metal")], pose, solid=False)
        elif style < 0.58:
            drop = (z1 - z0) * rng.uniform(0.3, 1.0)
            blind = [
                (g.moved(translate((x0 + x1) / 2, 0.05, z1)), r)
                for g, r in fu.blinds(rng, w - 0.04, drop)
            ]
            stage.add(blind, pose, solid=False)


def _door(stage: Stage, length: float, pose: Array) -> None:
    rng = stage.rng
    if length < 2.2:
        return
    x = rng.uniform(-length / 2 + 0.6, length / 2 - 0.6)
    leaf = box(0.85, 0.03, 2.05, 0.004).moved(translate(x, -0.015, 0.005))
    frame = [box(0.08, 0.05, 2.14).moved(translate(x + s * 0.47, -0.02, 0)) for s in (-1, 1)]
    frame.append(box(1.02, 0.05, 0.08).moved(translate(x, -0.02, 2.06)))
    panels = [
        box(0.3, 0.012, 0.7, 0.006).moved(translate(x + s * 0.2, -0.033, z))
        for s in (-1, 1)
        for z in (0.2, 1.1)
    ]
    knob = fu.tube(
        np.array([[x + 0.3, -0.03, 1.02], [x + 0.3, -0.07, 1.02], [x + 0.38, -0.075, 1.02]]), 0.01
    )
    role = str(rng.choice(["wood", "trim"]))
    stage.add(
        [(leaf, role), (merge(panels), role), (merge(frame), "trim"), (knob, "metal")],
        pose,
        solid=False,
    )


# --- themes ----------------------------------------------------------------------------------


def _on_top(
    stage: Stage, pose: Array, reach: tuple[float, float], h: float, count: int, size: float
) -> None:
    """Strew some things on a top at height ``h`` of furniture at ``pose``."""
    rng = stage.rng
    taken: list[tuple[float, float, float]] = []
    for _ in range(count):
        item = thing(rng, rng.uniform(0.5, 1.2) * size)
        low, high = extent(item)
        r = float(np.max((high - low)[:2])) / 2
        if r > min(reach):
            continue
        for _ in range(10):
            x, y = rng.uniform(-1, 1, 2) * np.maximum(np.array(reach) - r, 0)
            if all(np.hypot(x - a, y - b) > r + c for a, b, c in taken):
                taken.append((x, y, r))
                centre = (low + high) / 2
                place = pose @ translate(x - centre[0], y - centre[1], h - low[2])
                stage.add(item, place, movable="thing" if rng.random() < 0.5 else None)
                break


def _dining(stage: Stage, floor: Floor, h: float) -> Array:
    rng = stage.rng
    w, d, top = rng.uniform(1.2, 2.2), rng.uniform(0.8, 1.0), rng.uniform(0.72, 0.76)
    at = translate(rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), 0) @ rotate(
        "z", rng.choice([0, np.pi / 2])
    )
    stage.add(fu.table(rng, w, d, top), at)
    seed_chair = fu.chair(rng)
    for k in range(max(1, int(w / 0.62))):
        x = ((k + 0.5) / max(1, int(w / 0.62)) - 0.5) * (w - 0.2)
        for s in (-1, 1):
            if rng.random() < 0.08:
                continue
            out = d / 2 + rng.uniform(0.0, 0.25)
            turn = 0 if s > 0 else np.pi
            place = at @ translate(x, s * out, 0) @ rotate("z", turn + rng.normal(0, 0.1))
            stage.add(seed_chair, place, movable="chair")
    _on_top(stage, at, (w / 2 * 0.85, d / 2 * 0.8), top, int(rng.integers(2, 7)), 0.24)
    floor.take(at[0, 3], at[1, 3], *((w + 1, d + 1.4) if abs(at[0, 0]) > 0.5 else (d + 1.4, w + 1)))
    return at


def _living(stage: Stage, floor: Floor, h: float) -> Array:
    rng = stage.rng
    seats = int(rng.integers(2, 4))
    at = rotate("z", rng.choice([0, np.pi / 2, np.pi, -np.pi / 2]))
    back = 1.35
    if rng.random() < 0.7:
        rug = quad(rng.uniform(2.2, 3.2), rng.uniform(1.5, 2.2), (1, 1)).moved(
            translate(0, 0, 0.008)
        )
        stage.add([(rug, "rug")], at, solid=False)
    stage.add(fu.sofa(rng, seats), at @ translate(0, back, 0))
    if rng.random() < 0.7:
        stage.add(
            fu.sofa(rng, 1),
            at @ translate(-1.6, 0, 0) @ rotate("z", np.pi / 2 + rng.normal(0, 0.15)),
            movable="armchair",
        )
    if rng.random() < 0.3:
        stage.add(
            fu.chair(rng),
            at @ translate(1.5, -0.2, 0) @ rotate("z", -np.pi / 2 + rng.normal(0, 0.3)),
            movable="chair",
        )
    w, d, top = rng.uniform(0.8, 1.3), rng.uniform(0.5, 0.7), rng.uniform(0.32, 0.45)
    stage.add(fu.table(rng, w, d, top), at)
    _on_top(stage, at, (w / 2 * 0.85, d / 2 * 0.85), top, int(rng.integers(2, 6)), 0.2)
    floor.take(0, 0, 3.4, 3.4)
    if rng.random() < 0.55:
        board = at @ translate(0, -1.75, 0) @ rotate("z", np.pi)
        stage.add(fu.cabinet(rng, 1.6, 0.5, 0.4), board)
        _screen(stage, board @ translate(0, 0, 1.1), 1.2)
    return at


def _screen(stage: Stage, pose: Array, w: float) -> None:
    """A television; sometimes it is on."""
    rng = stage.rng
    h = w * 9 / 16
    stage.add(
        [(box(w + 0.04, 0.04, h + 0.04, 0.006).moved(translate(0, 0.025, -h / 2 - 0.02)), "black")],
        pose,
    )
    upright = pose @ translate(0, -0.002, 0) @ rotate("x", np.pi / 2)
    if rng.random() < 0.6 and stage.free("picture"):
        stage.light(
            "picture",
            "screen",
            white(rng, 0.25) * rng.uniform(0.15, 0.7),
            upright,
            (w, h, 1),
            image=to_bytes(screen(rng)),
        )
    else:
        stage.add([(quad(w, h), "black")], upright, solid=False)


def _bedroom(stage: Stage, floor: Floor, h: float) -> Array:
    rng = stage.rng
    w = float(rng.choice([0.9, 1.4, 1.6]))
    at = floor.by_wall(rng, w + 0.2, 2.2)
    at = translate(0, 0, 0) if at is None else at
    stage.add(fu.bed(rng, w), at)
    for s in (-1, 1):
        night = at @ translate(s * (w / 2 + 0.35), 0.85, 0)
        stage.add(fu.cabinet(rng, 0.4, 0.5, 0.38), night)
        if rng.random() < 0.7:
            _standing_lamp(stage, night @ translate(0, 0, 0.5), rng.uniform(0.35, 0.5), 0.13)
        floor.take(night[0, 3], night[1, 3], 0.5, 0.5)
    if rng.random() < 0.6:
        rug = quad(2.2, 1.6, (1, 1)).moved(translate(0, -1.0, 0.008))
        stage.add([(rug, "rug")], at, solid=False)
    return at @ translate(0, -0.6, 0)


def _study(stage: Stage, floor: Floor, h: float) -> Array:
    rng = stage.rng
    w = rng.uniform(1.2, 1.8)
    at = floor.by_wall(rng, w, 1.5)
    at = translate(0, 0, 0) if at is None else at
    desk = at @ translate(0, 0.38, 0)
    stage.add(fu.table(rng, w, 0.7, 0.74), desk)
    stage.add(
        fu.chair(rng),
        at @ translate(rng.normal(0, 0.15), -0.3, 0) @ rotate("z", np.pi + rng.normal(0, 0.5)),
        movable="chair",
    )
    _screen(stage, desk @ translate(rng.uniform(-0.2, 0.2), 0.2, 1.05), 0.6)
    _on_top(
        stage, desk @ translate(0, -0.1, 0), (w / 2 * 0.9, 0.2), 0.74, int(rng.integers(2, 6)), 0.18
    )
    return at


def _kitchen(stage: Stage, floor: Floor, h: float) -> Array:
    rng = stage.rng
    at = floor.by_wall(rng, min(3.0, floor.width - 0.2), 0.62, wall=int(rng.choice([0, 2])))
    at = translate(0, 0, 0) if at is None else at
    length = min(3.0, floor.width - 0.2)
    stage.add(fu.cabinet(rng, length, 0.88, 0.6), at)
    stage.add([(box(length + 0.02, 0.63, 0.03, 0.004).moved(translate(0, 0, 0.88)), "marble")], at)
    upper = fu.cabinet(rng, length * 0.6, 0.7, 0.34)
    stage.add([(g.moved(translate(0, 0.13, 1.4)), r) for g, r in upper], at)
    _on_top(stage, at, (length / 2 * 0.9, 0.24), 0.91, int(rng.integers(4, 9)), 0.24)
    _dining(stage, floor, h)
    return at @ translate(0, -0.8, 0)


_THEMES = {
    "dining": _dining,
    "living": _living,
    "bedroom": _bedroom,
    "study": _study,
    "kitchen": _kitchen,
}


# --- lamps -----------------------------------------------------------------------------------


def _standing_lamp(stage: Stage, pose: Array, height: float, radius: float) -> None:
    rng = stage.rng
    stage.add(fu.lamp_stand(rng, height, radius), pose)
    if "lamps_on" not in stage.tags or not stage.free("bulb"):
        return
    r = 0.03 if rng.random() < 0.7 else 0.012
    at = pose @ translate(0, 0, height - radius * 0.8)
    if rng.random() < 0.25 and stage.free("point"):
        power = white(rng, rng.uniform(0.6, 0.95)) * rng.uniform(0.3, 1) / (4 * np.pi)
        stage.light("point", "lamps", power, at)
        return
    colour = white(rng, rng.uniform(0.6, 0.95)) * rng.uniform(0.3, 1) / (4 * np.pi**2 * r * r)
    stage.light("bulb", "lamps", colour, at, (r, r, r))


def ceiling_lights(stage: Stage, w: float, d: float, h: float, at: Array) -> None:
    """Lamps of one style under the ceiling, over ``at (4, 4)``; lit if the stage says so."""
    rng = stage.rng
    style = str(rng.choice(["pendant", "panels", "spots", "string"], p=[0.4, 0.25, 0.25, 0.1]))
    if style == "pendant":
        for k in range(int(rng.integers(1, 3))):
            x, y = at[0, 3] + (k - 0.5) * 0.7, at[1, 3]
            drop, r = rng.uniform(0.4, h - 1.7), rng.uniform(0.12, 0.3)
            stage.add(fu.pendant(rng, drop, r), translate(x, y, h))
            if "lamps_on" in stage.tags:
                b = min(0.04, r * 0.25)
                colour = white(rng, 0.75) / (4 * np.pi**2 * b * b)
                stage.light(
                    "bulb", "pendant", colour, translate(x, y, h - drop - r * 0.45), (b, b, b)
                )
    elif "lamps_on" not in stage.tags:
        return
    elif style == "panels":
        n = int(rng.integers(1, 4))
        size = rng.uniform(0.3, 1.2, 2)
        for k in range(n):
            pose = translate(
                (k + 0.5) / n * w - w / 2, rng.uniform(-0.2, 0.2) * d, h - 0.02
            ) @ rotate("x", np.pi)
            colour = white(rng, rng.uniform(0.2, 0.7)) / (np.pi * size.prod() * n)
            stage.light("panel", "panels", colour, pose, (size[0], size[1], 1))
            frame = box(size[0] + 0.06, size[1] + 0.06, 0.019).moved(translate(*pose[:3, 3]))
            stage.add([(frame, "trim")], solid=False)
    elif style == "spots":
        for k in range(int(rng.integers(2, 4))):
            x, y = rng.uniform(-0.42, 0.42, 2) * [w, d]
            aim = np.array([rng.normal(0, 0.4), rng.normal(0, 0.4), -1])
            colour = (neon(rng) if rng.random() < 0.12 else white(rng, 0.6)) * rng.uniform(0.3, 1)
            pose = translate(x, y, h - 0.05) @ frame_to(aim)
            stage.light("spot", f"spots_{k}", colour, pose, cutoff=float(rng.uniform(20, 50)))
    else:
        ends = np.array(
            [[-w / 2, -d / 2, h - 0.2], [0, d / 2 - 0.1, h - 0.35], [w / 2, -d / 2, h - 0.2]]
        )
        line = along(ends, 0.35)
        stage.light(
            "string", "fairy_lights", white(rng, 0.9) * 18, np.eye(4), spots=line, bead=0.015
        )
        stage.add([(fu.tube(line, 0.002, 4), "black")], solid=False)


def room(stage: Stage) -> list[CameraPlan]:
    """A furnished room by day, in the evening or at night; returns the cameras."""
    rng = stage.rng
    theme = str(rng.choice(list(_THEMES), p=[0.25, 0.32, 0.17, 0.14, 0.12]))
    w, d, h = rng.uniform(3.6, 7.0), rng.uniform(3.6, 6.5), rng.uniform(2.4, 3.4)
    if theme == "living":
        w, d = max(w, 4.4), max(d, 4.4)
    time = str(rng.choice(["day", "day_lamps", "evening", "night"], p=[0.42, 0.18, 0.18, 0.22]))
    if time != "day":
        stage.tags.add("lamps_on")
    stage.tags.update({theme, time})
    glazed, open_sides = shell(stage, w, d, h, time != "night")
    floor = Floor(w, d)
    middle = _THEMES[theme](stage, floor, h)
    _along_walls(stage, floor, h)
    _on_walls(stage, w, d, open_sides)
    ceiling_lights(stage, w, d, h, middle)
    expose(stage, time, glazed, (w, d, h))
    fog = _haze(stage, w, d, h) if rng.random() < 0.04 else None
    low = np.array([-w / 2, -d / 2, 0])

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        origin = low + np.array([w, d, 1]) * np.array(
            [*r.uniform(0.06, 0.94, 2), r.uniform(0.5, 1.9)]
        )
        aim = (
            middle[:3, 3]
            if r.random() < 0.55
            else low + np.array([w, d, 0]) * r.uniform(0.1, 0.9, 3)
        )
        target = np.array(
            [aim[0] + r.normal(0, 0.3), aim[1] + r.normal(0, 0.3), r.uniform(0.3, 1.4)]
        )
        return origin, target

    return cameras.choose(
        rng, stage.boxes, candidate, clearance=0.5, focal=(16, 50), medium=fog, lens=0.25
    )


def _along_walls(stage: Stage, floor: Floor, h: float) -> None:
    rng = stage.rng
    for _ in range(int(rng.integers(3, 8))):
        what = str(
            rng.choice(
                ["shelf", "cabinet", "plant", "lamp", "chair", "low_shelf"],
                p=[0.3, 0.16, 0.18, 0.18, 0.08, 0.1],
            )
        )
        if what == "shelf":
            w, tall = rng.uniform(0.6, 1.8), rng.uniform(1.6, min(2.3, h - 0.1))
            pose = floor.by_wall(rng, w, 0.3)
            if pose is not None:
                stage.add(fu.shelf(rng, w, tall), pose)
        elif what in ("cabinet", "low_shelf"):
            w, tall, deep = rng.uniform(0.8, 1.8), rng.uniform(0.6, 0.95), rng.uniform(0.35, 0.5)
            pose = floor.by_wall(rng, w, deep)
            if pose is not None:
                maker = (
                    fu.cabinet(rng, w, tall, deep)
                    if what == "cabinet"
                    else fu.shelf(rng, w, tall, deep)
                )
                stage.add(maker, pose)
                _on_top(
                    stage, pose, (w / 2 * 0.9, deep / 2 * 0.85), tall, int(rng.integers(1, 5)), 0.26
                )
        elif what == "plant":
            pose = floor.by_wall(rng, 0.6, 0.6)
            if pose is not None:
                stage.add(potted(rng, rng.uniform(0.7, 1.6)), pose, movable="plant")
        elif what == "lamp":
            pose = floor.by_wall(rng, 0.5, 0.5)
            if pose is not None:
                _standing_lamp(stage, pose, rng.uniform(1.3, 1.7), rng.uniform(0.16, 0.25))
        else:
            pose = floor.by_wall(rng, 0.55, 0.55)
            if pose is not None:
                stage.add(fu.chair(rng), pose, movable="chair")


def _on_walls(stage: Stage, w: float, d: float, open_sides: set[int]) -> None:
    """Pictures on walls without windows (they may hang over shelves)."""
    rng = stage.rng
    for side in range(4):
        if side in open_sides or rng.random() < 0.2:
            continue
        length, away = (w, d / 2) if side % 2 == 0 else (d, w / 2)
        pose = rotate("z", side * np.pi / 2) @ translate(0, away - 0.004, 0)
        n = int(rng.integers(1, 4))
        for k in range(n):
            pw, ph = rng.uniform(0.25, 1.0), rng.uniform(0.3, 0.8)
            x = ((k + 0.5) / n - 0.5) * min(length - 0.8, n * 1.1)
            at = pose @ translate(x, 0, rng.uniform(1.45, 1.65) if ph < 0.7 else 1.55)
            stage.add(fu.picture(rng, pw, ph), at)


def expose(
    stage: Stage,
    time: str,
    glazed: float,
    size: tuple[float, float, float],
    outside_image: Array | None = None,
) -> None:
    """The surroundings (a map of one's own by day), and the strength of everything."""
    rng = stage.rng
    w, d, h = size
    surface = 2 * (w * d + w * h + d * h)
    if time in ("day", "day_lamps"):
        image = sky.daylight(rng, sky.sun_direction(rng, 12, 50))
    elif time == "evening":
        image = sky.daylight(rng, sky.sun_direction(rng, 3, 10), sun_share=0.15)
    else:
        image = sky.night(rng)
    outside = np.pi * max(glazed, 0.2)
    inside = exposure.lamps_flux(stage)
    share = {"day": 0.0, "day_lamps": 0.5, "evening": 2.5, "night": 20.0}[time]
    scale_out = 1.0
    if inside > 0 and share > 0:
        scale_out = inside / (share * outside)
    if inside == 0 and time == "night":
        image = sky.daylight(rng, sky.sun_direction(rng, 12, 50))
    if outside_image is not None and time != "night":
        image = outside_image
    stage.environment(image, scale_out)
    level = (outside * scale_out * 0.8 + inside) * 0.55 / (np.pi * surface * 0.45)
    stage.scale_lights(2.6 * exposure.wish(rng) / max(level, 1e-9))


def _haze(stage: Stage, w: float, d: float, h: float) -> int:
    rng = stage.rng
    fog = MediumPlan(float(rng.uniform(0.03, 0.15)), (0.95, 0.95, 0.96), float(rng.uniform(0, 0.7)))
    skin = box(w + 1.2, d + 1.2, h + 0.6).moved(translate(0, 0, -0.2))
    return stage.medium(fog, skin)
