"""Redshift's AOVs.

Names are those of Redshift's documentation (Integrated AOVs; Maxon's help and docs.redshift3d.com,
pages of 2022 to 2024), as files have them: ``DiffuseLighting`` and so on; Cinema 4D's shorter ones
(``Speculars``, ``GI``) from a public compositing tool. ``DiffuseFilter`` is the diffuse colour, an
albedo; the beauty is the sum of the lighting, GI, reflections, refractions, scattering, caustics,
emission and volume layers, and those called ``…Raw`` are the same before their filter. Light groups
follow the name (``DiffuseLighting_key``). Spaces and header attributes: not verified.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_LIGHT = (
    r"diffuse([ _]?lighting)?|speculars?([ _]?lighting)?|global[ _]?illumination|gi|reflections?"
    r"|refractions?|sss|sub[ _]?surface[ _]?scatter(ing)?|caustics|background|volume[ _]?lighting"
    r"|volume[ _]?fog[ _]?emission"
)

REDSHIFT = Dialect(
    name="redshift",
    title="Redshift",
    header=(r"(Software|software|renderer)=.*redshift.*", r"(rs|redshift)[:/].*=.*"),
    names=(
        r"diffuse_?lighting",
        r"diffuse_?lighting_?raw",
        r"diffuse_?filter",
        r"speculars|specular_?lighting",
        r"(gi|global_?illumination)_?raw",
        r"reflections_?(raw|filter)",
        r"refractions_?(raw|filter)",
        r"sub_?surface_?scatter(ing)?(_?raw)?",
        r"volume_?(lighting|fogemission|fogtint)",
        r"puzzle_?matte\w*",
    ),
    rules=(
        Rule(r"RGBA?|beauty|main", Role.COLOUR, "the beauty"),
        Rule(r".*raw(_.+)?|total.*raw.*", Role.OTHER, "light before the surface's filter"),
        Rule(r"diffuse[ _]?filter", Role.ALBEDO, "the diffuse filter colour, an albedo"),
        Rule(r"reflections?[ _]?filter", Role.SPECULAR_ALBEDO, "reflection filter"),
        Rule(r"refractions?[ _]?filter|trans(lucency)?[ _]?(filter|tint)|volume[ _]?fog[ _]?tint",
             Role.OTHER, "a filter colour"),
        Rule(r"bump[ _]?normals?", Role.NORMAL, "with bump maps"),
        Rule(r"normals?|N", Role.NORMAL, "without bump maps"),
        Rule(r"object[ _]?(space)?[ _]?(bump[ _]?normals?|positions?)", Role.OTHER,
             "in the space of each object"),
        Rule(r"depth|z", Role.DEPTH, "depth"),
        Rule(r"world[ _]?position|P", Role.POSITION, "position", space=Space.WORLD),
        Rule(r"motion[ _]?vectors?", Role.OTHER, "motion, perhaps scaled and clamped"),
        Rule(r"emission", Role.EMISSION, "light that surfaces give off"),
        Rule(rf"({_LIGHT})(_.+)?|emission_.+", Role.LIGHTING, "a part of the light"),
        Rule(r"puzzle.*|object[ _]?id|.*crypto.*", Role.ID, "ids"),
        Rule(r"ao|ambient[ _]?occlusion|shadows?|matte", Role.OTHER, "not light"),
    ),
    verified="Redshift documentation (Integrated AOVs); no file at hand",
)  # fmt: skip
