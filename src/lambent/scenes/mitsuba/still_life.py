"""Still lifes: a few things on a table, a pedestal or a studio floor, seen from near."""

from __future__ import annotations

import numpy as np

from lambent.scenes.mitsuba import cameras, exposure, sky
from lambent.scenes.mitsuba import surfaces as sf
from lambent.scenes.mitsuba.geometry import (
    Array,
    Geometry,
    box,
    copies,
    frame_to,
    grid,
    lathe,
    merge,
    quad,
    rotate,
    super_ellipsoid,
    translate,
)
from lambent.scenes.mitsuba.lamps import along, neon, white
from lambent.scenes.mitsuba.layout import extent, spots
from lambent.scenes.mitsuba.plan import CameraPlan, MediumPlan
from lambent.scenes.mitsuba.stage import Part, Stage
from lambent.scenes.mitsuba.things import books, pile, statue, thing


def sweep(width: float, depth: float, height: float) -> Geometry:
    """A studio's backdrop: floor and wall in one bent sheet, the bend at +y."""
    r = 0.35 * height
    angle = np.linspace(0, np.pi / 2, 16)
    y = np.concatenate([[-depth, 0], r * np.sin(angle)[1:], [r]])
    z = np.concatenate([[0, 0], r - r * np.cos(angle)[1:], [height]])
    x = np.array([-0.5, 0.5]) * width
    points = np.stack(np.broadcast_arrays(x[None, :], y[:, None], z[:, None]), -1)
    path = np.concatenate([[0], np.cumsum(np.hypot(np.diff(y), np.diff(z)))])
    uv = np.stack(np.broadcast_arrays(x[None, :], path[:, None]), -1)
    return grid(points, uv)


def still_life(stage: Stage) -> list[CameraPlan]:
    """Things on a surface under one or two lights; returns the cameras."""
    rng = stage.rng
    setting = str(rng.choice(["table", "sweep", "corner", "pedestal"], p=[0.4, 0.2, 0.25, 0.15]))
    reach = _surface(stage, setting)
    _arrange(stage, reach, tall=setting == "pedestal")
    _light(stage, setting)
    level = exposure.irradiance(stage, np.array([0, 0, 0.1])) + _ambient(stage)
    stage.scale_lights(exposure.wish(rng) * np.pi / (0.3 * max(level, 1e-6)))

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        around = np.pi * 1.5 + r.normal(0, 0.55)
        up = np.radians(r.uniform(3, 50) if r.random() < 0.8 else r.uniform(50, 75))
        distance = max(reach) * np.exp(r.uniform(np.log(1.1), np.log(2.9)))
        toward = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        target = np.array([*(r.normal(0, 0.22, 2) * reach), r.uniform(0.03, 0.2)])
        return target + toward * distance, target

    boxes = stage.boxes
    return cameras.choose(
        rng, boxes, candidate, clearance=0.12, focal=(28, 90), lens=0.5, background=True
    )


def _surface(stage: Stage, setting: str) -> tuple[float, float]:
    """Put up what things stand on at z = 0; returns its half sides."""
    rng = stage.rng
    if setting == "pedestal":
        r = rng.uniform(0.22, 0.35)
        block = box(2 * r, 2 * r, 1.1, 0.01).moved(translate(0, 0, -1.1))
        drum = np.array(
            [
                [0, 0],
                [r * 1.1, 0],
                [r * 1.1, 0.05],
                [r, 0.08],
                [r, 1.02],
                [r * 1.1, 1.05],
                [r * 1.1, 1.1],
                [0, 1.1],
            ]
        )
        round_one = lathe(drum, 48, smooth=1).moved(translate(0, 0, -1.1))
        stage.add([(block if rng.random() < 0.5 else round_one, "pedestal")])
        stage.add([(quad(9, 9).moved(translate(0, 0, -1.1)), "floor")])
        wall = rng.uniform(0.6, 2.2)
        stage.add([(quad(9, 4).moved(translate(0, wall, 0.5) @ rotate("x", np.pi / 2)), "wall")])
        return r * 0.85, r * 0.85
    if setting == "sweep":
        sheet = sweep(30, 8, 8).moved(translate(0, rng.uniform(0.4, 1.2), 0))
        stage.add(
            [(sheet, str(rng.choice(["wall", "cloth", "lacquer", "gloss", "black"])))], solid=False
        )
        stage.boxes.append((np.array([-4, -4, -0.1]), np.array([4, 1.5, 0.0])))
        stage.boxes.append((np.array([-4, 1.5, 0]), np.array([4, 1.7, 3.0])))
        return rng.uniform(0.3, 0.6), rng.uniform(0.25, 0.45)
    w, d = rng.uniform(0.8, 1.6), rng.uniform(0.6, 0.9)
    role = str(
        rng.choice(
            ["wood", "marble", "stone", "lacquer", "metal", "floor"],
            p=[0.45, 0.15, 0.1, 0.1, 0.05, 0.15],
        )
    )
    stage.add([(box(w, d, 0.05, 0.006).moved(translate(0, 0, -0.05)), role)])
    if rng.random() < 0.45:
        _drape(stage, w, d)
    if setting == "corner":
        stage.add(
            [(quad(8, 4).moved(translate(0, d / 2 + 0.01, 0.9) @ rotate("x", np.pi / 2)), "wall")]
        )
        side = float(rng.choice([-1, 1]))
        turn = rotate("z", -side * np.pi / 2) @ rotate("x", np.pi / 2)
        at = translate(side * (w / 2 + rng.choice([0.01, 0.4])), d / 2 - 4, 0.9)
        stage.add([(quad(8, 4).moved(at @ turn), "wall_accent")])
        stage.add([(quad(10, 10).moved(translate(0, 0, -0.75)), "floor")])
    else:
        back = rng.uniform(0.5, 2.5)
        stage.add([(quad(10, 5).moved(translate(0, back, 0.5) @ rotate("x", np.pi / 2)), "wall")])
        stage.add([(quad(10, 8).moved(translate(0, back - 4, -0.75)), "floor")])
        if rng.random() < 0.35:
            stage.add(
                [
                    (
                        sf.cloth(rng, 2.4, 3.2, 12).moved(
                            translate(rng.uniform(-1, 1), back - 0.12, 2.4)
                        ),
                        "curtain",
                    )
                ]
            )
        if rng.random() < 0.3:
            row = books(rng, 0.8, 0.25)
            stage.add(row, translate(-0.4, back - 0.15, 0.2))
            stage.add([(box(1.2, 0.25, 0.03).moved(translate(0, back - 0.13, 0.17)), "wood")])
    return w / 2 * 0.85, d / 2 * 0.85


