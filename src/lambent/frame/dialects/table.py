"""The records of a dialect: how one renderer names its layers.

A dialect is data, nothing else: patterns of names with the role each means. The small engine that
reads the tables is in `matching`; how channels become images with names is in `images`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from lambent.frame.role import INFO, Role, Space, Stat


@dataclass(frozen=True)
class Rule:
    """One line of a table: a layer whose name matches has this role.

    ``pattern``: regular expression that must match the whole name, whatever its case. Images
    without a name are called ``RGB``, ``XYZ``, ``XY``, ``UV`` or by their only channel.
    ``what``: what the layer is, in the renderer's words; part of the reason that is shown.
    ``space``: None takes that of the role. ``miss``: values besides those of the role that mean
    "nothing was hit". ``component``: regular expression for the last part of a single channel's
    name. ``alpha``: True or False asks for an image with or without an alpha of its own.
    ``without``: the rule holds only where no layer of that name is beside it.
    ``per_sample``: the file holds the variance of the samples; divided by spp it is that of the
    mean. ``factors``: what each channel is multiplied with to have the role's unit and direction.
    ``cie``: the rule takes CIE XYZ for a colour. ``hint``: text in small letters that every
    matching name contains; it spares compiling patterns that cannot match.
    """

    pattern: str
    role: Role
    what: str = ""
    stat: Stat = Stat.MEAN
    space: Space | None = None
    miss: tuple[float, ...] = ()
    component: str = ""
    alpha: bool | None = None
    without: str = ""
    per_sample: bool = False
    factors: tuple[float, ...] = ()
    cie: bool = False
    hint: str = ""


@dataclass(frozen=True)
class Dialect:
    """How one renderer names its layers.

    ``header``: regular expressions for ``key=value`` of a header attribute; one match is proof.
    ``names``: regular expressions for typical layer names; ``enough`` different ones are taken
    for proof where no header tells. ``rules``: first match decides; of several layers for one
    role the one whose rule comes first is taken. ``scoped``: names have a view layer in front.
    ``spp``: pairs of a regular expression for ``key=value`` whose group is a number, and the
    power that makes samples per pixel of it. ``verified``: where the names were looked up.
    """

    name: str
    title: str
    rules: tuple[Rule, ...]
    header: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    enough: int = 2
    scoped: bool = False
    spp: tuple[tuple[str, int], ...] = ()
    verified: str = ""


@dataclass(frozen=True)
class Found:
    """A layer and what it means.

    ``channels``: pairs (part index, channel name) in the order of the role's components; the
    part of the first is ``part``. ``view``: name of the stereo view; ``""`` in a file without
    views, and for layers that all views share. ``miss``: all values that mean "nothing was hit".
    ``scale``: factor from the file's values to the role's unit (variances per sample: 1/spp).
    ``factors``: the same for each channel of its own (signs of motion); empty: none. ``cie``: the
    file holds CIE XYZ, the frame linear RGB.
    """

    role: Role
    name: str
    channels: tuple[tuple[int, str], ...]
    stat: Stat = Stat.MEAN
    space: Space = Space.NONE
    view: str = ""
    why: str = ""
    miss: tuple[float, ...] = ()
    scale: float = 1.0
    factors: tuple[float, ...] = ()
    cie: bool = False

    @property
    def part(self) -> int:
        """Index of the part that holds the first channel."""
        return self.channels[0][0]


@dataclass(frozen=True)
class Identified:
    """What a file's layers mean.

    ``dialect``: name of the table, ``why`` it was taken; ``spp`` if the header tells it;
    ``views``: names of the views, the main one first, empty for a file without; ``notes``:
    sentences for the user.
    """

    dialect: str
    why: str
    layers: tuple[Found, ...]
    spp: int | None = None
    views: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())

    def of(self, role: Role, stat: Stat = Stat.MEAN, view: str = "") -> Found | None:
        """The layer of a role in a view (or shared by all views), or None."""
        for wanted in (view, ""):
            for found in self.layers:
                if (found.role, found.stat, found.view) == (role, stat, wanted):
                    return found
        return None


def misses(role: Role, more: tuple[float, ...] = ()) -> tuple[float, ...]:
    """The miss values of a role and those of a rule, without repeats."""
    return tuple(dict.fromkeys((*more, *INFO[role].misses)))
