"""Houdini: Karma's standard render variables (and Mantra's ``C``, ``Pz``).

Names from SideFX' documentation (Karma Standard Render Vars) and from pipeline tools for Karma:
``C`` is the beauty, ``beauty`` in the parameters; light is ``directdiffuse``, ``indirectdiffuse``
and so on, with ``combined…`` the sum of both. ``N`` and ``P`` are in world space (``P_camera`` is
there beside). Header attributes of husk: not verified beyond names of programs.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

HOUDINI = Dialect(
    name="houdini",
    title="Houdini",
    header=(
        r"(software|renderer|capture:renderer|husk:.*|karma:.*)=.*(karma|husk|houdini|mantra).*",
        r"(husk|karma)[:/].*=.*",
    ),
    names=(
        r"(in)?direct(diffuse|emission|volume)",
        r"combined(diffuse|emission|volume|glossyreflection)",
        r"(in)?directglossyreflection",
        r"glossytransmission",
        r"beautyunshadowed",
        r"albedodiffuse",
        r"oraclevariance|primarysamples",
    ),
    rules=(
        Rule(r"C|RGBA?|beauty", Role.COLOUR, "the beauty"),
        Rule(r"(albedo|basecolor)", Role.ALBEDO, "albedo"),
        Rule(r"albedodiffuse", Role.DIFFUSE_ALBEDO, "diffuse albedo"),
        Rule(r"N", Role.NORMAL, "shading normal", space=Space.WORLD),
        Rule(r"Ng", Role.NORMAL, "geometric normal", space=Space.WORLD),
        Rule(r"depth|Pz|Z", Role.DEPTH, "depth", miss=(0.0,)),
        Rule(r"depth_.+", Role.OTHER, "depth with another filter"),
        Rule(r"P|P_world", Role.POSITION, "position", space=Space.WORLD, miss=(0.0,)),
        Rule(r"P_camera|pRef", Role.OTHER, "position in another space"),
        Rule(r"motionvectors?", Role.MOTION, "motion in pixels"),
        Rule(r"velocity", Role.OTHER, "velocity in the scene"),
        Rule(r"combineddiffuse", Role.DIFFUSE, "direct and indirect diffuse light"),
        Rule(r"combinedglossyreflection", Role.SPECULAR, "direct and indirect reflection"),
        Rule(r"combinedemission|emission", Role.EMISSION, "light that surfaces give off"),
        Rule(r".*(unshadowed|shadow)(_.+)?", Role.OTHER, "not part of the beauty"),
        Rule(
            r"(in)?direct(diffuse|glossyreflection|emission|volume)(_.+)?|combinedvolume"
            r"|glossytransmission|coat|sss|caustics|visiblelights|refract|combined\w+_.+|C_.+",
            Role.LIGHTING,
            "a part of the light",
        ),
        Rule(
            r"oraclevariance|primarysamples|indirectraycount|cputime|ao|facingratio.*",
            Role.OTHER,
            "statistics of the render",
        ),
    ),
    verified="SideFX documentation (Karma Standard Render Vars); the spaces and the miss value of "
    "depth are not verified",
)
