"""The user's own choices: ``--map role=layer``, by any name a layer goes by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lambent.errors import LayerError, UnknownNameError
from lambent.frame.dialects.images import Image, shown
from lambent.frame.dialects.matching import Match, picked
from lambent.frame.dialects.table import Found, misses
from lambent.frame.role import INFO, Role, Stat, parse_role


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
        hits = _named(images, layer.strip())
        if not hits:
            raise UnknownNameError("layer", layer, {i.name for i in images}, file=file)
        fitting = [image for image in hits if picked(role, image) is not None]
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

    spelled = [list(names(image)) for image in images]
    for fold in (False, True):
        target = asked.lower() if fold else asked
        for level in range(5):
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
                channels = picked(role, image)
                assert channels is not None
                why = f"--map {role.value}{'' if stat is Stat.MEAN else '.' + stat.value}"
                space, factors = INFO[role].space, ()
                if match.found.role is role:
                    space, factors = match.found.space, match.found.factors
                found = Found(
                    role, image.name, channels, stat, space, image.view, why, misses(role),
                    factors=factors,
                )  # fmt: skip
                result[place] = Match(image, found, -1, match.scope)
    return result
