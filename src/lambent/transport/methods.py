"""The one registry of methods: ways to find a scene's light and hold it.

An entry is a `Method`. Commands and reports ask it for all they need, and know no method by name:
``lambent solve`` makes its options of the settings, ``lambent view --show`` knows the views, the
page of a solve draws those of ``page``. To add a method: a package with its `Method`, a subclass
of `lambent.transport.solution.Solution`, and a line in `METHODS`.

Entries are imported by ``--help`` and by the shell's completion: what needs Mitsuba is imported in
the functions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from lambent.errors import OptionError, UnknownNameError
from lambent.progress import Progress
from lambent.registry import Registry
from lambent.settings import settings_of

if TYPE_CHECKING:
    from lambent.archive import Archive
    from lambent.render.scene import LoadedScene


#: The solutions of a method.
S = TypeVar("S")
Watch = Callable[[S], None]
Export = Callable[[S, "LoadedScene", Path, float, bool], None]


class View(Protocol):
    """A Mitsuba integrator that shows a solution in one of its ways."""

    def prepare(self, scene: Any) -> None:
        """Get ready for a scene, once. Raises `FileError` for one that was not solved."""

    def update(self, solution: Any) -> None:
        """Show another state of the same solution, without compiling anything anew."""


@dataclass(frozen=True)
class Method(Generic[S]):
    """A method.

    ``title``: what it does, for ``--help``. ``shows``: kind of view -> what it shows, the default
    first; ``page``: those that a report has in the end. ``settings``: a frozen dataclass with
    fields by `lambent.settings.setting`. ``solve(loaded, settings, start, progress, watch)`` gives
    a solution; ``start`` is one to go on with, or None. ``load`` reads one from its archive.
    ``view(solution, show)`` is an integrator.
    ``exports``: "mesh" and "lightmap", as far as the light of all surfaces can be written so:
    functions of solution, scene, path, exposure and whether to overwrite.
    """

    name: str
    title: str
    paper: str
    shows: Mapping[str, str]
    settings: type
    solve: Callable[[LoadedScene, Any, S | None, Progress | None, Watch[S] | None], S]
    load: Callable[[Archive], S]
    view: Callable[[S, str], View]
    page: tuple[str, ...] = ()
    exports: Mapping[str, Export[S]] = field(default_factory=dict)

    def show(self, name: str | None) -> str:
        """A kind of view, None for the default. Raises `UnknownNameError`."""
        return checked_show(name, self.shows)

    def configured(self, values: Mapping[str, Any], before: Mapping[str, Any] | None) -> Any:
        """The settings from values by name; ``before``: those of a solution to go on with.

        Raises `OptionError` for settings that the method does not know, or that would mix two
        solutions, and what the settings themselves raise.
        """
        known = settings_of(self.settings)
        strange = sorted(set(values) - set(known))
        if strange:
            raise OptionError(
                f"{self.name} has no setting {', '.join(strange)}",
                remedy=f"there are: {', '.join(sorted(known))}",
            )
        if before is None:
            return self.settings(**values)
        kept = {k: v for k, v in before.items() if k in known and known[k][1].resumed != "anew"}
        changed = [
            f"{k} ({kept.get(k)} there, {v} here)" for k, v in sorted(values.items())
            if known[k][1].resumed == "fixed" and kept.get(k) != v
        ]  # fmt: skip
        if changed:
            raise OptionError(
                f"the solution to continue has another {', '.join(changed)}",
                remedy="leave that out, or start again with --overwrite",
            )
        return self.settings(**{**kept, **values})


#: Every method by name.
METHODS = Registry("method", {"radiosity": "lambent.transport.radiosity.method:RADIOSITY"})
#: The one that is taken where nothing is said.
DEFAULT_METHOD = "radiosity"


def checked_show(name: str | None, shows: Mapping[str, str]) -> str:
    """The name of a kind of view, the first for None. Raises `UnknownNameError`."""
    if name is None:
        return next(iter(shows))
    if name not in shows:
        raise UnknownNameError("kind of view", name, shows)
    return name
