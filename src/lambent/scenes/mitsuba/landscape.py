"""Open scenes under a sky: terrain with rocks, plants and ruins, courtyards, terraces."""

from __future__ import annotations

import numpy as np

from lambent.scenes.mitsuba import cameras, exposure, sky
from lambent.scenes.mitsuba import furniture as fu
from lambent.scenes.mitsuba import surfaces as sf
from lambent.scenes.mitsuba.geometry import (
    Array,
    box,
    copies,
    extrude,
    merge,
    quad,
    rotate,
    scale,
    translate,
    tube,
)
from lambent.scenes.mitsuba.palette import SKY_SCALES
from lambent.scenes.mitsuba.plan import CameraPlan, EmitterPlan, MediumPlan
from lambent.scenes.mitsuba.room import wall_with_holes, window_frame
from lambent.scenes.mitsuba.stage import Part, Stage
from lambent.scenes.mitsuba.things import potted, statue, thing, vase


def tree(rng: np.random.Generator, height: float) -> list[Part]:
    """A trunk with branches, and cards for leaves; some are conifers, some bare."""
    parts: list[Part] = []
    t = np.linspace(0, 1, 10)[:, None]
    lean = rng.normal(0, 0.08, 2)
    trunk = np.concatenate([lean * height * t**1.5, height * 0.85 * t], 1)
    thick = 0.03 * height
    limbs = [tube(trunk, thick * (1.15 - t[:, 0]), 8)]
    crowns = []
    conifer = rng.random() < 0.3
    bare = rng.random() < 0.12
    for _ in range(int(rng.integers(5, 10))):
        s = rng.uniform(0.35, 0.95)
        base = trunk[int(s * 9)]
        a = rng.uniform(0, 2 * np.pi)
        reach = height * (0.34 * (1.2 - s) if conifer else rng.uniform(0.15, 0.32))
        rise = reach * (-0.2 if conifer else rng.uniform(0.3, 1.0))
        end = base + np.array([np.cos(a) * reach, np.sin(a) * reach, rise])
        path = base + (end - base) * t + np.array([0, 0, 0.1 * reach]) * np.sin(np.pi * t)
        limbs.append(tube(path, thick * 0.5 * (1.1 - t[:, 0]), 6))
        if not bare:
            r = reach * rng.uniform(0.5, 0.8)
            crown = sf.foliage(
                rng,
                int(rng.integers(60, 160)),
                r,
                height * rng.uniform(0.05, 0.09),
                upright=-0.2 if conifer else 0.4,
            )
            crowns.append(crown.moved(translate(*(base * 0.25 + end * 0.75))))
    parts.append((merge(limbs), "wood"))
    if crowns:
        parts.append((merge(crowns), "leaf"))
    return parts


