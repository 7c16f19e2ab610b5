"""Halls: galleries and arcades with columns, pedestals, stairs, lit from above or by spots."""

from __future__ import annotations

import numpy as np

from lambent.scenes.mitsuba import cameras, exposure, sky
from lambent.scenes.mitsuba import furniture as fu
from lambent.scenes.mitsuba import surfaces as sf
from lambent.scenes.mitsuba.geometry import Array, box, frame_to, merge, quad, rotate, translate
from lambent.scenes.mitsuba.lamps import along, neon, white
from lambent.scenes.mitsuba.layout import Floor
from lambent.scenes.mitsuba.plan import CameraPlan, MediumPlan
from lambent.scenes.mitsuba.room import wall_with_holes
from lambent.scenes.mitsuba.stage import Stage
from lambent.scenes.mitsuba.textures import screen, to_bytes
from lambent.scenes.mitsuba.things import potted, statue, thing


def hall(stage: Stage) -> list[CameraPlan]:
    """A large interior; returns the cameras."""
    rng = stage.rng
    w, d, h = rng.uniform(6, 11), rng.uniform(8, 16), rng.uniform(3.4, 6)
    light = str(
        rng.choice(
            ["skylight", "windows", "spots", "panels", "neon"], p=[0.27, 0.2, 0.22, 0.16, 0.15]
        )
    )
    stage.tags.add(light)
    opening = _shell(stage, w, d, h, light)
    floor = Floor(w - 0.6, d - 0.6)
    if rng.random() < 0.6:
        _columns(stage, w, d, h)
    if rng.random() < 0.35:
        stage.add(fu.stairs(2.2, 8), translate(0, d / 2 - 2.4, 0))
        floor.take(0, d / 2 - 1.2, 2.4, 2.6)
        stage.add([(box(w, 0.6, 0.1), "pedestal")], translate(0, d / 2 - 0.3, 1.36), solid=False)
    _exhibits(stage, floor)
    _pictures(stage, w, d)
    _lamps(stage, w, d, h, light)
    _expose(stage, light, opening, (w, d, h))
    fog = None
    if rng.random() < 0.08:
        haze = MediumPlan(float(rng.uniform(0.03, 0.12)), (0.96, 0.96, 0.96), 0.4)
        fog = stage.medium(haze, box(w + 1, d + 1, h + 1).moved(translate(0, 0, -0.2)))

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        origin = np.array([*(r.uniform(-0.45, 0.45, 2) * [w, d]), r.uniform(0.6, 2.2)])
        target = np.array([*(r.uniform(-0.4, 0.4, 2) * [w, d]), r.uniform(0.4, 2.0)])
        return origin, target

    return cameras.choose(
        rng, stage.boxes, candidate, clearance=0.7, focal=(18, 60), medium=fog, lens=0.25
    )


