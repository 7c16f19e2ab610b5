"""Models on a floor, a table, shelves, terrain, or in a room: a `ScenePlan` from a seed.

It uses the stage, the lamps, the rooms and the fixed palette of `lambent.scenes.mitsuba`, so that
all arrangements share one compiled kernel. Models are scaled by their bounding boxes and stand on
what carries them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lambent.scenes.assets.library import Library, beside
from lambent.scenes.assets.model import Model, boxed, load_model, read_picture
from lambent.scenes.assets.surface import Surface, pbr
from lambent.scenes.mitsuba import cameras, exposure, sky
from lambent.scenes.mitsuba import room as rm
from lambent.scenes.mitsuba import surfaces as sf
from lambent.scenes.mitsuba.geometry import (
    Array,
    Geometry,
    box,
    frame_to,
    merge,
    quad,
    rotate,
    scale,
    translate,
)
from lambent.scenes.mitsuba.lamps import neon, white
from lambent.scenes.mitsuba.layout import extent, spots
from lambent.scenes.mitsuba.materials import Wardrobe
from lambent.scenes.mitsuba.noise import generator
from lambent.scenes.mitsuba.palette import ASSET_SLOTS, ENVIRONMENT
from lambent.scenes.mitsuba.plan import CameraPlan, ScenePlan
from lambent.scenes.mitsuba.stage import Part, Stage

#: The kind that is a whole scene of the folder (`whole`).
WHOLE = "whole"
#: Kinds of scenes, and how often each comes up.
SHARES = {"floor": 0.17, "table": 0.19, "shelf": 0.1, "terrain": 0.12, "room": 0.17, WHOLE: 0.25}
#: Roles of procedural materials that a model may be given in place of its own.
_ROLES = (
    "wood", "lacquer", "metal", "metal", "mirror", "glass", "tinted", "frosted", "ceramic",
    "marble", "gloss", "plastic", "upholstery", "stone", "fruit",
)  # fmt: skip
#: The gap between a model and what it stands on, in metres: no surfaces share a place.
_GAP = 0.0005


@dataclass
class Set:
    """A scene in the making: the stage, and where models come from."""

    library: Library
    mi: Any
    stage: Stage
    models: dict[Path, Model] = field(default_factory=dict)
    _surfaces: dict[int, int] = field(default_factory=dict)
    _textures: dict[Path, int] = field(default_factory=dict)

    @property
    def rng(self) -> np.random.Generator:
        """The stage's."""
        return self.stage.rng

    def model(self, most: float | None = None) -> Model:
        """A model at random; if ``most`` is given, rather one of real size below so many metres."""
        for _ in range(6):
            path = self.library.models[int(self.rng.integers(len(self.library.models)))]
            if path not in self.models:
                self.models[path] = load_model(path, self.mi)
            found = self.models[path]
            if most is None or not found.metric or found.size < most:
                break
        return found

    def dressed(self, model: Model) -> list[Part] | None:
        """Meshes and numbers of materials: the model's own or others. None: no slot is left."""
        wardrobe = self.stage.wardrobe
        parts: list[Part] = []
        swap = self.rng.random() < (1.0 if model.plain else 0.3)
        for geometry, surface in model.parts:
            cut_out = surface.structure == "cards"
            if swap and not cut_out and self.rng.random() < 0.8:
                number = self.covering() if self.rng.random() < 0.4 else None
                if number is None:
                    number = wardrobe.get(str(self.rng.choice(_ROLES)))
                parts.append((boxed(geometry), number))
                continue
            if id(surface) not in self._surfaces:
                if not wardrobe.left(surface.structure):
                    return None
                self._surfaces[id(surface)] = self._hung(surface)
            parts.append((geometry, self._surfaces[id(surface)]))
        return parts

    def covering(self) -> int | None:
        """The number of a material from one of the folder's textures, in metres; None: full."""
        pictures = self.library.textures
        if not pictures or self.stage.wardrobe.left("pbr") < 4:
            return None
        path = pictures[int(self.rng.integers(len(pictures)))]
        if path not in self._textures:
            rough, metal, normals = (beside(path, w) for w in ("roughness", "metallic", "normal"))
            surface = pbr(
                path.parent.name,
                read_picture(path, 3),
                read_picture(rough, 1) if rough else float(self.rng.uniform(0.25, 0.9)),
                read_picture(metal, 1) if metal else 0.0,
                normals=read_picture(normals, 3) if normals else None,
            )
            metres = float(np.exp(self.rng.uniform(np.log(0.4), np.log(2.5))))
            self._textures[path] = self._hung(surface, metres)
        return self._textures[path]

    def _hung(self, surface: Surface, metres: float = 1.0) -> int:
        name = "".join(c if c.isalnum() else "_" for c in surface.name)
        return self.stage.wardrobe.own(name, surface.structure, metres, **surface.values)

    def floor(self, *roles: str) -> str | int:
        """A material for a large surface: a texture of the folder, or one of the roles."""
        number = self.covering() if self.rng.random() < 0.65 else None
        return str(self.rng.choice(roles)) if number is None else number

    def surroundings(self) -> tuple[Array, str]:
        """An environment map ``(256, 512, 3)`` of mean luminance one, turned at random."""
        paths = self.library.environments
        if not paths:
            makers = [sky.studio, sky.indoors, lambda r: sky.daylight(r, sky.sun_direction(r))]
            return sky.normalised(makers[int(self.rng.integers(3))](self.rng)), "procedural"
        path = paths[int(self.rng.integers(len(paths)))]
        image = read_map(path, self.mi)
        turn = int(self.rng.integers(ENVIRONMENT[1]))
        image = np.roll(image, turn, 1)
        return sky.normalised(image[:, ::-1] if self.rng.random() < 0.5 else image), path.stem