def house(rng: np.random.Generator, w: float, d: float, h: float) -> list[Part]:
    """Four walls with windows, a pitched or flat roof, a door; its front is −y."""
    parts: list[Part] = []
    floors = max(1, int(h / 2.8))
    for side in range(4):
        length, away = (w, d / 2) if side % 2 == 0 else (d, w / 2)
        pose = rotate("z", side * np.pi / 2) @ translate(0, away, 0) @ rotate("z", np.pi)
        n = max(1, int(length / 2.2))
        holes = []
        for k in range(n):
            x = ((k + 0.5) / n - 0.5) * length
            low = 0.05 if (side == 2 and k == n // 2) else 0.9
            holes.append((x - 0.5, x + 0.5, low, 2.2))
        ground = wall_with_holes(length, 2.8, holes)
        levels = [ground.moved(translate(0, 0, 2.8 * f)) for f in range(floors)]
        parts.append(
            (merge(levels).moved(pose @ rotate("z", np.pi) @ translate(0, -0.22, 0)), "facade")
        )
        for f in range(floors):
            for hole in holes:
                for g, role in window_frame(rng, hole)[:1]:
                    turn = pose @ rotate("z", np.pi) @ translate(0, -0.22, 2.8 * f)
                    parts.append((g.moved(turn), role))
                glass = quad(1.0, 2.2 - hole[2]).moved(
                    translate((hole[0] + hole[1]) / 2, 0.1, (hole[2] + 2.2) / 2 + 2.8 * f)
                    @ rotate("x", np.pi / 2)
                )
                parts.append(
                    (glass.moved(pose @ rotate("z", np.pi) @ translate(0, -0.22, 0)), "black")
                )
    top = 2.8 * floors
    if rng.random() < 0.6:
        rise = rng.uniform(0.8, 2.4)
        outline = np.array([[-d / 2 - 0.4, 0], [d / 2 + 0.4, 0], [0, rise]])
        roof = extrude(outline, w + 0.6).moved(
            translate(-w / 2 - 0.3, 0, top) @ rotate("z", np.pi / 2) @ rotate("x", np.pi / 2)
        )
        parts.append((roof, str(rng.choice(["wood", "lacquer", "stone", "rust"]))))
    else:
        parts.append((box(w + 0.4, d + 0.4, 0.25).moved(translate(0, 0, top)), "stone"))
    return parts


def landscape(stage: Stage) -> list[CameraPlan]:
    """An open scene; returns the cameras."""
    rng = stage.rng
    theme = str(
        rng.choice(["wild", "ruins", "village", "court", "table"], p=[0.32, 0.18, 0.2, 0.18, 0.12])
    )
    stage.tags.add(theme)
    half = 11.0
    rough = rng.uniform(0.4, 0.55)
    relief = rng.uniform(0.3, 4.5) if theme in ("wild", "ruins") else 0.25
    if theme in ("court", "table"):
        relief = 0.02
    ground = sf.terrain(rng, relief, rough)
    stage.add([(ground.geometry(), "ground")], solid=False)
    for a in range(8):  # the ground as boxes, for the cameras' eyes only
        for b in range(8):
            x, y = (a - 3.5) * 20, (b - 3.5) * 20
            z = ground(x, y)
            stage.boxes.append((np.array([x - 10, y - 10, z - 5]), np.array([x + 10, y + 10, z])))
    _populate(stage, theme, ground, half)
    _sky(stage)
    fog = None
    if rng.random() < 0.08:
        mist = MediumPlan(float(rng.uniform(0.01, 0.04)), (0.97, 0.97, 0.98), 0.5)
        fog = stage.medium(mist, box(60, 60, 30).moved(translate(0, 0, -8)))
    near = theme in ("court", "table")

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        a = r.uniform(0, 2 * np.pi)
        distance = np.exp(r.uniform(np.log(2.0), np.log(8.0 if near else 15.0)))
        target = np.array([*r.normal(0, 1.2, 2), 0])
        target[2] = ground(target[0], target[1]) + r.uniform(0.2, 1.5)
        origin = target + distance * np.array([np.cos(a), np.sin(a), 0])
        origin[2] = (
            ground(origin[0], origin[1])
            + r.uniform(0.3, 1.9)
            + (r.random() < 0.15) * r.uniform(1, 4)
        )
        return origin, target

    return cameras.choose(
        rng,
        stage.boxes,
        candidate,
        clearance=0.7,
        focal=(20, 70),
        background=True,
        lens=0.25,
        medium=fog,
    )


def _populate(stage: Stage, theme: str, ground: sf.Terrain, half: float) -> None:
    rng = stage.rng

    def spot(reach: float) -> Array:
        x, y = rng.uniform(-reach, reach, 2)
        return translate(x, y, ground(x, y) - 0.03)

    def turned() -> Array:
        return rotate("z", rng.uniform(0, 2 * np.pi))

    greens = {"wild": 9, "ruins": 4, "village": 5, "court": 2, "table": 1}[theme]
    for _ in range(int(rng.integers(greens // 2, greens + 1))):
        at = spot(half) if theme != "court" else spot(half) @ translate(0, 9, 0)
        if np.hypot(at[0, 3], at[1, 3]) > 2.5:
            stage.add(tree(rng, rng.uniform(2.5, 7)), at @ turned())
    _backdrop(stage, ground)
    rocks = {"wild": 14, "ruins": 8, "village": 3, "court": 2, "table": 2}[theme]
    kinds = [sf.stone(rng, 1.0), sf.stone(rng, 1.0), sf.chunk(rng, 0.8)]
    for _ in range(int(rng.integers(rocks // 2, rocks + 1))):
        size = float(np.exp(rng.uniform(np.log(0.15), np.log(1.4))))
        rock = kinds[int(rng.integers(3))].moved(
            turned() @ scale(size, size * rng.uniform(0.7, 1.2), size * rng.uniform(0.6, 1))
        )
        stage.add(
            [(rock, "rock")],
            spot(half * 0.7) @ translate(0, 0, size * 0.15),
            movable="rock" if size < 0.5 else None,
        )
    if theme in ("wild", "ruins", "village"):
        count = int(rng.integers(250, 1100))
        xy = rng.normal(0, half * 0.35, (count, 2))
        points = np.array([[x, y, ground(x, y) - 0.02] for x, y in xy])
        stage.add(
            [(sf.blades(rng, points, rng.uniform(0.15, 0.7), rng.uniform(0.08, 0.3)), "blade")],
            solid=False,
        )
        for _ in range(int(rng.integers(3, 12))):
            bush = sf.foliage(
                rng, int(rng.integers(80, 220)), rng.uniform(0.3, 0.7), rng.uniform(0.1, 0.2)
            )
            stage.add([(bush, "leaf")], spot(half * 0.6) @ translate(0, 0, 0.3))
    if theme == "ruins":
        h, r = rng.uniform(2.5, 4.5), rng.uniform(0.2, 0.35)
        for k in range(int(rng.integers(3, 8))):
            pillar = fu.column(rng, h, r)
            if rng.random() < 0.3:
                stage.add(pillar, spot(5) @ translate(0, 0, r) @ turned() @ rotate("x", np.pi / 2))
            else:
                stage.add(pillar, translate(k * 1.8 - 5, 3 + 0.2 * k, ground(k * 1.8 - 5, 3) - 0.1))
        for _ in range(int(rng.integers(1, 4))):
            pieces = sf.fractured(rng, (1.2, 0.3, 0.8), 14, 0.04, 0.5)
            stage.add([(merge(pieces), "pedestal")], spot(4) @ translate(0, 0, 0.6) @ turned())
        stage.add(statue(rng, 1.6), translate(0, 0, ground(0, 0)), movable="statue")
    elif theme == "village":
        for k in range(int(rng.integers(1, 5))):
            w, d, h = rng.uniform(5, 9), rng.uniform(4, 7), rng.uniform(2.8, 8)
            at = translate(k * 10.5 - 14, 7 + rng.uniform(0, 3), ground(k * 10.5 - 14, 8) - 0.1)
            stage.add(house(rng, w, d, h), at @ rotate("z", rng.normal(0, 0.15)))
        fence = [(g, "wood") for g, _ in fu.rail(40, 9.0, 0.9)]
        stage.add(fence, translate(rng.uniform(-3, 3), 2.5, ground(0, 2.5)))
        stage.add(statue(rng, 1.4), translate(0, 0, ground(0, 0)), movable="statue")
        stage.add(thing(rng, 0.7), spot(2.5), movable="thing")
    elif theme == "court":
        w = rng.uniform(7, 12)
        holes = [(x - 0.6, x + 0.6, 0.0, 2.6) for x in np.arange(-w / 2 + 1.2, w / 2 - 1, 2.2)]
        for side in range(int(rng.integers(2, 4))):
            pose = rotate("z", side * np.pi / 2) @ translate(0, w / 2, 0)
            stage.add([(wall_with_holes(w, rng.uniform(3, 5), holes), "facade")], pose)
        stage.add([(quad(w, w).moved(translate(0, 0, 0.01)), "floor")], solid=False)
        for x in np.arange(-w / 2 + 0.6, w / 2, 2.2):
            stage.add(fu.column(rng, 3.0, 0.16), translate(x, w / 2 - 1.8, 0))
        for _ in range(int(rng.integers(3, 8))):
            x, y = rng.uniform(-w / 2 + 0.8, w / 2 - 0.8, 2)
            stage.add(potted(rng, rng.uniform(0.7, 1.8)), translate(x, y, 0.01), movable="pot")
        stage.add([(box(0.9, 0.9, 0.9, 0.02), "pedestal")], translate(0, 0, 0))
        stage.add(statue(rng, 1.1), translate(0, 0, 0.9), movable="statue")
        stage.add(fu.stairs(2.0, 5), translate(w / 4, w / 2 - 1.6, 0))
    elif theme == "table":
        stage.add([(box(5, 5, 0.12).moved(translate(0, 0, 0.02)), "floor")])
        stage.add(fu.table(rng, 1.5, 0.9, 0.85), translate(0, 0, 0.14))
        for k in range(int(rng.integers(3, 7))):
            item = vase(rng, 0.3) if k == 0 else thing(rng, rng.uniform(0.15, 0.3))
            stage.add(item, translate(-0.5 + 0.22 * k, rng.normal(0, 0.15), 0.99), movable="thing")
        for s in (-1, 1):
            stage.add(
                fu.chair(rng),
                translate(0, s * 0.75, 0.14) @ rotate("z", 0 if s > 0 else np.pi),
                movable="chair",
            )
        stage.add(fu.rail(30, 5, 0.9), translate(0, 2.5, 0.1))
        stage.add(potted(rng, 1.4), translate(1.8, 1.6, 0.14), movable="pot")


def _backdrop(stage: Stage, ground: sf.Terrain) -> None:
    """Trees and rocks far behind: copies of a few."""
    rng = stage.rng
    if rng.random() < 0.25:
        return
    for _ in range(int(rng.integers(1, 3))):
        model = tree(rng, rng.uniform(4, 10))
        count = int(rng.integers(4, 12))
        a, r = rng.uniform(0, 2 * np.pi, count), rng.uniform(15, 55, count)
        size, turn = rng.uniform(0.6, 1.3, count), rng.uniform(0, 6.3, count)
        matrices = np.array(
            [
                translate(
                    r[k] * np.cos(a[k]),
                    r[k] * np.sin(a[k]),
                    ground(r[k] * np.cos(a[k]), r[k] * np.sin(a[k])) - 0.1,
                )
                @ rotate("z", turn[k])
                @ scale(size[k])
                for k in range(count)
            ]
        )
        stage.add([(copies(g, matrices), role) for g, role in model], solid=False)
    count = int(rng.integers(5, 40))
    a, r = rng.uniform(0, 2 * np.pi, count), rng.uniform(8, 80, count)
    size = np.exp(rng.uniform(np.log(0.2), np.log(2.5), count))
    matrices = np.array(
        [
            translate(
                r[k] * np.cos(a[k]),
                r[k] * np.sin(a[k]),
                ground(r[k] * np.cos(a[k]), r[k] * np.sin(a[k])),
            )
            @ rotate("z", a[k] * 7)
            @ scale(size[k])
            for k in range(count)
        ]
    )
    stage.add([(copies(sf.stone(rng, 1.0), matrices), "rock")], solid=False)


def _sky(stage: Stage) -> None:
    rng = stage.rng
    wish = exposure.wish(rng) * 1.4
    if rng.random() < 0.12:
        sun = sky.sun_direction(rng, 6, 60)
        values = {
            "sun": tuple(sun.tolist()),
            "turbidity": float(rng.uniform(2, 8)),
            "albedo": float(rng.uniform(0.1, 0.5)),
            "scale": float(rng.choice(SKY_SCALES)),
        }
        stage.emitters.append(EmitterPlan("environment", "sunsky", values))
        stage.tags.add("sunsky")
        return
    image = sky.daylight(rng, sky.sun_direction(rng, 5, 65))
    stage.environment(image, wish * 3.0)
