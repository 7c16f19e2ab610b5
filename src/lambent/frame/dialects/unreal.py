"""Unreal Engine's Movie Render Queue.

Names from Epic's documentation (Render Passes, Unreal Engine 4.27; Cinematic Render Passes, 5) and
from public tools that read such files: the beauty has no layer, others the pass and the material in
front (``FinalImageMovieRenderQueue_WorldDepth``). Depth is in centimetres, the first of three
channels; normals are stored as 0.5 + 0.5 n; motion vectors around 0.5, so that they are only
carried along. The beauty is tone-mapped unless that was off. No pass is a part of the light.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_PASS = r"((FinalImage|PathTracer|Path_?Tracer)\w*?)?"

UNREAL = Dialect(
    name="unreal",
    title="Unreal Engine",
    header=(r"unreal/.*=.*", r"(Software|software)=.*unreal.*"),
    names=(r"(FinalImage|PathTracer)\w*_\w+", r"ActorHitProxyMask\d*", r"FinalImage\w+"),
    rules=(
        Rule(r"RGBA?|FinalImage|PathTracer", Role.COLOUR,
             "the final image (tone-mapped, unless that was off)"),
        Rule(_PASS + r"(World|Scene)Depth", Role.DEPTH, "depth in centimetres"),
        Rule(_PASS + r"WorldNormal", Role.NORMAL, "normal", space=Space.WORLD),
        Rule(_PASS + r"BaseColor", Role.ALBEDO, "the material's base colour"),
        Rule(_PASS + r"(Diffuse|Subsurface)Color", Role.DIFFUSE_ALBEDO, "diffuse colour"),
        Rule(_PASS + r"SpecularColor", Role.SPECULAR_ALBEDO, "specular colour"),
        Rule(_PASS + r"Roughness", Role.ROUGHNESS, "roughness"),
        Rule(_PASS + r"WorldPosition", Role.POSITION, "position", space=Space.WORLD),
        Rule(_PASS + r"MotionVectors?", Role.OTHER, "motion, stored around 0.5"),
        Rule(r".*(ActorHitProxyMask|CustomStencil|ObjectId)\w*", Role.ID, "ids and masks"),
        Rule(_PASS + r"(AmbientOcclusion|Metallic|Specular|Opacity|\w*Lighting\w*|Reflections\w*"
             r"|Unlit)", Role.OTHER, "another view of the scene, not a part of the sum"),
        Rule(r"FinalImage\w+", Role.OTHER, "a pass of its own material"),
    ),
    verified="Epic documentation (Render Passes) and public tools; no file at hand",
)  # fmt: skip
