"""Radiance packed small enough for a web page, and good enough for twelve stops of exposure.

Eight bits cannot hold a picture whose exposure is to be turned by ±6 stops, and lossless radiance
of a noisy frame weighs megabytes. So the page brings its own small codec (decoded in
``page/codec.js``, which must agree with `unpack_radiance` here):

1. x = radiance · exposure, negative values to 0; L = log2(1 + 4096 x), linear near black.
2. Y = (R + 2G + B) / 4, Co = R - B, Cg = G - (R + B) / 2 of the L values.
3. A 5/3 wavelet (D. Le Gall, A. Tabatabai, "Sub-band coding of digital images using symmetric short
   kernel filters and arithmetic coding techniques", 1988), `LEVELS` levels, by lifting in floats.
4. Uniform quantisation with a dead zone. A step is halved with each coarser level: fine grain is
   kept to a tenth of a stop or so, smooth gradients to about a hundredth, and a dark gradient at
   +6 stops shows no bands.
5. Bands one after the other, zigzag 16-bit integers as a plane of low bytes and one of high
   bytes, zlib.

Error maps take steps 3 to 5 on one channel that is already in [0, 1]. Numbers in the page's tables
never come from decoded pictures; they are computed from the originals.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.metrics.pair import FloatArray

#: L = log2(1 + TOE x): values below 1 / TOE of display white are near linear.
TOE = 4096.0

#: Halvings of the size by the wavelet.
LEVELS = 5

#: Steps at the finest level, in L (stops) for luma and chroma, and the finest step of all.
LUMA_STEP = 0.14
CHROMA_STEP = 0.36
SMALLEST_STEP = 0.012

#: Steps for maps in [0, 1].
MAP_STEP = 0.06
SMALLEST_MAP_STEP = 0.006

#: Part of a step by which rounding prefers zero.
DEAD_ZONE = 0.12


@dataclass(frozen=True)
class Packed:
    """An encoded picture. ``steps``: for each channel the step of each level, finest first."""

    width: int
    height: int
    steps: tuple[tuple[float, ...], ...]
    payload: bytes

    def as_dict(self) -> dict[str, Any]:
        """What the page's decoder reads."""
        return {
            "w": self.width,
            "h": self.height,
            "steps": self.steps,
            "data": base64.b64encode(self.payload).decode("ascii"),
        }


def pack_radiance(image: NDArray[Any], exposure: float) -> Packed:
    """``(H, W, 3)`` linear radiance to a packed picture; what is not finite becomes black."""
    sound = np.where(np.isfinite(image), image, 0).astype(np.float32)
    x = np.maximum(sound * np.float32(exposure), 0)
    r, g, b = np.moveaxis(np.log2(1 + np.float32(TOE) * np.minimum(x, 1e5)), 2, 0)
    channels = [(r + 2 * g + b) / 4, r - b, g - (r + b) / 2]
    steps = [_steps(s, SMALLEST_STEP) for s in (LUMA_STEP, CHROMA_STEP, CHROMA_STEP)]
    return _pack(channels, steps)


def pack_map(values: NDArray[Any]) -> Packed:
    """``(H, W)`` values in [0, 1] to a packed picture."""
    return _pack([np.clip(values, 0, 1).astype(np.float32)], [_steps(MAP_STEP, SMALLEST_MAP_STEP)])


def unpack_radiance(packed: Packed) -> FloatArray:
    """The twin of the page's decoder: ``(H, W, 3)`` radiance times exposure."""
    y, co, cg = _unpack(packed)
    side = y - cg / 2
    logs = np.stack([side + co / 2, y + cg / 2, side - co / 2], axis=2)
    return np.asarray((np.exp2(np.maximum(logs, 0)) - 1) / TOE, np.float32)


def unpack_map(packed: Packed) -> FloatArray:
    """The twin of the page's decoder for maps: ``(H, W)`` in [0, 1]."""
    return np.asarray(np.clip(_unpack(packed)[0], 0, 1), np.float32)


# ------------------------------------------------------------------ private


def _steps(finest: float, smallest: float) -> tuple[float, ...]:
    return tuple(max(finest / 2**level, smallest) for level in range(LEVELS + 1))


