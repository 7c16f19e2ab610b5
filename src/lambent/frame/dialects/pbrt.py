"""pbrt-v4's ``gbuffer`` film.

Names and meaning from ``GBufferFilm`` (``src/pbrt/film.cpp``): ``N`` is the geometric normal,
``Ns`` the shading normal; both and ``P`` are in camera space unless the film was told
``"coordinatesystem" "world"``, of which the file says nothing. There is no depth layer: ``P.Z`` is
the depth in camera space, and is not taken for it since the space is not certain.
``Variance`` is the variance of the samples, so that it needs the header's ``samplesPerPixel``.
Early versions of v4 wrote ``Px Py Pz``, ``Nx``…, ``Nsx``… and ``rgbVariance``,
``rgbRelativeVariance``.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space, Stat

PBRT = Dialect(
    name="pbrt",
    title="pbrt",
    header=(r"(Software|software|generatedBy)=pbrt.*",),
    names=(r"Ns", r"dzdx", r"(rgb)?RelativeVariance", r"Albedo", r"P"),
    enough=3,
    spp=((r"samplesPerPixel=(\d+(?:\.\d+)?)", 1),),
    rules=(
        Rule(r"RGB", Role.COLOUR, "the film"),
        Rule(r"Albedo", Role.ALBEDO, "albedo of the first surface"),
        Rule(r"Ns", Role.NORMAL, "shading normal (camera space unless the film said world)",
             space=Space.CAMERA),
        Rule(r"N", Role.NORMAL, "geometric normal (camera space unless the film said world)",
             space=Space.CAMERA),
        Rule(r"P", Role.POSITION, "position (camera space unless the film said world)",
             space=Space.CAMERA, miss=(0.0,)),
        Rule(r"(rgb)?Variance", Role.COLOUR, "variance of the samples", Stat.VARIANCE,
             per_sample=True),
        Rule(r"(rgb)?RelativeVariance", Role.OTHER, "variance relative to the mean"),
        Rule(r"dzdx|dzdy|uv", Role.OTHER, "surface data"),
    ),
    verified="source of pbrt-v4's gbuffer film",
)  # fmt: skip
