"""The fixed set of plug-in structures that all scenes are made of, and how many of each.

Dr.Jit compiles a scene's kernel from the *structure* of its plug-ins; textures, meshes and numbers
are data. The layout of its call tables also depends on how many BSDFs, shapes and emitters live.
So every scene has exactly the `SLOTS`, `LIGHTS` and a multiple of `SHAPES` below: what a plan does
not use is filled with dummies of the same structure (black lights that are never chosen, triangles
of no size). Two scenes then share one compiled kernel.
"""

from __future__ import annotations

#: Structures of BSDFs, and how many of each a scene has. In brackets: textures (others: numbers).
SLOTS: dict[str, int] = {
    "principled": 10,  # twosided(principled(base_color [3], roughness [1], …))
    "bump": 3,  # twosided(bumpmap([1], principled))
    "normalmap": 2,  # twosided(normalmap([3], principled))
    "diffuse": 3,  # twosided(diffuse([3]))
    "plastic": 2,  # twosided(plastic([3]))
    "roughplastic": 2,  # twosided(roughplastic([3]))
    "conductor": 1,  # twosided(conductor): mirrors
    "roughconductor": 3,  # twosided(roughconductor): anisotropic
    "dielectric": 2,  # the index of refraction is compiled in: 1.5, and for water 1.33
    "water": 1,
    "thindielectric": 1,
    "roughdielectric": 1,
    "transmissive": 1,  # principled with spec_trans: tinted, rough glass
    "translucent": 2,  # principledthin(base_color [3]): paper, shades, petals
    "cards": 2,  # mask(opacity [1], twosided(diffuse [3]))
    "blend": 1,  # twosided(blendbsdf([1], roughconductor, diffuse [3])): rust
    "null": 1,  # the skin of a medium
}

#: The same for scenes with real models: many more surfaces, each with pictures of its own.
ASSET_SLOTS: dict[str, int] = {
    **SLOTS,
    "pbr": 24,  # twosided(normalmap([3], principled(base_color [3], roughness [1], metallic [1])))
    "cards": 8,
    "dielectric": 4,
    "thindielectric": 2,
    "roughdielectric": 3,
}

#: Kinds of emitters but the environment (always one), and how many of each a scene has. The face
#: count of an area light is part of the structure, so that each of these has its own mesh.
LIGHTS: dict[str, int] = {
    "panel": 4,  # area on a quad
    "bulb": 3,  # area on a ball
    "string": 1,  # area on many small octahedra
    "picture": 1,  # area with a texture on a quad
    "spot": 3,
    "point": 2,
}

#: Area lights need a mesh.
AREA = ("panel", "bulb", "string", "picture")

#: Shapes without emission come in multiples of this.
SHAPES = 48

#: Height and width of the environment map.
ENVIRONMENT = (256, 512)

#: How many octahedra a string of lights has.
BEADS = 48

#: Height and width of textures whose size is compiled in: bump maps, and what plastic takes.
TEXTURE = 256

#: The strengths of analytic skies, which are compiled in.
SKY_SCALES = (1.5, 4.0)
