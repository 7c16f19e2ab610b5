"""How a part of a model looks: a structure of the palette with its values.

Most are the structure ``pbr``: base colour, roughness and metal as pictures under a normal map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Nothing reflects more than this share of the light: light would never end otherwise.
BRIGHTEST = 0.9


@dataclass(frozen=True, eq=False)
class Surface:
    """A ``structure`` of `lambent.scenes.mitsuba.palette` and its values (numbers, uint8 pictures).

    ``constant`` says that no value differs from place to place.
    """

    name: str
    structure: str
    values: Mapping[str, Any]
    constant: bool = False


def pbr(
    name: str,
    base_color: Any,
    roughness: Any = 0.5,
    metallic: Any = 0.0,
    *,
    normals: NDArray[np.uint8] | None = None,
    opacity: Any = None,
    tint: Any = None,
    clearcoat: float = 0.0,
) -> Surface:
    """A metallic-roughness surface; with ``opacity`` a cut-out that reflects diffusely.

    ``base_color``: linear colour ``(3,)`` or sRGB picture ``(H, W, 3)`` uint8, times the linear
    ``tint``; ``roughness``, ``metallic``, ``opacity``: a number or a picture ``(H, W, 1)`` of
    values up to 255; ``normals``: a picture ``(H, W, 3)`` with y up.
    """
    constant = np.ndim(base_color) == 1 and np.ndim(roughness) == np.ndim(metallic) == 0
    constant = constant and normals is None and opacity is None
    values: dict[str, Any] = {"base_color": _colours(base_color, tint)}
    if opacity is not None:
        return Surface(name, "cards", {**values, "opacity": _grey(opacity)})
    values |= {"roughness": _grey(roughness, 0.04), "metallic": _grey(metallic)}
    values["clearcoat"] = clearcoat
    if normals is not None:
        values["normals"] = np.ascontiguousarray(normals)
    return Surface(name, "pbr", values, constant and not clearcoat)


def glass(name: str, tint: Any, roughness: float, *, thin: bool) -> Surface:
    """Clear or frosted glass, solid or a thin sheet; ``tint`` is linear ``(3,)``."""
    colour = tuple(float(v) for v in np.clip(tint, 0, 1))
    if thin:
        return Surface(name, "thindielectric", {"tint": colour})
    if roughness > 0.05:
        return Surface(name, "roughdielectric", {"tint": colour, "alpha": max(roughness**2, 0.02)})
    return Surface(name, "dielectric", {"tint": colour})


def swatches(surfaces: list[Surface]) -> tuple[Surface, NDArray[np.float64]]:
    """Constant surfaces as one with a row of swatches; and the texture coordinate of each.

    So a model of seven plain colours needs one slot of the palette.
    """
    edge = 4
    joined = {
        key: np.concatenate(
            [s.values[key][:1].repeat(edge, 0).repeat(edge, 1) for s in surfaces], 1
        )
        for key in ("base_color", "roughness", "metallic")
    }
    place = (np.arange(len(surfaces)) + 0.5) / len(surfaces)
    return Surface(surfaces[0].name, "pbr", joined), np.stack([place, np.full_like(place, 0.5)], 1)


def _colours(value: Any, tint: Any) -> NDArray[np.uint8]:
    """A picture in sRGB, no brighter than `BRIGHTEST`."""
    if np.ndim(value) == 3 and tint is None:
        return np.minimum(value, np.uint8(243))
    linear = np.asarray(value, float)
    if linear.ndim == 3:
        linear = _linear(linear / 255) * np.asarray(tint, float)
    else:
        linear = linear.reshape(1, 1, 3)
    srgb = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    return np.rint(np.clip(srgb, 0, 0.953) * 255).astype(np.uint8)


def _linear(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _grey(value: Any, least: float = 0.0) -> NDArray[np.uint8]:
    if np.ndim(value) == 0:
        value = np.full((1, 1, 1), float(value) * 255)
    return np.rint(np.clip(value, least * 255, 255)).astype(np.uint8)
