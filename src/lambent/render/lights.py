"""Light groups: which emitter belongs to which layer of light.

A group is a name and patterns of ids (``fill = ["lamp*", "window"]``); an emitter has an id of its
own, and an area light also that of its shape. Emitters that no pattern names form the group
``rest``.
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


def emitter_ids(scene: Any) -> list[tuple[str, ...]]:
    """The ids of every emitter of a scene, in Mitsuba's order: its shape's first, then its own."""
    shapes = {}
    for shape in scene.shapes():
        if shape.is_emitter():
            shapes[_index(shape.emitter())] = shape.id()
    return [
        tuple(name for name in (shapes.get(_index(e), ""), e.id()) if name)
        for e in scene.emitters()
    ]


def _index(emitter: Any) -> int:
    """The emitter's place in Dr.Jit's registry."""
    return int(dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(emitter))[0])


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
            found = [
                i for i, own in enumerate(ids) if any(fnmatch.fnmatchcase(n, pattern) for n in own)
            ]
            if not found:
                raise UnknownNameError("emitter", pattern, [n for own in ids for n in own])
            for i in found:
                member[i] = number if member[i] == len(names) else member[i]
    if len(names) in member:
        names.append(REST)
    pointers = np.array(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
    table = np.zeros(int(pointers.max(initial=0)) + 1, np.uint32)
    table[pointers] = member
    return names, mi.UInt32(table)
