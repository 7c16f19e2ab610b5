"""A frame as the network's input, and planes for its filter, each in one pass over the pixels.

`packed_inputs` computes what `inputs.signals_of`, `inputs.encode` and `inputs.pack` say, in one
Dr.Jit kernel: a thread takes four pixels, reads every layer once and writes every channel. The
frame is continued to multiples of 32 by its mirror image: the last row again and again would be
stripes, which a network takes for texture as far as it can see. `split` and `merged` are the two
ends of the filter: colour and colour/d as planes, and both put together by the gate; `divisors`
is what d is averaged from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.denoise.inputs import (
    CHANNELS,
    CONSTANTS,
    DEPTH_RANGE,
    LAYERS,
    OFFSET,
    PLANES,
    RANGE,
    SLOPE,
    Signals,
    albedo_of,
    constants,
    divisor,
    typical_depth,
)
from lambent.denoise.samples import seeming_samples
from lambent.filters.features import variance_of
from lambent.frame.exposure import block_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.misses import FAR
from lambent.frame.role import INFO, Role
from lambent.kernels.arrays import aligned, backend
from lambent.kernels.pyramid import (
    Level,
    Logits,
    Workspace,
    as_floats,
    average_planes,
    level_of,
    padded,
)


@dataclass(frozen=True)
class Whole:
    """Numbers of the whole frame that its tiles need: exposure, the median depth, samples.

    ``guess``: `samples.seeming_samples`.
    """

    exposure: float
    depth: float
    spp: float | None
    guess: float | None = None

    @classmethod
    def of(cls, frame: Frame) -> Whole:
        """Measured on a frame."""
        factor = block_exposure(frame.colour)
        guess = seeming_samples(frame, factor)
        return cls(factor, typical_depth(frame), float(frame.spp) if frame.spp else None, guess)


@dataclass(frozen=True, eq=False)
class Given:
    """The layers of a frame that the network reads, as flat arrays, ``(H·W·C,)``."""

    height: int
    width: int
    arrays: dict[str, tuple[FloatImage, int]]

    @classmethod
    def of(cls, frame: Frame) -> Given:
        """Those that the frame has."""
        found: dict[str, FloatImage | None] = {
            "colour": frame.colour,
            "albedo": albedo_of(frame),
            "normal": frame.get(Role.NORMAL),
            "depth": frame.get(Role.DEPTH),
            "roughness": frame.get(Role.ROUGHNESS),
        }
        for name, role in (
            ("colour", Role.COLOUR),
            ("albedo", Role.ALBEDO),
            ("normal", Role.NORMAL),
            ("depth", Role.DEPTH),
        ):
            if found[name] is not None:
                found[f"{name}_std"] = variance_of(frame, role)
        arrays = {
            name: (np.ascontiguousarray(image, np.float32).reshape(-1), image.shape[2])
            for name, image in found.items()
            if image is not None
        }
        return cls(frame.height, frame.width, arrays)

    def has(self, name: str) -> bool:
        """Whether there is that layer."""
        return name in self.arrays

    def divisor(self) -> FloatImage | None:
        """What colours are divided by before it is averaged ``(H, W, 3)``; None without albedo."""
        if not self.has("albedo"):
            return None
        array, channels = self.arrays["albedo"]
        albedo = array.reshape(self.height, self.width, channels)[:, :, :3]
        return np.asarray(divisor(np, np.nan_to_num(albedo, nan=0, posinf=0, neginf=0)), np.float32)

    def masks(self, spp: float | None, guess: float | None) -> Signals:
        """Signals without pixels: what `inputs.constants` looks at."""
        return Signals(None, {name: None for name in LAYERS if name in self.arrays}, spp, guess)


def packed_shape(given: Given) -> tuple[int, int, int, int]:
    """``(1, CHANNELS, H/2, W/2)``, H and W padded to multiples of 32."""
    return (1, CHANNELS, padded(given.height) // 2, padded(given.width) // 2)


def packed_memory(shape: tuple[int, ...], step: float | None = None) -> NDArray[Any]:
    """Zeros of that shape: float32, or int8 where there is a step."""
    if step is None:
        return aligned(shape)
    count = int(np.prod(shape))
    return aligned((-(-count // 4),)).view(np.int8)[:count].reshape(shape)


def packed_inputs(
    given: Given,
    whole: Whole,
    preference: float,
    device: str,
    out: NDArray[Any] | None = None,
    only_known: bool = False,
    step: float | None = None,
) -> NDArray[Any]:
    """The network's input, of `packed_shape`; written into ``out`` where that is given.

    ``only_known``: the planes of layers that there are not are 0 already. ``step``: as whole
    numbers of such steps, int8, for a network whose input is rounded so.
    """
    module = backend(device)
    import drjit as dr  # after `backend`, which says where LLVM is

    height, width = padded(given.height) // 2, padded(given.width) // 2
    count = height * width
    shape = packed_shape(given)
    memory = out if out is not None else packed_memory(shape, step)
    kind = module.Float if step is None else module.Int8
    target = kind(memory.reshape(-1))
    per_step = dr.opaque(module.Float, 1 / step if step else 1)
    index = dr.arange(module.UInt32, count)
    columns = dr.opaque(module.UInt32, width)
    row, column = index // columns, index % columns
    scale = dr.opaque(module.Float, whole.exposure)
    depth_scale = dr.opaque(module.Float, 1 / whole.depth)
    arrays = {name: (module.Float(array), n) for name, (array, n) in given.arrays.items()}
    last_row = dr.opaque(module.UInt32, given.height - 1)
    last_column = dr.opaque(module.UInt32, given.width - 1)
    stride = dr.opaque(module.UInt32, given.width)
    size = dr.opaque(module.UInt32, count)

    def mirrored(place: Any, last: Any) -> Any:
        # 0 … last, last, last - 1, …; the first again where a frame is smaller than what it lacks
        beyond = dr.minimum(place - dr.minimum(place, last + 1), last)
        return dr.select(place > last, last - beyond, place)

    for number in range(4):
        y, x = divmod(number, 2)
        pixel = mirrored(2 * row + y, last_row) * stride + mirrored(2 * column + x, last_column)

        def read(name: str, at: Any = pixel) -> list[Any]:
            array, channels = arrays[name]
            values = [dr.gather(module.Float, array, at * channels + c) for c in range(channels)]
            return [dr.select(dr.isfinite(v), v, 0) for v in values]

        planes = _planes(dr, module, given, read, scale, depth_scale)
        for k, value in enumerate(planes):
            if value is not None or not only_known:
                plane = index + size * (4 * k + number)
                value = module.Float(0) if value is None else value
                if step is not None:
                    value = kind(module.Int32(dr.round(dr.clip(value * per_step, -128, 127))))
                dr.scatter(target, value, plane)
    dr.eval(target)
    dr.sync_thread()
    result = target.numpy().reshape(shape)
    numbers = constants(given.masks(whole.spp, whole.guess), preference)
    if step is not None:
        numbers = np.rint(np.clip(numbers / step, -128, 127))
    result[0, 4 * PLANES :] = numbers[:, None, None]
    assert result.shape[1] == 4 * PLANES + CONSTANTS
    return result


def _planes(
    dr: Any, module: Any, given: Given, read: Any, scale: Any, depth_scale: Any
) -> list[Any]:
    """The planes of `inputs.encode` at one pixel; None: 0, for want of the layer."""

    def curve(v: Any) -> Any:
        return dr.log(1 + SLOPE * dr.maximum(v, 0)) * (1 / RANGE)

    def spread(values: list[Any]) -> Any:
        return dr.sqrt(sum(values[1:], values[0]) / len(values))

    albedo = None
    d = [module.Float(1)] * 3
    if given.has("albedo"):
        albedo = [dr.clip(v, 0, 2) for v in read("albedo")]
        d = [a + OFFSET for a in albedo]
    found = [curve(c * scale / v) for c, v in zip(read("colour"), d, strict=True)]
    found += albedo or [None] * 3
    found += [dr.clip(v, -1, 1) for v in read("normal")[:3]] if given.has("normal") else [None] * 3
    z = None
    if given.has("depth"):
        z, miss = _depth(dr, read("depth")[0])
        relative = dr.clip(dr.log(z * depth_scale) * (1 / DEPTH_RANGE), -1, 1)
        found.append(dr.select(miss, 1, relative))
    else:
        found.append(None)
    found.append(dr.clip(read("roughness")[0], -1, 1) if given.has("roughness") else None)
    if given.has("colour_std"):
        found.append(curve(spread(read("colour_std")) * scale / ((d[0] + d[1] + d[2]) / 3)))
    else:
        found.append(None)
    for name in ("albedo_std", "normal_std"):
        found.append(dr.sqrt(dr.clip(spread(read(name)), 0, 1)) if given.has(name) else None)
    if given.has("depth_std") and z is not None:
        found.append(dr.sqrt(dr.clip(dr.sqrt(read("depth_std")[0]) / z, 0, 1)))
    else:
        found.append(None)
    found += [None] * 3  # history
    return found


def _depth(dr: Any, value: Any) -> tuple[Any, Any]:
    """The distance (1 for a miss), and whether it is a miss: `frame.misses.missing_depth`."""
    z = dr.abs(value)
    miss = (z == 0) | (z >= FAR)
    for one in INFO[Role.DEPTH].misses:
        if one < FAR:
            miss |= z == one
    return dr.select(miss, 1, z), miss


# --------------------------------------------------------------- the filter's ends


def divisors(
    given: Given, logits: Logits, device: str, workspace: Workspace | None = None
) -> Level | None:
    """The albedo plus `OFFSET` in three planes, averaged by its kernels; None without an albedo.

    ``logits`` ``(36, H/2, W/2)``: see `kernels.pyramid.average_planes`, as long as whose result
    this lives. The planes before are where `split` writes, so that is for later.
    """
    if not given.has("albedo"):
        return None
    module = backend(device)
    import drjit as dr  # after `backend`, which says where LLVM is

    level = level_of(3, given.height, given.width, workspace)
    array, channels = given.arrays["albedo"]
    flat = module.Float(array)
    index = dr.arange(module.UInt32, given.height * given.width)
    values = [dr.gather(module.Float, flat, index * channels + c) for c in range(3)]
    target = module.Float(level.memory.reshape(-1))
    place = _places(dr, module, given, level, index)
    _, rows, stride = level.memory.shape
    step = dr.opaque(module.UInt32, rows * stride)
    for c, value in enumerate(values):
        own = dr.clip(dr.select(dr.isfinite(value), value, 0), 0, 2) + OFFSET
        dr.scatter(target, own, place + step * c)
    dr.eval(target)
    dr.sync_thread()
    _stored(level, target)
    return average_planes(logits, level, device, workspace)


def split(
    given: Given,
    images: Sequence[FloatImage],
    divided: Sequence[bool],
    d: Level | None,
    device: str,
    workspace: Workspace | None = None,
) -> Level:
    """Images ``(H, W, 1 or 3)`` as planes for the filter.

    Where ``divided``, an image gives its planes divided by those of ``d``, then its own; else only
    its own. Without ``d`` nothing is divided. What is not finite counts as 0.
    """
    module = backend(device)
    import drjit as dr  # after `backend`, which says where LLVM is

    height, width = given.height, given.width
    counts = [
        image.shape[2] * (2 if own and d is not None else 1)
        for image, own in zip(images, divided, strict=True)
    ]
    level = level_of(sum(counts), height, width, workspace)
    _, rows, stride = level.memory.shape
    target = module.Float(level.memory.reshape(-1))
    index = dr.arange(module.UInt32, height * width)
    place = _places(dr, module, given, level, index)
    step = dr.opaque(module.UInt32, rows * stride)
    by = _read(dr, module, d, place) if d is not None else None
    plane = 0
    for image, wanted in zip(images, divided, strict=True):
        channels = image.shape[2]
        flat = module.Float(np.ascontiguousarray(image, np.float32).reshape(-1))
        values = [dr.gather(module.Float, flat, index * channels + c) for c in range(channels)]
        values = [dr.select(dr.isfinite(v), v, 0) for v in values]  # or it would spread
        if wanted and by is not None:
            for c, value in enumerate(values):
                own = by[c] if channels == 3 else (by[0] + by[1] + by[2]) / 3
                dr.scatter(target, value / own, place + step * plane)
                plane += 1
        for value in values:
            dr.scatter(target, value, place + step * plane)
            plane += 1
    dr.eval(target)
    dr.sync_thread()
    _stored(level, target)
    return level


def merged(
    given: Given,
    level: Level,
    gate: Logits,
    channels: Sequence[int],
    divided: Sequence[bool],
    d: Level | None,
    device: str,
) -> list[FloatImage]:
    """The images out of the filtered planes: g · d · F(c / d) + (1 - g) · F(c).

    ``gate``: the gate's logits ``(4, H/2, W/2)``, packed; ``channels`` of each image.
    """
    module = backend(device)
    import drjit as dr  # after `backend`, which says where LLVM is

    height, width = given.height, given.width
    _, rows, stride = level.memory.shape
    source = module.Float(level.memory.reshape(-1))
    index = dr.arange(module.UInt32, height * width)
    columns = dr.opaque(module.UInt32, width)
    row, column = index // columns, index % columns
    place = _places(dr, module, given, level, index)
    step = dr.opaque(module.UInt32, rows * stride)
    by, g = None, None
    if d is not None and any(divided):
        by = _read(dr, module, d, place)
        cells = dr.opaque(module.UInt32, gate.shape[1] * gate.shape[2])
        at = ((row & 1) * 2 + (column & 1)) * cells
        at += (row >> 1) * dr.opaque(module.UInt32, gate.shape[2]) + (column >> 1)
        flat = module.Float(as_floats(gate).reshape(-1))
        logit = dr.gather(module.Float, flat, at)
        g = 1 / (1 + dr.exp(-logit))
    plane = 0
    results, outs = [], []
    for count, wanted in zip(channels, divided, strict=True):
        memory = aligned((height * width * count,))
        out = module.Float(memory)
        values = [
            dr.gather(module.Float, source, place + step * (plane + c))
            for c in range(count * (2 if wanted and by is not None else 1))
        ]
        plane += len(values)
        if wanted and by is not None and g is not None:
            for c in range(count):
                own = by[c] if count == 3 else (by[0] + by[1] + by[2]) / 3
                value = dr.fma(g, own * values[c] - values[count + c], values[count + c])
                dr.scatter(out, value, index * count + c)
        else:
            for c in range(count):
                dr.scatter(out, values[c], index * count + c)
        outs.append((out, count))
    dr.eval(*(out for out, _ in outs))
    dr.sync_thread()
    for out, count in outs:
        results.append(out.numpy().reshape(height, width, count))
    return results


def _places(dr: Any, module: Any, given: Given, level: Level, index: Any) -> Any:
    """Where a level's first plane has the pixels of the frame."""
    columns = dr.opaque(module.UInt32, given.width)
    stride = dr.opaque(module.UInt32, level.memory.shape[2])
    return index // columns * stride + index % columns + dr.opaque(module.UInt32, level.start)


def _read(dr: Any, module: Any, level: Level, place: Any) -> list[Any]:
    """The divisor's planes there.

    An average of what is at least `OFFSET` is so, too, but for a pixel whose weights are all 0.
    """
    _, rows, stride = level.memory.shape
    source = module.Float(level.memory.reshape(-1))
    step = dr.opaque(module.UInt32, rows * stride)
    planes = [dr.gather(module.Float, source, place + step * c) for c in range(3)]
    return [dr.maximum(plane, OFFSET) for plane in planes]


def _stored(level: Level, target: Any) -> None:
    """What was written to ``target`` is in the level, on a device with its own memory too."""
    if target.numpy().ctypes.data != level.memory.ctypes.data:
        level.memory[...] = target.numpy().reshape(level.memory.shape)
