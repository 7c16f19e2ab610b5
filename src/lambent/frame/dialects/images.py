"""From the channels of a file to images with names: views, layers, components.

Channels ``ViewLayer.Diffuse Direct.R/G/B`` are one image named ``ViewLayer.Diffuse Direct``;
``left.R`` is the red of the view ``left``; a part ``depth_left`` with one channel ``Z`` is an
image ``depth`` of that view. Nothing here knows a renderer.

Views follow *Storing Multi-View Images in OpenEXR Files* (OpenEXR documentation): the header
attribute ``multiView`` names them, the default first, and a channel carries its view as the last
part of its layer. Nuke writes the view in front; both are read.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lambent.frame.exr import ExrFile

#: Spellings of components, in the order of the image's channels.
TRIPLES: dict[str, tuple[tuple[str, ...], ...]] = {
    "rgb": (("R", "G", "B"), ("RED", "GREEN", "BLUE")),
    "xyz": (("X", "Y", "Z"),),
}
PAIRS: dict[str, tuple[str, str]] = {"xy": ("X", "Y"), "uv": ("U", "V")}
ALPHAS = ("A", "ALPHA")
#: Names of channels without a dot that are components, not layers.
COMPONENTS = frozenset(
    {"R", "G", "B", "A", "RED", "GREEN", "BLUE", "ALPHA", "X", "Y", "Z", "W", "U", "V", "RY", "BY"}
)
STEREO = ("left", "right")
#: What programs call the only view of a file.
MAIN = "main"
_PART_VIEW = re.compile(r"^(.*?)[._\- ]?(left|right)$", re.IGNORECASE)
#: OpenImageIO's name for the first part without one (the next is subimage01).
_UNNAMED = re.compile(r"subimage0+", re.IGNORECASE)
_XYZ_NAME = re.compile(r"^(.+?)([xyz])$")


@dataclass(frozen=True)
class Image:
    """Channels that belong together.

    ``name``: as shown to people and asked for with ``--map``. ``layer``: the name without
    component (``""`` for bare channels). ``kind``: ``rgb``, ``luma``, ``xyz``, ``xyzw``, ``xy``,
    ``uv`` or ``scalar``. ``alpha``: the image's own alpha channel, if it has one.
    """

    name: str
    layer: str
    kind: str
    channels: tuple[tuple[int, str], ...]
    view: str = ""
    part_name: str = ""
    component: str = ""
    alpha: tuple[int, str] | None = None


@dataclass
class _Group:
    """Channels of one layer while they are collected: component (upper case) to channel."""

    view: str
    layer: str
    part: int
    part_name: str
    members: dict[str, tuple[int, str]]


def views_of(exr: ExrFile) -> tuple[str, ...]:
    """Names of the file's views, the main one first; empty for a file without views."""
    declared: list[str] = []
    for part in exr.parts:
        declared += _texts(part.header.get("multiView"))
    declared += [part.view for part in exr.parts if part.view]
    if not declared:
        by_name = [m.group(2).lower() for p in exr.parts if (m := _PART_VIEW.match(p.name or ""))]
        if set(by_name) == set(STEREO):
            declared = by_name
    if not declared:
        first = {n.split(".")[0] for p in exr.parts for n in p.channels if "." in n}
        declared = [view for view in STEREO if view in first]
        bare = any("." not in n for p in exr.parts for n in p.channels)
        if len(declared) == 1 and not bare:
            declared = []  # a layer that happens to be called "left"
        elif len(declared) == 1:
            # Channels without a view belong to the other eye, which is the main one.
            declared = ["right" if declared[0] == "left" else "left", declared[0]]
    return tuple(dict.fromkeys(declared))


def images_of(exr: ExrFile) -> list[Image]:
    """Every image of a file, in the order of parts and channels. No channel is left out."""
    groups = _merged(_grouped(exr, views_of(exr)), several_parts=len(exr.parts) > 1)
    images: list[Image] = []
    for group in groups:
        images += _split(group)
    return images


def shown(name: str) -> str:
    """A name that can be printed: bytes that are no UTF-8 become ``\\udce9`` and the like.

    EXR names are bytes; decoded, wrong ones are lone surrogates, which no terminal takes.
    """
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