def _drape(stage: Stage, w: float, d: float) -> None:
    """A cloth over a part of the table, with folds, hanging over the front edge."""
    rng = stage.rng
    n, m = 60, 44
    u, v = np.linspace(-0.5, 0.5, n), np.linspace(-0.9, 0.5, m)
    width = w * rng.uniform(0.4, 0.8)
    x = np.broadcast_to(u * width, (m, n)) + rng.uniform(-0.15, 0.15)
    run = v * d * 1.0
    over = np.maximum(-d / 2 - 0.004 - run, 0)
    y = np.maximum(run, -d / 2 - 0.004)[:, None] + np.zeros((m, n))
    fold = 0.012 * np.sin(u * rng.uniform(14, 30) + rng.uniform(0, 6)) ** 2
    z = 0.004 - over[:, None] + fold * (over[:, None] <= 0)
    y = y - (over[:, None] > 0) * (fold * 2)
    points = np.stack([x, y, z], -1)
    uv = np.stack(np.broadcast_arrays(u * width, run[:, None]), -1)
    stage.add([(grid(points, uv), "cloth")], solid=False)


def _arrange(stage: Stage, reach: tuple[float, float], *, tall: bool) -> None:
    rng = stage.rng
    items: list[list[Part]] = []
    if tall:
        items.append(statue(rng, rng.uniform(0.3, 0.55)))
    else:
        for _ in range(int(rng.integers(3, 10))):
            items.append(thing(rng, rng.uniform(0.14, 0.36)))
        if rng.random() < 0.25:
            items.append(pile(rng, 0.12, 0.22))
    bounds = [extent(i) for i in items]
    sizes = [float(np.max((b[1] - b[0])[:2])) / 2 + 0.005 for b in bounds]
    order = np.argsort(sizes)[::-1]
    places = spots(rng, [sizes[i] for i in order], reach)
    for i, place in zip(order, places, strict=True):
        if place is None:
            continue
        centre = (bounds[i][0] + bounds[i][1]) / 2
        pose = translate(place[0] - centre[0], place[1] - centre[1], -bounds[i][0][2] + 0.0005)
        stage.add(items[i], pose, movable="thing")
    if rng.random() < 0.2 and not tall:
        scattered(stage, reach, float(rng.uniform(0.006, 0.015)), int(rng.integers(30, 250)))
    if rng.random() < 0.05:
        r = rng.uniform(0.04, 0.08)
        e1, e2 = (float(v) for v in rng.choice([0.3, 1.0], 2))
        body = super_ellipsoid((r, r, r), e1, e2, 24).moved(translate(0, 0, r * 1.01))
        fog = MediumPlan(float(rng.uniform(10, 60)), tuple(rng.uniform(0.7, 0.99, 3).tolist()), 0.3)
        free = [p for p in places if p is not None]
        x, y = free[-1] if free else (0.0, 0.0)
        stage.fill([(body, "glass")], translate(x, y - reach[1] * 0.4, 0), fog)