def _shell(stage: Stage, w: float, d: float, h: float, light: str) -> float:
    """Walls, floor and a roof; returns the area of openings."""
    rng = stage.rng
    stage.add([(quad(w + 1, d + 1), "floor")])
    opening = 0.0
    for side in range(4):
        length, away = (w, d / 2) if side % 2 == 0 else (d, w / 2)
        pose = rotate("z", side * np.pi / 2) @ translate(0, away, 0)
        holes = []
        if light == "windows" and side in (1, 3 if rng.random() < 0.3 else 1):
            n = int(length / 2.4)
            holes = [
                (
                    (k + 0.5) / n * length - length / 2 - 0.55,
                    (k + 0.5) / n * length - length / 2 + 0.55,
                    0.6,
                    h - 0.6,
                )
                for k in range(n)
            ]
        opening += sum((b - a) * (f - e) for a, b, e, f in holes)
        stage.add(
            [(wall_with_holes(length + 0.44, h, holes), "wall" if side != 0 else "wall_accent")],
            pose,
            solid=False,
        )
        slab = box(length, 0.2, h).moved(pose @ translate(0, 0.1, 0))
        stage.boxes.append(slab.bounds)
    top = translate(0, 0, h) @ rotate("x", np.pi / 2)
    if light == "skylight":
        n = int(d / 2.5)
        hole = (-w * 0.2, w * 0.2, d / n / 2 - 0.7, d / n / 2 + 0.7)
        strips = [wall_with_holes(w + 0.4, d / n, [hole])] * n
        roof = merge([s.moved(translate(0, 0, k * d / n)) for k, s in enumerate(strips)])
        stage.add([(roof.moved(translate(0, d / 2, 0.0) @ top), "ceiling")], solid=False)
        opening += n * 1.4 * w * 0.4
        beams = [
            box(w, 0.1, 0.2).moved(translate(0, (k + 0.5) / n * d - d / 2, h - 0.25))
            for k in range(n)
        ]
        stage.add([(merge(beams), str(rng.choice(["wood", "metal", "trim"])))], solid=False)
    else:
        stage.add(
            [(quad(w + 0.6, d + 0.6).moved(translate(0, 0, h) @ rotate("x", np.pi)), "ceiling")]
        )
        if rng.random() < 0.5:
            beams = [
                box(w, 0.2, 0.25).moved(translate(0, y, h - 0.25))
                for y in np.arange(-d / 2 + 1, d / 2, 1.8)
            ]
            stage.add([(merge(beams), str(rng.choice(["wood", "metal", "trim"])))], solid=False)
    return opening


def _columns(stage: Stage, w: float, d: float, h: float) -> None:
    pillar = fu.column(stage.rng, h, stage.rng.uniform(0.15, 0.28))
    for y in np.arange(-d / 2 + 1.2, d / 2 - 0.8, 2.4):
        for s in (-1, 1):
            stage.add(pillar, translate(s * w * 0.3, y, 0))


def _exhibits(stage: Stage, floor: Floor) -> None:
    rng = stage.rng
    for _ in range(int(rng.integers(5, 11))):
        kind = str(
            rng.choice(
                ["pedestal", "case", "large", "bench", "plant", "pile"],
                p=[0.38, 0.14, 0.2, 0.1, 0.1, 0.08],
            )
        )
        pose = floor.anywhere(rng, 1.3, 1.3)
        if pose is None:
            continue
        if kind in ("pedestal", "case"):
            h = rng.uniform(0.7, 1.2)
            stage.add([(box(0.5, 0.5, h, 0.01), "pedestal")], pose)
            size = rng.uniform(0.3, 0.7)
            item = statue(rng, size) if rng.random() < 0.7 else thing(rng, size * 0.7)
            stage.add(item, pose @ translate(0, 0, h), movable="exhibit")
            if kind == "case":
                stage.add(
                    [(box(0.48, 0.48, 0.7).moved(translate(0, 0, h)), "window")], pose, solid=False
                )
        elif kind == "large":
            stage.add(statue(rng, rng.uniform(1.0, 2.0)), pose, movable="sculpture")
        elif kind == "bench":
            stage.add(fu.table(rng, 1.3, 0.4, 0.45), pose)
        elif kind == "plant":
            stage.add(potted(rng, rng.uniform(1, 2)), pose, movable="plant")
        else:
            for k in range(int(rng.integers(2, 5))):
                s = rng.uniform(0.3, 0.6)
                at = (
                    pose
                    @ translate(rng.normal(0, 0.2), rng.normal(0, 0.2), 0.5 * k * (k < 2))
                    @ rotate("z", rng.uniform(0, 3))
                )
                stage.add([(box(s, s, s, 0.01), str(rng.choice(["wood", "lacquer", "rust"])))], at)


