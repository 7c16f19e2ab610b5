"""The user's own choices: ``--map role=layer``, by any name a layer goes by.

Channels that no naming joins are joined by the user: ``--map colour=0,1,2`` (`joined` makes an
image of them before the tables are asked). A colour may be a single channel then, and X, Y and Z
as one layer are CIE XYZ; as three channels with commas they are taken as they stand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from lambent.errors import LayerError, UnknownNameError
from lambent.frame.dialects.images import Image, shown
from lambent.frame.dialects.matching import Match, is_cie, picked
from lambent.frame.dialects.table import Found, misses
from lambent.frame.role import INFO, Role, Stat, parse_role

#: Kind of an image of so many channels that the user joined.
_KINDS = {1: "scalar", 2: "xy", 3: "rgb", 4: "xyzw"}


def joined(images: Sequence[Image], overrides: Mapping[str, str], file: object) -> list[Image]:
    """The images, with those that choices such as ``colour=0,1,2`` put together from channels.

    Raises `UnknownNameError` for a channel that is not there, `LayerError` for one that is asked
    for twice or for more channels than any role has.
    """
    result = list(images)
    for role, layer in overrides.items():
        names = _pieces(layer)
        if len(names) > 1 and not _named(images, layer.strip()):
            result = _joined(result, role, names, file)
    return result


def _pieces(layer: str) -> list[str]:
    return [name.strip() for name in layer.split(",")]


def _joined(images: list[Image], role: str, names: list[str], file: object) -> list[Image]:
    picks = [_channels_named(images, name, file) for name in names]
    made = []
    for view in dict.fromkeys(view for pick in picks for view in pick):
        channels = tuple(pick.get(view, pick.get("")) for pick in picks)
        if None in channels:
            continue
        if len(set(channels)) < len(channels) or len(channels) not in _KINDS:
            raise LayerError(
                f"--map {role}={','.join(names)} does not name up to four different channels",
                file=file,
                remedy="name each channel once: --map colour=0,1,2",
            )
        kind, name = _KINDS[len(channels)], ",".join(names)
        owners = [image for image in images if set(channels) & set(image.channels)]  # type: ignore[arg-type]
        alpha = owners[0].alpha if len(owners) == 1 else None
        made.append(Image(name, name, kind, channels, view, alpha=alpha))  # type: ignore[arg-type]
    used = {channel for image in made for channel in image.channels}
    rest: list[Image] = []
    for image in images:
        if not used & set(image.channels):
            rest.append(image)
            continue
        for channel in image.channels:
            if channel not in used:
                name = shown(channel[1])
                own = name.rpartition(".")[2]
                rest.append(
                    replace(
                        image,
                        name=name,
                        kind="scalar",
                        channels=(channel,),
                        component=own,
                        alpha=None,
                    )
                )
    # In front, so that a colour comes before its alpha.
    return [*made, *rest]


def _channels_named(
    images: Sequence[Image], asked: str, file: object
) -> dict[str, tuple[int, str]]:
    """The channel of each view that goes by a name, or by its part's name and its own."""
    known = [
        (image.view, channel, shown(channel[1]), image.part_name)
        for image in images
        for channel in image.channels
    ]
    for fold in (False, True):
        target = asked.lower() if fold else asked
        found: dict[str, tuple[int, str]] = {}
        for view, channel, name, part in known:
            for text in (name, f"{part}.{name}"):
                if (text.lower() if fold else text) == target:
                    found.setdefault(view, channel)
        if found:
            return found
    raise UnknownNameError("channel", asked, {name for _, _, name, _ in known}, file=file)


def asked_for(
    images: Sequence[Image], overrides: Mapping[str, str], file: object
) -> list[tuple[Role, Stat, Image]]:
    """The images that ``role=layer`` choices name, one for each view that has the layer.

    A layer may be given by full name, last component, part name, channel or ``part.layer``.
    Raises `UnknownNameError` (nearest names) and `LayerError` (channels that do not suit).
    """
    wanted: list[tuple[Role, Stat, Image]] = []
    for role_name, layer in overrides.items():
        role, stat = parse_role(role_name)
        hits = _named(images, layer.strip()) or _named(images, ",".join(_pieces(layer)))
        if not hits:
            raise UnknownNameError("layer", layer, {i.name for i in images}, file=file)
        fitting = [image for image in hits if picked(role, image, stat, asked=True) is not None]
        if not fitting:
            have = len(hits[0].channels)
            allowed = " or ".join(map(str, INFO[role].channels))
            listed = ", ".join(shown(name) for _, name in hits[0].channels)
            raise LayerError(
                f"{INFO[role].title} cannot be read from channels of these names ({listed})"
                if have in INFO[role].channels
                else f"{INFO[role].title} needs {allowed} channels, this has {have} ({listed})",
                file=file,
                layer=hits[0].name,
                remedy=f"name another layer: --map {role_name}=NAME",
            )
        views = dict.fromkeys(image.view for image in fitting)
        for view in views:
            wanted.append((role, stat, next(i for i in fitting if i.view == view)))
    return wanted


def _named(images: Sequence[Image], asked: str) -> list[Image]:
    """Images that go by a name, trying exact spellings first."""

    def names(image: Image) -> Iterator[tuple[str, ...]]:
        channels = tuple(name for _, name in image.channels)
        yield (image.name, *channels)
        yield (image.layer, f"{image.part_name}.{image.layer}", f"{image.part_name}.{image.name}")
        yield (image.part_name,)
        yield (image.layer.rpartition(".")[2], image.name.rpartition(".")[2])
        yield (f"{image.view}.{image.name}", f"{image.name}.{image.view}")
        yield tuple(f"{image.part_name}{mark}{image.view}" for mark in "._- ")

    spelled = [list(names(image)) for image in images]
    for fold in (False, True):
        target = asked.lower() if fold else asked
        for level in range(6):
            hits = [
                image
                for image, levels in zip(images, spelled, strict=True)
                if any(n and (n.lower() if fold else n) == target for n in levels[level])
            ]
            if hits:
                return hits
    return []


def overridden(matches: Sequence[Match], wanted: Sequence[tuple[Role, Stat, Image]]) -> list[Match]:
    """The matches with the user's choices in place; a rank below zero wins in `settle`."""
    result = list(matches)
    factors: tuple[float, ...]
    for role, stat, image in wanted:
        for place, match in enumerate(result):
            if match.image is image:
                channels = picked(role, image, stat, asked=True)
                assert channels is not None
                why = f"--map {role.value}{'' if stat is Stat.MEAN else '.' + stat.value}"
                space, factors = INFO[role].space, ()
                if match.found.role is role:
                    space, factors = match.found.space, match.found.factors
                found = Found(
                    role, image.name, channels, stat, space, image.view, why, misses(role),
                    factors=factors, cie=is_cie(role, image),
                )  # fmt: skip
                result[place] = Match(image, found, -1, match.scope)
    return result
