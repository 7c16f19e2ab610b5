"""The engine that reads the tables: which dialect a file speaks, and what its images mean.

1. `recognise` looks for proof of a renderer: a header attribute, then typical layer names.
2. `assign` takes every image through the dialect's rules, then through those of the generic table.
3. `settle` leaves one image for each role and view, and says in words what it decided.

The user's own choices (``--map role=layer``, see `choices`) stand above all of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import TYPE_CHECKING

from lambent.frame.dialects.images import Image, shown
from lambent.frame.dialects.table import Dialect, Found, Rule, misses
from lambent.frame.role import INFO, Role, Space, Stat

if TYPE_CHECKING:
    from lambent.frame.exr import ExrFile

#: Roles of which a frame holds many; all others exist once for each statistic and view.
MANY = frozenset({Role.LIGHTING, Role.ID, Role.OTHER})

#: Kinds of images that can stand for a role, best first; the number is how many channels to take.
#: An RGB image may hold a vector (Arnold) or the same number three times (Blender's single files).
KINDS: dict[Role, tuple[tuple[str, int], ...]] = {
    Role.NORMAL: (("xyz", 3), ("rgb", 3)),
    Role.POSITION: (("xyz", 3), ("rgb", 3)),
    Role.MOTION: (("xyzw", 4), ("xy", 2), ("uv", 2), ("xyz", 2), ("rgb", 2)),
    Role.DEPTH: (("scalar", 1), ("luma", 1), ("rgb", 1)),
    Role.ROUGHNESS: (("scalar", 1), ("luma", 1), ("rgb", 1)),
    Role.ALPHA: (("scalar", 1), ("luma", 1)),
    Role.COLOUR: (("rgb", 3), ("luma", 3)),
}
REFLECTANCE = (("rgb", 3), ("luma", 1), ("scalar", 1))


@dataclass(frozen=True)
class Match:
    """An image with the rule that fits it. ``rank``: place of the rule, small is better."""

    image: Image
    found: Found
    rank: int
    scope: str = ""


@lru_cache(maxsize=4096)
def compiled(pattern: str) -> re.Pattern[str]:
    """A pattern of a table; names are compared without regard to case."""
    return re.compile(pattern, re.IGNORECASE)


@lru_cache(maxsize=4096)
def _words(pattern: str) -> frozenset[str] | None:
    """The words of a pattern that is nothing but words and bars; compiling one takes 0.1 ms."""
    if all(c.isalnum() or c in "_- |" for c in pattern):
        return frozenset(pattern.lower().split("|"))
    return None


def fits(pattern: str, name: str) -> bool:
    """Whether a pattern of a table matches a whole name, whatever its case."""
    words = _words(pattern)
    if words is not None:
        return name.lower() in words
    return compiled(pattern).fullmatch(name) is not None


# ------------------------------------------------------------------------------- which dialect


def attributes(exr: ExrFile) -> Iterator[str]:
    """``key=value`` of every header attribute that is a text or a number."""
    seen = set()
    for part in exr.parts:
        for key, value in part.header.items():
            if isinstance(value, (str, int, float)) and (key, value) not in seen:
                seen.add((key, value))
                yield f"{key}={value}"[:400]


def recognise(
    exr: ExrFile, images: Sequence[Image], dialects: Mapping[str, Dialect]
) -> tuple[Dialect | None, str]:
    """The dialect of a file and the proof, or None. A header attribute beats any name."""
    texts = list(attributes(exr))
    for dialect in dialects.values():
        for pattern in dialect.header:
            for text in texts:
                if compiled(pattern).match(text):
                    key, _, value = text.partition("=")
                    text = "" if value.startswith("{") else f" = {value[:60]}"  # JSON: too long
                    return dialect, f"the header has {key}{text}"
    best: tuple[int, Dialect, list[str]] | None = None
    names = list(dict.fromkeys(image.name for image in images))
    for dialect in dialects.values():
        hits = {}
        for pattern in dialect.names:
            hit = next((name for name in names if fits(pattern, name)), None)
            if hit is not None:
                hits[pattern] = hit
        if dialect.names and len(hits) >= dialect.enough and (best is None or len(hits) > best[0]):
            best = len(hits), dialect, list(hits.values())
    if best is None:
        return None, ""
    shown = ", ".join(f"'{name}'" for name in best[2][:4])
    return best[1], f"layers are named {shown}"


def samples(
    exr: ExrFile, dialect: Dialect | None, scopes: Iterable[str], extra: Dialect
) -> dict[str, int | None]:
    """Samples per pixel of each view layer from the header, or None.

    Where several attributes match, that with the view layer's name between dots is taken.
    """
    found: list[tuple[str, int]] = []
    texts = list(attributes(exr))
    for pattern, power in (*(dialect.spp if dialect else ()), *extra.spp):
        for text in texts:
            match = compiled(pattern).match(text)
            value = float(match.group(1)) ** power if match else 0.0
            if math.isfinite(value) and 1 <= value < 1e9:
                found.append((text.partition("=")[0], round(value)))
    usual = found[0][1] if found else None
    told: dict[str, int | None] = {scope: usual for scope in scopes}
    longest = max((scope.count(".") + 1 for scope in told), default=0)
    waiting = {scope for scope in told if scope}
    for key, value in found:
        words = key.split(".")
        for a in range(1, len(words) - 1):
            for b in range(a + 1, min(a + longest + 1, len(words))):
                scope = ".".join(words[a:b])
                if scope in waiting:
                    waiting.remove(scope)
                    told[scope] = value
    return told


# ------------------------------------------------------------------------------------- the rules


def scope_of(image: Image, dialect: Dialect | None) -> tuple[str, str]:
    """View layer and pass name of an image: ``"ViewLayer.Mist"`` to ``("ViewLayer", "Mist")``."""
    if dialect is None or not dialect.scoped:
        return "", image.name
    layer = image.layer
    if "." not in layer:
        return "", image.name
    scope, _, name = layer.rpartition(".")
    return scope, name + image.name[len(layer) :]


def picked(
    role: Role, image: Image, stat: Stat = Stat.MEAN, asked: bool = False
) -> tuple[tuple[int, str], ...] | None:
    """The channels of an image that stand for a role, or None where the image cannot.

    Where it is ``asked`` for by name, a colour may be one channel of any name, or CIE XYZ (but
    for a variance, which cannot be converted).
    """
    if role in (Role.ID, Role.OTHER):
        return image.channels
    for kind, count in KINDS.get(role, REFLECTANCE):
        if image.kind == kind:
            return image.channels[:count]
    cie = image.kind == "xyz" and stat is not Stat.VARIANCE
    if asked and role is Role.COLOUR and (image.kind == "scalar" or cie):
        return image.channels
    return None


def is_cie(role: Role, image: Image) -> bool:
    """Whether an image that stands for a role is taken as CIE XYZ."""
    return role is Role.COLOUR and image.kind == "xyz"


def assign(
    images: Sequence[Image],
    dialect: Dialect | None,
    generic: Dialect,
    crypto: Iterable[str],
    spp_of: Mapping[str, int | None],
) -> tuple[list[Match], list[str]]:
    """Every image with what it means, and notes. ``crypto``: names of cryptomattes (header)."""
    beside: dict[tuple[str, str], set[str]] = {}
    for image in images:
        scope, text = scope_of(image, dialect)
        beside.setdefault((image.view, scope), set()).add(text.lower())
    tables = [(d, d.title) for d in (dialect, generic) if d is not None]
    mattes = {name.lower() for name in crypto}

    @cache
    def blocked(pattern: str, view: str, scope: str) -> bool:
        return any(fits(pattern, name) for name in beside[view, scope])

    parents: dict[tuple[int, str], Match] = {}
    matches: list[Match] = []
    notes: list[str] = []
    for image in images:
        scope, text = scope_of(image, dialect)
        shown = text if scope else image.name
        if mattes and not mattes.isdisjoint(_matte_names(image.name)):
            why = "the header lists it as a cryptomatte"
            matches.append(Match(image, _found(image, Role.ID, why), 0, scope))
            continue
        parent = parents.get(image.channels[0])
        if parent is not None:
            # `settle` makes the alpha of the colour the frame's alpha.
            role = Role.ID if parent.found.role is Role.ID else Role.OTHER
            found = _found(image, role, f"alpha of '{parent.found.name}'")
            matches.append(Match(image, found, 0, scope))
            continue
        match, offset = None, 0
        for table, title in tables:
            for rank, rule in enumerate(table.rules):
                if not _fits(rule, text, image):
                    continue
                if rule.without and blocked(rule.without, image.view, scope):
                    continue
                channels = picked(rule.role, image, rule.stat, asked=rule.cie)
                if channels is None:
                    continue
                what = f": {rule.what}" if rule.what else ""
                why = f"{title}, '{shown}'{what}"
                found, note = _from_rule(rule, image, channels, why, spp_of.get(scope))
                notes += [note] if note else []
                match = Match(image, found, offset + rank, scope)
                break
            if match:
                break
            offset += len(table.rules)
        if match is None:
            why = f"no table has a meaning for '{shown}'"
            match = Match(image, _found(image, Role.OTHER, why), offset, scope)
        matches.append(match)
        if image.alpha is not None:
            parents[image.alpha] = match
    return matches, notes


def _matte_names(name: str) -> Iterator[str]:
    """The cryptomattes an image of this name may be of: theirs, then a number, a component."""
    for text in dict.fromkeys((name, re.sub(r"\.\w+$", "", name))):
        digits = len(text) - len(text.rstrip("0123456789"))
        yield from (text[: len(text) - n].lower() for n in range(digits + 1))


def _fits(rule: Rule, text: str, image: Image) -> bool:
    if rule.hint not in text.lower() or not fits(rule.pattern, text):
        return False
    if rule.component and not fits(rule.component, image.component):
        return False
    return rule.alpha is None or rule.alpha == (image.alpha is not None)


def _from_rule(
    rule: Rule, image: Image, channels: tuple[tuple[int, str], ...], why: str, spp: int | None
) -> tuple[Found, str]:
    space = INFO[rule.role].space if rule.space is None else rule.space
    if len(channels) < len(image.channels) and image.kind != "luma":
        why += f" ({', '.join(shown(name) for _, name in channels)} only)"
    found = Found(
        rule.role, image.name, channels, rule.stat, space, image.view, why,
        misses(rule.role, rule.miss) if rule.stat is not Stat.VARIANCE else (),
        factors=rule.factors[: len(channels)], cie=is_cie(rule.role, image),
    )  # fmt: skip
    if not rule.per_sample:
        return found, ""
    if spp:
        why = f"{why}; divided by {spp} spp to be that of the mean"
        return replace(found, scale=1.0 / spp, why=why), ""
    why = f"{why}; not used: the header does not hold the samples per pixel"
    note = (
        f"'{image.name}' holds the variance of single samples; name the samples per pixel "
        "(--spp) to have it used"
    )
    return replace(found, role=Role.OTHER, stat=Stat.MEAN, space=Space.NONE, why=why), note


def _found(image: Image, role: Role, why: str) -> Found:
    return Found(role, image.name, image.channels, Stat.MEAN, INFO[role].space, image.view, why)


# ----------------------------------------------------------------------------- one image a role


def chosen_scope(matches: Sequence[Match], asked: str = "") -> str:
    """The view layer that gives the roles: the one asked for, else the richest with a colour.

    Of equals the first in the file (one part: in the alphabet). Blender's ``Composite`` (the
    compositor's result) only where there is no other.
    """
    scopes = list(dict.fromkeys(m.scope for m in matches))
    if asked and asked in scopes:
        return asked
    known = {scope: 0 for scope in scopes}
    for match in matches:
        known[match.scope] += match.found.role not in (Role.ID, Role.OTHER)
    coloured = {m.scope for m in matches if m.found.role is Role.COLOUR}

    def worth(scope: str) -> tuple[bool, bool, int]:
        return scope in coloured, bool(scope) and scope.lower() != "composite", known[scope]

    return max(scopes, key=worth, default="")


def settle(matches: Sequence[Match], scope: str) -> tuple[list[Found], list[str]]:
    """One image for each role, statistic and view; what is left over keeps its name.

    A second image of light is a lighting layer (it is filtered like the beauty), a second guide
    is only carried along. Images of other view layers are carried along, too.
    """
    best: dict[tuple[str, Role, Stat], Match] = {}
    for match in matches:
        key = (match.found.view, match.found.role, match.found.stat)
        if match.scope in ("", scope) and match.found.role not in MANY:
            held = best.get(key)
            if held is None or match.rank < held.rank:
                best[key] = match
    alphas = {
        (view, match.image.alpha): match.found.name
        for (view, role, stat), match in best.items()
        if (role, stat) == (Role.COLOUR, Stat.MEAN) and match.image.alpha is not None
    }
    views_by_alpha: dict[tuple[int, str], list[str]] = {}
    for view, channel in alphas:
        views_by_alpha.setdefault(channel, []).append(view)
    for match in matches:
        channel = match.image.channels[0]
        for view in views_by_alpha.get(channel, ()) if len(match.image.channels) == 1 else ():
            key = (view, Role.ALPHA, Stat.MEAN)
            if key not in best or best[key].rank >= 0:
                why = f"alpha of '{alphas[view, channel]}'"
                found = Found(
                    Role.ALPHA, match.found.name, match.image.channels, view=view, why=why
                )
                best[key] = replace(match, found=found)
    chosen = {id(match.image): match for match in best.values()}
    result: list[Found] = []
    for match in matches:
        match = chosen.get(id(match.image), match)
        found = match.found
        key = (found.view, found.role, found.stat)
        if match.scope not in ("", scope):
            if found.role is not Role.ID:
                why = f"belongs to the view layer '{match.scope}', not to '{scope}'"
                found = replace(found, role=Role.OTHER, stat=Stat.MEAN, space=Space.NONE, why=why)
        elif found.role not in MANY and best[key] is not match:
            taken = best[key].found.name
            light = INFO[found.role].radiance and found.stat is Stat.MEAN
            found = replace(
                found,
                role=Role.LIGHTING if light else Role.OTHER,
                stat=Stat.MEAN,
                channels=match.image.channels,
                why=f"{found.why}; '{taken}' is taken as {found.role.value}",
            )
        result.append(found)
    others = sorted({m.scope for m in matches} - {"", scope})
    notes = []
    if others and scope:
        names = ", ".join(f"'{name}'" for name in others)
        notes.append(
            f"The file has several view layers; '{scope}' is used, not {names}. "
            f"Take another with --map colour={others[0]}.Combined"
        )
    return _named_apart(result), notes


def _named_apart(layers: list[Found]) -> list[Found]:
    """Layers of one view with names of their own: a frame finds extra layers by name."""
    used: set[tuple[str, str]] = set()
    last: dict[tuple[str, str], int] = {}
    result = []
    for found in layers:
        name = found.name
        if (found.view, name) in used:
            name = (
                f"{found.name} [{'/'.join(shown(c).rpartition('.')[2] for _, c in found.channels)}]"
            )
        number = last.get((found.view, found.name), 1)
        while (found.view, name) in used:
            number += 1
            name = f"{found.name} #{number}"
        last[found.view, found.name] = number
        used.add((found.view, name))
        result.append(replace(found, name=name))
    return result
