"""Lambent's own renders: ``lambent render`` leaves the attribute ``lambent_render``.

Most layers have the common names. ``first_*`` are of the first hit, where the plain ones look
through mirrors and glass; they say what a surface is, but not what is seen in it.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_STAT = r"(_variance)?"

LAMBENT = Dialect(
    name="lambent",
    title="Lambent",
    header=(r"lambent_render=.*",),
    rules=(
        Rule(r"normal", Role.NORMAL, "shading normal", space=Space.WORLD),
        Rule(r"first_(albedo|normal|depth)" + _STAT, Role.OTHER,
             "of the first hit; the plain one looks through mirrors and glass"),
        Rule(r"previous_depth" + _STAT, Role.OTHER, "distance from the previous camera"),
    ),
    verified="a file of `lambent render`",
)  # fmt: skip
