"""Random Mitsuba scenes to learn from: rooms, still lifes, landscapes, halls, studios.

`random_scene` makes a `ScenePlan`, which is plain data, from a seed; the same seed gives the same
plan on every machine. `motion.animate` makes a clip of it, `build.build` the Mitsuba scene. All
scenes share a fixed palette
of plug-in structures (`palette`), so that one compiled kernel renders them all.

::

    from lambent.render.variant import mitsuba
    from lambent.scenes.mitsuba import random_scene
    from lambent.scenes.mitsuba.build import build

    mi = mitsuba()
    plan = random_scene(7, kind="room")
    image = mi.render(build(plan, mi, camera=0, size=(256, 256)), spp=64)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from lambent.errors import OptionError, UnknownNameError

if TYPE_CHECKING:
    from lambent.scenes.mitsuba.plan import CameraPlan, ScenePlan
    from lambent.scenes.mitsuba.stage import Stage

#: Kinds of scenes, and how often each comes up.
_SHARES = {"room": 0.32, "still_life": 0.22, "open": 0.2, "hall": 0.14, "studio": 0.12}

#: The names of the kinds.
KINDS: tuple[str, ...] = tuple(_SHARES)

__all__ = ["KINDS", "random_scene"]


def _maker(kind: str) -> Callable[[Stage], list[CameraPlan]]:
    from lambent.scenes.mitsuba.hall import hall
    from lambent.scenes.mitsuba.landscape import landscape
    from lambent.scenes.mitsuba.room import room
    from lambent.scenes.mitsuba.still_life import still_life
    from lambent.scenes.mitsuba.studio import studio

    makers = {
        "room": room,
        "still_life": still_life,
        "open": landscape,
        "hall": hall,
        "studio": studio,
    }
    return makers[kind]


def random_scene(seed: int, kind: str | None = None) -> ScenePlan:
    """The scene of a seed (0 or more), of a ``kind`` of `KINDS` or of any.

    Raises `UnknownNameError` for another kind, `OptionError` for a negative seed.
    """
    import numpy as np

    from lambent.scenes.mitsuba.materials import Wardrobe
    from lambent.scenes.mitsuba.noise import generator
    from lambent.scenes.mitsuba.stage import Stage

    if kind is not None and kind not in _SHARES:
        raise UnknownNameError("kind of scene", kind, KINDS)
    if seed < 0:
        raise OptionError(f"a scene's seed is {seed}", remedy="take 0 or more")
    if kind is None:
        kind = str(generator(seed, 0).choice(KINDS, p=np.array(list(_SHARES.values()))))
    for attempt in range(20):  # a composition without four good views is put up anew
        key = (KINDS.index(kind) + 1, attempt)
        stage = Stage(generator(seed, 1, *key), Wardrobe(generator(seed, 2, *key)))
        cameras = _maker(kind)(stage)
        if len(cameras) >= 4:
            return stage.finish(kind, seed, cameras)
    raise AssertionError(f"no view of scene {seed} ({kind}) is good")