def kind_of(seed: int, library: Library) -> str:
    """The kind of scene of a seed, of those that the folder has something for."""
    kinds = [k for k in SHARES if (library.scenes if k == WHOLE else library.models)]
    shares = np.array([SHARES[k] for k in kinds])
    return str(generator(seed, 3).choice(kinds, p=shares / shares.sum()))


def arrangement(seed: int, library: Library, mi: Any, setting: str) -> ScenePlan:
    """The arrangement of a seed in one of `SHARES`, but `WHOLE`."""
    models: dict[Path, Model] = {}
    for attempt in range(20):  # a composition without four good views is put up anew
        key = (list(SHARES).index(setting) + 1, attempt)
        wardrobe = Wardrobe(generator(seed, 5, *key), ASSET_SLOTS)
        stage = Stage(generator(seed, 4, *key), wardrobe)
        views = _MAKERS[setting](Set(library, mi, stage, models))
        if len(views) >= 4:
            return stage.finish(setting, seed, views)
    raise AssertionError(f"no view of arrangement {seed} ({setting}) is good")


def read_map(path: Path, mi: Any) -> Array:
    """An environment map at the palette's size, without negative or infinite values."""
    picture = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
    image = np.nan_to_num(np.asarray(picture, np.float64), posinf=6e4)
    image = np.clip(image, 0, 6e4)
    h, w = ENVIRONMENT
    while image.shape[0] >= 2 * h:  # halves keep the light; small suns stay
        even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
        image = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4
    rows = np.arange(h) * image.shape[0] // h
    columns = np.arange(w) * image.shape[1] // w
    return image[rows][:, columns]


def wanted_size(rng: np.random.Generator, model: Model, least: float, most: float) -> float:
    """The longest side that a model is given, in metres: its own where that is known and fits."""
    if model.metric and least * 0.5 < model.size < most * 1.5:
        return float(np.clip(model.size * np.exp(rng.normal(0, 0.15)), least, most))
    return float(np.exp(rng.uniform(np.log(least), np.log(most))))


# ------------------------------------------------------------------- private


