"""LuxCoreRender: film channels.

Names are those of ``Film::String2FilmChannelType`` (``slg/film/filmchannels.cpp``). LuxCore writes
a file for each output; a multi-layer file comes through Blender (then that dialect's view layers
are in front) or from a pipeline that keeps the channel's name. Normals are in world space;
``DEPTH`` is infinite where nothing is hit. Samples: not in the header.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

LUXCORE = Dialect(
    name="luxcore",
    title="LuxCore",
    header=(r"(Software|software)=.*Lux(Core|Render).*",),
    names=(
        r"RGBA?_IMAGEPIPELINE.*",
        r"AVG_SHADING_NORMAL|SHADING_NORMAL|GEOMETRY_NORMAL",
        r"(IN)?DIRECT_(DIFFUSE|GLOSSY)(_REFLECT|_TRANSMIT)?",
        r"INDIRECT_SPECULAR(_REFLECT|_TRANSMIT)?",
        r"(MATERIAL|OBJECT)_ID",
        r"RADIANCE_GROUP.*",
        r"RAYCOUNT|CONVERGENCE|SAMPLECOUNT",
    ),
    rules=(
        Rule(r"RGBA?_IMAGEPIPELINE(_0)?|RGBA?", Role.COLOUR,
             "the film (its image pipeline may have tone-mapped it)"),
        Rule(r"RGBA?_IMAGEPIPELINE_\d+", Role.OTHER, "another image pipeline"),
        Rule(r"ALBEDO", Role.ALBEDO, "albedo"),
        Rule(r"AVG_SHADING_NORMAL", Role.NORMAL, "mean shading normal", space=Space.WORLD),
        Rule(r"SHADING_NORMAL", Role.NORMAL, "shading normal of one sample", space=Space.WORLD),
        Rule(r"GEOMETRY_NORMAL", Role.NORMAL, "geometric normal", space=Space.WORLD),
        Rule(r"DEPTH", Role.DEPTH, "depth"),
        Rule(r"POSITION", Role.POSITION, "position", space=Space.WORLD),
        Rule(r"ALPHA", Role.ALPHA, "coverage"),
        Rule(r"EMISSION", Role.EMISSION, "light that surfaces give off"),
        Rule(r"(IN)?DIRECT_SHADOW_MASK|(MATERIAL|OBJECT)_ID(_MASK.*|_COLOR)?", Role.ID,
             "ids and masks"),
        Rule(r"(IN)?DIRECT_(DIFFUSE|GLOSSY|SPECULAR)", Role.LIGHTING, "light by lobe"),
        Rule(r"(IN)?DIRECT_(DIFFUSE|GLOSSY|SPECULAR)_(REFLECT|TRANSMIT)", Role.OTHER,
             "a share of a lobe that is there as a whole, too"),
        Rule(r"RADIANCE_GROUP.*|RADIANCE_PER_(PIXEL|SCREEN)_NORMALIZED.*", Role.LIGHTING,
             "light group"),
        Rule(r"BY_(MATERIAL|OBJECT)_ID.*|CAUSTIC", Role.OTHER, "light of some objects"),
        Rule(r"NOISE|CONVERGENCE|RAYCOUNT|SAMPLECOUNT|USER_IMPORTANCE|IRRADIANCE", Role.OTHER,
             "statistics of the render"),
    ),
    verified="source of LuxCore (film channels); no file at hand. RADIANCE_GROUP and *_REFLECT: "
    "from its documentation, not verified in a file",
)  # fmt: skip
