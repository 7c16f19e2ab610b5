"""Applying predicted kernels on a pyramid of images: the filter of Lambent's own network.

The equations, the papers and the training form are in `lambent.learn.networks.kernel_pyramid`:
softmax weights of 5x5 pixels of a level and 3x3 of the coarser one, and one logit a pixel for the
way down. Here they run on a whole frame, for any number of channels at once; all get the same
weights. Pixels outside the frame never get any.

`average_planes` is a single average in 3x3 pixels, without a pyramid, which the albedo gets.

Two forms: `filter_planes` compiles loops of its own (`kernels.machine`), in which the weights of a
few pixels are made once and stay in the first cache for all channels; `reference` is the same in
NumPy, for machines without LLVM, and the one reference of the filter: the loops are tested against
it, PyTorch's form against the loops, and Triton's against PyTorch's.

Logits come as the network gives them, channels first: ``logits[0]`` ``(4·K, H/2, W/2)`` with
channel 4 k + 2 y + x for the pixels (2 i + y, 2 j + x), then ``(K, H/2, W/2)``, and so on; K is 35
and more (what follows is ignored), 25 on the coarsest level. H and W are multiples of 32; the frame
itself may be smaller (``height``, ``width``). They are float32, or bfloat16 as the upper halves of
float32 in uint16: half the memory to go through, and exact enough for weights.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.kernels.arrays import FloatImage, aligned
from lambent.kernels.exponential import LEAST
from lambent.kernels.machine import LANES, Code, Kernel, available

#: Taps of a level's own window (5x5), and of the coarser level's (3x3).
OWN, COARSE = 25, 9
#: Taps of `average_planes` (3x3).
NEAR = 9
#: float32, or the upper halves of float32 in uint16.
Logits = NDArray[Any]
#: Keeps a division by no weight finite; nothing beside the least weight (`exponential.LEAST`).
TINY = 1e-37
#: Empty columns left and right of a plane, and rows above and below.
_LEFT, _RIGHT, _ROWS = LANES, 3 * LANES, 2


@dataclass(frozen=True, eq=False)
class Level:
    """An image as planes with empty surroundings; the first plane is 1 where there is a pixel.

    ``memory`` ``(1 + C, rows, stride)``; `mask` and `planes` are the parts that hold the image.
    """

    memory: FloatImage
    height: int
    width: int

    @property
    def channels(self) -> int:
        """Planes without the mask."""
        return len(self.memory) - 1

    @classmethod
    def empty(cls, channels: int, height: int, width: int) -> Level:
        """All zero. ``channels`` without the mask."""
        stride = -(-width // LANES) * LANES + _LEFT + _RIGHT
        return cls(aligned((channels + 1, height + 2 * _ROWS, stride)), height, width)

    @property
    def planes(self) -> FloatImage:
        """``(C, height, width)``, a view."""
        rows, columns = self._inside
        return self.memory[1:, rows, columns]

    @property
    def mask(self) -> FloatImage:
        """``(height, width)``, a view."""
        rows, columns = self._inside
        return self.memory[0, rows, columns]

    @property
    def start(self) -> int:
        """Floats from the first of the memory to pixel (0, 0) of the first plane."""
        _, rows, stride = self.memory.shape
        return (rows + _ROWS) * stride + _LEFT

    @property
    def _inside(self) -> tuple[slice, slice]:
        return slice(_ROWS, _ROWS + self.height), slice(_LEFT, _LEFT + self.width)

    @property
    def params(self) -> list[int | np.ndarray]:
        """For kernels: the address of the planes' pixel (0, 0), floats from row to row and from
        plane to plane, the number of planes.
        """
        _, rows, stride = self.memory.shape
        start = self.memory.reshape(-1)[self.start :]
        return [start, stride, rows * stride, self.channels]


class Workspace:
    """Levels that are used again from frame to frame: fresh memory costs as much as filtering it.

    For one user at a time. The surroundings of a level stay 0, since kernels write 0 there.
    """

    def __init__(self) -> None:
        self._levels: dict[str, tuple[tuple[int, ...], Level]] = {}

    def level(self, name: str, channels: int, height: int, width: int, *more: int) -> Level:
        """The level of that name, if its size (and ``more``) is what it was; else a new one.

        A level with more channels than are wanted gives its first.
        """
        key = (height, width, *more)
        known = self._levels.get(name)
        if known is None or known[0] != key or known[1].channels < channels:
            self._levels.pop(name, None)  # let go first
            known = (key, Level.empty(channels, height, width))
            self._levels[name] = known
        return Level(known[1].memory[: channels + 1], height, width)


def padded(size: int) -> int:
    """The least multiple of 32 from ``size`` on: what the network works on."""
    return -(-size // 32) * 32


def level_of(channels: int, height: int, width: int, workspace: Workspace | None = None) -> Level:
    """The finest level of a frame of ``height`` x ``width``, its mask set, 0 around the frame.

    ``channels`` is rounded up to a multiple of 3. Its pixels are to be written.
    """
    space = workspace or Workspace()
    count = -(-channels // 3) * 3
    level = space.level("in", count, padded(height), padded(width), height, width)
    level.mask[:height, :width] = 1
    return level


def filter_planes(
    logits: Sequence[Logits],
    level: Level,
    device: str = "auto",
    workspace: Workspace | None = None,
) -> Level:
    """The filtered planes of ``level`` (from `level_of`), its mask carried along.

    ``logits`` must have `LANES` floats of memory behind their end (see `logits_memory`). The
    result lives in the workspace, if one is given, until it is used again.
    """
    space = workspace or Workspace()
    if not available(device):
        found = Level.empty(level.channels, level.height, level.width)
        found.planes[...] = reference(logits, level.planes, level.mask)
        found.mask[...] = level.mask
        return found
    levels = [level]
    for number in range(len(logits) - 1):
        levels.append(_down(levels[-1], logits[number], space, number))
    out: Level | None = None
    for number in range(len(logits) - 1, -1, -1):
        out = _gather(levels.pop(), logits[number], out, space, number)
    assert out is not None
    return out


def average_planes(
    logits: Logits, level: Level, device: str = "auto", workspace: Workspace | None = None
) -> Level:
    """The planes of ``level`` averaged in windows of 3x3 alone, without a pyramid.

    ``logits`` ``(36, H/2, W/2)`` in the order of the finest level's of `filter_planes`; the result
    lives as long as that function's.
    """
    space = workspace or Workspace()
    if not available(device):
        found = Level.empty(level.channels, level.height, level.width)
        (z,) = _unpacked([logits])
        found.planes[...] = _averaged(z, level.planes, level.mask, None, None, side=3)
        found.mask[...] = level.mask
        return found
    return _gather(level, logits, None, space, 0, side=3)


def logits_memory(shape: tuple[int, ...], short: bool = False) -> Logits:
    """An array for logits with room behind its end, as kernels that read whole vectors need.

    ``short``: for bfloat16.
    """
    count = int(np.prod(shape))
    if short:
        return aligned((count // 2 + 4 * LANES,)).view(np.uint16)[:count].reshape(shape)
    return aligned((count + 4 * LANES,))[:count].reshape(shape)


def as_floats(logits: Logits) -> FloatImage:
    """Logits as float32."""
    if logits.dtype == np.uint16:
        return (logits.astype(np.uint32) << 16).view(np.float32)
    return np.asarray(logits, np.float32)


def compile_all() -> None:
    """Compile every kernel of the filter now: before they are needed, in another thread."""
    if available():
        for packed in (True, False):
            _down_kernel(packed, True).prepare()
        for packed, coarse, side in (
            (True, False, 3), (True, True, 5), (False, True, 5), (False, False, 5),
        ):  # fmt: skip
            _gather_kernel(packed, coarse, True, side).prepare()


# -------------------------------------------------------------------- kernels


def _down(level: Level, logits: Logits, space: Workspace, number: int) -> Level:
    """The next coarser level, equation (1)."""
    packed, channels = number == 0, level.channels
    coarse = space.level(f"down{number}", channels, level.height // 2, level.width // 2)
    first = 4 * (OWN + COARSE) if packed else OWN + COARSE
    _down_kernel(packed, logits.dtype == np.uint16).rows(
        [
            *level.params,
            *coarse.params,
            logits[first],
            logits.shape[2],
            logits.shape[1] * logits.shape[2],
            coarse.width,
        ],
        0,
        coarse.height,
    )
    return coarse


def _gather(
    level: Level,
    logits: Logits,
    coarse: Level | None,
    space: Workspace,
    number: int,
    side: int = 5,
) -> Level:
    """A level filtered, equations (2) and (3); ``side`` of a level's own window."""
    packed, channels = number == 0, level.channels
    out = space.level(f"out{number}x{side}", channels, level.height, level.width)
    out.memory[0] = level.memory[0]
    above = coarse if coarse is not None else level
    _gather_kernel(packed, coarse is not None, logits.dtype == np.uint16, side).rows(
        [
            *level.params,
            *above.params,
            *out.params,
            logits,
            logits.shape[2],
            logits.shape[1] * logits.shape[2],
            level.width,
        ],
        0,
        level.height,
        scratch=(OWN + COARSE) * 2 * LANES,
    )
    return out


