"""Radiosity's entry in the registry of methods."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from lambent.transport.methods import Method, Progress, View, Watch
from lambent.transport.radiosity.settings import SHOWS, Settings

if TYPE_CHECKING:
    from lambent.archive import Archive
    from lambent.render.scene import LoadedScene
    from lambent.transport.radiosity.solution import RadiositySolution


def _solve(
    loaded: LoadedScene, settings: Settings, start: RadiositySolution | None,
    progress: Progress | None, watch: Watch[RadiositySolution] | None,
) -> RadiositySolution:  # fmt: skip
    from lambent.transport.radiosity.solve import solve

    return solve(loaded, settings, start, progress, watch)


def _load(archive: Archive) -> RadiositySolution:
    from lambent.transport.radiosity.solution import RadiositySolution

    return RadiositySolution.from_archive(archive)


def _view(solution: RadiositySolution, show: str) -> View:
    from lambent.transport.radiosity.integrator import RadiosityView

    view: View = RadiosityView.of(solution, show)
    return view


def _mesh(
    solution: RadiositySolution, loaded: LoadedScene, path: Path, exposure: float, overwrite: bool
) -> None:
    from lambent.transport.radiosity.export import export
    from lambent.transport.surfaces import surfaces_of

    export(solution, loaded.scene, surfaces_of(loaded.scene), path, exposure, overwrite)


def _lightmap(
    solution: RadiositySolution, loaded: LoadedScene, path: Path, exposure: float, overwrite: bool
) -> None:
    from lambent.transport.radiosity.export import lightmap, write_lightmap
    from lambent.transport.surfaces import surfaces_of

    # irradiance in W/m², whatever the exposure
    made = lightmap(solution, loaded.scene, surfaces_of(loaded.scene))
    write_lightmap(path, made, overwrite)


RADIOSITY: Method[Any] = Method(
    name="radiosity",
    title="surfaces cut into patches and taken as diffuse, the light between them solved for",
    paper="Goral, Torrance, Greenberg and Battaile 1984, "
    "Modeling the interaction of light between diffuse surfaces",
    shows=SHOWS,
    page=("mesh", "irradiance", "residual"),
    settings=Settings,
    solve=_solve,
    load=_load,
    view=_view,
    exports={"mesh": _mesh, "lightmap": _lightmap},
)
