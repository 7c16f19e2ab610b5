"""V-Ray's render elements.

Names from Chaos' documentation and from a file of V-Ray 3.60: ``normals`` are in camera space
(in multi-channel EXR in [-1, 1]), ``bumpNormals`` the same with bump; ``diffuse`` is the diffuse
*filter*, an albedo, not light. The beauty is lighting + GI + reflect + refract + specular + SSS +
selfIllum (+ atmosphere, background). ``noiseLevel`` is an estimate, not a variance; ``velocity``
may be scaled and clamped by its settings; both are only carried along. ``DR`` is a user's own
element in our sample and without meaning here.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

VRAY = Dialect(
    name="vray",
    title="V-Ray",
    header=(r"vrayInfo/.*=.*", r"(Software|software)=.*V-?Ray.*"),
    names=(r"selfIllum", r"rawGI", r"rawLight(ing)?", r"reflectionFilter", r"noiseLevel",
           r"defocusAmount", r"bumpNormals", r"reflect", r"refract"),
    rules=(
        Rule(r"RGBA?", Role.COLOUR, "the beauty"),
        Rule(r"effectsResult|denoiser|denoised.*", Role.OTHER, "already denoised by V-Ray"),
        Rule(r"diffuse|diffuseFilter|diffuse_?filter|VRayDiffuseFilter", Role.ALBEDO,
             "the diffuse filter colour, an albedo"),
        Rule(r"reflection_?Filter|VRayReflectionFilter", Role.SPECULAR_ALBEDO, "reflection filter"),
        Rule(r"refraction_?Filter|VRayRefractionFilter", Role.OTHER, "refraction filter"),
        Rule(r"bump_?normals?|VRayBumpNormals", Role.NORMAL, "with bump maps", space=Space.CAMERA),
        Rule(r"normals?|VRayNormals", Role.NORMAL, "without bump maps", space=Space.CAMERA),
        Rule(r"z|z_?depth|VRayZDepth", Role.DEPTH, "depth"),
        Rule(r"lighting|VRayLighting|total_?light(ing)?", Role.LIGHTING, "direct diffuse light"),
        Rule(r"GI|VRayGlobalIllumination", Role.LIGHTING, "indirect diffuse light"),
        Rule(r"raw.+", Role.OTHER, "light before the surface's filter, not part of the sum"),
        Rule(r"reflect(ion)?|VRayReflection", Role.LIGHTING, "reflected light"),
        Rule(r"refract(ion)?|VRayRefraction", Role.LIGHTING, "refracted light"),
        Rule(r"specular|VRaySpecular", Role.LIGHTING, "highlights of lamps"),
        Rule(r"SSS\d?|VRaySSS2", Role.LIGHTING, "light from under the surface"),
        Rule(r"selfIllum(ination)?|VRaySelfIllumination", Role.EMISSION, "light given off"),
        Rule(r"atmosphere|background|caustics|coat|sheen|translucency", Role.LIGHTING,
             "a part of the light"),
        Rule(r"lightSelect.*|LightSelect.*|light_?mix.*", Role.LIGHTING, "light of chosen lamps"),
        Rule(r"noiseLevel|VRayNoiseLevel|sampleRate|defocusAmount", Role.OTHER,
             "noise estimate for V-Ray's denoiser, not a variance"),
        Rule(r"velocity|VRayVelocity", Role.OTHER, "motion, perhaps scaled and clamped"),
        Rule(r".*(multimatte|multiMatteElement).*|renderID|objectID|materialID|nodeID", Role.ID,
             "ids"),
        Rule(r".*crypto.*", Role.ID, "cryptomatte"),
        Rule(r"DR", Role.OTHER, "a user's own element"),
    ),
    verified="Chaos documentation (Render Elements); a file of V-Ray 3.60. The VRay… spellings and "
    "noise elements: not verified in a file",
)  # fmt: skip
