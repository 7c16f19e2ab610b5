"""From a scene to its radiosity: cut, measure, cast, balance, solve; and again where it pays."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from lambent.errors import OptionError, by_interrupt
from lambent.phases import Phases
from lambent.progress import Progress, silent
from lambent.render.scene import LoadedScene
from lambent.transport.diffuse import assumptions
from lambent.transport.methods import Watch
from lambent.transport.radiosity import adaptive
from lambent.transport.radiosity.patches import Patches, cluster, size_for, uniform
from lambent.transport.radiosity.settings import Settings
from lambent.transport.radiosity.solution import RadiositySolution, digest_of
from lambent.transport.radiosity.solvers import History, run
from lambent.transport.radiosity.system import system_of
from lambent.transport.surfaces import Array, Surfaces, surfaces_of

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


def solve(
    loaded: LoadedScene,
    settings: Settings,
    start: RadiositySolution | None = None,
    progress: Progress | None = None,
    watch: Watch[RadiositySolution] | None = None,
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
    watch: Watch[RadiositySolution] | None

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
            raise OptionError(f"patches cannot have size {size:g}", remedy="give a length above 0")
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
        """Solve for these patches; ``words`` are of a round whose result is not the last."""
        wish = self.settings

        def say(done: float, total: float, text: str) -> None:
            self.progress(done, total, words + text)

        system = system_of(self.loaded, patches, wish, self.phases, say)
        history = History()

        def packed(x: Array, interrupted: bool = False) -> RadiositySolution:
            return RadiositySolution(
                **system.arrays(x),
                history=history,
                digest=digest_of(self.surfaces),
                scene=None if self.loaded.path is None else str(self.loaded.path.resolve()),
                scene_digest=self.loaded.digest,
                settings=dict(vars(wish)),
                notes=(*self.notes, *system.notes),
                seconds=dict(self.phases.seconds),
                interrupted=interrupted,
            )

        def tell(step: int, residual: float, x: Array) -> None:
            share = np.log(max(residual, wish.tolerance)) / np.log(wish.tolerance)
            text = f"{wish.solver}, step {step}, residual {residual:.1e}"
            say(min(1.0, max(0.0, float(share))), 1, text)
            if self.watch is None or words or time.monotonic() < self.next_watch:
                return
            began = time.monotonic()
            with self.phases("watching"):
                self.watch(packed(x))
            # whoever watches may take a tenth of the time
            now = time.monotonic()
            self.next_watch = now + max(WATCH_EVERY, 10 * (now - began))

        with self.phases("solver"):
            x, _, interrupted = run(
                system.equation, wish.solver,
                start=None if start is None else start.reflected[system.faces],
                tolerance=wish.tolerance, steps=wish.steps, seconds=wish.seconds, watch=tell,
                history=history,
            )  # fmt: skip
        if interrupted:
            if words:
                raise KeyboardInterrupt
            return packed(x, interrupted)
        done = packed(x)
        if words or wish.factors == "pairs":
            return done
        with self.phases("error"):
            say(1, 1, "how far off it is")
            return replace(done, error=system.error(x))
