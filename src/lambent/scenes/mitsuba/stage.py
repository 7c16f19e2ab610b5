"""The stage on which a scene is put together, and what becomes of it: a few merged meshes.

Everything that stands still and has the same material becomes one mesh, so that a room of a
thousand things has some twenty shapes. A few things stay apart so that they can move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lambent.scenes.mitsuba.geometry import Array, Geometry, merge
from lambent.scenes.mitsuba.lamps import beads, light_mesh
from lambent.scenes.mitsuba.materials import Wardrobe
from lambent.scenes.mitsuba.palette import AREA, LIGHTS, SHAPES
from lambent.scenes.mitsuba.plan import (
    CameraPlan,
    EmitterPlan,
    MediumPlan,
    ScenePlan,
    ShapePlan,
)

#: A mesh and the role (or the number) of its material.
Part = tuple[Geometry, str | int]


@dataclass
class Stage:
    """What has been put up so far. ``rng`` decides places, the wardrobe has its own stream."""

    rng: np.random.Generator
    wardrobe: Wardrobe
    emitters: list[EmitterPlan] = field(default_factory=list)
    media: list[MediumPlan] = field(default_factory=list)
    tags: set[str] = field(default_factory=set)
    boxes: list[tuple[Array, Array]] = field(default_factory=list)
    _still: dict[int, list[Geometry]] = field(default_factory=dict)
    _movable: list[tuple[str, Array, dict[int, list[Geometry]]]] = field(default_factory=list)
    shining: list[ShapePlan] = field(default_factory=list)
    _filled: list[ShapePlan] = field(default_factory=list)

    def add(
        self,
        parts: Sequence[Part],
        pose: Array | None = None,
        *,
        movable: str | None = None,
        solid: bool = True,
    ) -> None:
        """Put a thing at ``pose (4, 4)``. ``solid`` things keep cameras out of their boxes."""
        pose = np.eye(4) if pose is None else pose
        chosen: dict[str, int] = {}
        groups: dict[int, list[Geometry]] = {}
        for geometry, role in parts:
            if isinstance(role, str):
                chosen.setdefault(role, self.wardrobe.get(role))
                number = chosen[role]
            else:
                number = role
            scaled = geometry.with_uv(1 / self.wardrobe.metres(number))
            groups.setdefault(number, []).append(scaled)
            if solid:
                self.boxes.append(geometry.moved(pose).bounds)
        if movable is not None:
            self._movable.append((movable, pose, groups))
            return
        for number, members in groups.items():
            self._still.setdefault(number, []).extend(m.moved(pose) for m in members)

    def free(self, kind: str) -> bool:
        """Whether one more light of a kind fits the palette."""
        return sum(e.kind == kind for e in self.emitters) < LIGHTS[kind]

    def light(
        self,
        kind: str,
        group: str,
        radiance: Array,
        pose: Array,
        size: tuple[float, float, float] = (1, 1, 1),
        *,
        spots: Array | None = None,
        bead: float = 0.01,
        **values: object,
    ) -> bool:
        """Add a light at ``pose``; area lights are scaled by ``size``. False: no slot is left."""
        if not self.free(kind):
            return False
        count = sum(e.id == group or e.id.rpartition("_")[0] == group for e in self.emitters)
        name = f"{group}_{count + 1}" if count else group
        values["radiance"] = tuple(float(v) for v in radiance)
        if kind not in AREA:
            values["to_world"] = pose
            self.emitters.append(EmitterPlan(name, kind, values))
            return True
        mesh = light_mesh(kind, 1.0) if spots is None else beads(spots, bead)
        mesh = mesh.moved(np.diag([*size, 1.0]))
        body = self.wardrobe.get("trim")
        shape = ShapePlan(f"lamp_{name}", mesh, pose, body, emitter=len(self.emitters))
        self.shining.append(shape)
        self.emitters.append(EmitterPlan(name, kind, values))
        return True

    def environment(self, image: Array, scale: float, weight: float = 1.0) -> None:
        """Light from all around, ``image (H, W, 3)`` times ``scale``."""
        values = {"image": image.astype(np.float32), "scale": float(scale), "weight": weight}
        self.emitters.append(EmitterPlan("environment", "envmap", values))

    def medium(self, medium: MediumPlan, skin: Geometry) -> int:
        """Fill ``skin`` with a medium; returns its number."""
        number = len(self.media)
        self.media.append(medium)
        material = self.wardrobe.plain("null")
        shape = ShapePlan(f"medium_{number}", skin, np.eye(4), material, medium=number)
        self._filled.append(shape)
        self.tags.add("medium")
        return number

    def fill(self, parts: Sequence[Part], pose: Array, medium: MediumPlan) -> None:
        """A solid of glass filled with a medium (milk, tea, wax)."""
        number = len(self.media)
        self.media.append(medium)
        for k, (geometry, role) in enumerate(parts):
            material = self.wardrobe.get(role) if isinstance(role, str) else role
            name = f"filled_{number}_{k}"
            self._filled.append(ShapePlan(name, geometry, pose, material, medium=number))
            self.boxes.append(geometry.moved(pose).bounds)
        self.tags.add("medium")

    def scale_lights(self, factor: float) -> None:
        """All lights brighter or darker."""
        for i, e in enumerate(self.emitters):
            values = dict(e.values)
            if "scale" in values:
                values["scale"] = float(values["scale"] * factor)  # type: ignore[arg-type]
            else:
                values["radiance"] = tuple(float(v * factor) for v in values["radiance"])
            self.emitters[i] = EmitterPlan(e.id, e.kind, values)

    def finish(self, kind: str, seed: int, cameras: Sequence[CameraPlan]) -> ScenePlan:
        """The plan."""
        materials = self.wardrobe.made
        movable, still = [], {n: list(m) for n, m in self._still.items()}
        # At worst every material has one mesh that stands still.
        used = set(still).union(*(groups for _, _, groups in self._movable))
        room = SHAPES - len(used) - len(self._filled)
        for k, (name, pose, groups) in enumerate(self._movable):
            if len(groups) > room:
                for n, members in groups.items():
                    still.setdefault(n, []).extend(m.moved(pose) for m in members)
                continue
            room -= len(groups)
            for n, members in groups.items():
                shape_id = f"{name}_{k}_{materials[n].name}"
                movable.append(ShapePlan(shape_id, merge(members), pose, n, movable=f"{name}_{k}"))
        fixed = [
            ShapePlan(f"still_{materials[n].name}", merge(still[n]), np.eye(4), n)
            for n in sorted(still)
        ]
        shapes = (*self.shining, *fixed, *movable, *self._filled)
        return ScenePlan(
            kind, seed, shapes, tuple(materials), tuple(self.emitters), tuple(cameras),
            tuple(self.media), tags=tuple(sorted(self.tags)), slots=self.wardrobe.slots,
        )  # fmt: skip