def scattered(stage: Stage, reach: tuple[float, float], size: float, count: int) -> None:
    """Many copies of one small solid strewn over the surface: beads, petals, coins, sweets."""
    rng = stage.rng
    e = rng.choice([0.2, 1.0, 1.0, 2.0], 2)
    flat = float(rng.choice([0.15, 0.5, 1.0]))
    one = super_ellipsoid((size, size, size * flat), float(e[0]), float(e[1]), 8)
    matrices = np.zeros((count, 4, 4))
    for k in range(count):
        x, y = rng.normal(0, 0.45, 2) * reach
        turn = rotate("z", rng.uniform(0, 6.3)) @ rotate("x", rng.normal(0, 0.15))
        matrices[k] = translate(x, y, size * flat + 0.0005) @ turn
    role = str(rng.choice(["gloss", "metal", "glass", "ceramic", "wood", "petal", "tinted"]))
    stage.add([(copies(one, matrices), role)], solid=False)
    stage.tags.add("scattered")


def _ambient(stage: Stage) -> float:
    env = next(e for e in stage.emitters if e.kind == "envmap")
    return np.pi * float(env.values["scale"]) * 0.6


def _light(stage: Stage, setting: str) -> None:
    """Window light, soft boxes, one bulb, spots, or only the surroundings."""
    rng = stage.rng
    style = str(
        rng.choice(
            ["softbox", "window", "bulb", "spots", "surroundings", "string"],
            p=[0.26, 0.24, 0.12, 0.14, 0.18, 0.06],
        )
    )
    maker = [sky.studio, sky.indoors][int(rng.integers(2))]
    fill = {"surroundings": 1.0, "bulb": 0.04, "spots": 0.06, "string": 0.08}.get(style, 0.15)
    stage.environment(maker(rng), fill * rng.uniform(0.4, 1.6))
    if style in ("softbox", "window"):
        for k in range(int(rng.integers(1, 3))):
            phi = rng.uniform(np.pi * 0.9, np.pi * 2.1)
            up = rng.uniform(0.15, 1.3)
            toward = np.array([np.cos(phi) * np.cos(up), np.sin(phi) * np.cos(up), np.sin(up)])
            distance = rng.uniform(1.2, 2.5)
            size = rng.uniform(0.15, 1.2, 2)
            pose = translate(*(toward * distance)) @ frame_to(-toward)
            colour = neon(rng) if rng.random() < 0.06 else white(rng, rng.uniform(0.1, 0.7))
            power = colour * distance**2 / size.prod() * (1 if k == 0 else rng.uniform(0.1, 0.6))
            stage.light("panel", f"softbox_{k}", power, pose, (size[0], size[1], 1))
            if style == "window":  # glazing bars before the light throw a pattern
                bars = [
                    box(size[0] + 0.3, 0.03, 0.03).moved(translate(0, s * size[1] / 4, 0.1))
                    for s in (-1, 0, 1)
                ]
                bars += [
                    box(0.03, size[1] + 0.3, 0.03).moved(translate(s * size[0] / 4, 0, 0.1))
                    for s in (-1, 0, 1)
                ]
                stage.add([(merge(bars), "trim")], pose)
    elif style == "bulb":
        r = rng.uniform(0.005, 0.05)
        x, y, z = rng.uniform(-0.7, 0.7), rng.uniform(-0.7, 0.2), rng.uniform(0.4, 1.2)
        if rng.random() < 0.3:
            stage.light("point", "bulb", white(rng, rng.uniform(0.5, 1)), translate(x, y, z))
        else:
            power = white(rng, rng.uniform(0.5, 1)) / (4 * r * r)
            stage.light("bulb", "bulb", power, translate(x, y, z), (r, r, r))
    elif style == "spots":
        for k in range(int(rng.integers(1, 4))):
            at = np.array([rng.uniform(-1.2, 1.2), rng.uniform(-1.4, 0.3), rng.uniform(0.7, 1.8)])
            pose = translate(*at) @ frame_to(-at + rng.normal(0, 0.08, 3))
            colour = neon(rng) if rng.random() < 0.25 else white(rng)
            stage.light(
                "spot", f"spot_{k}", colour * (at @ at), pose, cutoff=float(rng.uniform(10, 35))
            )
    elif style == "string":
        ends = np.array([[-0.8, 0.3, 0.5], [0, 0.25, rng.uniform(0.4, 0.7)], [0.8, 0.3, 0.5]])
        beads = along(ends, 0.12)
        stage.light(
            "string", "fairy_lights", white(rng, 0.9) * 60, np.eye(4), spots=beads, bead=0.006
        )
        stage.add([(sf.tube(beads, 0.0015, 4), "rubber")], solid=False)
    if setting == "pedestal" and style == "surroundings":
        stage.light(
            "panel",
            "ceiling",
            white(rng, 0.4) * 2,
            translate(0, 0, 2.5) @ rotate("x", np.pi),
            (1, 1, 1),
        )
