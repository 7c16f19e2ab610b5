"""Studios: one large thing, or a composition of solids, before a bent backdrop."""

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
    frame_to,
    merge,
    quad,
    rotate,
    sphere,
    super_ellipsoid,
    translate,
)
from lambent.scenes.mitsuba.lamps import neon, white
from lambent.scenes.mitsuba.layout import extent, spots
from lambent.scenes.mitsuba.plan import CameraPlan, MediumPlan
from lambent.scenes.mitsuba.stage import Part, Stage
from lambent.scenes.mitsuba.still_life import sweep
from lambent.scenes.mitsuba.things import potted, statue, thing


def studio(stage: Stage) -> list[CameraPlan]:
    """A product shot or an abstract composition; returns the cameras."""
    rng = stage.rng
    back = sweep(60, 14, 14).moved(translate(0, rng.uniform(1.5, 3), 0))
    stage.add(
        [
            (
                back,
                str(rng.choice(["wall", "lacquer", "gloss", "floor", "black", "ceiling"])),
            )
        ],
        solid=False,
    )
    stage.boxes.append((np.array([-8, -8, -0.1]), np.array([8, 3, 0.0])))
    stage.boxes.append((np.array([-8, 3, 0]), np.array([8, 3.3, 9.0])))
    theme = str(
        rng.choice(
            ["hero", "solids", "swarm", "letters", "furniture", "blocks"],
            p=[0.2, 0.25, 0.15, 0.1, 0.18, 0.12],
        )
    )
    stage.tags.add(theme)
    _subject(stage, theme)
    if rng.random() < 0.06:
        r = 0.8
        smoke = MediumPlan(
            float(rng.uniform(0.5, 2.5)), tuple(rng.uniform(0.6, 0.99, 3).tolist()), 0.2
        )
        skin = sf.displaced(rng, (r, r, r), 0.3, 1.5, level=4)
        stage.medium(smoke, skin.moved(translate(rng.uniform(-1, 1), rng.uniform(-0.5, 0.8), 1.25)))
    _light(stage)

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        around = np.pi * 1.5 + r.normal(0, 0.5)
        up = np.radians(r.uniform(2, 38))
        distance = np.exp(r.uniform(np.log(1.6), np.log(5)))
        toward = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        target = np.array([*r.normal(0, 0.35, 2), r.uniform(0.15, 0.8)])
        origin = target + toward * distance
        origin[2] = max(origin[2], 0.15)
        return origin, target

    return cameras.choose(
        rng, stage.boxes, candidate, clearance=0.3, focal=(24, 85), lens=0.45, background=True
    )


