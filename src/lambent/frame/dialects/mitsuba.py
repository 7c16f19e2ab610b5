"""Mitsuba 3: the ``aov`` integrator, whose layers have the user's names.

What it writes is told by the components (``src/integrators/aov.cpp``): ``.R .G .B`` an albedo,
``.R .G .B .A`` the image of a nested integrator, ``.T`` a depth (distance from the pinhole, 0 where
nothing is hit), ``.X .Y .Z`` a position, a normal or a derivative, ``.U .V`` texture coordinates or
their derivatives, ``.I`` an index. Only the vectors need their name read; a vector with a name of
no meaning stays without role. All vectors are in world space. The first nested image is also
written as the bare ``R G B``. A film of the pixel format ``xyz`` is the bare ``X Y Z``, of CIE.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space

_END = r"(\.[xyz])?"  # the documentation's example calls a depth "dd.y"

MITSUBA = Dialect(
    name="mitsuba",
    title="Mitsuba",
    header=(r"generatedBy=Mitsuba.*", r"(Software|software)=Mitsuba.*"),
    names=(r".*\.T", r"dd\.y", r"sh_normal", r"geo_normal", r"(prim|shape)_index"),
    rules=(
        Rule(r"RGB|Y", Role.COLOUR, "the film"),
        Rule(r"XYZ", Role.COLOUR, "the film, CIE XYZ", cie=True, without=r"RGB|Y"),
        Rule(r".*", Role.DEPTH, "component T: distance from the camera, 0 = nothing hit",
             component="T", miss=(0.0,)),
        Rule(r".*", Role.ID, "component I: index of a shape or triangle", component="I"),
        Rule(r"(.*[_.\- ])?(alb|albedo|aa|diffuse_reflectance|reflectance)", Role.ALBEDO,
             "albedo of the surface", alpha=False),
        Rule(r"(.*[_.\- ])?(sh_?n(ormals?)?|shading_?normals?|ns)" + _END, Role.NORMAL,
             "shading normal", space=Space.WORLD),
        Rule(r"(.*[_.\- ])?(nn?|normals?|nrm)" + _END, Role.NORMAL, "normal", space=Space.WORLD),
        Rule(r"(.*[_.\- ])?(geo_?n(ormals?)?|ng)" + _END, Role.NORMAL, "geometric normal",
             space=Space.WORLD),
        Rule(r"(.*[_.\- ])?(p|pp|pos|positions?)" + _END, Role.POSITION, "position of the hit",
             space=Space.WORLD, miss=(0.0,)),
        Rule(r"(.*[_.\- ])?(dp_?d[uv]|duv_?d[xy])" + _END, Role.OTHER, "derivative"),
        Rule(r"(.*[_.\- ])?(uv|boundary(_test)?)(\..)?", Role.OTHER, "surface data"),
        Rule(r"(m2_|.*\.m2_).*", Role.OTHER, "second moment"),
        Rule(r".+", Role.COLOUR, "image of a nested integrator", alpha=True, without=r"RGB|Y"),
        Rule(r".+", Role.LIGHTING, "image of a nested integrator", alpha=True),
    ),
    verified="source of the aov integrator; a file of Mitsuba 3.9.1",
)  # fmt: skip
