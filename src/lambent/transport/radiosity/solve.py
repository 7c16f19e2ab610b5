"""From a scene to its radiosity: cut, measure, cast, balance, solve; and again where it pays."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError, UnknownNameError, by_interrupt
from lambent.phases import Phases
from lambent.progress import Progress, silent
from lambent.render.scene import LoadedScene
from lambent.transport.diffuse import assumptions
from lambent.transport.radiosity import adaptive, light
from lambent.transport.radiosity.balance import balanced, symmetric
from lambent.transport.radiosity.casting import cast, gathered
from lambent.transport.radiosity.patches import Patches, cluster, size_for, uniform
from lambent.transport.radiosity.probe import Probe
from lambent.transport.radiosity.solution import RadiositySolution, digest_of
from lambent.transport.radiosity.solvers import SOLVERS, Equation, History, run
from lambent.transport.surfaces import Array, Surfaces, surfaces_of

#: Rays with which faces that light never reaches are told from the others.
SCOUTS = 64
#: Seconds from one look of a watcher to the next, at least.
WATCH_EVERY = 2.0
#: More patches than this are refused.
MOST = 5e6
#: How much longer patches are before an adaptive solve cuts them.
COARSER = 2.5
#: Points at which direct light is measured on a part of a patch, to see what the patch hides.
PEEKS = 16
#: Rounds of refinement; each but the last adds half of what is left.
ROUNDS = 4

Watch = Callable[[RadiositySolution], None]


@dataclass(frozen=True)
class Settings:
    """What a person can choose.

    ``patches``: about so many; or ``size``: their length in the scene's unit. ``rays`` from each
    face for the form factors; ``factors``: "rays" or "pairs" (`lambent.transport.radiosity.pairs`).
    ``direct``: light straight from emitters by ``samples`` of them for each face, or "factors",
    through F like all other light: the textbook's B = (I - ρF)⁻¹ E, which knows no environment and
    no points, and needs many rays where a lamp is small. ``adaptive``: cut finer where the picture
    changes.
    ``tolerance``: of the residual, relative; ``steps``, ``seconds``: the most for the solver.
    """

    patches: int = 4000
    size: float | None = None
    solver: str = "cg"
    factors: str = "rays"
    rays: int = 256
    samples: int = 512
    direct: str = "samples"
    adaptive: bool = False
    tolerance: float = 1e-6
    steps: int = 1000
    seconds: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise UnknownNameError("solver", self.solver, SOLVERS)
        if self.factors not in ("rays", "pairs"):
            raise UnknownNameError("kind of form factors", self.factors, ("rays", "pairs"))
        if self.direct not in ("samples", "factors"):
            raise UnknownNameError("kind of direct light", self.direct, ("samples", "factors"))
        for name in ("patches", "rays", "samples", "steps"):
            if getattr(self, name) < 1:
                raise OptionError(f"{name} must be 1 or more, not {getattr(self, name)}")
        if not 0 < self.tolerance < 1:
            raise OptionError(f"a tolerance of {self.tolerance:g} cannot be reached or is none")
        if self.factors == "pairs" and self.solver == "matrix-free":
            raise OptionError("the matrix-free solver casts rays", remedy="take --solver cg")


def solve(
    loaded: LoadedScene,
    settings: Settings,
    start: RadiositySolution | None = None,
    progress: Progress | None = None,
    watch: Watch | None = None,
) -> RadiositySolution:
    """The radiosity of a loaded scene.

    ``start``: a solution of the same scene to go on with; its patches are kept. ``watch`` gets the
    solution as it grows. Ctrl-C while solving ends it; the result is marked ``interrupted``.
    Raises `OptionError`: no surface, nothing lights any, too little memory for the solver.
    """
    work = _Work(loaded, settings, progress or silent, watch)
    return work.go_on(start) if start is not None else work.begin()


# ------------------------------------------------------------------- private


@dataclass
class _Work:
    """One solve: the scene, what is wished, and whom to tell."""

    loaded: LoadedScene
    settings: Settings
    progress: Progress
    watch: Watch | None

    def __post_init__(self) -> None:
        self.scene = self.loaded.scene
        self.surfaces: Surfaces = surfaces_of(self.scene)
        if float(self.surfaces.area.sum()) <= 0:
            raise OptionError(
                "the scene has no surface to solve for",
                file=self.loaded.path,
                remedy="give a scene with meshes, rectangles, spheres, disks or cylinders",
            )
        self.notes = assumptions(self.scene, self.surfaces.left_out, self.surfaces.degenerate)
        self.phases = Phases()
        self.next_watch = 0.0

    def begin(self) -> RadiositySolution:
        """Cut and solve; with ``adaptive`` from large patches down."""
        wish = self.settings
        self.progress(0, 1, "cutting the surfaces")
        size = wish.size if wish.size is not None else size_for(self.surfaces, wish.patches)
        self._check_size(size)
        # all begins coarse, and is cut where it pays
        coarse = size if not wish.adaptive else size * COARSER
        cells = uniform(self.surfaces, coarse)
        if not wish.adaptive:
            return self.once(cluster(cells, size), None, "")
        found: RadiositySolution | None = None
        rough = replace(wish, rays=max(32, wish.rays // 4), tolerance=1e-3, solver="cg")
        final = wish
        base = len(cells.child)
        halved = np.zeros(base, np.int8)
        for round_ in range(ROUNDS):
            patches = cluster(cells, coarse, base, halved)
            left = wish.patches - len(patches)
            if left <= 0:
                break
            self.settings = rough
            try:
                found = self.once(patches, None, f"round {round_ + 1}: ")
                share = self._shares(patches, found)
            except BaseException as error:
                if found is None or not by_interrupt(error):
                    raise
                return replace(found, interrupted=True)  # rough, but whole
            more = left if round_ == ROUNDS - 1 else left // 2
            cells, halved = adaptive.refined(patches, share, more, halved)
        self.settings = final
        return self.once(cluster(cells, coarse, base, halved), None, "")

    def _shares(self, patches: Patches, found: RadiositySolution) -> Array:
        """What each patch has of the picture's error ``(n,)``."""
        variance = np.zeros(len(found.live))
        if self.settings.direct == "samples":
            with self.phases("light"):
                variance = adaptive.hidden(
                    self.scene, patches, found.live, PEEKS, self.settings.seed
                )
            variance *= found.reflectance.mean(axis=1) ** 2
        return adaptive.shares(patches, found.reflected, found.live.astype(float), variance)

    def _check_size(self, size: float) -> None:
        """Refuse patches so small that cutting alone would fill the memory."""
        if not size > 0:
            raise OptionError(f"patches of size {size:g} cannot be", remedy="give a length above 0")
        count = float(self.surfaces.area.sum()) / (size * size)
        if count > MOST:
            raise OptionError(
                f"patches of size {size:g} would be {count:,.0f}, which takes about "
                f"{count * 2e4 / 2**30:,.0f} GiB",
                remedy=f"take --patch-size {(count / 1e5) ** 0.5 * size:.3g}, for 100,000",
            )

    def go_on(self, start: RadiositySolution) -> RadiositySolution:
        """The same patches, from what was reached."""
        start.check(self.surfaces, self.loaded.path)
        return self.once(start.patches_on(self.surfaces), start, "")

    def once(
        self, patches: Patches, start: RadiositySolution | None, words: str
    ) -> RadiositySolution:
        """Solve for these patches."""
        wish, scene = self.settings, self.scene
        n = len(patches)
        probe = Probe.of(patches)
        every = np.arange(2 * n)
        with self.phases("light"):
            self.progress(0, 1, f"{words}{n:,} patches: materials and direct light")
            seen = light.look(scene, probe, every, seed=wish.seed)
            rho = seen.reflectance
            reflecting = rho.max(axis=1) > 0
            arriving = np.zeros((2 * n, 3))
            at = np.flatnonzero(reflecting)
            shining = seen.emission.max(axis=1) > 0
            if wish.direct == "samples":
                arriving[at] = light.direct(scene, probe, at, wish.samples, wish.seed)
        if not (arriving.max(initial=0) > 0 or seen.emission.max(initial=0) > 0):
            raise OptionError(
                "no light reaches any surface that reflects",
                file=self.loaded.path,
                remedy="check the emitters, and the sides of one-sided materials",
            )
        if wish.direct == "factors":
            lost = sorted({e.class_name() for e in scene.emitters() if e.get_shape() is None})
            note = f"left out, since light goes through form factors: {', '.join(lost)}"
            if lost and note not in self.notes:
                self.notes.append(note)
        with self.phases("form factors"):
            through_f = wish.direct == "factors"
            if through_f:
                reflecting = reflecting | shining  # lamps are seen, whether they reflect or not
            lit = shining if through_f else arriving.max(axis=1) > 0
            live = self._live(patches, probe, reflecting, lit, words)
            faces = np.flatnonzero(live)
            area = np.repeat(patches.area, 2)[faces]
            factors, gather, off = self._factors(patches, probe, faces, live, words)
        if through_f:
            emitted = seen.emission[faces]
            arriving[faces] = factors @ emitted if factors is not None else gather(emitted)
        first = rho[faces] * arriving[faces]
        equation = Equation(first, rho[faces], factors, area, gather)

        def packed(x: Array, history: History, interrupted: bool = False) -> RadiositySolution:
            indirect = equation.apply(x)
            return self._packed(
                patches, faces, rho, seen.emission, arriving, indirect,
                equation.residual(x), history, off, interrupted,
            )  # fmt: skip

        def tell(step: int, residual: float, x: Array) -> None:
            share = np.log(max(residual, wish.tolerance)) / np.log(wish.tolerance)
            self.progress(
                min(1.0, max(0.0, float(share))), 1,
                f"{words}{wish.solver}, step {step}, residual {residual:.1e}",
            )  # fmt: skip
            if self.watch is None or words or time.monotonic() < self.next_watch:
                return
            began = time.monotonic()
            with self.phases("watching"):
                self.watch(packed(x, so_far))
            # whoever watches may take a tenth of the time
            now = time.monotonic()
            self.next_watch = now + max(WATCH_EVERY, 10 * (now - began))

        so_far = History()
        with self.phases("solver"):
            begin = None
            if start is not None:
                begin = start.reflected[faces]
            x, history, interrupted = run(
                equation, wish.solver, start=begin, tolerance=wish.tolerance,
                steps=wish.steps, seconds=wish.seconds, watch=tell, history=so_far,
            )  # fmt: skip
        if interrupted:
            if words:
                raise KeyboardInterrupt
            return packed(x, history, interrupted)
        done = packed(x, history)
        if words or wish.factors == "pairs":
            return done
        with self.phases("error"):
            self.progress(1, 1, "how far off it is")
            return replace(done, error=self._error(patches, probe, faces, live, area, equation, x))

    def _live(
        self, patches: Patches, probe: Probe, reflecting: Any, lit: Any, words: str
    ) -> NDArray[np.bool_]:
        """Reflecting faces that light can reach in any number of bounces."""
        from scipy import sparse
        from scipy.sparse.csgraph import connected_components

        at = np.flatnonzero(reflecting)
        if lit[at].all():
            return np.asarray(reflecting)
        self.progress(0, 1, f"{words}which faces see light")
        found = cast(self.scene, patches, probe, at, reflecting, SCOUTS, self.settings.seed)
        size = len(reflecting)
        hits = found.shares.tocoo()
        graph = sparse.coo_matrix(
            (np.ones(hits.nnz, np.int8), (at[hits.row], hits.col)), (size,) * 2
        )
        _, part = connected_components(graph, directed=False)
        bright = np.zeros(part.max() + 1, bool)
        bright[part[lit & reflecting]] = True
        return np.asarray(reflecting & bright[part])

    def _factors(
        self, patches: Patches, probe: Probe, faces: Any, live: Any, words: str
    ) -> tuple[Any, Any, float]:
        """F, or how to gather without it, and how far rows are from their sums."""
        wish = self.settings
        if wish.solver == "matrix-free":

            def gather(x: Array) -> Array:
                return gathered(self.scene, patches, probe, faces, live, x, wish.rays, wish.seed)

            return None, gather, 0.0
        area = np.repeat(patches.area, 2)[faces]
        if wish.factors == "pairs":
            from lambent.transport.radiosity.pairs import exchange_matrix

            g, seen = exchange_matrix(
                self.scene, patches, probe, faces, live, wish.seed,
                lambda done, total, text: self.progress(done, total, words + text),
            )  # fmt: skip
            factors, off = balanced(g, area, seen)
            return factors, None, off
        found = cast(
            self.scene, patches, probe, faces, live, wish.rays, wish.seed,
            lambda done, total, text: self.progress(done, total, words + text),
        )  # fmt: skip
        shares = found.shares[:, faces]
        seen = np.asarray(shares.sum(axis=1)).ravel()
        self.progress(0, 1, f"{words}reciprocity")
        factors, off = balanced(symmetric(shares, area), area, seen, wish.rays)
        return factors, None, off

    def _error(
        self, patches: Patches, probe: Probe, faces: Any, live: Any, area: Array,
        equation: Equation, x: Array,
    ) -> float:  # fmt: skip
        """Relative standard error of a face's indirect light, root mean square by area.

        Gathered once more along a quarter as many other rays: if σ² is the variance of one ray, the
        two differ by σ² (1/N + 4/N).
        """
        few = max(1, self.settings.rays // 4)
        other = gathered(
            self.scene, patches, probe, faces, live, x, few, self.settings.seed + 0x9E37
        )
        mine = equation.apply(x)
        apart = equation.norm(mine - other)
        size = equation.norm(mine)
        if not size > 0:
            return 1.0 if apart > 0 else 0.0
        return apart / size / (1 + self.settings.rays / few) ** 0.5

    def _packed(
        self, patches: Patches, faces: Any, rho: Array, emission: Array, arriving: Array,
        indirect: Array, residual: Array, history: History, off: float, interrupted: bool,
    ) -> RadiositySolution:  # fmt: skip
        n = 2 * len(patches)
        bounced, left, live = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, bool)
        bounced[faces], left[faces], live[faces] = indirect, residual, True
        notes = list(self.notes)
        if off > 1e-4:
            notes.append(f"form factors of some faces sum to {off:.1e} off what the face sees")
        return RadiositySolution(
            child=patches.cells.child,
            prim=patches.cells.prim,
            corner=patches.cells.corner,
            cell_patch=patches.cell_patch,
            reflectance=rho.astype(np.float32),
            emission=emission.astype(np.float32),
            direct=arriving.astype(np.float32),
            indirect=bounced.astype(np.float32),
            residual=left.astype(np.float32),
            live=live,
            history=history,
            digest=digest_of(self.surfaces),
            scene=None if self.loaded.path is None else str(self.loaded.path.resolve()),
            scene_digest=self.loaded.digest,
            settings={k: v for k, v in vars(self.settings).items()},
            notes=tuple(notes),
            seconds=dict(self.phases.seconds),
            interrupted=interrupted,
        )
