"""What no training set may hold: the scenes and seeds that networks are judged on.

A network that has seen its exam proves nothing. These names are refused wherever they stand in a
recipe, and no random scene ever draws one of the seeds.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from lambent.errors import OptionError

#: Scenes, by the name of their folder or file.
SCENES = ("veach-mis", "living-room", "dining-room", "cornell-box")
#: Random Cycles scenes.
CYCLES_SEEDS = (900001, 900002, 900003, 900004, 900005, 900006)
#: Random animated scenes.
ANIMATION_SEEDS = (910001, 910002)
#: All seeds that are reserved, whatever makes the scene.
SEEDS = frozenset((*CYCLES_SEEDS, *ANIMATION_SEEDS))


def refuse_scene(path: Path, file: object = None) -> None:
    """Raise `OptionError` if a path leads to a validation scene, links followed."""
    for part in (*path.parts, *path.resolve().parts):
        name = part.lower().replace("_", "-").partition(".")[0]
        if name in SCENES:
            raise OptionError(
                f"'{name}' is a validation scene and must be in no training set",
                file=file,
                remedy=f"take it out of the recipe; reserved are {', '.join(SCENES)}",
            )


def refuse_file(path: Path) -> None:
    """Raise `OptionError` if a file belongs to a validation scene, by name or by content."""
    refuse_scene(path)


def refuse_seeds(seeds: Iterable[int], file: object = None) -> None:
    """Raise `OptionError` if one of the seeds is a validation scene's."""
    for seed in seeds:
        if seed in SEEDS:
            raise OptionError(
                f"the seed {seed} is a validation scene's and must be in no training set",
                file=file,
                remedy=f"take another; reserved are {', '.join(map(str, sorted(SEEDS)))}",
            )
