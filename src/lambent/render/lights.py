"""Light groups: which emitter belongs to which layer of light.

A group is a name and patterns of ids (``fill = ["lamp*", "window"]``); an emitter's id is its own, or
for an area light that of its shape. Emitters that no pattern names form the group ``rest``.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from lambent.errors import UnknownNameError

#: The group of the emitters that nobody named.
REST = "rest"


def emitter_ids(scene: Any) -> list[str]:
    """The id of every emitter of a scene, in Mitsuba's order."""
    named = []
    for emitter in scene.emitters():
        shape = emitter.get_shape() if hasattr(emitter, "get_shape") else None
        own = emitter.id()
        named.append(shape.id() if shape is not None and own in ("", "emitter") else own)
    return named


def group_table(scene: Any, groups: Mapping[str, Iterable[str]]) -> tuple[list[str], Any]:
    """Names of the groups, and for every emitter's registry index its group (`UInt32`), or None.

    Raises `UnknownNameError` for a pattern that no emitter matches.
    """
    if not groups:
        return [], None
    ids = emitter_ids(scene)
    names = list(groups)
    member = [len(names)] * len(ids)
    for number, name in enumerate(names):
        for pattern in groups[name]:
            found = [i for i, known in enumerate(ids) if fnmatch.fnmatchcase(known, pattern)]
            if not found:
                raise UnknownNameError("emitter", pattern, ids)
            for i in found:
                member[i] = number if member[i] == len(names) else member[i]
    if len(names) in member:
        names.append(REST)
    pointers = np.array(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
    table = np.zeros(int(pointers.max(initial=0)) + 1, np.uint32)
    table[pointers] = member
    return names, mi.UInt32(table)