def _subject(stage: Stage, theme: str) -> None:
    rng = stage.rng
    if theme == "hero":
        stage.add(statue(rng, rng.uniform(0.9, 1.5)), translate(0, 0, 0), movable="hero")
        for _ in range(int(rng.integers(1, 5))):
            item = thing(rng, rng.uniform(0.25, 0.5))
            a, r = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 1.5)
            stage.add(
                item,
                translate(r * np.cos(a), r * np.sin(a) * 0.7, -extent(item)[0][2]),
                movable="thing",
            )
    elif theme == "solids":
        sizes = [float(s) for s in rng.uniform(0.12, 0.45, int(rng.integers(5, 14)))]
        roles = [
            "glass",
            "mirror",
            "metal",
            "gloss",
            "ceramic",
            "marble",
            "frosted",
            "tinted",
            "lacquer",
            "rust",
            "plastic",
        ]
        for reach, place in zip(sizes, spots(rng, sizes, (1.6, 1.0)), strict=True):
            if place is None:
                continue
            kind = rng.integers(3)
            if kind == 0:
                e = rng.choice([0.15, 0.4, 1.0, 1.0, 2.0], 2)
                g = super_ellipsoid(
                    (reach, reach * 0.9, reach * rng.uniform(0.4, 1.3)),
                    float(e[0]),
                    float(e[1]),
                    28,
                )
            elif kind == 1:
                g = sphere(reach * 0.9, 28)
            else:
                sides = int(rng.integers(3, 9))
                turn = np.linspace(0, 2 * np.pi, sides + 1)[:-1]
                outline = np.stack([np.cos(turn), np.sin(turn)], -1) * reach * 0.9
                g = extrude(
                    outline,
                    reach * rng.uniform(0.5, 2.2),
                    taper=float(rng.choice([1.0, 0.6, 0.1])),
                    twist=float(rng.choice([0, 0, 1.2])),
                )
            g = g.moved(translate(0, 0, -g.bounds[0][2]))
            stage.add(
                [(g, str(rng.choice(roles)))],
                translate(*place, 0) @ rotate("z", rng.uniform(0, 6)),
                movable="solid",
            )
    elif theme == "swarm":
        bead = float(rng.uniform(0.03, 0.09))
        count = int(rng.integers(150, 700))
        e = rng.choice([0.2, 1.0, 2.0], 2)
        one = super_ellipsoid((bead, bead, bead), float(e[0]), float(e[1]), 7)
        role_count = int(rng.integers(1, 4))
        centre = rng.normal(0, 1, (count, 3)) * [0.6, 0.4, 0.35] + [0, 0, 0.75]
        centre[:, 2] = np.abs(centre[:, 2]) + bead
        if rng.random() < 0.5:  # a helix instead of a cloud
            t = np.linspace(0, 1, count)
            centre = np.stack(
                [0.7 * np.cos(18 * t) * (1.1 - t), 0.7 * np.sin(18 * t) * (1.1 - t), 0.1 + 1.5 * t],
                -1,
            )
        matrices = np.array(
            [translate(*c) @ rotate(rng.normal(size=3), rng.uniform(0, 3)) for c in centre]
        )
        names = ["gloss", "metal", "glass", "ceramic", "mirror", "wood", "tinted"]
        chosen = [str(r) for r in rng.choice(names, role_count, replace=False)]
        groups = rng.integers(0, role_count, count)
        for k, role in enumerate(chosen):
            if (groups == k).any():
                stage.add([(copies(one, matrices[groups == k]), role)], movable="swarm")
        stage.tags.add("scattered")
    elif theme == "letters":
        text = sf.relief(
            rng,
            int(rng.integers(3, 7)),
            rng.uniform(0.4, 0.8),
            rng.uniform(0.06, 0.3),
            rows=int(rng.integers(1, 3)),
        )
        stage.add(
            [
                (
                    text,
                    str(
                        rng.choice(["metal", "gloss", "wood", "glass", "mirror", "marble", "rust"])
                    ),
                )
            ],
            movable="letters",
        )
        stage.add(thing(rng, 0.4), translate(0.5, -0.6, 0), movable="thing")
        stage.add(thing(rng, 0.3), translate(-0.6, -0.5, 0), movable="thing")
    elif theme == "furniture":
        makers: list[list[Part]] = [
            fu.chair(rng),
            fu.sofa(rng, int(rng.integers(1, 3))),
            fu.lamp_stand(rng, 1.5, 0.22),
            potted(rng, 1.3),
        ]
        keep = rng.permutation(4)[: int(rng.integers(2, 4))]
        for k, i in enumerate(keep):
            turn = rotate("z", rng.normal(0, 0.5))
            stage.add(
                makers[i],
                translate((k - 1) * 1.15 + 0.3, rng.uniform(-0.3, 0.6), 0) @ turn,
                movable="furniture",
            )
        stage.add([(quad(2.6, 1.8, (1, 1)).moved(translate(0, 0, 0.006)), "rug")], solid=False)
    else:
        pieces = sf.fractured(rng, (0.7, 0.45, 0.6), int(rng.integers(12, 26)), 0.04, 0.5)
        roles = [
            str(r)
            for r in rng.choice(
                ["stone", "marble", "glass", "gloss", "metal", "ceramic"], 2, replace=False
            )
        ]
        for k in (0, 1):
            part = merge(pieces[k::2])
            stage.add([(part.moved(translate(0, 0, 0.75)), roles[k])], movable="block")
        stage.add([(box(1.8, 1.2, 0.12, 0.01), "pedestal")], translate(0, 0, 0))


def _light(stage: Stage) -> None:
    rng = stage.rng
    style = str(rng.choice(["map", "boxes", "spots", "coloured"], p=[0.35, 0.35, 0.15, 0.15]))
    makers = [sky.studio, sky.studio, sky.indoors]
    image = makers[int(rng.integers(3))](rng)
    stage.environment(image, 1.0 if style == "map" else rng.uniform(0.03, 0.3))
    if style in ("boxes", "coloured"):
        for k in range(int(rng.integers(1, 4))):
            phi, up = rng.uniform(np.pi * 0.85, np.pi * 2.15), rng.uniform(0.25, 1.4)
            toward = np.array([np.cos(phi) * np.cos(up), np.sin(phi) * np.cos(up), np.sin(up)])
            distance = rng.uniform(3, 5)
            size = rng.uniform(0.3, 2.2, 2)
            pose = translate(*(toward * distance + [0, 0, 0.4])) @ frame_to(-toward)
            colour = neon(rng) if style == "coloured" else white(rng, rng.uniform(0.2, 0.6))
            power = colour * distance**2 / size.prod() * (1.5 if k == 0 else rng.uniform(0.2, 1))
            stage.light("panel", f"softbox_{k}", power, pose, (size[0], size[1], 1))
    elif style == "spots":
        for k in range(int(rng.integers(2, 4))):
            at = np.array([rng.uniform(-3, 3), rng.uniform(-3.5, 1), rng.uniform(2, 4)])
            pose = translate(*at) @ frame_to(np.array([0, 0, 0.4]) - at)
            colour = neon(rng) if rng.random() < 0.3 else white(rng)
            stage.light(
                "spot",
                f"spot_{k}",
                colour * (at @ at) * 1.5,
                pose,
                cutoff=float(rng.uniform(8, 25)),
            )
        r = 0.02
        if rng.random() < 0.5:  # a small strong lamp: caustics and fireflies
            at = translate(rng.uniform(-1.5, 1.5), rng.uniform(-0.5, 1), rng.uniform(0.8, 1.8))
            stage.light("bulb", "lamp", white(rng, 0.8) * 0.5 / (r * r), at, (r, r, r))
    env = next(e for e in stage.emitters if e.kind == "envmap")
    level = (
        exposure.irradiance(stage, np.array([0, 0, 0.3])) + np.pi * float(env.values["scale"]) * 0.6
    )
    stage.scale_lights(exposure.wish(rng) * np.pi / (0.42 * max(level, 1e-6)))