# ----------------------------------------------------------------------------- channels to groups


def _grouped(exr: ExrFile, views: tuple[str, ...]) -> list[_Group]:
    groups: dict[tuple[str, str, int], _Group] = {}
    every = {name for part in exr.parts for name in part.channels}
    several = len(exr.parts) > 1
    known = views or ((MAIN,) if _all_of_main(exr) else ())
    for number, (part, (part_name, part_view)) in enumerate(
        zip(exr.parts, _named_parts(exr, known), strict=True)
    ):
        paths = {
            name: _view_and_path(shown(name), part_view, known, every, part.channels, several)
            for name in part.channels
        }
        beside = {(view, *path) for view, path in paths.values()}
        for name, (view, path) in paths.items():
            layer, component = _layer_and_component(view, path, beside)
            if not layer and several:
                nameless = part_name.lower() in ("", MAIN, "default") or _UNNAMED.fullmatch(
                    part_name
                )
                layer = "" if nameless else part_name
            view = view if views else ""
            key = (view, layer, number)
            if key not in groups:
                groups[key] = _Group(view, layer, number, part_name, {})
            members = groups[key].members
            # Two channels that differ in case only both stay: the second is known by its own name.
            members[name if component.upper() in members else component.upper()] = (number, name)
    return list(groups.values())


def _all_of_main(exr: ExrFile) -> bool:
    """Whether every part (or, in a single part, every channel) carries the view ``main``."""
    if len(exr.parts) > 1:
        return all(_without_view(shown(part.name or ""), MAIN) is not None for part in exr.parts)
    paths = [name.split(".") for part in exr.parts for name in part.channels]
    return bool(paths) and all(len(path) > 1 and MAIN in (path[0], path[-2]) for path in paths)


def _named_parts(exr: ExrFile, views: tuple[str, ...]) -> list[tuple[str, str]]:
    """Name and view of each part, the view taken off the name.

    A name that is another part's of the same view without it stays whole: there ``RGBA_main``
    beside ``RGBA`` is a light group.
    """
    whole = [(shown(part.name or ""), part.view) for part in exr.parts]
    if len(exr.parts) == 1:
        return whole
    taken, named = set(whole), []
    for name, own in whole:
        found = (name, own)
        for view in (own,) if own else views:
            rest = _without_view(name, view, in_front=bool(own))
            if rest is not None and (not rest or (rest, view) not in taken):
                found = (rest, view)
                break
        named.append(found)
    return named


def _without_view(name: str, view: str, in_front: bool = False) -> str | None:
    """A part's name without the view behind it (or in front of it); None: it has none there."""
    low, ending = name.lower(), view.lower()
    if low == ending:
        return ""
    for mark in "._- ":
        if low.endswith(mark + ending):
            return name[: -len(view) - 1]
        if in_front and low.startswith(ending + mark):
            return name[len(view) + 1 :]
    if ending in STEREO and low.endswith(ending):
        return name[: -len(view)]
    return None


def _view_and_path(
    name: str,
    part_view: str,
    views: tuple[str, ...],
    every: set[str],
    own: Collection[str],
    several_parts: bool,
) -> tuple[str, list[str]]:
    path = name.split(".")
    for place in (len(path) - 2, 0):
        if place >= 0 and len(path) > 1 and path[place] in views:
            rest = path[:place] + path[place + 1 :]
            # In a part of this view it may be a layer's name, beside the channel without it.
            if path[place] != part_view or ".".join(rest) not in own:
                return path[place], rest
    if part_view or not views:
        return part_view, path
    if len(path) > 1 or several_parts:
        # By the standard a layer without view belongs to no view; where another view has the
        # same layer (Nuke), it is the main view's.
        twin = any(f"{view}.{name}" in every for view in views)
        return (views[0] if twin else ""), path
    return views[0], path


