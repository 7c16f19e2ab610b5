"""What a source of scenes is, and the table of them.

A source makes scenes from seeds; a scene has cameras; a camera has one view, or one for each frame
of a clip; a view renders a window of its picture, as `Samples` that add up. Or the scene gives
whole stills (`WholeScene`). Nothing else is known here of renderers. Other packages join through
the entry-point group ``lambent.sources``, and a recipe may name any ``"module:attribute"``.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from lambent.dataset.item import Still
from lambent.dataset.recipe import Recipe
from lambent.errors import LambentError, OptionError
from lambent.frame.frame import Frame
from lambent.phases import Phases
from lambent.registry import Registry


@dataclass(frozen=True)
class Window:
    """A square of a picture: its first column and row, and its edge, in pixels."""

    x: int
    y: int
    edge: int


@dataclass(frozen=True)
class Draw:
    """A wish for samples of a window: ``spp`` a pixel, with the random numbers of ``seed``."""

    window: Window
    spp: int
    seed: int


class Samples(Protocol):
    """A render of a window; more of the same can be added."""

    @property
    def spp(self) -> int:
        """Samples per pixel."""

    def __add__(self, other: Any) -> Any:
        """All samples of both."""

    def frame(self) -> Frame:
        """Means, variances of the means, half buffers of the colour."""


class View(Protocol):
    """What a camera sees at one time."""

    def pilot(self, size: tuple[int, int], spp: int, seed: int) -> Frame:
        """The whole picture, small and quick: colour with variance, and features."""

    def sample(self, draws: Sequence[Draw]) -> Sequence[Samples]:
        """Windows of the whole picture, all at once; what a draw gives depends on it alone."""


class Scene(Protocol):
    """A scene. ``about`` says what it is, as JSON knows it; ``cameras`` how many there are."""

    about: Mapping[str, Any]
    cameras: int

    def views(self, camera: int) -> Sequence[View]:
        """The views of a camera: one, or one for each frame of a clip."""


@runtime_checkable
class WholeScene(Protocol):
    """A scene of a renderer that makes all pictures of an item in one go, with crops of its own."""

    about: Mapping[str, Any]
    cameras: int

    def stills(
        self, camera: int, edge: int, spp: Sequence[int], target_spp: int
    ) -> tuple[Still, ...]:
        """The stills of an item: noise levels of ``spp`` and the target, all independent."""


class Source(Protocol):
    """Makes scenes. Called ``source(recipe, device, phases)`` to get one.

    ``licences`` are those of what goes into the pictures; ``versions`` those of the programs.
    """

    licences: Sequence[str]

    def scene(self, seed: int, job: int, frames: int) -> Scene | WholeScene:
        """The scene of a seed. ``job`` is its number in the set, ``frames`` 1 for a still."""

    def versions(self) -> Mapping[str, str]:
        """Program to version."""


Maker = Callable[[Recipe, str, Phases], Source]

#: Name in the recipe -> how to make the source.
SOURCES = Registry(
    "source",
    {
        "procedural": "lambent.dataset.mitsuba_source:ProceduralSource",
        "scenes": "lambent.dataset.mitsuba_source:FileSource",
        "assets": "lambent.dataset.assets_source:AssetSource",
        "cycles": "lambent.dataset.cycles_source:RandomSource",
        "blend": "lambent.dataset.cycles_source:BlendSource",
    },
    group="lambent.sources",
)


def open_source(recipe: Recipe, device: str, phases: Phases) -> Source:
    """The source of a recipe. Raises `OptionError` for one that cannot be imported."""
    name = recipe.source
    if ":" not in name:
        return SOURCES[name](recipe, device, phases)
    module, _, attribute = name.partition(":")
    try:
        maker: Maker = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise OptionError(
            f"the source '{name}' cannot be imported: {error}",
            remedy=f"known by name are {', '.join(SOURCES)}",
        ) from error
    return maker(recipe, device, phases)


class UnfitSceneError(LambentError):
    """A scene that gives nothing to learn from; another is taken.

    A source raises it for what will be so whenever and wherever the scene is made. For any other
    error the scene's items are left out this time, and said to be.
    """
