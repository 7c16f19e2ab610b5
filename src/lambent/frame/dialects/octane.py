"""OctaneRender's render passes.

Names from OTOY's documentation (Render Passes: Standalone, Lightwave 2024, Blender) and, in the
spelling of files, from the source of its Blender plug-in; there a view layer stands in front and
the header is Blender's, whose table has these rules too. The beauty is the sum of emitters,
environment, diffuse, reflection, refraction, transmission, scattering and volume. ``ZDepth`` is
scaled by the pass's largest depth; motion vectors by the largest speed, so that they are only
carried along. Spaces of the normals and header attributes: not verified.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_PARTS = (
    r"diffuse|reflection|refraction|transmission|environment|volume|volume[ _]?emission"
    r"|sub-?surface[ _]?scattering|sss|(diffuse|reflection)[ _]?(in)?direct"
)

#: What its passes mean, but for the beauty; Blender's table has these too.
RULES = (
    Rule(r"denoised[ _]?\w+", Role.OTHER, "already denoised by Octane"),
    Rule(r"denoiser?[ _]?albedo", Role.ALBEDO, "made for denoising"),
    Rule(r"denoiser?[ _]?normal", Role.NORMAL, "made for denoising"),
    Rule(r"diffuse[ _]?filter[ _]?\(?(beauty|info)?\)?", Role.ALBEDO, "the diffuse filter colour"),
    Rule(r"reflection[ _]?filter[ _]?\(?(beauty|info)?\)?", Role.SPECULAR_ALBEDO,
         "reflection filter"),
    Rule(r"(refraction|transmission)[ _]?filter[ _]?\(?(beauty|info)?\)?", Role.OTHER,
         "a filter colour"),
    Rule(r"shading[ _]?normals?|normals?[ _]?\(?shading\)?", Role.NORMAL, "shading normal"),
    Rule(r"smooth[ _]?normals?|normals?[ _]?\(?smooth\)?", Role.NORMAL, "smooth normal"),
    Rule(r"geo(metric)?[ _]?normals?|normals?[ _]?\(?geometric\)?", Role.NORMAL,
         "geometric normal"),
    Rule(r"tangent[ _]?normals?|normals?[ _]?\(?tangent\)?", Role.OTHER, "in tangent space"),
    Rule(r"z[ -]?depth", Role.DEPTH, "depth, scaled by the largest"),
    Rule(r"volume[ _]?(z[ -]?depth[ _]?(front|back)|mask)", Role.OTHER, "data of the volume"),
    Rule(r"position", Role.POSITION, "position", space=Space.WORLD),
    Rule(r"emitters|emission", Role.EMISSION, "light that surfaces give off"),
    Rule(_PARTS, Role.LIGHTING, "a part of the light"),
    Rule(r"(ambient[ _]?light|sun[ _]?light|light(ID)?[ _]?\d+)[ _]?(direct|indirect)?",
         Role.LIGHTING, "light of some lamps"),
    Rule(r"crypto\w*|(material|object|baking[ _]?group|light[ _]?pass|render[ _]?layer)"
         r"[ _]?(id|mask)", Role.ID, "ids"),
    Rule(r"motion[ _]?vectors?", Role.OTHER, "motion, scaled by the largest speed"),
    Rule(r"(black[ _]?)?layer[ _]?(shadows|reflections)|shadow|irradiance|light[ _]?direction|noise"
         r"|post[ _]?processing|postfx.*|wireframe|ambient[ _]?occlusion|object[ _]?layer[ _]?color"
         r"|uv[ _]?coordinates|texture[ _]?tangent|opacity|index[ _]?of[ _]?refraction",
         Role.OTHER, "not a part of the sum"),
)  # fmt: skip

OCTANE = Dialect(
    name="octane",
    title="Octane",
    header=(r"(Software|software|renderer)=.*octane.*", r"octane[:/].*=.*"),
    names=(
        r"denoised[ _]?beauty",
        r"denoiser?[ _]?(albedo|normal)",
        r"(diffuse|reflection|refraction|transmission)[ _]?filter[ _]?\(?(beauty|info)\)?",
        r"emitters",
        r"(reflection|diffuse)(direct|indirect)|reflection[ _](in)?direct",
        r"light[ _]?direction|post[ _]?processing|black[ _]?layer[ _]?shadows",
        r"normals?[ _]?\(?(shading|smooth|tangent)\)?",
        r"light[ _]?pass[ _]?id|baking[ _]?group[ _]?id|render[ _]?layer[ _]?(id|mask)",
        r"sun[ _]?light([ _]?(in)?direct)?",
    ),
    rules=(
        Rule(r"RGBA?|beauty|main|combined", Role.COLOUR, "the beauty"),
        *RULES,
    ),
    verified="OTOY documentation (Render Passes); source of Octane's plug-in for Blender; no file "
    "at hand",
)
