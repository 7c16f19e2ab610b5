"""Materials: what things are made of, as people set up the Principled shader.

`make` draws a material of a kind (wood, stone, metal, glass, …) or of any; one palette a scene
keeps its things together. Most have a texture for colour, many one for roughness and a bump, so
that the albedo, the highlights and the normals all carry detail at several scales.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from .dice import Colour, Dice
from .nodes import Tree
from .textures import coloured, factor, picture

METALS: tuple[Colour, ...] = (
    (1.0, 0.77, 0.34),
    (0.95, 0.93, 0.88),
    (0.96, 0.64, 0.54),
    (0.56, 0.57, 0.58),
    (0.91, 0.92, 0.92),
    (0.55, 0.42, 0.22),
    (0.3, 0.3, 0.32),
)
WOODS: tuple[Colour, ...] = (
    (0.35, 0.17, 0.07),
    (0.15, 0.065, 0.03),
    (0.5, 0.3, 0.15),
    (0.25, 0.1, 0.05),
    (0.6, 0.45, 0.28),
)


def _new(name: str) -> tuple[Any, Tree]:
    material = bpy.data.materials.new(name)
    if not material.node_tree:
        material.use_nodes = True
    return material, Tree(material.node_tree)


def _finish(tree: Tree, surface: Any, volume: Any = None, displacement: Any = None) -> None:
    tree.add("OutputMaterial", Surface=surface, Volume=volume, Displacement=displacement)


def _bump(tree: Tree, height: Any, strength: float, distance: float = 0.02) -> Any:
    return tree.add("Bump", Strength=strength, Distance=distance, Height=height).out()


def _scale(dice: Dice) -> float:
    """Features per metre."""
    return dice.log(1.0, 24.0)


def _roughness(tree: Tree, dice: Dice, low: float, high: float) -> Any:
    """One roughness, or a texture between two."""
    if dice.chance(0.55):
        return dice.uniform(low, high)
    value = factor(tree, dice, _scale(dice), dice.pick(("noise", "noise", "crackle", "wave")))
    return tree.add(
        "MapRange",
        Value=value,
        From_Min=0.3,
        From_Max=0.7,
        To_Min=max(0.02, low * dice.uniform(0.5, 1.0)),
        To_Max=min(1.0, high * dice.uniform(0.8, 1.2)),
    ).out()


def _colour(tree: Tree, dice: Dice, palette: list[Colour], textured: float = 0.75) -> Any:
    if not dice.chance(textured):
        return dice.pick(palette)
    value = factor(tree, dice, _scale(dice))
    colour = coloured(tree, dice, value, palette)
    if dice.chance(0.3):  # dirt, or a second pattern
        mask = factor(tree, dice, _scale(dice), "noise")
        mask = tree.ramp(mask, [(0.45, (0, 0, 0)), (0.6, (1, 1, 1))])
        colour = tree.mix(mask, colour, dice.near(dice.pick(palette), 0.5))
    return colour


def _matte(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    colour = _colour(tree, dice, palette)
    normal = None
    if dice.chance(0.5):
        normal = _bump(tree, factor(tree, dice, _scale(dice) * 2), dice.log(0.1, 0.8))
    return tree.add(
        "BsdfPrincipled",
        Base_Color=colour,
        Roughness=_roughness(tree, dice, 0.5, 1.0),
        Specular_IOR_Level=dice.uniform(0.1, 0.5),
        Normal=normal,
    ).out()


def _gloss(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    coat = dice.pick((0.0, 0.0, 1.0))
    normal = None
    if dice.chance(0.25):
        normal = _bump(tree, factor(tree, dice, _scale(dice), "noise"), dice.log(0.05, 0.3))
    return tree.add(
        "BsdfPrincipled",
        Base_Color=_colour(tree, dice, palette, 0.5),
        Normal=normal,
        Roughness=_roughness(tree, dice, 0.05, 0.45),
        Coat_Weight=coat,
        Coat_Roughness=0.03,
    ).out()


def _metal(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    colour: Any = dice.near(dice.pick(METALS), 0.15) if dice.chance(0.8) else dice.vivid()
    if dice.chance(0.3):
        rust = tree.ramp(
            factor(tree, dice, _scale(dice), dice.pick(("noise", "ridge", "voronoi"))),
            [(0.45, (0, 0, 0)), (0.55, (1, 1, 1))],
        )
        colour = tree.mix(rust, colour, dice.near((0.3, 0.12, 0.05), 0.4))
    normal = None
    if dice.chance(0.35):
        normal = _bump(tree, factor(tree, dice, _scale(dice) * 2), dice.log(0.05, 0.5))
    return tree.add(
        "BsdfPrincipled",
        Base_Color=colour,
        Metallic=1.0,
        Normal=normal,
        Roughness=_roughness(tree, dice, 0.03, 0.5) if dice.chance(0.75) else 0.0,
        Anisotropic=dice.pick((0.0, 0.0, 0.0, 0.7)),
    ).out()


def _glass(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    tint = dice.pick(palette) if dice.chance(0.4) else (1.0, 1.0, 1.0)
    colour = tuple(c**0.3 for c in tint)
    roughness: Any = 0.0 if dice.chance(0.65) else _roughness(tree, dice, 0.05, 0.4)
    normal = None
    if dice.chance(0.2):
        normal = _bump(tree, factor(tree, dice, _scale(dice), "noise"), dice.log(0.05, 0.3))
    return tree.add(
        "BsdfPrincipled",
        Base_Color=colour,
        Transmission_Weight=1.0,
        Roughness=roughness,
        IOR=dice.uniform(1.3, 1.7),
        Normal=normal,
    ).out()


def _wood(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    base = dice.near(dice.pick(WOODS), 0.25)
    grain = factor(tree, dice, dice.log(2, 8), dice.pick(("wave", "rings", "noise")))
    colour = tree.ramp(
        grain, [(0.15, dice.near(base, 0.3)), (0.5, base), (0.9, dice.near(base, 0.4))]
    )
    if dice.chance(0.4):
        planks = factor(tree, dice, dice.log(0.8, 3), "brick")
        colour = tree.mix(0.6, colour, planks, "MULTIPLY")
    return tree.add(
        "BsdfPrincipled",
        Base_Color=colour,
        Roughness=_roughness(tree, dice, 0.2, 0.7),
        Normal=_bump(tree, grain, dice.log(0.03, 0.3), 0.005),
        Coat_Weight=dice.pick((0.0, 0.0, 0.5)),
    ).out()


def _stone(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    base = dice.near(
        dice.pick(((0.4, 0.38, 0.35), (0.6, 0.55, 0.5), (0.2, 0.2, 0.22), (0.5, 0.3, 0.2))), 0.3
    )
    value = factor(
        tree, dice, dice.log(1, 8), dice.pick(("noise", "ridge", "crackle", "brick", "cells"))
    )
    colour = tree.ramp(
        value, [(0.1, dice.near(base, 0.6)), (0.5, base), (0.8, dice.near(base, 0.5))]
    )
    fine = factor(tree, dice, dice.log(10, 40), "noise")
    return tree.add(
        "BsdfPrincipled",
        Base_Color=tree.mix(0.4, colour, fine, "OVERLAY"),
        Roughness=_roughness(tree, dice, 0.15, 0.9),
        Normal=_bump(tree, value, dice.log(0.1, 1.0)),
    ).out()


def _fabric(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    weave = factor(tree, dice, dice.log(8, 40), "fabric")
    colour = _colour(tree, dice, palette, 0.6)
    colour = tree.mix(0.5, colour, weave, "MULTIPLY")
    return tree.add(
        "BsdfPrincipled",
        Base_Color=colour,
        Roughness=0.9,
        Specular_IOR_Level=0.1,
        Sheen_Weight=dice.uniform(0.0, 1.0),
        Normal=_bump(tree, weave, 0.4, 0.005),
    ).out()


def _wax(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    return tree.add(
        "BsdfPrincipled",
        Base_Color=_colour(tree, dice, palette, 0.3),
        Roughness=0.4,
        Subsurface_Weight=1.0,
        Subsurface_Scale=dice.log(0.02, 0.2),
    ).out()


def _leaf(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    base = dice.near(
        dice.pick(((0.1, 0.25, 0.04), (0.2, 0.3, 0.05), (0.4, 0.2, 0.04), (0.05, 0.15, 0.06))), 0.4
    )
    shade = tree.add("ObjectInfo").out("Random")
    colour = tree.ramp(shade, [(0.0, dice.near(base, 0.5)), (1.0, dice.near(base, 0.5))])
    shell = tree.add("BsdfPrincipled", Base_Color=colour, Roughness=0.5).out()
    through = tree.add("BsdfTranslucent", Color=colour).out()
    return tree.add("MixShader", 0.35, shell, through).out()


def _emissive(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    colour: Any = dice.warmth()
    strength = dice.log(1.0, 12.0)
    if dice.chance(0.5):
        value = factor(
            tree, dice, _scale(dice), dice.pick(("cells", "stripes", "dots", "brick", "checker"))
        )
        colour = tree.ramp(
            value, [(0.3, (0.01, 0.01, 0.01)), (0.6, dice.vivid()), (0.8, dice.vivid())]
        )
    return tree.add(
        "BsdfPrincipled",
        Base_Color=dice.pick(palette),
        Emission_Color=colour,
        Emission_Strength=strength,
        Roughness=0.4,
    ).out()


def _film(tree: Tree, dice: Dice, palette: list[Colour]) -> Any:
    """Two materials on one thing, divided by a texture: paint worn off, puddles, inlays."""
    first = tree.add(
        "BsdfPrincipled", Base_Color=_colour(tree, dice, palette), Roughness=dice.uniform(0.4, 0.9)
    ).out()
    metal = dice.chance(0.5)
    second = tree.add(
        "BsdfPrincipled",
        Base_Color=dice.pick(METALS if metal else palette),
        Metallic=float(metal),
        Roughness=dice.uniform(0.02, 0.3),
    ).out()
    mask = tree.ramp(factor(tree, dice, _scale(dice)), [(0.45, (0, 0, 0)), (0.52, (1, 1, 1))])
    return tree.add("MixShader", mask, first, second).out()


KINDS: dict[str, Callable[[Tree, Dice, list[Colour]], Any]] = {
    "matte": _matte,
    "gloss": _gloss,
    "metal": _metal,
    "glass": _glass,
    "wood": _wood,
    "stone": _stone,
    "fabric": _fabric,
    "wax": _wax,
    "leaf": _leaf,
    "emissive": _emissive,
    "film": _film,
}


def make(dice: Dice, palette: list[Colour], kind: str | None = None) -> Any:
    """A material; without a kind, one that any thing might be made of."""
    kind = kind or dice.weighted(
        matte=5,
        gloss=4,
        metal=2.5,
        glass=1.8,
        wood=2,
        stone=2,
        fabric=1.5,
        wax=0.7,
        film=1.2,
        emissive=0.25,
    )
    material, tree = _new(kind)
    _finish(tree, KINDS[kind](tree, dice, palette))
    return material


def poster(dice: Dice, palette: list[Colour], glow: float = 0.0) -> Any:
    """A painted picture by the mesh's UV map; ``glow`` makes a screen or a lit sign of it."""
    material, tree = _new("poster")
    node = tree.add("TexImage", Vector=tree.coordinates("UV"))
    node.raw.image = picture(dice, palette)
    colour = node.out("Color")
    _finish(
        tree,
        tree.add(
            "BsdfPrincipled",
            Base_Color=colour,
            Roughness=dice.uniform(0.1, 0.9),
            Emission_Color=colour if glow else (0.0, 0.0, 0.0),
            Emission_Strength=glow,
        ).out(),
    )
    return material


def lamp(colour: Colour, strength: float) -> Any:
    """A surface that gives off an even light."""
    material, tree = _new("lamp")
    _finish(tree, tree.add("Emission", Color=colour, Strength=strength).out())
    return material


def fog(dice: Dice, density: float) -> Any:
    """A thin medium, even or in clouds."""
    material, tree = _new("fog")
    amount: Any = density
    if dice.chance(0.15):  # slow: Cycles marches through what is not even
        cloud = factor(tree, dice, dice.log(0.3, 1.0), "noise")
        amount = tree.math("MULTIPLY", tree.math("POWER", cloud, 3.0), 8 * density)
    colour = tuple(0.7 + 0.3 * c for c in dice.colour())
    volume = tree.add(
        "VolumeScatter", Color=colour, Density=amount, Anisotropy=dice.uniform(0, 0.7)
    ).out()
    _finish(tree, None, volume)
    return material