_EVEN, _ODD = range(0, 2 * LANES, 2), range(1, 2 * LANES, 2)
#: Lanes of two vectors woven together: the first 16, the last 16.
_WEAVE = (
    [lane for k in range(LANES // 2) for lane in (k, LANES + k)],
    [lane for k in range(LANES // 2, LANES) for lane in (k, LANES + k)],
)
#: Each lane twice: the lower half, the upper half.
_TWICE = ([k // 2 for k in range(LANES)], [LANES // 2 + k // 2 for k in range(LANES)])


@dataclass(frozen=True)
class _Image:
    """Parameters of a `Level` in a kernel."""

    base: str
    stride: str
    plane: str
    mask: str

    @classmethod
    def of(cls, code: Code, first: int) -> _Image:
        base, stride, plane = code.address(first), code.param(first + 1), code.param(first + 2)
        return cls(base, stride, plane, code.integer("sub", 0, plane))


def _logit(code: Code, short: bool, base: str, *index: str | int) -> str:
    return code.load_short(base, *index) if short else code.load(code.at(base, *index))


@functools.lru_cache(maxsize=4)
def _down_kernel(packed: bool, short: bool) -> Kernel:
    def write(code: Code) -> None:
        fine, coarse = _Image.of(code, 0), _Image.of(code, 4)
        u, stride, plane, width = code.address(8), code.param(9), code.param(10), code.param(11)
        count = code.param(3)

        def split(image: str, at: str) -> list[str]:
            """Two vectors in memory as their even and their odd lanes."""
            a, b = code.load(code.at(image, at)), code.load(code.at(image, at, LANES))
            return [code.shuffle(a, b, _EVEN), code.shuffle(a, b, _ODD)]

        with code.loop("%first", "%last") as row:
            up = code.integer("mul", row.i, 2)
            rows = [code.integer("mul", code.integer("add", up, y), fine.stride) for y in (0, 1)]
            to = code.integer("mul", row.i, coarse.stride)
            with code.loop(0, width, LANES) as x:
                x2 = code.integer("mul", x.i, 2)
                if packed:
                    line = code.integer("add", code.integer("mul", row.i, stride), x.i)
                    logits = [
                        _logit(code, short, u, line, code.integer("mul", plane, k))
                        for k in range(4)
                    ]
                else:
                    logits = []
                    for y in (0, 1):
                        line = code.integer("mul", code.integer("add", up, y), stride)
                        at = code.integer("add", line, x2)
                        a, b = (_logit(code, short, u, at, n) for n in (0, LANES))
                        logits += [code.shuffle(a, b, _EVEN), code.shuffle(a, b, _ODD)]
                highest = logits[0]
                for value in logits[1:]:
                    highest = code.greater(highest, value)
                e = [code.exp(code.op("fsub", value, highest)) for value in logits]
                masks = [
                    m for y in (0, 1) for m in split(fine.base, _sum(code, fine.mask, rows[y], x2))
                ]
                e = [code.op("fmul", a, m) for a, m in zip(e, masks, strict=True)]
                total = code.number(TINY)
                for value in e:
                    total = code.op("fadd", total, value)
                one = code.op("fdiv", code.number(1.0), total)
                e = [code.op("fmul", value, one) for value in e]
                there = masks[0]
                for m in masks[1:]:
                    there = code.greater(there, m)
                target = code.integer("add", to, x.i)
                code.store(there, code.at(coarse.base, coarse.mask, target))
                with code.loop(0, count) as c:
                    offset = code.integer("mul", c.i, fine.plane)
                    mean = code.number(0.0)
                    for y in (0, 1):
                        halves = split(fine.base, _sum(code, offset, rows[y], x2))
                        for k, value in enumerate(halves):
                            mean = code.fma(e[2 * y + k], value, mean)
                    place = code.integer("add", code.integer("mul", c.i, coarse.plane), target)
                    code.store(mean, code.at(coarse.base, place))

    return Kernel(f"pyramid_down_{int(packed)}{int(short)}", write, effort=0)


@functools.lru_cache(maxsize=16)
def _gather_kernel(packed: bool, with_coarse: bool, short: bool, side: int) -> Kernel:
    own_taps, reach = side * side, side // 2
    taps = own_taps + (COARSE if with_coarse else 0)
    parts = 2 if packed else 1
    step = parts * LANES

    def write(code: Code) -> None:
        own, above, out = (_Image.of(code, first) for first in (0, 4, 8))
        w, stride, plane, width = code.address(12), code.param(13), code.param(14), code.param(15)
        count = code.param(3)

        def weight(k: int, part: int) -> str:
            return code.at("%scratch", step * k + LANES * part)

        with code.loop("%first", "%last") as row:
            half = code.integer("lshr", row.i, 1)
            parity = code.integer("and", row.i, 1)
            lines = [
                code.integer("mul", code.integer("add", row.i, dy), own.stride)
                for dy in range(-reach, reach + 1)
            ]
            lines2 = [
                code.integer("mul", code.integer("add", half, dy), above.stride)
                for dy in range(-1, 2)
            ]
            if packed:
                begin = code.integer("mul", half, stride)
                begin = code.integer(
                    "add", begin, code.integer("mul", code.integer("mul", parity, 2), plane)
                )
            else:
                begin = code.integer("mul", row.i, stride)
            with code.loop(0, width, step) as x:
                x_half = code.integer("lshr", x.i, 1)
                here = code.integer("add", begin, x_half if packed else x.i)

                def logit(k: int, part: int) -> str:
                    number = 4 * k + part if packed else k
                    return _logit(code, short, w, here, code.integer("mul", plane, number))

                highest = [logit(0, part) for part in range(parts)]
                for k in range(1, taps):
                    highest = [code.greater(h, logit(k, p)) for p, h in enumerate(highest)]
                for k in range(taps):
                    e = [code.exp(code.op("fsub", logit(k, p), highest[p])) for p in range(parts)]
                    if packed:  # pixels side by side again
                        e = [code.shuffle(e[0], e[1], lanes) for lanes in _WEAVE]
                    for part in range(parts):
                        code.store(e[part], weight(k, part))

                def averages(planes: Sequence[tuple[str, str]]) -> list[list[str]]:
                    """Σ weight · value for planes at offsets (own, coarse); a list for each."""
                    sums = [[code.number(0.0)] * parts for _ in planes]
                    for k in range(taps):
                        e = [code.load(weight(k, part)) for part in range(parts)]
                        for sum_, (offset, offset2) in zip(sums, planes, strict=True):
                            if k < own_taps:
                                dy, dx = divmod(k, side)
                                at = _sum(code, offset, lines[dy], x.i)
                                values = [
                                    code.load(code.at(own.base, at, LANES * part + dx - reach))
                                    for part in range(parts)
                                ]
                            else:
                                dy, dx = divmod(k - own_taps, 3)
                                at = _sum(code, offset2, lines2[dy], x_half)
                                both = code.load(code.at(above.base, at, dx - 1))
                                values = [
                                    code.shuffle(both, both, _TWICE[part]) for part in range(parts)
                                ]
                            for part in range(parts):
                                sum_[part] = code.fma(e[part], values[part], sum_[part])
                    return sums

                total = averages([(own.mask, above.mask)])[0]
                target = code.integer("add", code.integer("mul", row.i, out.stride), x.i)
                scale = []
                for part in range(parts):
                    at = code.at(out.base, out.mask, target, LANES * part)
                    sure = code.op("fadd", total[part], code.number(TINY))
                    scale.append(code.op("fdiv", code.load(at), sure))
                with code.loop(0, count, 3) as c:
                    numbers = [code.integer("add", c.i, n) for n in range(3)]
                    planes = [
                        (code.integer("mul", n, own.plane), code.integer("mul", n, above.plane))
                        for n in numbers
                    ]
                    for n, sums in zip(numbers, averages(planes), strict=True):
                        place = code.integer("add", code.integer("mul", n, out.plane), target)
                        for part in range(parts):
                            mean = code.op("fmul", sums[part], scale[part])
                            code.store(mean, code.at(out.base, place, LANES * part))

    name = f"pyramid_gather_{int(packed)}{int(with_coarse)}{int(short)}{side}"
    return Kernel(name, write, effort=0)


def _sum(code: Code, *numbers: str) -> str:
    total = numbers[0]
    for number in numbers[1:]:
        total = code.integer("add", total, number)
    return total


# ------------------------------------------------------------------ reference


def reference(logits: Sequence[Logits], image: FloatImage, mask: FloatImage) -> FloatImage:
    """The same in NumPy: ``image`` ``(C, H, W)``, ``mask`` ``(H, W)`` 1 where there is a pixel."""
    planes = _unpacked(logits)
    images, masks = [image], [mask]
    for level in planes[:-1]:
        c, m = images[-1], masks[-1]
        e = _going_down(level, m)
        total = e.sum(axis=(1, 3)) + TINY
        images.append(np.stack([(e * _cells(plane)).sum(axis=(1, 3)) / total for plane in c]))
        masks.append(_cells(m).max(axis=(1, 3)))
    out: FloatImage | None = None
    for number in range(len(planes) - 1, -1, -1):
        below = masks[number + 1] if out is not None else None
        out = _averaged(planes[number], images[number], masks[number], out, below)
    assert out is not None
    return out


def _averaged(
    z: FloatImage,
    c: FloatImage,
    m: FloatImage,
    coarse: FloatImage | None,
    coarse_mask: FloatImage | None,
    side: int = 5,
) -> FloatImage:
    """Equations (2) and (3) of one level: ``z`` ``(K, H, W)``, ``c`` ``(C, H, W)``, masks."""
    own = side * side
    taps = own if coarse is None else own + COARSE
    e = _weights(z[:taps], z[:taps].max(axis=0))
    total, sums = np.zeros_like(m), np.zeros_like(c)
    for k in range(taps):
        if k < own:
            y, x = divmod(k, side)
            value, there = _moved(c, y, x, side // 2), _moved(m[None], y, x, side // 2)
        else:
            assert coarse is not None
            assert coarse_mask is not None
            y, x = divmod(k - own, 3)
            value = _doubled(_moved(coarse, y, x, 1))
            there = _doubled(_moved(coarse_mask[None], y, x, 1))
        total += e[k] * there[0]
        sums += e[k] * value
    return np.asarray(sums / (total + TINY) * m, np.float32)


def weights_at(logits: Sequence[Logits], mask: FloatImage, x: int, y: int) -> FloatImage:
    """The weights ``(H, W)`` of all pixels in the filtered pixel (x, y); ``mask`` as above.

    The filter run backwards: from the pixel down to the coarsest level, what each level's pixels
    count in it, and up again, what each pixel counts in those.
    """
    planes = _unpacked(logits)
    masks = [mask]
    for _ in planes[1:]:
        masks.append(_cells(masks[-1]).max(axis=(1, 3)))
    asked: dict[tuple[int, int], float] = {(y, x): 1.0}
    counts: list[FloatImage] = []
    for number, (level, m) in enumerate(zip(planes, masks, strict=True)):
        last = number == len(planes) - 1
        own, beyond = np.zeros_like(m), dict[tuple[int, int], float]()
        for (py, px), share in asked.items():
            z = level[: OWN if last else OWN + COARSE, py, px]
            taps: list[tuple[bool, int, int, float]] = []
            for k, weight in enumerate(_weights(z, z.max())):
                if k < OWN:
                    at, there = (py + k // 5 - 2, px + k % 5 - 2), m
                else:
                    at = (py // 2 + (k - OWN) // 3 - 1, px // 2 + (k - OWN) % 3 - 1)
                    there = masks[number + 1]
                inside = 0 <= at[0] < there.shape[0] and 0 <= at[1] < there.shape[1]
                if inside and there[at]:
                    taps.append((k < OWN, *at, float(weight)))
            total = sum(weight for *_, weight in taps) + TINY
            for is_own, qy, qx, weight in taps:
                if is_own:
                    own[qy, qx] += share * weight / total
                else:
                    beyond[qy, qx] = beyond.get((qy, qx), 0.0) + share * weight / total
        counts.append(own)
        asked = beyond
    found = counts[-1]
    for number in range(len(planes) - 2, -1, -1):
        e = _going_down(planes[number], masks[number])
        e = e / (e.sum(axis=(1, 3), keepdims=True) + TINY) * found[:, None, :, None]
        found = counts[number] + e.reshape(counts[number].shape)
    return np.asarray(found, np.float32)


def _weights(logits: FloatImage, highest: FloatImage) -> FloatImage:
    return np.exp(np.maximum(logits - highest, np.float32(LEAST)))


def _unpacked(logits: Sequence[Logits]) -> list[FloatImage]:
    """Logits ``(K, H, W)`` of every level, as float32; the finest comes folded."""
    floats = [as_floats(level) for level in logits]
    fine = floats[0]
    count, height, width = fine.shape[0] // 4, fine.shape[1], fine.shape[2]
    fine = fine.reshape(count, 2, 2, height, width).transpose(0, 3, 1, 4, 2)
    return [fine.reshape(count, 2 * height, 2 * width), *floats[1:]]


def _going_down(level: FloatImage, mask: FloatImage) -> FloatImage:
    """What each pixel counts in the one below, ``(H/2, 2, W/2, 2)``, not yet of sum 1."""
    u = _cells(level[OWN + COARSE])
    return np.asarray(_weights(u, u.max(axis=(1, 3), keepdims=True)) * _cells(mask))


def _cells(plane: FloatImage) -> FloatImage:
    return plane.reshape(plane.shape[0] // 2, 2, plane.shape[1] // 2, 2)


def _moved(image: FloatImage, y: int, x: int, radius: int) -> FloatImage:
    padded_image = np.pad(image, ((0, 0), (radius, radius), (radius, radius)))
    return padded_image[:, y : y + image.shape[1], x : x + image.shape[2]]


def _doubled(image: FloatImage) -> FloatImage:
    return image.repeat(2, axis=1).repeat(2, axis=2)
