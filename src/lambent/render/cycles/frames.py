"""What Cycles wrote, as frames: light split like Mitsuba's, blocks of samples joined.

Cycles writes light before the surface's colour (`lambent.frame.dialects.blender`). `with_lobes`
adds what Lambent's own integrator gives, each a sum of products of the passes:

    diffuse  = (diffuse direct + diffuse indirect) · diffuse colour
    direct   = Σ direct · colour of all lobes, volume, + emission + environment
    specular = beauty − diffuse              indirect = beauty − direct

so that both pairs sum to the beauty exactly, what the passes leave out included.

`joined` makes one frame of several independent renders of a view (blocks, each with a seed of its
own): the mean by samples, the variance of that mean from the spread of the blocks,

    variance = Σ nᵢ (xᵢ − x̄)² / (N (B − 1)),        nᵢ samples in block i, N in all, B blocks,

which is unbiased also where blocks differ in size, and two half buffers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Space, Stat

_LOBES = ("Diffuse", "Glossy", "Transmission")
#: Roles that Cycles averages over a pixel's samples (position, depth "Z" and ids are single ones).
_AVERAGED = frozenset(
    role for role, info in INFO.items() if info.radiance or role in (Role.ALBEDO, Role.NORMAL)
) | {Role.ALPHA, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO}


def passes_of(frame: Frame) -> dict[str, Layer]:
    """Layers of the view layer in use by Blender's name for the pass (``Diffuse Direct``)."""
    colour = frame.layer(Role.COLOUR)
    scope = "" if colour is None else colour.name.rpartition(".")[0]
    start = f"{scope}." if scope else ""
    named = {}
    for layer in frame.all_layers():
        if layer.name.startswith(start):
            named[layer.name[len(start) :]] = layer
    return named


def with_lobes(frame: Frame) -> Frame:
    """The frame with diffuse, specular, direct and indirect radiance, made when looked at.

    A frame without the passes they are made of stays as it is.
    """
    named = passes_of(frame)
    needed = ("Diffuse Direct", "Diffuse Indirect", "Diffuse Color")
    if not all(name in named for name in needed) or not frame.has(Role.COLOUR):
        return frame

    def get(name: str) -> FloatImage | float:
        return named[name].data if name in named else 0.0

    def diffuse() -> NDArray[Any]:
        return np.asarray((get("Diffuse Direct") + get("Diffuse Indirect")) * get("Diffuse Color"))

    def direct() -> NDArray[Any]:
        total: Any = get("Volume Direct") + get("Emission") + get("Environment")
        for lobe in _LOBES:
            total = total + get(f"{lobe} Direct") * get(f"{lobe} Color")
        return np.asarray(total)

    made = (
        (Role.DIFFUSE, diffuse, "(diffuse direct + indirect) · colour"),
        (Role.SPECULAR, lambda: frame.colour - diffuse(), "beauty − diffuse"),
        (Role.DIRECT, direct, "direct light of all lobes, emission and environment"),
        (Role.INDIRECT, lambda: frame.colour - direct(), "beauty − direct"),
    )
    for role, pixels, why in made:
        if not frame.has(role):
            frame = frame.with_layer(Layer(role, pixels, why=f"made of Cycles' passes: {why}"))
    return frame


def world_normal(frame: Frame, to_world: Sequence[Sequence[float]]) -> Frame:
    """The frame with its normal in world space, unit length where there is one.

    ``to_world``: the camera's matrix (4 × 4, Blender's camera looks along −z). Cycles' camera
    looks along +z, hence the sign.
    """
    layer = frame.layer(Role.NORMAL)
    if layer is None or layer.space is not Space.CAMERA:
        return frame
    turn = np.asarray(to_world, np.float32)[:3, :3] * np.array([1, 1, -1], np.float32)
    turned = Layer(
        Role.NORMAL, np.asarray(layer.data @ turn.T), name=layer.name, space=Space.WORLD,
        why=f"{layer.why}; turned into world space",
    )  # fmt: skip
    return frame.with_layer(turned)


def joined(blocks: Sequence[Frame], halves: bool = True) -> Frame:
    """One frame of several independent renders of a view; no origin. ``halves``: keep two halves
    of the colour.

    Variance comes with every averaged role. Layers that are no averages are those of the first
    block. One block is returned as it is, without its file.
    """
    first = blocks[0].replace(origin=None)
    if len(blocks) == 1:
        return first.replace(notes=first.notes)
    spp = [float(block.spp or 1) for block in blocks]
    layers: list[Layer] = []
    for layer in first.all_layers():
        if layer.role not in _AVERAGED or layer.stat is not Stat.MEAN:
            layers.append(layer)
            continue
        key = layer.name if layer.name in first.extras else layer.key
        images = [_same(block, key).data for block in blocks]
        mean, variance = mean_and_variance(images, spp)
        layers.append(layer.with_data(mean))
        if layer.role is not Role.LIGHTING:
            layers.append(Layer(layer.role, variance, Stat.VARIANCE, space=layer.space))
        if layer.role is Role.COLOUR and halves:
            middle = len(blocks) // 2
            for stat, part in (
                (Stat.HALF_A, slice(None, middle)),
                (Stat.HALF_B, slice(middle, None)),
            ):
                half, _ = mean_and_variance(images[part], spp[part])
                layers.append(Layer(Role.COLOUR, half, stat))
    fields = {
        "spp": int(sum(spp)),
        "view": first.view,
        "dialect": first.dialect,
        "notes": first.notes,
        "windows": first.windows,
    }
    return Frame.from_layers(layers, **fields)


def mean_and_variance(
    images: Sequence[FloatImage], spp: Sequence[float]
) -> tuple[FloatImage, FloatImage]:
    """Mean weighted by samples, and the variance of that mean (module docstring); 0 for one."""
    total = sum(spp)
    mean = sum(np.float64(n) * image for n, image in zip(spp, images, strict=True)) / total
    if len(images) == 1:
        return np.asarray(mean, np.float32), np.zeros_like(images[0])
    spread = sum(np.float64(n) * (x - mean) ** 2 for n, x in zip(spp, images, strict=True))
    return (
        np.asarray(mean, np.float32),
        np.asarray(spread / (total * (len(images) - 1)), np.float32),
    )


def _same(block: Frame, key: Any) -> Layer:
    return block.extras[key] if isinstance(key, str) else block.layers[key]
