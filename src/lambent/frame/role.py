"""What a layer means.

A renderer names its layers as it likes; a `Role` is what Lambent understands by one. A role says
how many channels there are, in which unit, whether the layer is light that adds up to the beauty,
and which values mean "nothing was hit here".
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from lambent.errors import UnknownNameError


class Stat(str, Enum):
    """Which statistic of the samples of a pixel a layer holds."""

    MEAN = "mean"
    #: Variance *of the pixel's mean* (sample variance divided by spp), in the role's unit squared.
    VARIANCE = "variance"
    #: Mean over one half of the samples, and over the other: two independent renders.
    HALF_A = "half_a"
    HALF_B = "half_b"


class Space(str, Enum):
    """The coordinate system of a vector layer, or the transfer of a colour layer."""

    NONE = "none"
    LINEAR = "linear"  # scene-linear radiance or reflectance
    SRGB = "srgb"  # display-referred, sRGB transfer
    WORLD = "world"
    CAMERA = "camera"
    PIXELS = "pixels"  # motion: x right, y down
    UNKNOWN = "unknown"  # a vector whose space the file does not tell


class Role(str, Enum):
    """What a layer means; the table `INFO` has channels, unit and misses of each."""

    COLOUR = "colour"
    ALPHA = "alpha"
    ALBEDO = "albedo"
    NORMAL = "normal"
    DEPTH = "depth"
    POSITION = "position"
    #: Where a point of this pixel was in the previous frame: pixel + motion (x right, y down).
    #: Channels 2 and 3, if any, lead to the next frame in the same way.
    MOTION = "motion"
    ROUGHNESS = "roughness"
    EMISSION = "emission"
    DIFFUSE = "diffuse"
    SPECULAR = "specular"
    DIFFUSE_ALBEDO = "diffuse_albedo"
    SPECULAR_ALBEDO = "specular_albedo"
    DIRECT = "direct"
    INDIRECT = "indirect"
    #: Any other radiance that is part of the beauty: light groups, Cycles' single passes.
    #: Frames hold these by name in `Frame.extras`.
    LIGHTING = "lighting"
    #: Object ids, cryptomatte, coverage masks: never filtered, never averaged.
    ID = "id"
    #: Anything else. Carried along untouched.
    OTHER = "other"


@dataclass(frozen=True)
class RoleInfo:
    """Facts about a role.

    ``channels``: allowed channel counts (empty: any). ``radiance``: light that sums to the beauty,
    so that it is filtered with the weights of the beauty. ``guide``: a noise-poor feature that a
    filter may look at. ``low``/``high``: the range of sound values. ``misses``: values that
    renderers write where nothing was hit (infinities always count).
    """

    title: str
    channels: tuple[int, ...]
    unit: str
    space: Space
    radiance: bool = False
    guide: bool = False
    low: float | None = None
    high: float | None = None
    misses: tuple[float, ...] = ()


#: Depth "at infinity": Cycles 1e10; Arnold, Houdini and others the largest half or float or a
#: round number near it (V-Ray and RenderMan 1e30 to 1e38, 8.5e37 is Nuke's and mental ray's).
DEPTH_MISSES = (1e10, 65504.0, 1e30, 8.507e37, 1e38, 3.4028235e38)

INFO: dict[Role, RoleInfo] = {
    Role.COLOUR: RoleInfo("beauty", (1, 3), "radiance", Space.LINEAR, radiance=True),
    Role.ALPHA: RoleInfo("coverage", (1,), "1", Space.NONE, low=0.0, high=1.0),
    Role.ALBEDO: RoleInfo("albedo", (1, 3), "1", Space.LINEAR, guide=True, low=0.0, high=1.0),
    Role.NORMAL: RoleInfo("shading normal", (3,), "1", Space.UNKNOWN, guide=True),
    Role.DEPTH: RoleInfo(
        "depth", (1,), "scene unit", Space.NONE, guide=True, low=0.0, misses=DEPTH_MISSES
    ),
    Role.POSITION: RoleInfo("position", (3,), "scene unit", Space.WORLD, guide=True),
    Role.MOTION: RoleInfo("motion", (2, 4), "pixel", Space.PIXELS),
    Role.ROUGHNESS: RoleInfo("roughness", (1,), "1", Space.NONE, guide=True, low=0.0, high=1.0),
    Role.EMISSION: RoleInfo("emission", (1, 3), "radiance", Space.LINEAR, radiance=True),
    Role.DIFFUSE: RoleInfo("diffuse light", (1, 3), "radiance", Space.LINEAR, radiance=True),
    Role.SPECULAR: RoleInfo("specular light", (1, 3), "radiance", Space.LINEAR, radiance=True),
    Role.DIFFUSE_ALBEDO: RoleInfo(
        "diffuse albedo", (1, 3), "1", Space.LINEAR, guide=True, low=0.0, high=1.0
    ),
    Role.SPECULAR_ALBEDO: RoleInfo(
        "specular albedo", (1, 3), "1", Space.LINEAR, guide=True, low=0.0, high=1.0
    ),
    Role.DIRECT: RoleInfo("direct light", (1, 3), "radiance", Space.LINEAR, radiance=True),
    Role.INDIRECT: RoleInfo("indirect light", (1, 3), "radiance", Space.LINEAR, radiance=True),
    Role.LIGHTING: RoleInfo("lighting layer", (1, 3), "radiance", Space.LINEAR, radiance=True),
    Role.ID: RoleInfo("object or material id", (), "id", Space.NONE),
    Role.OTHER: RoleInfo("other", (), "", Space.NONE),
}

#: Other spellings people type, for `--map` and friends.
ALIASES = {
    "color": Role.COLOUR,
    "beauty": Role.COLOUR,
    "rgb": Role.COLOUR,
    "normals": Role.NORMAL,
    "z": Role.DEPTH,
    "p": Role.POSITION,
    "velocity": Role.MOTION,
    "vector": Role.MOTION,
    "glossy": Role.SPECULAR,
    "emit": Role.EMISSION,
    "a": Role.ALPHA,
}


def parse_role(text: str) -> tuple[Role, Stat]:
    """``"albedo"`` or ``"colour.variance"`` to a role and a statistic.

    Raises `UnknownNameError` with the nearest names.
    """
    name, _, stat = text.strip().lower().partition(".")
    name = name.replace("-", "_").replace(" ", "_")
    try:
        role = ALIASES.get(name) or Role(name)
    except ValueError:
        raise UnknownNameError("role", name, [r.value for r in Role]) from None
    try:
        return role, Stat(stat or "mean")
    except ValueError:
        raise UnknownNameError("statistic", stat, [s.value for s in Stat]) from None
