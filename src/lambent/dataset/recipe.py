"""The recipe of a data set: a small TOML file, of which everything in the set follows.

::

    name = "rooms"
    seed = 1
    source = "procedural"      # procedural, scenes, assets, cycles, blend, or a "module:attribute"
    count = 4000               # crops
    clip_count = 300           # short moving clips

Every other key has the default below. Unknown keys are errors, answered with the nearest known one.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lambent.dataset.validation import refuse_scene, refuse_seeds
from lambent.errors import FileError, OptionError
from lambent.settings import Range, check_ranges, read_toml, record_from

#: A set may grow: these keys change how much there is, not what an item holds.
GROWING = ("count", "clip_count")
#: These keys name a place, and no more.
PLACES = ("name", "assets")


@dataclass(frozen=True)
class Recipe:
    """Settings of a data set. Sizes are in pixels, ``(width, height)``; spp are samples per pixel.

    ``kinds``: kinds of scenes the source knows, empty for all; ``scenes``: files, for the sources
    that read files; ``seeds``: seeds of the scenes one after the other, empty for random ones.
    ``items_per_scene`` crops are cut from ``cameras_per_scene`` views of a scene.
    ``levels`` noise levels a crop, of ``spp`` (lowest, highest), log-spaced; ``mean_spp`` is about
    the mean of the highest one. The target takes ``target_spp`` and at least
    ``target_over_level`` times the highest level, then more until its expected relMSE is
    ``target_error`` or it has ``target_most`` spp. ``uniform``: share of the crops that are chosen
    without looking at what is in them. ``vary``: change materials and lights of scene files.
    ``assets``: the folder of models, maps and scenes for the source of that name.
    """

    name: str
    seed: int
    source: str = "procedural"
    count: int = 0
    clip_count: int = 0
    kinds: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    licences: tuple[str, ...] = ()
    items_per_scene: int = 16
    cameras_per_scene: int = 4
    view: tuple[int, int] = (640, 360)
    crop: int = 128
    levels: int = 3
    spp: tuple[int, int] = (1, 1024)
    mean_spp: float = 24.0
    target_spp: int = 128
    target_most: int = 256
    target_error: float = 0.1
    target_over_level: float = 2.0
    depth: int = 12
    rr_depth: int = 3
    clips_per_scene: int = 2
    clip_frames: int = 6
    clip_levels: int = 1
    clip_mean_spp: float = 8.0
    clip_target_spp: int = 128
    pilot_spp: int = 4
    pilot_scale: float = 0.5
    uniform: float = 0.3
    vary: bool = True
    assets: str = ""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if field.type == "float":
                object.__setattr__(self, field.name, float(getattr(self, field.name)))
        check_ranges(self, _RANGES)
        if self.spp[0] > self.spp[1]:
            raise OptionError(f"spp = {list(self.spp)} is upside down", remedy="lowest first")
        if min(self.view) < self.crop:
            raise OptionError(
                f"a view of {self.view[0]}x{self.view[1]} cannot hold a crop of {self.crop} pixels",
                remedy="make the view larger or the crop smaller",
            )
        if not self.name or any(c in self.name for c in "/\\\0") or self.name.startswith("."):
            raise OptionError(
                f"'{self.name}' cannot be the name of a data set", remedy="take a plain word"
            )
        refuse_seeds(self.seeds)
        for scene in self.scenes:
            refuse_scene(Path(scene))

    @property
    def essence(self) -> str:
        """A hash of all that decides what an item holds; the same for a set that has grown."""
        settings = {k: v for k, v in self.as_dict().items() if k not in (*GROWING, *PLACES)}
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]

    def as_dict(self) -> dict[str, Any]:
        """Every key with its value, as JSON and TOML know them."""
        fields = dataclasses.asdict(self)
        return {k: list(v) if isinstance(v, tuple) else v for k, v in fields.items()}

    @classmethod
    def from_dict(cls, settings: dict[str, Any], file: object = None) -> Recipe:
        """A recipe from keys and values. Raises `OptionError` for unknown keys and wrong types."""
        return record_from(cls, settings, (), file, required=("name", "seed"))


_RANGES: tuple[Range, ...] = (
    ("seed", 0, 2**31 - 1),
    ("count", 0, 10_000_000),
    ("clip_count", 0, 10_000_000),
    ("seeds", 0, 2**31 - 1),
    ("items_per_scene", 1, 1024),
    ("cameras_per_scene", 1, 64),
    ("view", 16, 8192),
    ("crop", 16, 1024),
    ("levels", 1, 16),
    ("spp", 1, 65536),
    ("mean_spp", 1, 65536),
    ("target_spp", 2, 1 << 20),
    ("target_most", 2, 1 << 20),
    ("target_error", 0, 1e9),
    ("target_over_level", 0, 1024),
    ("depth", 1, 1024),
    ("rr_depth", 1, 1024),
    ("clips_per_scene", 1, 64),
    ("clip_frames", 1, 64),
    ("clip_levels", 1, 16),
    ("clip_mean_spp", 1, 65536),
    ("clip_target_spp", 2, 1 << 20),
    ("pilot_spp", 2, 4096),
    ("pilot_scale", 0.05, 1),
    ("uniform", 0, 1),
)


def load_recipe(
    path: str | os.PathLike[str], assets: str | os.PathLike[str] | None = None
) -> Recipe:
    """The recipe in a TOML file; scene files are found from the recipe's own folder.

    ``assets``: a folder of assets in place of the recipe's; else ``LAMBENT_ASSETS`` fills in where
    a recipe with ``source = "assets"`` has none.

    Raises `FileError` (missing, no TOML), `OptionError` (unknown key, value that makes no sense,
    a validation scene).
    """
    path = Path(path)
    settings = read_toml(path)
    recipe = Recipe.from_dict(settings, path)
    found = []
    for scene in recipe.scenes:
        place = _filled_in(scene)
        if not place.is_absolute():
            place = path.parent / place
        if not place.exists():
            raise FileError(
                f"the recipe '{path}' names a scene that is not there",
                file=place,
                remedy="paths count from the recipe's folder",
            )
        refuse_scene(place, path)
        found.append(str(place.resolve()))
    folder = str(Path(assets).resolve()) if assets is not None else ""
    if not folder and recipe.assets:
        folder = str((path.parent / _filled_in(recipe.assets)).resolve())
    elif not folder and recipe.source == "assets" and os.environ.get("LAMBENT_ASSETS"):
        folder = str(Path(os.environ["LAMBENT_ASSETS"]).expanduser().resolve())
    return dataclasses.replace(recipe, scenes=tuple(found), assets=folder)


def _filled_in(text: str) -> Path:
    return Path(os.path.expandvars(text)).expanduser()
