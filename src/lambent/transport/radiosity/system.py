"""The equation B = b + ρ F B of a set of patches on a scene: light, faces, form factors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError
from lambent.phases import Phases
from lambent.render.scene import LoadedScene
from lambent.transport.methods import Progress
from lambent.transport.radiosity import light
from lambent.transport.radiosity.balance import balanced, symmetric
from lambent.transport.radiosity.casting import cast, gathered
from lambent.transport.radiosity.patches import Patches
from lambent.transport.radiosity.probe import Probe
from lambent.transport.radiosity.settings import Settings
from lambent.transport.radiosity.solvers import Equation
from lambent.transport.surfaces import Array

#: Rays with which faces that light never reaches are told from the others.
SCOUTS = 64


@dataclass(frozen=True, eq=False)
class Measure:
    """How patches on a scene are measured; ``say`` is told how far it is."""

    scene: Any
    settings: Settings
    patches: Patches
    probe: Probe
    say: Progress

    def live(self, reflecting: Any, lit: Any) -> NDArray[np.bool_]:
        """Reflecting faces that light can reach in any number of bounces."""
        from scipy import sparse
        from scipy.sparse.csgraph import connected_components

        at = np.flatnonzero(reflecting)
        if lit[at].all():
            return np.asarray(reflecting)
        self.say(0, 1, "which faces see light")
        seed = self.settings.seed
        found = cast(self.scene, self.patches, self.probe, at, reflecting, SCOUTS, seed)
        size = len(reflecting)
        hits = found.shares.tocoo()
        graph = sparse.coo_matrix(
            (np.ones(hits.nnz, np.int8), (at[hits.row], hits.col)), (size,) * 2
        )
        _, part = connected_components(graph, directed=False)
        bright = np.zeros(part.max() + 1, bool)
        bright[part[lit & reflecting]] = True
        return np.asarray(reflecting & bright[part])

    def gathered(self, faces: Any, live: Any, x: Array, rays: int, seed: int = 0) -> Array:
        """F @ x along so many rays of each face; ``seed`` is added to that of the settings."""
        seed += self.settings.seed
        return gathered(self.scene, self.patches, self.probe, faces, live, x, rays, seed)

    def factors(self, faces: Any, live: Any, area: Array) -> tuple[Any, float]:
        """F, and how far its rows are from their sums."""
        of = self.scene, self.patches, self.probe, faces, live
        wish = self.settings

        if wish.factors == "pairs":
            from lambent.transport.radiosity.pairs import exchange_matrix

            g, seen = exchange_matrix(*of, wish.seed, self.say)
            return balanced(g, area, seen)
        shares = cast(*of, wish.rays, wish.seed, self.say).shares[:, faces]
        seen = np.asarray(shares.sum(axis=1)).ravel()
        self.say(0, 1, "reciprocity")
        return balanced(symmetric(shares, area), area, seen, wish.rays)


@dataclass(frozen=True, eq=False)
class System:
    """What is to be solved, and what it was made of.

    Of all ``2 n`` faces: ``reflectance``, ``emission`` and ``direct`` irradiance ``(2 n, 3)``, and
    ``live`` ``(2 n,)``, those that reflect and that light reaches. ``equation`` is of the live ones
    alone, ``faces`` their numbers. ``notes``: sentences for a person.
    """

    measure: Measure
    reflectance: Array
    emission: Array
    direct: Array
    live: NDArray[np.bool_]
    faces: NDArray[np.int64]
    equation: Equation
    notes: tuple[str, ...]

    def arrays(self, x: Array) -> dict[str, Any]:
        """The arrays of a `RadiositySolution` whose reflected light ``B - E`` is ``x``."""
        patches = self.measure.patches
        indirect, residual = np.zeros_like(self.direct), np.zeros_like(self.direct)
        indirect[self.faces] = self.equation.apply(x)
        residual[self.faces] = self.equation.residual(x)
        return {
            "child": patches.cells.child,
            "prim": patches.cells.prim,
            "corner": patches.cells.corner,
            "cell_patch": patches.cell_patch,
            "reflectance": self.reflectance.astype(np.float32),
            "emission": self.emission.astype(np.float32),
            "direct": self.direct.astype(np.float32),
            "indirect": indirect.astype(np.float32),
            "residual": residual.astype(np.float32),
            "live": self.live,
        }

    def error(self, x: Array) -> float:
        """Relative standard error of a face's indirect light, root mean square by area.

        Gathered once more along a quarter as many other rays: if σ² is the variance of one ray, the
        two differ by σ² (1/N + 4/N).
        """
        rays = self.measure.settings.rays
        few = max(1, rays // 4)
        other = self.measure.gathered(self.faces, self.live, x, few, 0x9E37)
        mine = self.equation.apply(x)
        apart = self.equation.norm(mine - other)
        size = self.equation.norm(mine)
        if not size > 0:
            return 1.0 if apart > 0 else 0.0
        return apart / size / (1 + rays / few) ** 0.5


def system_of(
    loaded: LoadedScene, patches: Patches, settings: Settings, phases: Phases, say: Progress
) -> System:
    """Measure what patches reflect, emit and receive, and how they see each other.

    Raises `OptionError` where nothing is lit.
    """
    scene, count = loaded.scene, 2 * len(patches)
    measure = Measure(scene, settings, patches, Probe.of(patches), say)
    through_f = settings.direct == "factors"
    notes = []
    with phases("light"):
        say(0, 1, f"{len(patches):,} patches: materials and direct light")
        seen = light.look(scene, measure.probe, np.arange(count), seed=settings.seed)
        rho = seen.reflectance
        reflecting = rho.max(axis=1) > 0
        shining = seen.emission.max(axis=1) > 0
        arriving = np.zeros((count, 3))
        if not through_f:
            at = np.flatnonzero(reflecting)
            arriving[at] = light.direct(scene, measure.probe, at, settings.samples, settings.seed)
    if not (arriving.max(initial=0) > 0 or shining.any()):
        raise OptionError(
            "no light reaches any surface that reflects",
            file=loaded.path,
            remedy="check the emitters, and the sides of one-sided materials",
        )
    if through_f:
        lost = sorted({e.class_name() for e in scene.emitters() if e.get_shape() is None})
        if lost:
            notes.append(f"left out, since light goes through form factors: {', '.join(lost)}")
    with phases("form factors"):
        if through_f:
            reflecting = reflecting | shining  # lamps are seen, whether they reflect or not
        live = measure.live(reflecting, shining if through_f else arriving.max(axis=1) > 0)
        faces = np.flatnonzero(live)
        area = np.repeat(patches.area, 2)[faces]
        factors, gather = None, None
        if settings.solver == "matrix-free":

            def gather(x: Array) -> Array:
                return measure.gathered(faces, live, x, settings.rays)
        else:
            factors, off = measure.factors(faces, live, area)
            if off > 1e-4:
                notes.append(f"form factors of some faces sum to {off:.1e} off what the face sees")
    if through_f:
        emitted = seen.emission[faces]
        arriving[faces] = factors @ emitted if factors is not None else gather(emitted)
    equation = Equation(rho[faces] * arriving[faces], rho[faces], factors, area, gather)
    return System(measure, rho, seen.emission, arriving, live, faces, equation, tuple(notes))
