"""Blender: Cycles and EEVEE, old pass names and new, one part or many.

Names of Blender 5.0 were read off files rendered with it (`benchmarks/cycles_frames.py`); those up
to 4.x (``DiffDir``, ``IndexOB``, ``Env``) come from Blender's manual and from files of that time.
A layer is ``<view layer>.<pass>``; view layers and light groups have any name the user gave.

``Noisy Image`` is there when Blender denoised the render: then ``Combined`` is the clean picture.
``Diffuse Direct`` and its kind are light *before* the surface's colour: the beauty is
Σ (direct + indirect) · colour + emission + environment. ``Denoising Normal`` is in camera space
(Cycles' camera looks along +z: what one sees has z < 0), ``Normal`` in world space. ``Vector``
holds, in pixels with y *up*, (where the point was in the previous frame) - (where it is) in X, Y,
and (where it is) - (where it will be) in Z, W: three of the four change sign to become Lambent's
motion (measured by warping frames of 5.0 into each other, ``tests/render/cycles``).
"""

from __future__ import annotations

from lambent.frame.dialects.octane import RULES as OCTANE_PASSES
from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Space, Stat

_LOBES = (
    ("Diffuse", "Diff"),
    ("Glossy", "Gloss"),
    ("Transmission", "Trans"),
    ("Subsurface", "Subsurface"),
    ("Volume", "Volume"),
)

_LIGHT = tuple(
    Rule(f"{new} {long}|{old}{short}", Role.LIGHTING, f"{new.lower()} light, {long.lower()}")
    for new, old in _LOBES
    for long, short in (("Direct", "Dir"), ("Indirect", "Ind"))
)

BLENDER = Dialect(
    name="blender",
    title="Blender",
    scoped=True,
    header=(
        r"BlenderMultiChannel=.*",
        r"cycles\..*=.*",
        r"Software=Blender.*",
    ),
    names=(
        r".+\.Combined",
        r".+\.Noisy Image",
        r".+\.(Diffuse Direct|DiffDir)",
        r".+\.(Diffuse Color|DiffCol)",
        r".+\.(Glossy Direct|GlossDir)",
        r".+\.Denoising (Albedo|Normal)",
        r".+\.(IndexOB|IndexMA|Object Index)",
        r".+\.Mist",
    ),
    spp=((r"cycles\..*\.samples=(\d+)", 1),),
    rules=(
        Rule(r"Noisy Image", Role.COLOUR, "the render before Blender's own denoising"),
        Rule(r"Combined", Role.COLOUR, "the beauty", without="Noisy Image"),
        Rule(r"Combined", Role.OTHER, "the beauty, already denoised by Blender"),
        Rule(r"RGBA?|Y", Role.COLOUR, "the only image"),
        Rule(r"Crypto\w*\d\d(\..)?", Role.ID, "cryptomatte"),
        Rule(r"(IndexOB|IndexMA|Object Index|Material Index)(\..)?", Role.ID, "object ids"),
        Rule(r"Denoising Albedo", Role.ALBEDO, "made for denoising"),
        Rule(r"Denoising Normal", Role.NORMAL, "made for denoising", space=Space.CAMERA),
        Rule(r"Denoising Depth", Role.DEPTH, "made for denoising, 0 = nothing hit", miss=(0.0,)),
        Rule(r"Normal", Role.NORMAL, "first hit", space=Space.WORLD),
        Rule(r"Depth|Z", Role.DEPTH, "first sample only, 1e10 = nothing hit", miss=(1e10,)),
        Rule(r"Mist(\.Z)?", Role.OTHER, "mist factor"),
        Rule(r"Position", Role.POSITION, "first hit", space=Space.WORLD, miss=(0.0,)),
        Rule(
            r"Vector",
            Role.MOTION,
            "X, Y to the previous frame, Z, W to the next, in pixels",
            space=Space.PIXELS,
            factors=(1.0, -1.0, -1.0, 1.0),
        ),
        Rule(r"UV|UV\.A", Role.OTHER, "texture coordinates"),
        Rule(r"Diffuse Color|DiffCol", Role.DIFFUSE_ALBEDO, "colour of the surface"),
        Rule(r"Glossy Color|GlossCol", Role.SPECULAR_ALBEDO, "colour of the surface"),
        Rule(
            r"(Transmission|Subsurface) Color|(Trans|Subsurface)Col",
            Role.OTHER,
            "colour of the surface",
        ),
        *_LIGHT,
        Rule(r"Emission|Emit", Role.EMISSION, "light that surfaces give off"),
        Rule(r"Environment|Env", Role.LIGHTING, "light of the sky seen directly"),
        Rule(r"Combined_.+|RGBA_.+", Role.LIGHTING, "light group"),
        Rule(r"Ambient Occlusion|AO", Role.OTHER, "occlusion, not part of the beauty"),
        Rule(r"(Noisy )?Shadow( Catcher)?", Role.OTHER, "shadow, not part of the beauty"),
        Rule(r"Volume (Scatter|Transmit|Majorant)(\..)?", Role.OTHER, "volume data"),
        # Blender 2.79 to 2.8x had a denoiser with its own passes; what unit its variance has is
        # not verified, so that it is not used.
        Rule(
            r"Denoising (Variance|Clean|Intensity|Shadowing)(\..)?",
            Role.OTHER,
            "data of Blender 2.8's denoiser",
        ),
        Rule(r"Debug .+|Render Time(\..)?", Role.OTHER, "statistics of the render"),
        Rule(r"Grease Pencil", Role.OTHER, "drawn, not rendered"),
        Rule(r"Combined variance", Role.COLOUR, "variance of the mean", Stat.VARIANCE),
        *OCTANE_PASSES,
    ),
    verified="5.0: rendered here; older names: Blender manual (Passes)",
)
