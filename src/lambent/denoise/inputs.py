"""What the network reads of a frame: one description for training and for run time.

`signals_of` finds the layers in a frame, `encode` turns them into planes of similar range, `pack`
folds 2x2 pixels into channels. All three work on channels-first arrays; the last two take NumPy
arrays or PyTorch tensors alike (``xp`` is the module), with any leading batch axes.

The colour is divided by the albedo before it is looked at (Bako et al. 2017, eq. 8), so that
texture does not hide noise; `OFFSET` keeps black surfaces from exploding::

    d = albedo + OFFSET   (1 where there is no albedo),      x = exposure · colour / d

Planes, in this order (an absent layer is 0 everywhere, and its mask is 0):

====== ============================================================ ==================
number what                                                         mask
====== ============================================================ ==================
3      t(x),  t(v) = log(1 + 16 v) / 6                              (always there)
3      albedo, held to [0, 2]                                       albedo
3      normal                                                       normal
1      log(depth / median depth) / 4, held to [-1, 1]; a miss is 1  depth
1      roughness                                                    roughness
1      t of the standard deviation of x (mean of the channels)      colour variance
1      square root of the albedo's standard deviation               feature variance
1      the same of the normal's                                     feature variance
1      the same of the depth's, relative to the depth               feature variance
3      history: t of the previous output, warped here               history
====== ============================================================ ==================

Constants, the same in every pixel: the seven masks above, log2(spp)/10, whether spp is known, and
the preference λ in [0, 1] (0: least error, 1: keep what might be detail). Where spp is unknown and
there is no colour variance either, its place has what the frame seems to have (`denoise.samples`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np

from lambent.filters.features import variance_of
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.misses import missing_depth
from lambent.frame.role import Role

#: Counts up when what a network reads, or what its outputs mean, is another (2: it predicts kernels
#: for the albedo, too; 3: it is told a guess of spp).
VERSION = 3
#: Added to the albedo before dividing by it; the most a colour is amplified is 1/OFFSET.
OFFSET = 0.05
#: t(v) = log(1 + SLOPE v) / RANGE: 0.18 becomes 0.22, 1 becomes 0.47, 1000 becomes 1.6.
SLOPE, RANGE = 16.0, 6.0
#: A depth e^4 times the median and more is all the same.
DEPTH_RANGE = 4.0

#: The layers that a signal can have beside its colour, with their number of channels.
LAYERS: Mapping[str, int] = {
    "albedo": 3,
    "normal": 3,
    "depth": 1,
    "roughness": 1,
    "colour_std": 1,
    "albedo_std": 1,
    "normal_std": 1,
    "depth_std": 1,
    "history": 3,
}
#: The masks, and the layers that each stands for.
MASKS: Mapping[str, tuple[str, ...]] = {
    "albedo": ("albedo",),
    "normal": ("normal",),
    "depth": ("depth",),
    "roughness": ("roughness",),
    "colour_std": ("colour_std",),
    "feature_std": ("albedo_std", "normal_std", "depth_std"),
    "history": ("history",),
}
PLANES = 3 + sum(LAYERS.values())
CONSTANTS = len(MASKS) + 3
#: Channels that the network reads, at half the resolution.
CHANNELS = 4 * PLANES + CONSTANTS


@dataclass(frozen=True)
class Signals:
    """The layers of a frame as the network wants them, channels first, float32.

    ``colour`` ``(3, H, W)``, linear radiance. ``layers``: those of `LAYERS` that there are.
    Standard deviations are of the pixel means; that of the colour is the root of the mean variance
    of its channels. ``depth`` is encoded (see the module's table). ``spp`` None: unknown; ``guess``
    is what it seems to be, then.
    """

    colour: Any
    layers: Mapping[str, Any] = field(default_factory=dict)
    spp: float | None = None
    guess: float | None = None

    def masks(self) -> dict[str, float]:
        """1 for every mask whose layers are there."""
        return {name: float(any(n in self.layers for n in of)) for name, of in MASKS.items()}


def typical_depth(frame: Frame) -> float:
    """The median depth of every fourth pixel down and across that is no miss; 1 without any."""
    depth = frame.get(Role.DEPTH)
    if depth is None:
        return 1.0
    z = np.abs(depth[::4, ::4, 0])
    z = z[np.isfinite(z) & ~missing_depth(z)]
    return float(np.median(z)) if z.size else 1.0


def signals_of(frame: Frame, depth_scale: float | None = None) -> Signals:
    """The signals of a frame; ``depth_scale`` is the whole frame's where this is a tile.

    Where there is no albedo, the sum of diffuse and specular albedo takes its place. What is not
    finite counts as 0.
    """
    colour = _planes(frame.colour)
    found: dict[str, Any] = {}
    albedo = albedo_of(frame)
    if albedo is not None:
        found["albedo"] = _planes(albedo)
    if (normal := frame.get(Role.NORMAL)) is not None:
        found["normal"] = _planes(normal)
    depth = frame.get(Role.DEPTH)
    if depth is not None:
        z = np.abs(depth[:, :, 0])
        miss = missing_depth(z) | ~np.isfinite(z)
        z = np.where(miss, np.float32(1), z)
        scale = np.float32(depth_scale or typical_depth(frame))
        relative = np.clip(np.log(z / scale) / np.float32(DEPTH_RANGE), -1, 1)
        found["depth"] = np.where(miss, np.float32(1), relative)[None].astype(np.float32)
        if (variance := variance_of(frame, Role.DEPTH)) is not None:
            found["depth_std"] = np.sqrt(_planes(variance)[:1]) / z[None]
    if (roughness := frame.get(Role.ROUGHNESS)) is not None:
        found["roughness"] = _planes(roughness[:, :, :1])
    for name, role in (("colour", Role.COLOUR), ("albedo", Role.ALBEDO), ("normal", Role.NORMAL)):
        variance = variance_of(frame, role)
        if variance is not None:
            found[f"{name}_std"] = np.sqrt(_planes(variance).mean(0, keepdims=True))
    return Signals(colour, found, float(frame.spp) if frame.spp else None)


def albedo_of(frame: Frame) -> FloatImage | None:
    """The albedo ``(H, W, 3)`` of a frame: its layer, else diffuse plus specular albedo."""
    albedo = frame.get(Role.ALBEDO)
    if albedo is None:
        parts = [frame.get(Role.DIFFUSE_ALBEDO), frame.get(Role.SPECULAR_ALBEDO)]
        there = [part for part in parts if part is not None]
        albedo = sum(there[1:], there[0]) if there else None
    if albedo is not None and albedo.shape[2] == 1:
        albedo = np.repeat(albedo, 3, axis=2)
    return albedo


def divisor(xp: ModuleType, albedo: Any) -> Any:
    """What the colour is divided by: albedo, held to [0, 2], plus `OFFSET`."""
    return xp.clip(albedo, 0, 2) + OFFSET


def curve(xp: ModuleType, x: Any) -> Any:
    """t(x) = log(1 + 16 x) / 6; negative light counts as none."""
    return xp.log1p(SLOPE * xp.clip(x, 0, None)) / RANGE


def encode(xp: ModuleType, signals: Signals, exposure: float) -> Any:
    """The planes of the table, ``(..., PLANES, H, W)``."""
    colour, layers = signals.colour, signals.layers
    like = colour[..., :1, :, :]
    d = divisor(xp, layers["albedo"]) if "albedo" in layers else xp.ones_like(colour)
    found = [curve(xp, colour * exposure / d)]
    for name, count in LAYERS.items():
        layer = layers.get(name)
        if layer is None:
            found.append(xp.concatenate([xp.zeros_like(like)] * count, axis=-3))
        elif name == "colour_std":
            found.append(curve(xp, layer * exposure / d.mean(-3, keepdims=True)))
        elif name == "history":
            found.append(curve(xp, layer * exposure / d))
        elif name.endswith("_std"):
            found.append(xp.sqrt(xp.clip(layer, 0, 1)))
        elif name == "albedo":
            found.append(xp.clip(layer, 0, 2))
        else:
            found.append(xp.clip(layer, -1, 1))
    return xp.concatenate(found, axis=-3)


def constants(signals: Signals, preference: float) -> FloatImage:
    """The constants ``(CONSTANTS,)``: masks, spp, whether it is known, λ."""
    known = bool(signals.spp)
    size = float(np.log2(signals.spp or signals.guess or 1)) / 10
    return np.array([*signals.masks().values(), size, float(known), preference], np.float32)


def pack(xp: ModuleType, planes: Any, numbers: Any) -> Any:
    """``(..., PLANES, H, W)`` and ``(..., CONSTANTS)`` to ``(..., CHANNELS, H/2, W/2)``.

    Channel 4 p + 2 y + x is plane p at the pixels (2 i + y, 2 j + x). H and W must be even.
    """
    *batch, count, height, width = planes.shape
    cells = planes.reshape(*batch, count, height // 2, 2, width // 2, 2)
    n = len(batch)
    order = (*range(n), n, n + 2, n + 4, n + 1, n + 3)
    cells = xp.permute(cells, order) if hasattr(xp, "permute") else xp.transpose(cells, order)
    folded = cells.reshape(*batch, 4 * count, height // 2, width // 2)
    flat = numbers[..., :, None, None] + xp.zeros_like(folded[..., :1, :, :])
    return xp.concatenate([folded, flat], axis=-3)


def _planes(image: FloatImage) -> FloatImage:
    """``(H, W, C)`` to ``(C, H, W)``, what is not finite as 0."""
    planes = np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)
    if not np.isfinite(planes.sum()):
        planes = np.nan_to_num(planes, nan=0.0, posinf=0.0, neginf=0.0)
    return planes
