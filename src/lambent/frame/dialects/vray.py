"""V-Ray's render elements.

Names from Chaos' documentation (Render Elements of V-Ray for 3ds Max, Rhino and Blender; default
channel names: V-Ray for Nuke, page 27432907) and from a file of V-Ray 3.60: ``normals`` are in
camera space (in multi-channel EXR in [-1, 1]), ``bumpNormals`` the same with bump; ``diffuse`` is
the diffuse *filter*, an albedo, not light. The beauty is lighting + GI + reflect + refract +
specular + SSS + selfIllum (+ atmosphere, background). Hosts write ``VRay`` in front, and a number
or the user's word behind where there are several of one kind. ``noiseLevel`` is an estimate, not a
variance; ``velocity`` may be scaled and clamped by its settings; both are only carried along.
``DR`` is a user's own element in our sample and without meaning here.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space


def _named(words: str, own: bool = False) -> str:
    """A pattern of elements as hosts write them; ``own``: with a word of the user's behind."""
    ending = r"([ ._]?\d+|[ ._]\w.*)?" if own else r"([ ._]?\d+)?"
    return rf"(VRay[ _]?)?({words}){ending}"


VRAY = Dialect(
    name="vray",
    title="V-Ray",
    header=(r"vrayInfo/.*=.*", r"(Software|software)=.*V-?Ray.*"),
    names=(r"selfIllum", r"(raw_?GI|gi_raw)\d*", r"rawLight(ing)?|light_raw", r"reflectionFilter",
           r"noiseLevel", r"defocusAmount", r"bumpNormals", r"reflect", r"refract",
           r"VRay(DiffuseFilter|ReflectionFilter|RefractionFilter).*",
           r"VRay(BumpNormals|Normals|ZDepth|Velocity).*",
           r"VRay(Lighting|GlobalIllumination|LightSelect|LightMix|SelfIllumination).*",
           r"VRay(Reflection|Refraction|Specular|SSS2)\d*", r"VRay(Raw|MtlID|ObjectID|RenderID).*",
           r"atmospheric_effects", r"bump_normals", r"self_illumination",
           r"(reflection|refraction)_raw"),
    rules=(
        Rule(r"RGBA?|VRayBeauty|RGB_?color", Role.COLOUR, "the beauty"),
        Rule(_named(r"effectsResult|denoiser|denoised.*"), Role.OTHER,
             "already denoised by V-Ray"),
        Rule(_named(r"diffuse|diffuse_?filter"), Role.ALBEDO,
             "the diffuse filter colour, an albedo"),
        Rule(_named(r"reflection_?filter"), Role.SPECULAR_ALBEDO, "reflection filter"),
        Rule(_named(r"(refraction|coat|sheen)_?filter"), Role.OTHER, "a filter colour"),
        Rule(_named(r"bump_?normals?"), Role.NORMAL, "with bump maps", space=Space.CAMERA),
        Rule(_named(r"normals?"), Role.NORMAL, "without bump maps", space=Space.CAMERA),
        Rule(_named(r"z|z_?depth"), Role.DEPTH, "depth"),
        Rule(_named(r"raw.+|.+_raw|shadow"), Role.OTHER,
             "light before the surface's filter, not part of the sum"),
        Rule(_named(r"lighting|total_?light(ing)?"), Role.LIGHTING, "direct diffuse light"),
        Rule(_named(r"GI|global_?illumination"), Role.LIGHTING, "indirect diffuse light"),
        Rule(_named(r"reflect(ion)?"), Role.LIGHTING, "reflected light"),
        Rule(_named(r"refract(ion)?"), Role.LIGHTING, "refracted light"),
        Rule(_named(r"specular"), Role.LIGHTING, "highlights of lamps"),
        Rule(_named(r"SSS\d?"), Role.LIGHTING, "light from under the surface"),
        Rule(_named(r"self_?illum(ination)?"), Role.EMISSION, "light given off"),
        Rule(_named(r"atmosphere|atmospheric_effects|background|caustics|translucency"
                    r"|(coat|sheen)(_?(reflection|specular))?"), Role.LIGHTING,
             "a part of the light"),
        Rule(_named(r"light_?select.*|light_?mix.*", own=True), Role.LIGHTING,
             "light of chosen lamps"),
        Rule(_named(r"(other\.)?(noiseLevel|sampleRate|defocusAmount)"), Role.OTHER,
             "noise estimate for V-Ray's denoiser, not a variance"),
        Rule(_named(r"velocity"), Role.OTHER, "motion, perhaps scaled and clamped"),
        Rule(r".*(multimatte|multiMatteElement).*|(VRay)?(renderID|objectID|materialID|MtlID|nodeID)",
             Role.ID, "ids"),
        Rule(r".*crypto.*", Role.ID, "cryptomatte"),
        Rule(r"DR", Role.OTHER, "a user's own element"),
    ),
    verified="Chaos documentation (Render Elements); a file of V-Ray 3.60. The VRay… spellings, "
    "the names of V-Ray for Nuke and noise elements: not verified in a file",
)  # fmt: skip
