"""Corona's render elements.

Names are those of Corona's documentation ("What available render elements are there?", Chaos Help
Center, article 4528507137041; Corona 9 in Phoenix' list of supported elements) and of 3ds Max's
list of classes. The beauty is the sum of the ``CESSENTIAL_…`` elements; ``CShading_RawComponent``
is light without the albedo. Units of ``CGeometry_ZDepth``, the space of the normals and the
header's attributes: not verified.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

#: What tells several elements of one kind apart: a number or the user's word.
_END = r"([ _.]?\d+|[ _.].+)?"

CORONA = Dialect(
    name="corona",
    title="Corona",
    header=(r"(Software|software|renderer)=.*corona.*",),
    names=(r"CEssential_.+", r"CGeometry_.+", r"CShading_.+", r"CMasking_.+"),
    enough=1,
    rules=(
        Rule(r"RGBA?|beauty", Role.COLOUR, "the beauty"),
        Rule(r"CShading_Alpha" + _END, Role.ALPHA, "coverage"),
        Rule(r"CShading_Albedo" + _END, Role.ALBEDO, "albedo"),
        Rule(r"CShading_SourceColor" + _END, Role.ALBEDO, "colours of the material"),
        Rule(r"CGeometry_NormalsShading" + _END, Role.NORMAL, "with bump maps"),
        Rule(r"CGeometry_NormalsGeometry" + _END, Role.NORMAL, "without bump maps"),
        Rule(r"CGeometry_ZDepth" + _END, Role.DEPTH, "depth"),
        Rule(r"CGeometry_WorldPosition" + _END, Role.POSITION, "position", space=Space.WORLD),
        Rule(r"CGeometry_.+", Role.OTHER, "data of the surface"),
        Rule(r"CEssential_Emission" + _END, Role.EMISSION, "light given off towards the camera"),
        Rule(r"CEssential_.+", Role.LIGHTING, "a part of the light"),
        Rule(r"CShading_(LightSelect|Caustics|Components)" + _END, Role.LIGHTING,
             "a part of the light"),
        Rule(r"CShading_.+", Role.OTHER, "not a part of the sum"),
        Rule(r"CMasking_.+|.*crypto.*", Role.ID, "ids and masks"),
    ),
    verified="Corona documentation (render elements); no file at hand",
)  # fmt: skip
