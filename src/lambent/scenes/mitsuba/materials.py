"""Materials by the part they play: wall, floor, table top, vase, cushion, leaf.

A `Wardrobe` belongs to one scene: it has a colour scheme, makes a material when a role is first
asked for, and hands out what it has once the slots of the palette are full, as a real household
has few materials and many things.
"""

from __future__ import annotations

import colorsys
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from lambent.scenes.mitsuba import textures as tx
from lambent.scenes.mitsuba.palette import SLOTS
from lambent.scenes.mitsuba.plan import MaterialPlan
from lambent.scenes.mitsuba.textures import Colour, Cover, to_bytes

#: Woods in sRGB: oak, beech, walnut, cherry, ash, ebony, pine, teak, grey and white washed.
_WOODS: list[Colour] = [
    (0.62, 0.47, 0.31), (0.74, 0.56, 0.38), (0.40, 0.27, 0.18), (0.56, 0.31, 0.19),
    (0.78, 0.68, 0.52), (0.20, 0.15, 0.12), (0.80, 0.62, 0.38), (0.50, 0.34, 0.2),
    (0.55, 0.51, 0.46), (0.85, 0.82, 0.76),
]  # fmt: skip

#: Roles that always ask for the same few materials; what is not listed is made anew each time.
_VARIANTS = {
    "wall": 1, "wall_accent": 1, "floor": 1, "ceiling": 1, "trim": 1, "wood": 2, "lacquer": 2,
    "upholstery": 2, "metal": 2, "mirror": 1, "glass": 1, "window": 1, "frosted": 1, "leaf": 2,
    "shade": 1, "rug": 1, "curtain": 1, "ceramic": 3, "stone": 1, "marble": 1, "ground": 1,
    "plastic": 2, "paper": 1, "poster": 2, "rust": 1, "tinted": 1, "water": 1, "rubber": 1,
    "wire": 1, "book": 2, "cushion": 2, "facade": 1, "pedestal": 1, "fruit": 2, "cloth": 1,
    "blade": 1, "rock": 1, "gloss": 2, "black": 1, "petal": 1,
}  # fmt: skip


def colour_scheme(rng: np.random.Generator) -> list[Colour]:
    """Six sRGB colours that go together: neighbours of a hue, its opposite, two neutrals."""
    hue = rng.random()
    spread = rng.choice([0.04, 0.08, 0.33])
    strength = rng.uniform(0.08, 0.6)
    colours: list[Colour] = []
    for k in range(4):
        h = (hue + spread * (k - 1) + (0.5 if k == 3 else 0)) % 1
        s = float(np.clip(strength * rng.uniform(0.6, 1.3), 0.03, 0.85))
        colours.append(colorsys.hsv_to_rgb(h, s, rng.uniform(0.35, 0.9)))
    colours.append(colorsys.hsv_to_rgb(hue, 0.06, rng.uniform(0.75, 0.92)))
    colours.append(colorsys.hsv_to_rgb(hue, 0.15, rng.uniform(0.15, 0.35)))
    return colours