def _pack(channels: list[FloatArray], steps: list[tuple[float, ...]]) -> Packed:
    height, width = channels[0].shape
    values = []
    for channel, step in zip(channels, steps, strict=True):
        bands = _forward(channel)
        for level, band in bands:
            q = np.abs(band) / np.float32(step[level])
            q = np.floor(q + (0.5 if level == LEVELS else 0.5 - DEAD_ZONE)) * np.sign(band)
            values.append(np.clip(q, -32767, 32767).astype(np.int32).ravel())
    flat = np.concatenate(values)
    zigzag = np.where(flat < 0, -2 * flat - 1, 2 * flat).astype(np.uint16)
    planes = (zigzag & 255).astype(np.uint8).tobytes() + (zigzag >> 8).astype(np.uint8).tobytes()
    # Run-length matching only: as small as the full search on such data, and 20 times faster.
    squeeze = zlib.compressobj(9, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_RLE)
    return Packed(width, height, tuple(steps), squeeze.compress(planes) + squeeze.flush())


def _unpack(packed: Packed) -> list[FloatArray]:
    raw = np.frombuffer(zlib.decompress(packed.payload), np.uint8)
    half = raw.size // 2
    zigzag = raw[:half].astype(np.int32) | (raw[half:].astype(np.int32) << 8)
    flat = np.where(zigzag & 1, -((zigzag + 1) >> 1), zigzag >> 1).astype(np.float32)
    count = packed.width * packed.height
    return [
        _inverse(flat[i * count : (i + 1) * count], packed.width, packed.height, step)
        for i, step in enumerate(packed.steps)
    ]


def _forward(image: FloatArray) -> list[tuple[int, FloatArray]]:
    """The bands of a channel with the index of their level: LL, then coarse to fine."""
    bands: list[tuple[int, FloatArray]] = []
    low = image
    for level in range(LEVELS):
        left, right = _split(low, 1)
        low, below = _split(left, 0)
        above, corner = _split(right, 0)
        bands += [(level, corner), (level, below), (level, above)]
    bands.append((LEVELS, low))
    return bands[::-1]


def _inverse(flat: FloatArray, width: int, height: int, steps: tuple[float, ...]) -> FloatArray:
    sizes = [(height, width)]
    for _ in range(LEVELS):
        h, w = sizes[-1]
        sizes.append(((h + 1) // 2, (w + 1) // 2))
    at = 0

    def take(h: int, w: int, step: float) -> FloatArray:
        nonlocal at
        band = flat[at : at + h * w].reshape(h, w) * np.float32(step)
        at += h * w
        return band

    low = take(*sizes[LEVELS], steps[LEVELS])
    for level in range(LEVELS - 1, -1, -1):
        h, w = sizes[level]
        hl, wl = sizes[level + 1]
        above = take(hl, w - wl, steps[level])
        below = take(h - hl, wl, steps[level])
        corner = take(h - hl, w - wl, steps[level])
        low = _join(_join(low, below, 0), _join(above, corner, 0), 1)
    return low


def _split(image: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """Low and high half along an axis. Beyond the border a picture goes on as it ended."""
    x = np.moveaxis(image, axis, 0)
    even, odd = x[0::2].copy(), x[1::2].copy()
    n, m = len(even), len(odd)
    if m:
        odd -= (even[:m] + _next(even)[:m]) / 2
        i = np.arange(n)
        even += (odd[np.maximum(i - 1, 0)] + odd[np.minimum(i, m - 1)]) / 4
    return np.moveaxis(even, 0, axis), np.moveaxis(odd, 0, axis)


def _join(low: FloatArray, high: FloatArray, axis: int) -> FloatArray:
    """The inverse of `_split`."""
    even, odd = np.moveaxis(low, axis, 0).copy(), np.moveaxis(high, axis, 0).copy()
    n, m = len(even), len(odd)
    if m:
        i = np.arange(n)
        even -= (odd[np.maximum(i - 1, 0)] + odd[np.minimum(i, m - 1)]) / 4
        odd += (even[:m] + _next(even)[:m]) / 2
    x = np.empty((n + m, *even.shape[1:]), np.float32)
    x[0::2], x[1::2] = even, odd
    return np.moveaxis(x, 0, axis)


def _next(even: FloatArray) -> FloatArray:
    """The even samples one further on; the one behind the border lies on a straight line."""
    last = 2 * even[-1:] - even[-2:-1] if len(even) > 1 else even
    return np.concatenate([even[1:], last])
