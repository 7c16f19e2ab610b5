"""What no training set may hold: the scenes and seeds that networks are chosen and judged by.

A network that has seen its exam proves nothing. The lists are in ``sets.toml`` (in the repository
also ``recipes/sets.toml``): *selection*, by which every choice is made, and *test*, measured once a
release. Both are refused wherever they stand in a recipe or lie in a folder of assets, test scenes
by their content, too; and no random scene ever draws one of the seeds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lambent.errors import OptionError
from lambent.settings import read_toml

_SETS: dict[str, Any] = read_toml(Path(__file__).with_name("sets.toml"))
_TEST: dict[str, Any] = _SETS["test"]

#: Scenes of the selection, by the name of their folder or file.
SCENES: tuple[str, ...] = tuple(_SETS["selection"]["scenes"])
#: Scenes of the test, by the name of their folder or file.
TEST_SCENES: tuple[str, ...] = tuple(_TEST["scenes"])
#: Random Cycles scenes.
CYCLES_SEEDS: tuple[int, ...] = tuple(_SETS["selection"]["cycles_seeds"])
#: Random animated scenes.
ANIMATION_SEEDS: tuple[int, ...] = tuple(_SETS["selection"]["animation_seeds"])
#: All seeds that are reserved, whatever makes the scene.
SEEDS = frozenset((*CYCLES_SEEDS, *ANIMATION_SEEDS))
_DIGESTS = frozenset(_TEST["digests"])
_SIZES = frozenset(int(digest.partition("-")[0]) for digest in _DIGESTS)


def refuse_scene(path: Path, file: object = None) -> None:
    """Raise `OptionError` if a path leads to a scene of selection or test, links followed."""
    for place in (path, path.resolve()):
        names = [_plain(part) for part in place.parts]
        for name in names:
            if name in SCENES:
                raise _refused(f"'{name}' is a validation scene", SCENES, file)
        for name in names[-2:]:
            if name in TEST_SCENES:
                raise _refused(f"'{name}' is a test scene", TEST_SCENES, file)
        if _TEST["folder"] in names:
            raise _refused("it lies in the folder of the test scenes", TEST_SCENES, file)
    refuse_content(path, file)


def refuse_content(path: Path, file: object = None) -> None:
    """Raise `OptionError` if a file is one of a test scene's, whatever its name."""
    if not path.is_file() or path.stat().st_size not in _SIZES:
        return
    content = path.read_bytes()
    if f"{len(content)}-{hashlib.sha256(content).hexdigest()[:16]}" in _DIGESTS:
        raise _refused(f"'{path.name}' is a file of a test scene", TEST_SCENES, file)


def refuse_asset(path: Path) -> None:
    """Raise `OptionError` if a file of a folder of assets belongs to selection or test.

    A scene file is refused with its meshes.
    """
    if path.suffix.lower() == ".xml":
        refuse_scene(path)
        for mesh in path.parent.rglob("*"):
            refuse_content(mesh)
        return
    if _TEST["folder"] in (_plain(part) for part in path.resolve().parts):
        raise _refused("it lies in the folder of the test scenes", TEST_SCENES, None)
    refuse_content(path)


def refuse_seeds(seeds: Iterable[int], file: object = None) -> None:
    """Raise `OptionError` if one of the seeds is a validation scene's."""
    for seed in seeds:
        if seed in SEEDS:
            raise OptionError(
                f"the seed {seed} is a validation scene's and must be in no training set",
                file=file,
                remedy=f"take another; reserved are {', '.join(map(str, sorted(SEEDS)))}",
            )


# ------------------------------------------------------------------- private


def _plain(name: str) -> str:
    return name.lower().replace("_", "-").partition(".")[0]


def _refused(what: str, reserved: Iterable[str], file: object) -> OptionError:
    return OptionError(
        f"{what} and must be in no training set",
        file=file,
        remedy=f"take it out of the recipe; reserved are {', '.join(reserved)}"
        " (another scene of such a name: rename it)",
    )