def _layer_and_component(
    view: str, path: list[str], beside: set[tuple[str, ...]]
) -> tuple[str, str]:
    if len(path) > 1:
        if path[-1].upper() not in COMPONENTS and _all_components(view, path, -2, beside):
            return ".".join([*path[:-2], path[-1]]), path[-2]  # diffuse.R.001, R.diffuse
        return ".".join(path[:-1]), path[-1]
    name = path[0]
    if name.upper() in COMPONENTS:
        return "", name
    match = _XYZ_NAME.match(name)  # pbrt's Nx, Ny, Nz
    if match and all((view, match.group(1) + axis) in beside for axis in "xyz"):
        return match.group(1), match.group(2)
    return name, ""


def _all_components(view: str, path: list[str], place: int, beside: set[tuple[str, ...]]) -> bool:
    """Whether red, green and blue (or X, Y and Z) stand at one place of otherwise equal names."""
    if path[place].upper() not in COMPONENTS:
        return False
    cases = (str.upper, str.lower, str.capitalize)
    return any(
        all(
            (view, *path[:place], case(c), *path[len(path) + place + 1 :]) in beside for c in triple
        )
        for triples in TRIPLES.values()
        for triple in triples
        for case in cases
    )


def _merged(groups: list[_Group], several_parts: bool) -> list[_Group]:
    """Layers whose channels are spread over parts (a part for each component) become one."""
    if not several_parts:
        return groups
    fragments: dict[tuple[str, str], list[_Group]] = {}
    for group in groups:
        bare = group.layer == group.part_name and all(c in COMPONENTS for c in group.members)
        if not _complete(group.members):
            fragments.setdefault((group.view, "" if bare else group.layer), []).append(group)
    swallowed: set[int] = set()
    result: list[_Group] = []
    for (view, layer), pieces in fragments.items():
        union: dict[str, tuple[int, str]] = {}
        for piece in pieces:
            union.update(piece.members)
        count = sum(len(piece.members) for piece in pieces)
        colour = any(all(c in union for c in t) for t in TRIPLES["rgb"])
        vector = all(c in union for c in ("X", "Y", "Z")) and count == 3
        if len(pieces) > 1 and count == len(union) and (colour or vector):
            swallowed.update(id(piece) for piece in pieces)
            result.append(_Group(view, layer, pieces[0].part, "", union))
    rest = [group for group in groups if id(group) not in swallowed]
    return sorted(result + rest, key=lambda group: group.part)


def _complete(members: dict[str, tuple[int, str]]) -> bool:
    return any(all(c in members for c in t) for ts in TRIPLES.values() for t in ts)


# ------------------------------------------------------------------------------- groups to images


def _split(group: _Group) -> list[Image]:
    left = dict(group.members)
    made: list[Image] = []
    base = Image("", group.layer, "", (), group.view, group.part_name)

    def take(kind: str, components: tuple[str, ...], bare: str) -> None:
        channels = tuple(left.pop(c) for c in components)
        name = group.layer or bare
        made.append(replace(base, name=name, kind=kind, channels=channels))

    for kind, spellings in TRIPLES.items():
        for spelling in spellings:
            if all(c in left for c in spelling):
                if kind == "xyz" and "W" in left:
                    take("xyzw", (*spelling, "W"), "XYZW")
                else:
                    take(kind, spelling, kind.upper())
    if "Y" in left and not (group.layer and len(left) > 1 and "RY" not in left):
        chroma = tuple(c for c in ("RY", "BY") if c in left)
        if len(chroma) == 2 or "X" not in left:
            take("luma", ("Y", *(chroma if len(chroma) == 2 else ())), "Y")
    for kind, pair in PAIRS.items():
        if all(c in left for c in pair):
            take(kind, pair, kind.upper())

    colour = next((i for i, image in enumerate(made) if image.kind in ("rgb", "luma")), None)
    for component in list(left):
        channel = left.pop(component)
        own = shown(channel[1]).split(".")[-1] if component else ""
        lone = not made and len(group.members) == 1
        if component in ALPHAS and colour is not None:
            made[colour] = replace(made[colour], alpha=channel)
        name = group.layer if (lone and group.layer) else ".".join(filter(None, (group.layer, own)))
        made.append(replace(base, name=name, kind="scalar", channels=(channel,), component=own))
    return made


def _texts(value: Any) -> list[str]:
    if isinstance(value, (str, bytes)):
        value = [value]
    if not isinstance(value, Iterable):
        return []
    return [v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in value]