def _ready(s: Set, least: float, most: float) -> list[tuple[Geometry, str | int]] | None:
    """A model of a sensible size, turned about z (rarely lying), its base at z = 0 about (0, 0)."""
    rng = s.rng
    model = s.model(most * 1.5)
    size = wanted_size(rng, model, least, most)
    parts = s.dressed(model)
    if parts is None:
        return None
    matrix = rotate("z", rng.uniform(0, 2 * np.pi)) @ scale(size / model.size)
    if rng.random() < 0.08:
        matrix = rotate("x", np.pi / 2) @ matrix
    # Box-projected coordinates are in the model's units: metres by the same factor.
    turned: list[Part] = []
    for (geometry, _), (mesh, number) in zip(model.parts, parts, strict=True):
        own = mesh.uv is geometry.uv
        placed = mesh.moved(matrix)
        turned.append((placed if own else placed.with_uv(size / model.size), number))
    low, high = extent(turned)
    shift = translate(-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2])
    return [(g.moved(shift), number) for g, number in turned]


def _strew(
    s: Set,
    count: int,
    sizes: tuple[float, float],
    reach: tuple[float, float],
    at: Array,
    *,
    spread: float = 1.0,
    ground: Any = None,
) -> None:
    """Put ``count`` models on a rectangle of half sides ``reach`` about ``at (4, 4)``.

    ``ground(x, y)`` is the height of what carries them, if it is not level.
    """
    items = [item for item in (_ready(s, *sizes) for _ in range(count)) if item is not None]
    radii = []
    for item in items:
        low, high = extent(item)
        radii.append(float(np.hypot(*(high - low)[:2])) / 2 * 0.85 + 0.01)
    order = [int(i) for i in np.argsort(radii)[::-1]]
    places = spots(s.rng, [radii[i] for i in order], reach, spread=spread)
    for i, place in zip(order, places, strict=True):
        if place is None:
            continue
        z = _GAP if ground is None else ground(*place)
        pose = at @ translate(place[0], place[1], z)
        s.stage.add(items[i], pose, movable="model" if s.rng.random() < 0.6 else None)


def _floor(s: Set) -> list[CameraPlan]:
    rng, stage = s.rng, s.stage
    large = rng.random() < 0.5
    reach = (2.6, 2.2) if large else (1.0, 0.8)
    stage.add([(quad(60, 60), s.floor("floor", "stone", "ground", "lacquer"))], solid=False)
    stage.boxes.append((np.array([-8, -8, -0.1]), np.array([8, 8, 0.0])))
    if rng.random() < 0.35:
        back = quad(60, 5).moved(
            translate(0, reach[1] + rng.uniform(0.6, 2), 2.5) @ rotate("x", np.pi / 2)
        )
        stage.add([(back, s.floor("wall", "facade"))])
    sizes = (0.35, 2.4) if large else (0.12, 0.9)
    _strew(s, int(rng.integers(4, 13)), sizes, reach, np.eye(4))
    _light(s, max(reach))
    return _around(s, max(reach), 0.3 if large else 0.15)


