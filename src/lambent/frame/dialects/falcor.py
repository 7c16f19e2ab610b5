"""Falcor: outputs of its G-buffer and path tracer passes.

Names from the passes' channel lists (``RenderPasses/GBuffer``, ``RenderPasses/PathTracer``), with
the pass in front (``GBufferRT.posW``) or without. Falcor captures one file an output; a
multi-layer file comes from a script. ``mvec`` is in units of the screen, so it is not used as
motion in pixels.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_PASS = r"(.+\.)?"

FALCOR = Dialect(
    name="falcor",
    title="Falcor",
    header=(r"(Software|software)=.*Falcor.*",),
    names=tuple(
        _PASS + name
        for name in (
            r"posW",
            r"(norm|faceNormal|guideNormal|tangent)W",
            r"diffuseOpacity",
            r"specRough",
            r"mvecW?",
            r"linearZ",
            r"(specular|indirect)Albedo",
            r"guideNormal",
            r"vbuffer",
        )
    ),
    rules=(
        Rule(_PASS + r"colou?r|RGBA?|(AccumulatePass|PathTracer)\.(output|colou?r)", Role.COLOUR,
             "the path tracer's colour"),
        Rule(_PASS + r"(albedo|diffuseOpacity)", Role.ALBEDO, "diffuse albedo"),
        Rule(_PASS + r"specularAlbedo", Role.SPECULAR_ALBEDO, "specular albedo"),
        Rule(_PASS + r"(specRough|indirectAlbedo)(\..)?", Role.OTHER, "material data"),
        Rule(_PASS + r"guideNormalW?", Role.NORMAL, "normal made for denoising",
             space=Space.WORLD),
        Rule(_PASS + r"normW", Role.NORMAL, "shading normal", space=Space.WORLD),
        Rule(_PASS + r"faceNormalW", Role.NORMAL, "geometric normal", space=Space.WORLD),
        Rule(_PASS + r"linearZ", Role.DEPTH, "distance along the camera's axis"),
        Rule(_PASS + r"depth", Role.OTHER, "depth of the depth buffer, not linear"),
        Rule(_PASS + r"posW", Role.POSITION, "position", space=Space.WORLD, miss=(0.0,)),
        Rule(_PASS + r"(mvecW?|viewW|tangentW|texC|texGrads|mtlData|vbuffer|pnFwidth)(\..)?",
             Role.OTHER, "surface data"),
        Rule(_PASS + r"(emissive|nrdEmission)", Role.OTHER, "emission of the material"),
        Rule(_PASS + r"nrd.+", Role.OTHER, "input of NVIDIA's denoiser, in its own units"),
        Rule(_PASS + r"(rayCount|pathLength|sampleCount|time)", Role.OTHER, "statistics"),
    ),
    verified="source of Falcor's passes; no file at hand",
)  # fmt: skip
