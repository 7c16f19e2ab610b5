"""appleseed: AOVs as parts or files beside the beauty.

Names are those of its AOV factories (``renderer/modeling/aov``): ``albedo_aov``, ``depth_aov``,
``diffuse_aov``, ``direct_diffuse_aov``, … whose entities are named without ``_aov``; both are read.
Spaces: world, by the source's shading points; the miss value of depth: not verified.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_AOV = r"(_aov)?"

APPLESEED = Dialect(
    name="appleseed",
    title="appleseed",
    header=(r"(Software|software)=.*appleseed.*", r"appleseed[:/].*=.*"),
    names=(
        r"screen_space_velocity(_aov)?",
        r"(direct|indirect)_glossy(_aov)?",
        r"npr_(shading|contour)(_aov)?",
        r"pixel_(sample_count|time|variation|error)(_aov)?",
        r"invalid_samples(_aov)?",
    ),
    rules=(
        Rule(r"RGBA?|beauty", Role.COLOUR, "the beauty"),
        Rule(r"albedo" + _AOV, Role.ALBEDO, "albedo"),
        Rule(r"normal" + _AOV, Role.NORMAL, "shading normal", space=Space.WORLD),
        Rule(r"depth" + _AOV, Role.DEPTH, "depth"),
        Rule(r"position" + _AOV, Role.POSITION, "position", space=Space.WORLD),
        Rule(r"diffuse" + _AOV, Role.DIFFUSE, "all diffuse light"),
        Rule(r"glossy" + _AOV, Role.SPECULAR, "all glossy light"),
        Rule(r"emission" + _AOV, Role.EMISSION, "light that surfaces give off"),
        Rule(r"(direct|indirect)_(diffuse|glossy)" + _AOV, Role.LIGHTING, "light by lobe"),
        Rule(r"screen_space_velocity" + _AOV, Role.OTHER, "motion, its unit is not verified"),
        Rule(r"cryptomatte_.*", Role.ID, "cryptomatte"),
        Rule(r"(pixel_.*|invalid_samples|npr_.*|uv)" + _AOV, Role.OTHER, "statistics"),
    ),
    verified="source of appleseed's AOV factories; no file at hand",
)
