"""What a person can choose: how a scene is solved by radiosity, and how a solution is shown."""

from __future__ import annotations

from dataclasses import dataclass

from lambent.errors import OptionError
from lambent.settings import check_settings, setting
from lambent.transport.radiosity.solvers import SOLVERS

#: What a view can show.
SHOWS = {
    "smooth": "irradiance interpolated between corners, times the texture",
    "gather": "final gather: direct light and one bounce traced, the rest from the solution",
    "patch": "irradiance of the patch, times the texture",
    "mesh": "as patch, with the outlines of the patches",
    "irradiance": "smooth, without the texture",
    "residual": "where the solution does not yet agree with itself: |E + ρFB - B|",
}


@dataclass(frozen=True)
class Settings:
    """How to solve.

    ``factors``: "rays", or "pairs" (`lambent.transport.radiosity.pairs`). ``direct``: "samples" of
    the emitters, or "factors", through F like all other light: the textbook's B = (I - ρF)⁻¹ E,
    which knows no environment and no points, and needs many rays where a lamp is small.
    """

    patches: int = setting(4000, "About so many patches.", low=1, high=1e9)
    size: float | None = setting(
        None, "Their length in the scene's unit instead.", option="--patch-size", metavar="S"
    )
    adaptive: bool = setting(False, "Cut finer where the picture changes.")
    solver: str = setting(
        "cg", "How to solve the equation.", choices=SOLVERS, metavar="NAME", resumed="kept",
    )  # fmt: skip
    factors: str = setting(
        "rays", "Form factors by rays, or pair by pair.", choices=("rays", "pairs"),
        metavar="rays|pairs",
    )  # fmt: skip
    rays: int = setting(256, "Rays from every patch.", low=1, high=1e9)
    samples: int = setting(512, "Samples of the emitters for every patch.", low=1, high=1e9)
    direct: str = setting(
        "samples", "Light straight from emitters: sampled, or through F.",
        choices=("samples", "factors"), metavar="samples|factors",
    )  # fmt: skip
    tolerance: float = setting(
        1e-6, "Stop at this residual, relative to the first light.", low=1e-16, high=0.999,
        metavar="X", resumed="anew",
    )  # fmt: skip
    steps: int = setting(
        1000, "The solver takes at most so many steps.", low=1, high=1e9, resumed="anew"
    )
    seconds: float | None = setting(
        None, "Most time for the solver.", option="--time", metavar="TIME", resumed="anew"
    )
    seed: int = setting(0, "Seed of the random numbers.")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.factors == "pairs" and self.solver == "matrix-free":
            raise OptionError("the matrix-free solver casts rays", remedy="take --solver cg")
