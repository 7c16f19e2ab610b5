"""The channels of which a pass keeps mean and variance, in their order in memory.

A `Group` is one layer: its role, how many channels, and how it is read off a path's books.
``LIGHT`` and ``FEATURES`` are what `--features` chooses from; the colour is always there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from lambent.errors import UnknownNameError
from lambent.frame.role import Role
from lambent.kernels.extremes import smaller


@dataclass(frozen=True)
class Group:
    """One layer: ``channels`` numbers, read by ``take`` off the `Books` of a path.

    ``name`` is its name in files; ``role`` OTHER for what no role describes.
    """

    name: str
    role: Role
    channels: int
    take: Callable[[Any], Any]


def _specular(b: Any) -> Any:
    return b.colour - b.diffuse


def _indirect(b: Any) -> Any:
    return b.colour - b.direct


def _albedo(b: Any) -> Any:
    """At most 1: a plastic's diffuse reflectance and its Fresnel reflectance may sum to more."""
    both = b.diffuse_albedo + b.specular_albedo
    return smaller(both, type(both)(1))


COLOUR = Group("colour", Role.COLOUR, 3, lambda b: b.colour)

LIGHT = (
    Group("diffuse", Role.DIFFUSE, 3, lambda b: b.diffuse),
    Group("specular", Role.SPECULAR, 3, _specular),
    Group("direct", Role.DIRECT, 3, lambda b: b.direct),
    Group("indirect", Role.INDIRECT, 3, _indirect),
    Group("emission", Role.EMISSION, 3, lambda b: b.emission),
)

FEATURES = (
    Group("alpha", Role.ALPHA, 1, lambda b: [b.alpha]),
    Group("albedo", Role.ALBEDO, 3, _albedo),
    Group("diffuse_albedo", Role.DIFFUSE_ALBEDO, 3, lambda b: b.diffuse_albedo),
    Group("specular_albedo", Role.SPECULAR_ALBEDO, 3, lambda b: b.specular_albedo),
    Group("normal", Role.NORMAL, 3, lambda b: b.normal),
    Group("depth", Role.DEPTH, 1, lambda b: [b.depth]),
    Group("position", Role.POSITION, 3, lambda b: b.position),
    Group("roughness", Role.ROUGHNESS, 1, lambda b: [b.roughness]),
)

FIRST = (
    Group("first_albedo", Role.OTHER, 3, lambda b: b.first_albedo),
    Group("first_normal", Role.OTHER, 3, lambda b: b.first_normal),
    Group("first_depth", Role.OTHER, 1, lambda b: [b.first_depth]),
)

#: Motion to the previous frame, in pixels; written by the sampler, since it knows the camera.
MOTION = Group("motion", Role.MOTION, 2, lambda b: b.motion)

#: Distance that the point of the first hit had from the previous camera.
PREVIOUS_DEPTH = Group("previous_depth", Role.OTHER, 1, lambda b: [b.previous_depth])

GROUPS = (*LIGHT, *FEATURES, *FIRST, MOTION, PREVIOUS_DEPTH)


def light_group(number: int, name: str) -> Group:
    """The layer of a light group."""
    return Group(f"lightgroup_{name}", Role.LIGHTING, 3, lambda b: b.groups[number])


def chosen(features: str | Iterable[str]) -> tuple[Group, ...]:
    """The groups that a wish names, in their order: ``"all"``, ``"none"``, or names.

    Names are those of `GROUPS`; ``light``, ``features`` and ``first`` stand for their families.
    Raises `UnknownNameError`.
    """
    families = {
        "light": LIGHT,
        "features": FEATURES,
        "first": FIRST,
        "all": (*LIGHT, *FEATURES, *FIRST),
        "none": (),
    }
    names = [n.strip() for n in features.split(",")] if isinstance(features, str) else [*features]
    wanted: set[str] = set()
    known = {g.name for g in GROUPS}
    for name in filter(None, names):
        if name in families:
            wanted |= {g.name for g in families[name]}
        elif name == "colour":
            continue
        elif name in known:
            wanted.add(name)
        else:
            raise UnknownNameError("feature", name, [*families, *sorted(known)])
    return tuple(g for g in GROUPS if g.name in wanted)