class Wardrobe:
    """The materials of one scene. ``rng`` is used up by it; ``made`` is the result."""

    def __init__(self, rng: np.random.Generator, slots: Mapping[str, int] = SLOTS) -> None:
        self.rng = rng
        self.slots = slots
        self.scheme = colour_scheme(rng)
        self.woods = [_WOODS[i] for i in rng.choice(len(_WOODS), 2, replace=False)]
        self.made: list[MaterialPlan] = []
        self.covers: dict[str, float] = {}
        self._roles: dict[str, list[int]] = {}

    def get(self, role: str) -> int:
        """The number of a material for a role."""
        have = self._roles.setdefault(role, [])
        limit = _VARIANTS[role]
        if len(have) < limit and (not have or self.rng.random() < 0.6):
            have.append(self._make(role))
        return have[int(self.rng.integers(len(have)))]

    def plain(self, structure: str) -> int:
        """The number of a material of a structure without values, such as ``null``."""
        return self._add(structure, structure)

    def own(self, name: str, structure: str, metres: float = 1.0, **values: Any) -> int:
        """The number of a new material with these values; `left` says whether there is room."""
        return self._add(name, structure, metres, **values)

    def left(self, structure: str) -> int:
        """How many more materials of a structure the palette has room for."""
        return self.slots[structure] - sum(m.structure == structure for m in self.made)

    def metres(self, number: int) -> float:
        """The side of the texture of a material, in metres (1 where it does not matter)."""
        return self.covers.get(str(number), 1.0)

    def colour(self) -> Colour:
        """One of the scheme, varied a little."""
        c = np.asarray(self.scheme[int(self.rng.integers(4))])
        r, g, b = np.clip(c * self.rng.uniform(0.8, 1.15) + self.rng.normal(0, 0.03, 3), 0.02, 0.95)
        return float(r), float(g), float(b)

    def neutral(self) -> Colour:
        """A wall-paint colour: near white, or a muted one of the scheme."""
        if self.rng.random() < 0.75:
            v = self.rng.uniform(0.6, 0.93)
            tint = self.rng.normal(0, 0.02, 3)
            r, g, b = np.clip(v + tint, 0.3, 0.95)
            return float(r), float(g), float(b)
        r, g, b = 0.55 * np.asarray(self.colour()) + 0.45 * np.asarray(self.scheme[4])
        return float(r), float(g), float(b)

    # --- making ---

    def _add(self, role: str, structure: str, metres: float = 1.0, **values: Any) -> int:
        have = [i for i, m in enumerate(self.made) if m.structure == structure]
        if len(have) >= self.slots[structure]:
            if structure != "principled" and structure in ("bump", "normalmap"):
                return self._add(role, "principled", metres, **values)
            return have[int(self.rng.integers(len(have)))]
        number = len(self.made)
        self.made.append(MaterialPlan(f"{role}_{number}", structure, values))
        self.covers[str(number)] = metres
        return number

    def _cover(
        self, role: str, cover: Cover, roughness: float, *, relief: float = 0.0, **values: Any
    ) -> int:
        """A principled material from a cover, with bumps (a third of the time as normal map)."""
        rough = np.clip(roughness * cover.rough, 0.03, 1)
        values = {"base_color": to_bytes(cover.colour), "roughness": to_bytes(rough), **values}
        if relief > 0 and self.rng.random() < 0.8:
            if self.rng.random() < 0.4:
                normals = tx.normal_map(cover.height, relief * 6)
                return self._add(
                    role, "normalmap", cover.metres, normals=to_bytes(normals), **values
                )
            values.update(height=to_bytes(np.clip(cover.height, 0, 1)), strength=relief * 0.03)
            return self._add(role, "bump", cover.metres, **values)
        return self._add(role, "principled", cover.metres, **values)

    def _make(self, role: str) -> int:
        return getattr(self, f"_make_{role}")(role)

    def _make_wall(self, role: str) -> int:
        r = self.rng
        kind = r.choice(
            ["paint", "paper", "bricks", "concrete", "planks"], p=[0.6, 0.14, 0.1, 0.1, 0.06]
        )
        if kind == "paint":
            cover = tx.plain(r, self.neutral())
            if r.random() < 0.7:
                return self._add(role, "diffuse", 1.0, base_color=to_bytes(cover.colour))
            return self._cover(role, cover, r.uniform(0.4, 0.8))
        if kind == "paper":
            base = self.neutral()
            cover = tx.ornament(r, [base, tx.darker(base, r.uniform(0.7, 0.9)), self.colour()])
            return self._cover(role, cover, 0.7)
        if kind == "bricks":
            white = r.random() < 0.4
            cover = tx.bricks(r, (0.85, 0.83, 0.8) if white else (0.6, 0.34, 0.25))
            return self._cover(role, cover, 0.85, relief=0.5)
        if kind == "concrete":
            v = r.uniform(0.5, 0.75)
            return self._cover(role, tx.concrete(r, (v, v * 0.985, v * 0.95)), 0.75, relief=0.15)
        return self._cover(role, tx.planks(r, self.woods[0]), 0.5, relief=0.2)

    _make_wall_accent = _make_wall

    def _make_facade(self, role: str) -> int:
        r = self.rng
        if r.random() < 0.5:
            return self._cover(role, tx.bricks(r, self.colour()), 0.85, relief=0.5)
        return self._cover(role, tx.concrete(r, self.neutral()), 0.8, relief=0.2)

    def _make_ceiling(self, role: str) -> int:
        v = self.rng.uniform(0.8, 0.93)
        cover = tx.plain(self.rng, (v, v, v * 0.98))
        return self._add(role, "diffuse", base_color=to_bytes(cover.colour))

    def _make_trim(self, role: str) -> int:
        cover = tx.plain(self.rng, self.neutral() if self.rng.random() < 0.7 else self.colour())
        return self._cover(role, cover, 0.35)

    def _make_floor(self, role: str) -> int:
        r = self.rng
        kind = r.choice(["planks", "tiles", "concrete", "carpet", "marble", "stones"],
                        p=[0.46, 0.2, 0.1, 0.1, 0.1, 0.04])  # fmt: skip
        if kind == "planks":
            rough = r.uniform(0.15, 0.5)
            return self._cover(role, tx.planks(r, self.woods[0]), rough, relief=0.15)
        if kind == "tiles":
            light = (0.8, 0.78, 0.74)
            colours = [light, tx.darker(light, r.uniform(0.2, 0.8)), self.colour()]
            return self._cover(role, tx.tiles(r, colours), r.uniform(0.08, 0.4), relief=0.1)
        if kind == "concrete":
            return self._cover(role, tx.concrete(r, (0.55, 0.54, 0.52)), r.uniform(0.15, 0.6))
        if kind == "carpet":
            return self._cover(role, tx.fabric(r, self.neutral()), 0.95, relief=0.3, sheen=0.3)
        if kind == "marble":
            return self._make_marble(role)
        return self._cover(role, tx.stones(r, (0.55, 0.5, 0.44)), 0.7, relief=0.5)

    def _make_marble(self, role: str) -> int:
        r = self.rng
        pairs = [
            ((0.9, 0.89, 0.86), (0.35, 0.35, 0.37)),
            ((0.12, 0.13, 0.14), (0.75, 0.72, 0.65)),
            ((0.28, 0.38, 0.33), (0.7, 0.75, 0.7)),
            ((0.75, 0.6, 0.5), (0.45, 0.25, 0.2)),
        ]
        base, vein = pairs[int(r.integers(4))]
        return self._cover(role, tx.marble(r, [base, vein]), r.uniform(0.05, 0.25), specular=0.6)

    def _make_wood(self, role: str) -> int:
        r = self.rng
        colour = self.woods[int(r.integers(2))]
        coat = r.uniform(0.2, 1) if r.random() < 0.4 else 0.0
        return self._cover(
            role, tx.wood(r, colour), r.uniform(0.25, 0.6), relief=0.1, clearcoat=coat
        )

    def _make_lacquer(self, role: str) -> int:
        r = self.rng
        colour = self.colour() if r.random() < 0.6 else self.neutral()
        if r.random() < 0.5:
            picture = to_bytes(tx.plain(r, colour).colour)
            return self._add(role, "roughplastic", base_color=picture, alpha=r.uniform(0.04, 0.25))
        return self._cover(
            role, tx.plain(r, colour), r.uniform(0.1, 0.45), clearcoat=r.uniform(0, 1)
        )

    def _make_gloss(self, role: str) -> int:
        r = self.rng
        picture = to_bytes(tx.plain(r, self.colour()).colour)
        structure = "plastic" if r.random() < 0.6 else "roughplastic"
        return self._add(role, structure, base_color=picture, alpha=r.uniform(0.03, 0.15))

    _make_plastic = _make_gloss

    def _make_black(self, role: str) -> int:
        v = self.rng.uniform(0.03, 0.12)
        return self._cover(role, tx.plain(self.rng, (v, v, v)), self.rng.uniform(0.15, 0.6))

    _make_rubber = _make_black

    def _make_upholstery(self, role: str) -> int:
        r = self.rng
        kind = r.choice(["fabric", "leather", "velvet", "checks"], p=[0.5, 0.25, 0.15, 0.1])
        if kind == "leather":
            colour = self.woods[1] if r.random() < 0.6 else self.colour()
            cover = tx.stones(r, tx.darker(colour, 0.9), 256)
            cover = Cover(tx.plain(r, colour, 256).colour, cover.height, cover.rough, 0.15)
            return self._cover(role, cover, r.uniform(0.3, 0.5), relief=0.1)
        if kind == "velvet":
            return self._cover(role, tx.plain(r, self.colour()), 0.9, sheen=1.0, sheen_tint=0.8)
        if kind == "checks":
            return self._cover(role, tx.checks(r, self.scheme), 0.9, sheen=0.3)
        colour = self.colour() if r.random() < 0.6 else self.neutral()
        return self._cover(role, tx.fabric(r, colour), 0.9, relief=0.25, sheen=0.5)

    def _make_cushion(self, role: str) -> int:
        r = self.rng
        makers = [lambda: tx.checks(r, self.scheme), lambda: tx.fabric(r, self.colour()),
                  lambda: tx.ornament(r, self.scheme[:3])]  # fmt: skip
        cover = makers[int(r.integers(3))]()
        return self._add(role, "diffuse", cover.metres, base_color=to_bytes(cover.colour))

    def _make_cloth(self, role: str) -> int:
        r = self.rng
        cover = tx.checks(r, self.scheme) if r.random() < 0.5 else tx.fabric(r, self.neutral())
        return self._cover(role, cover, 0.95, relief=0.1, sheen=0.3)

    def _make_rug(self, role: str) -> int:
        r = self.rng
        cover = tx.rug(r, self.scheme)
        return self._cover(role, cover, 0.95, relief=0.05, sheen=0.2)

    def _make_curtain(self, role: str) -> int:
        r = self.rng
        colour = self.neutral() if r.random() < 0.6 else self.colour()
        cover = tx.fabric(r, colour) if r.random() < 0.6 else tx.checks(r, self.scheme)
        if r.random() < 0.6:
            picture = to_bytes(cover.colour)
            return self._add(role, "translucent", cover.metres, base_color=picture, rough=0.8,
                             diff_trans=r.uniform(0.5, 1.3))  # fmt: skip
        return self._cover(role, cover, 0.9, sheen=0.3)

    def _make_shade(self, role: str) -> int:
        r = self.rng
        warm = (0.93, r.uniform(0.75, 0.9), r.uniform(0.55, 0.8))
        cover = tx.fabric(r, warm if r.random() < 0.7 else self.colour())
        return self._add(role, "translucent", cover.metres, base_color=to_bytes(cover.colour),
                         rough=0.9, diff_trans=r.uniform(0.8, 1.4))  # fmt: skip

    def _make_petal(self, role: str) -> int:
        r = self.rng
        cover = tx.plain(r, self.colour())
        return self._add(role, "translucent", 1.0, base_color=to_bytes(cover.colour), rough=0.5,
                         diff_trans=0.8)  # fmt: skip

    def _make_paper(self, role: str) -> int:
        picture = to_bytes(tx.page(self.rng))
        return self._add(role, "diffuse", base_color=picture)

    def _make_poster(self, role: str) -> int:
        r = self.rng
        picture = to_bytes(tx.page(r) if r.random() < 0.2 else tx.abstract(r))
        if r.random() < 0.3:
            return self._add(role, "roughplastic", base_color=picture, alpha=r.uniform(0.03, 0.2))
        rough = np.full((4, 4, 1), int(255 * r.uniform(0.2, 0.9)), np.uint8)
        return self._add(role, "principled", base_color=picture, roughness=rough)

    def _make_book(self, role: str) -> int:
        """A sheet of spines: 32 columns of colour with bands and titles."""
        r = self.rng
        n, k = 256, 32
        colours = np.asarray([self.colour() for _ in range(k)])
        picture = np.repeat(colours, n // k, 0)[None].repeat(n, 0)
        for i in range(k):
            x = slice(i * n // k + 1, (i + 1) * n // k - 1)
            for _ in range(int(r.integers(1, 5))):
                y = int(r.integers(8, n - 30))
                picture[y : y + int(r.integers(2, 24)), x] = self.scheme[int(r.integers(6))]
            y0, y1 = sorted(int(v) for v in r.integers(40, 210, 2))
            title = r.random((y1 - y0, n // k - 4)) < 0.45
            picture[y0:y1, i * n // k + 2 : (i + 1) * n // k - 2][title] = (0.85, 0.8, 0.6)
        rough = np.full((4, 4, 1), 140, np.uint8)
        return self._add(role, "principled", base_color=to_bytes(picture), roughness=rough)

    def _make_metal(self, role: str) -> int:
        r = self.rng
        metal = str(r.choice(["aluminium", "iron", "chromium", "brass", "copper", "gold", "bronze",
                              "silver", "titanium"]))  # fmt: skip
        kind = r.choice(["rough", "brushed", "principled"], p=[0.5, 0.25, 0.25])
        if kind == "principled":
            colour = self.colour() if r.random() < 0.3 else (0.78, 0.76, 0.73)
            cover = tx.concrete(r, colour, 256)
            values: dict[str, Any] = {"metallic": 1.0, "anisotropic": float(r.choice([0, 0.7]))}
            return self._cover(role, cover, r.uniform(0.1, 0.5), **values)
        alpha = float(np.exp(r.uniform(np.log(0.02), np.log(0.4))))
        other = alpha if kind == "rough" else min(alpha * r.uniform(3, 8), 0.6)
        return self._add(role, "roughconductor", metal=metal, alpha_u=alpha, alpha_v=other)

    _make_wire = _make_metal

    def _make_mirror(self, role: str) -> int:
        r = self.rng
        metal = str(
            r.choice(
                ["silver", "aluminium", "chromium", "gold", "copper"], p=[0.4, 0.25, 0.15, 0.1, 0.1]
            )
        )
        return self._add(role, "conductor", metal=metal)

    def _make_glass(self, role: str) -> int:
        r = self.rng
        tint = (1.0, 1.0, 1.0)
        if r.random() < 0.35:
            red, green, blue = 0.35 + 0.65 * np.asarray(self.colour())
            tint = (float(red), float(green), float(blue))
        return self._add(role, "dielectric", tint=tint)

    def _make_water(self, role: str) -> int:
        return self._add(role, "water")

    def _make_window(self, role: str) -> int:
        return self._add(role, "thindielectric")

    def _make_frosted(self, role: str) -> int:
        r = self.rng
        return self._add(role, "roughdielectric", alpha=r.uniform(0.03, 0.3))

    def _make_tinted(self, role: str) -> int:
        r = self.rng
        rough = np.full((4, 4, 1), int(255 * r.uniform(0.02, 0.35)), np.uint8)
        colour = np.clip(0.45 + 0.55 * np.asarray(self.colour()), 0, 1)
        picture = to_bytes(np.tile(colour, (4, 4, 1)))
        return self._add(role, "transmissive", base_color=picture, roughness=rough,
                         spec_trans=r.uniform(0.75, 1))  # fmt: skip

    def _make_ceramic(self, role: str) -> int:
        r = self.rng
        colour = self.colour() if r.random() < 0.6 else (0.9, 0.88, 0.84)
        kind = r.choice(["plain", "painted", "speckled"], p=[0.5, 0.25, 0.25])
        if kind == "painted":
            picture = to_bytes(tx.ornament(r, [colour, self.colour(), self.colour()]).colour)
        elif kind == "speckled":
            speck = tx.ground(r, [colour, tx.darker(colour, 0.8), tx.darker(colour, 0.4)], 256)
            picture = to_bytes(speck.colour)
        else:
            picture = to_bytes(tx.plain(r, colour).colour)
        if r.random() < 0.5:
            return self._add(role, "plastic", 0.3, base_color=picture)
        return self._add(role, "roughplastic", 0.3, base_color=picture, alpha=r.uniform(0.05, 0.3))

    def _make_fruit(self, role: str) -> int:
        r = self.rng
        base = [
            (0.75, 0.12, 0.1),
            (0.9, 0.5, 0.1),
            (0.55, 0.65, 0.15),
            (0.9, 0.78, 0.2),
            (0.3, 0.1, 0.2),
        ]
        colour = base[int(r.integers(5))]
        other = base[int(r.integers(5))] if r.random() < 0.4 else tx.darker(colour, 0.7)
        cover = tx.ground(r, [colour, other, tx.darker(colour, 1.2)], 256)
        return self._cover(role, cover, r.uniform(0.2, 0.5), relief=0.03, specular=0.5)

    def _make_stone(self, role: str) -> int:
        r = self.rng
        v = r.uniform(0.35, 0.7)
        colour = (v, v * r.uniform(0.9, 1), v * r.uniform(0.8, 1))
        return self._cover(role, tx.concrete(r, colour), 0.85, relief=0.4)

    def _make_rock(self, role: str) -> int:
        r = self.rng
        v = r.uniform(0.3, 0.6)
        colours = [(v, v * 0.93, v * 0.85), (v * 0.6, v * 0.57, v * 0.52), (0.35, 0.38, 0.22)]
        return self._cover(role, tx.ground(r, colours), 0.9, relief=0.5)

    def _make_pedestal(self, role: str) -> int:
        return self._make_marble(role) if self.rng.random() < 0.5 else self._make_stone(role)

    def _make_ground(self, role: str) -> int:
        r = self.rng
        kinds: list[list[Colour]] = [
            [(0.30, 0.36, 0.14), (0.38, 0.42, 0.18), (0.36, 0.28, 0.18)],
            [(0.76, 0.66, 0.48), (0.68, 0.57, 0.4), (0.82, 0.74, 0.58)],
            [(0.9, 0.92, 0.95), (0.82, 0.85, 0.9), (0.45, 0.42, 0.38)],
            [(0.4, 0.32, 0.24), (0.3, 0.24, 0.18), (0.5, 0.45, 0.36)],
            [(0.5, 0.35, 0.25), (0.62, 0.42, 0.28), (0.4, 0.3, 0.24)],
        ]
        kind = int(r.integers(7))
        if kind == 5:
            return self._cover(role, tx.stones(r, (0.5, 0.47, 0.42)), 0.85, relief=0.5)
        if kind == 6:
            return self._cover(
                role, tx.tiles(r, [(0.6, 0.58, 0.54), (0.5, 0.48, 0.45)]), 0.6, relief=0.2
            )
        earth = dataclasses.replace(tx.ground(r, kinds[kind]), metres=r.uniform(4, 9))
        return self._cover(role, earth, 0.95, relief=0.4)

    def _make_leaf(self, role: str) -> int:
        colour, coverage = tx.leaf(self.rng)
        return self._add(role, "cards", base_color=to_bytes(colour), opacity=to_bytes(coverage))

    def _make_blade(self, role: str) -> int:
        r = self.rng
        green = (r.uniform(0.25, 0.6), r.uniform(0.4, 0.6), r.uniform(0.1, 0.25))
        n = 64
        y, x = np.mgrid[0:n, 0:n] / n
        coverage = (np.abs(((x * 3) % 1) - 0.5) < 0.4 * (1 - y) + 0.03).astype(float)
        shade = np.asarray(green) * (0.5 + 0.6 * y)[..., None]
        picture = to_bytes(np.clip(shade, 0, 1))
        return self._add(role, "cards", base_color=picture, opacity=to_bytes(coverage))

    def _make_rust(self, role: str) -> int:
        r = self.rng
        colour, eaten = tx.rusted(r)
        return self._add(role, "blend", base_color=to_bytes(colour), weight=to_bytes(eaten),
                         alpha=r.uniform(0.1, 0.35), metal="iron")  # fmt: skip
