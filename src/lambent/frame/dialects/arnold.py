"""Arnold and its denoiser noice.

Names from Arnold's documentation (AOVs, Noice) and from files: ``RGBA`` or bare channels, ``N`` and
``P`` in world space, ``Z`` the distance along the camera's axis, ``denoise_albedo``,
``diffuse_albedo``…, light by lobe (``diffuse_direct``, …), light groups ``RGBA_<group>``.
noice's ``variance`` has no documented unit and Arnold's filters are wider than a pixel, so that it
is carried along but not used. ``AA_samples`` is the root of the samples per pixel.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_LOBES = r"diffuse|specular|coat|sheen|sss|transmission|volume"

ARNOLD = Dialect(
    name="arnold",
    title="Arnold",
    header=(r"arnold/.*=.*", r"(Software|software)=.*Arnold.*"),
    names=(
        r"denoise_albedo",
        r"(diffuse|specular|sss|transmission|coat)_(direct|indirect|albedo)",
        r"RGBA_.+",
        r"crypto_(asset|object|material)",
        r"AA_inv_density",
    ),
    spp=((r"arnold/AA_samples=(\d+)", 2),),
    rules=(
        Rule(r"RGBA?", Role.COLOUR, "the beauty"),
        Rule(r"RGBA_denoise(d)?|.*_denoise(d)?", Role.OTHER, "already denoised by Arnold"),
        Rule(r"crypto_.*", Role.ID, "cryptomatte"),
        Rule(r"ID|instanceID|shader_id|object_id", Role.ID, "object ids"),
        Rule(r"denoise_albedo", Role.ALBEDO, "made for denoising"),
        Rule(r"albedo", Role.ALBEDO, "albedo of all lobes"),
        Rule(r"diffuse_albedo", Role.DIFFUSE_ALBEDO, "diffuse albedo"),
        Rule(r"specular_albedo", Role.SPECULAR_ALBEDO, "specular albedo"),
        Rule(r"(coat|sheen|sss|transmission|volume)_albedo", Role.OTHER, "albedo of one lobe"),
        Rule(r"N", Role.NORMAL, "shading normal", space=Space.WORLD),
        Rule(r"Z|volume_Z", Role.DEPTH, "distance along the camera's axis"),
        Rule(r"P", Role.POSITION, "position", space=Space.WORLD, miss=(0.0,)),
        Rule(r"Pref|Nref", Role.OTHER, "rest position or normal"),
        Rule(r"motionvector", Role.MOTION, "in pixels, to the next frame or as the shader says"),
        # noice: no documented unit.
        Rule(r"variance(_.*)?|.*_variance", Role.OTHER, "noice's variance, its unit is not known"),
        Rule(r"direct", Role.DIRECT, "direct light"),
        Rule(r"indirect", Role.INDIRECT, "indirect light"),
        Rule(r"diffuse", Role.DIFFUSE, "all diffuse light"),
        Rule(r"specular", Role.SPECULAR, "all specular light"),
        Rule(r"emission", Role.EMISSION, "light that surfaces give off"),
        Rule(rf"({_LOBES})_(direct|indirect)", Role.LIGHTING, "light of one lobe"),
        Rule(r"coat|sheen|sss|transmission|volume|background", Role.LIGHTING, "light of one lobe"),
        Rule(r"RGBA_.+", Role.LIGHTING, "light group"),
        Rule(rf"({_LOBES}|direct|indirect|emission)(_(direct|indirect))?_.+", Role.LIGHTING,
             "light of one lobe and group"),
        Rule(r"opacity|shadow|shadow_.*|AA_inv_density|cputime|raycount|volume_opacity",
             Role.OTHER, "not light"),
    ),
    verified="Arnold documentation (Arnold Denoiser, AOVs); files of Arnold 5.1, 7.1, 7.4",
)  # fmt: skip