def _pictures(stage: Stage, w: float, d: float) -> None:
    rng = stage.rng
    for side in (1, 3, 0, 2):
        length, away = (w, d / 2) if side % 2 == 0 else (d, w / 2)
        pose = rotate("z", side * np.pi / 2) @ translate(0, away - 0.004, 0)
        if rng.random() < 0.25:
            continue
        n = max(1, int(length / rng.uniform(1.6, 3)))
        for k in range(n):
            x = ((k + 0.5) / n - 0.5) * length
            pw, ph = rng.uniform(0.5, 1.4), rng.uniform(0.5, 1.5)
            if rng.random() < 0.12:
                letters = sf.relief(rng, 6, 0.25, 0.04, rows=3)
                stage.add([(letters, "metal")], pose @ translate(x, 0, 1.2), solid=False)
            else:
                stage.add(fu.picture(rng, pw, ph), pose @ translate(x, 0, 1.65), solid=True)


def _lamps(stage: Stage, w: float, d: float, h: float, light: str) -> None:
    rng = stage.rng
    if light == "spots":
        for k in range(3):
            at = np.array([rng.uniform(-0.3, 0.3) * w, ((k + 0.5) / 3 - 0.5) * d, h - 0.3])
            aim = np.array([rng.normal(0, 1), rng.normal(0, 0.6), -1.6])
            colour = neon(rng) if rng.random() < 0.15 else white(rng, rng.uniform(0.4, 0.8))
            stage.light(
                "spot",
                f"spots_{k}",
                colour,
                translate(*at) @ frame_to(aim),
                cutoff=float(rng.uniform(25, 55)),
            )
        for _ in range(2):
            x, y = rng.uniform(-0.4, 0.4, 2) * [w, d]
            stage.light("point", "bulbs", white(rng, 0.8) * 0.12, translate(x, y, h - 0.6))
        stage.light(
            "panel",
            "fill",
            white(rng, 0.4) * 0.1,
            translate(0, 0, h - 0.02) @ rotate("x", np.pi),
            (w * 0.3, d * 0.3, 1),
        )
    elif light == "panels":
        for k in range(4):
            size = (rng.uniform(0.2, 1.5), rng.uniform(0.2, 1.2))
            pose = translate(
                rng.uniform(-0.2, 0.2) * w, ((k + 0.5) / 4 - 0.5) * d, h - 0.3
            ) @ rotate("x", np.pi)
            stage.light(
                "panel", f"panels_{k % 2}", white(rng, 0.4) / (size[0] * size[1]), pose, (*size, 1)
            )
    elif light == "neon":
        for k in range(3):
            side = float(rng.choice([-1, 1]))
            pose = translate(
                side * (w / 2 - 0.05), rng.uniform(-0.4, 0.4) * d, rng.uniform(0.6, h - 0.5)
            ) @ rotate("y", -side * np.pi / 2)
            size = (rng.uniform(0.04, 0.1), rng.uniform(1, 3))
            stage.light("panel", f"neon_{k}", neon(rng) / (size[0] * size[1]), pose, (*size, 1))
        line = along(
            np.array(
                [[-w / 2, -d / 4, h - 0.4], [w / 2, d / 8, h - 0.4], [-w / 2, d / 3, h - 0.4]]
            ),
            0.6,
        )
        stage.light(
            "string", "fairy_lights", white(rng, 0.9) * 60, np.eye(4), spots=line, bead=0.02
        )
        stage.light(
            "picture",
            "screen",
            white(rng, 0.2) * 1.5,
            translate(0, d / 2 - 0.03, 2) @ rotate("x", np.pi / 2),
            (2.6, 1.5, 1),
            image=to_bytes(screen(rng)),
        )


def _expose(stage: Stage, light: str, opening: float, size: tuple[float, float, float]) -> None:
    rng = stage.rng
    w, d, h = size
    surface = 2 * (w * d + w * h + d * h)
    if opening > 0:
        image, scale_out = sky.daylight(rng, sky.sun_direction(rng, 25, 70)), 1.0
    else:
        image, scale_out = sky.night(rng), 1e-3
    stage.environment(image, scale_out, 1.0 if opening > 0 else 0.02)
    power = np.pi * opening * scale_out * 0.8 + exposure.lamps_flux(stage)
    level = power * 0.5 / (np.pi * surface * 0.5)
    stage.scale_lights(2.6 * exposure.wish(rng) / max(level, 1e-9))