def _table(s: Set) -> list[CameraPlan]:
    rng, stage = s.rng, s.stage
    w, d = rng.uniform(0.8, 1.6), rng.uniform(0.6, 1.0)
    top = box(w, d, 0.04, 0.006).moved(translate(0, 0, -0.04))
    legs = [
        box(0.05, 0.05, 0.71).moved(translate(x * (w / 2 - 0.06), y * (d / 2 - 0.06), -0.75))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    stage.add([(top, s.floor("wood", "marble", "lacquer", "stone", "metal"))])
    stage.add([(merge(legs), "wood")], solid=False)
    stage.add([(quad(40, 40).moved(translate(0, 0, -0.75)), s.floor("floor", "stone"))])
    if rng.random() < 0.45:
        away = d / 2 + rng.uniform(0.02, 2)
        back = quad(12, 4).moved(translate(0, away, 1.2) @ rotate("x", np.pi / 2))
        stage.add([(back, s.floor("wall", "wall_accent"))])
    count = int(rng.integers(4, 13))
    _strew(s, count, (0.06, 0.42), (w / 2 * 0.92, d / 2 * 0.92), np.eye(4), spread=0.8)
    _light(s, max(w, d) / 2)
    return _around(s, max(w, d) / 2, 0.1)


def _shelf(s: Set) -> list[CameraPlan]:
    rng, stage = s.rng, s.stage
    w, d, rise = rng.uniform(0.9, 1.8), rng.uniform(0.28, 0.42), rng.uniform(0.3, 0.5)
    boards = int(rng.integers(2, 5))
    wall = quad(14, 6).moved(translate(0, d / 2 + 0.01, 1.5) @ rotate("x", np.pi / 2))
    stage.add([(wall, s.floor("wall", "wall_accent", "facade"))])
    stage.add([(quad(14, 14), s.floor("floor"))])
    planks = [box(w, d, 0.025).moved(translate(0, 0, 0.3 + k * rise)) for k in range(boards + 1)]
    sides = [box(0.03, d, 0.325 + boards * rise).moved(translate(x * w / 2, 0, 0)) for x in (-1, 1)]
    stage.add([(merge([*planks, *sides]), s.floor("wood", "lacquer", "metal"))], solid=False)
    for k in range(boards):
        z = 0.325 + k * rise
        stage.boxes.append((np.array([-w / 2, -d / 2, z - 0.025]), np.array([w / 2, d / 2, z])))
        at = translate(0, 0, z)
        _strew(s, int(rng.integers(2, 5)), (0.08, rise * 0.8), (w / 2 * 0.95, d / 2), at)
    _light(s, w / 2, front=True)
    middle = 0.3 + boards * rise / 2

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        target = np.array([r.normal(0, w / 5), 0, middle + r.normal(0, boards * rise / 5)])
        around, up = np.pi * 1.5 + r.normal(0, 0.45), r.normal(0.1, 0.2)
        toward = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        return target + toward * np.exp(r.uniform(np.log(0.6), np.log(2.4))), target

    return cameras.choose(
        rng, stage.boxes, candidate, clearance=0.15, focal=(24, 80), lens=0.4, background=True
    )


def _terrain(s: Set) -> list[CameraPlan]:
    rng, stage = s.rng, s.stage
    ground = sf.terrain(rng, rng.uniform(0.1, 2.0), rng.uniform(0.4, 0.55))
    stage.add([(ground.geometry(), s.floor("ground", "rock"))], solid=False)
    for a in range(8):  # the ground as boxes, for the cameras' eyes only
        for b in range(8):
            x, y = (a - 3.5) * 10, (b - 3.5) * 10
            z = ground(x, y)
            stage.boxes.append((np.array([x - 5, y - 5, z - 5]), np.array([x + 5, y + 5, z])))
    reach = (7.0, 6.0)
    _strew(s, int(rng.integers(6, 13)), (0.5, 6.0), reach, np.eye(4), ground=ground)
    image, name = s.surroundings()
    stage.tags.add(name)
    stage.environment(image, 2.2 * exposure.wish(rng))

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        a, distance = r.uniform(0, 2 * np.pi), np.exp(r.uniform(np.log(2.5), np.log(14)))
        target = np.array([*r.normal(0, 2.0, 2), 0])
        target[2] = ground(target[0], target[1]) + r.uniform(0.3, 1.8)
        origin = target + distance * np.array([np.cos(a), np.sin(a), 0])
        origin[2] = ground(origin[0], origin[1]) + r.uniform(0.3, 2.2)
        return origin, target

    return cameras.choose(
        rng, stage.boxes, candidate, clearance=0.6, focal=(20, 70), background=True, lens=0.25
    )


def _room(s: Set) -> list[CameraPlan]:
    rng, stage = s.rng, s.stage
    w, d, h = rng.uniform(3.6, 6.5), rng.uniform(3.6, 6.0), rng.uniform(2.4, 3.3)
    time = str(rng.choice(["day", "day_lamps", "evening", "night"], p=[0.45, 0.2, 0.15, 0.2]))
    if time != "day":
        stage.tags.add("lamps_on")
    stage.tags.add(time)
    glazed, _ = rm.shell(stage, w, d, h, time != "night")
    _strew(s, int(rng.integers(6, 13)), (0.4, 2.2), (w / 2 - 0.25, d / 2 - 0.25), np.eye(4))
    x, y = rng.uniform(-0.6, 0.6, 2)
    rm.ceiling_lights(stage, w, d, h, translate(x, y, 0))
    image = s.surroundings()[0] if rng.random() < 0.6 else None
    rm.expose(stage, time, glazed, (w, d, h), image)

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        origin = np.array([*(r.uniform(-0.44, 0.44, 2) * [w, d]), r.uniform(0.4, 1.9)])
        target = np.array([*(r.normal(0, 0.2, 2) * [w, d]), r.uniform(0.2, 1.2)])
        return origin, target

    return cameras.choose(rng, stage.boxes, candidate, clearance=0.4, focal=(16, 50), lens=0.25)


_MAKERS = {"floor": _floor, "table": _table, "shelf": _shelf, "terrain": _terrain, "room": _room}


def _light(s: Set, reach: float, *, front: bool = False) -> None:
    """The surroundings alone, or dim ones and lamps somewhere around."""
    rng, stage = s.rng, s.stage
    image, name = s.surroundings()
    stage.tags.add(name)
    style = str(rng.choice(["map", "panels", "spots", "bulb"], p=[0.55, 0.22, 0.12, 0.11]))
    fill = 1.0 if style == "map" else float(rng.uniform(0.03, 0.4))
    stage.environment(image, fill)
    arc = (1.1, 1.9) if front else (0.0, 2.0)
    for k in range(0 if style == "map" else int(rng.integers(1, 4))):
        phi, up = np.pi * rng.uniform(*arc), rng.uniform(0.3, 1.4)
        toward = np.array([np.cos(phi) * np.cos(up), np.sin(phi) * np.cos(up), np.sin(up)])
        distance = reach * rng.uniform(1.4, 3) + 0.3
        at = toward * distance + [0, 0, 0.8 if front else 0.0]
        colour = neon(rng) if rng.random() < 0.12 else white(rng, rng.uniform(0.1, 0.8))
        power = colour * distance**2 * (1 if k == 0 else rng.uniform(0.1, 0.7))
        if style == "panels":
            size = reach * rng.uniform(0.15, 1.0, 2)
            pose = translate(*at) @ frame_to(-toward)
            stage.light("panel", f"panel_{k}", power / size.prod(), pose, (size[0], size[1], 1))
        elif style == "spots":
            aim = frame_to(-toward + rng.normal(0, 0.1, 3))
            cutoff = float(rng.uniform(12, 40))
            stage.light("spot", f"spot_{k}", power, translate(*at) @ aim, cutoff=cutoff)
        else:
            r = 0.02 * reach + 0.005
            stage.light("bulb", f"bulb_{k}", power / (4 * r * r), translate(*at), (r, r, r))
    level = exposure.irradiance(stage, np.array([0, 0, 0.6 if front else 0.1]))
    level += np.pi * fill * 0.7
    stage.scale_lights(exposure.wish(rng) * np.pi / (0.35 * max(level, 1e-6)))


def _around(s: Set, reach: float, clearance: float) -> list[CameraPlan]:
    """Cameras that look at the middle from the front half of all around."""

    def candidate(r: np.random.Generator) -> tuple[Array, Array]:
        around = np.pi * 1.5 + r.normal(0, 0.7)
        up = np.radians(r.uniform(3, 50) if r.random() < 0.85 else r.uniform(50, 75))
        distance = reach * np.exp(r.uniform(np.log(0.8), np.log(2.8)))
        toward = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        target = np.array([*(r.normal(0, 0.28, 2) * reach), r.uniform(0.05, 0.35) * reach])
        return target + toward * distance, target

    return cameras.choose(
        s.rng, s.stage.boxes, candidate, clearance=clearance, focal=(22, 85), lens=0.4,
        background=True,
    )  # fmt: skip
