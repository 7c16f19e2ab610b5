"""Where coverage (alpha) is noisy, measured so that its structure does not count as noise.

A soft edge is no noise, however wide: the fog of depth of field, the ramp of a pixel filter and the
penumbra of a shadow catcher are smooth once enough samples are taken. What tells structure from
noise is the median of the 3x3 pixels around. Along a straight edge coverage is a function of the
distance to it, f(n·p - d), which rises all the way under any pixel filter without negative lobes;
as many of the nine pixels lie on one side of the middle one as on the other, so it *is* the median:

    r = a - median of 3x3 around a

is exactly 0 on edges at every angle, on ramps and on constants, and close to 0 on curves. In
independent noise the pixel in the middle is the median once in nine times.

Medians also remove thin lines and corners, so that a pixel with |r| above a tenth of the range of
its 3x3 pixels is no noise where

- three or more of its eight neighbours agree with it (corners, aliased lines),
- a polynomial of second degree holds the nine values (peaks and saddles of fog), or
- the sums over the three columns (or rows, or diagonals) are equal: a line leaves the same coverage
  in each of them, however its pixels share it.

What remains is counted as a share of the pixels that differ from their neighbours, over 25x25
pixels. Measured (`tests/denoise/test_coverage.py`): edges and circles 0, polygons of a few pixels
0.1, a few hairs 0.2 at most; noise of 4 samples a pixel and more 0.35 to 0.65. With few samples
coverage has few values, neighbours agree by chance, and less is enough (`SHARES`). Two limits: fur
in which every hair crosses others passes for noise, and noise that is small beside a steep ramp
(64 samples, six pixels wide) for structure.

Where a file has the variance of alpha, or two halves, the noise is known: a deviation above 0.15 of
the range counts, and half of the pixels must have it.

Pixels whose 5x5 neighbourhood is exactly 0, or exactly 1, are never noisy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lambent.filters.features import variance_of
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role

Mask = NDArray[np.bool_]

#: A difference from the median below this share of the 3x3 range, or below `FLOOR`, is no noise.
TOLERANCE, FLOOR = 0.1, 0.005
#: Neighbours agree with a pixel within this share of the range; so many of them make a structure.
AGREE, AGREEING = 0.12, 3
#: Columns of a line hold the same coverage within this share of the range.
LINE = 0.15
#: Third and fourth differences below this share of the range are those of a smooth image.
SMOOTH = 0.07
#: Which share of unexplained pixels is noise, where coverage has at most so many values.
SHARES = ((2, 0.05), (5, 0.1), (17, 0.22), (1 << 62, 0.3))
#: Standard deviation over range above which measured noise counts, and the share of such pixels.
MEASURED, MEASURED_SHARE = 0.15, 0.5
#: Radius of the window for shares; pixels needed in it; how far noise reaches beyond its seeds.
RADIUS, ENOUGH, REACH = 12, 30, 6
#: Radius in which coverage that is exactly 0 or 1 stays so.
EXACT = 2
#: Rows looked at together, which bounds the memory.
ROWS = 256


def noisy_coverage(frame: Frame) -> Mask:
    """Where the alpha of a frame is noisy ``(H, W)``; nowhere if it has none.

    Look at the whole frame, not at its tiles.
    """
    alpha = frame.get(Role.ALPHA)
    if alpha is None or alpha.size == 0 or float(np.ptp(alpha)) == 0:
        return np.zeros((frame.height, frame.width), bool)
    a = np.ascontiguousarray(alpha[..., 0])
    variance = variance_of(frame, Role.ALPHA)
    differing, noisy = np.zeros(a.shape, bool), np.zeros(a.shape, bool)
    for top in range(0, len(a), ROWS):
        rows = slice(max(0, top - 2), min(len(a), top + ROWS + 2))
        here = slice(top - rows.start, min(len(a), top + ROWS) - rows.start)
        spread = None if variance is None else variance[rows, :, 0]
        for whole, part in zip((differing, noisy), _marked(a[rows], spread), strict=True):
            whole[top : top + ROWS] = part[here]
    if not noisy.any():
        return noisy
    if variance is None:
        values = len(np.unique(a[differing]))
        enough = next(share for most, share in SHARES if values <= most)
    else:
        enough = MEASURED_SHARE
    count = box_count(differing, RADIUS)
    share = box_count(noisy, RADIUS) / np.maximum(count, 1)
    seeds = (share > enough) & (count >= min(ENOUGH, a.size // 2))
    near = (box_count(seeds, REACH) > 0) & (share > 0.6 * enough)
    return np.asarray((seeds | near) & ~exact(alpha))


def exact(alpha: FloatImage) -> Mask:
    """Where alpha ``(H, W, 1)`` is exactly 0, or exactly 1, in all of 5x5 pixels ``(H, W)``."""
    a = alpha[..., 0]
    whole = box_count(np.ones(a.shape, bool), EXACT)
    found = [box_count(a == value, EXACT) == whole for value in (0, 1)]
    return np.asarray(found[0] | found[1])


def box_count(mask: Mask, radius: int) -> NDArray[np.int32]:
    """How many pixels are set within ``radius`` rows and columns; none lies outside the picture."""
    total = np.pad(mask.astype(np.int32), ((radius + 1, radius), (radius + 1, radius)))
    side = 2 * radius + 1
    total = total.cumsum(0, dtype=np.int32)
    total = total[side:] - total[:-side]
    total = total.cumsum(1, dtype=np.int32)
    return np.asarray(total[:, side:] - total[:, :-side])


# ------------------------------------------------------------------- private

#: Smith's network: pairs to exchange so that the middle of nine is their median.
_MEDIAN = (
    (1, 2), (4, 5), (7, 8), (0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (0, 3),
    (5, 8), (4, 7), (3, 6), (1, 4), (2, 5), (4, 7), (4, 2), (6, 4), (4, 2),
)  # fmt: skip


def _marked(a: FloatImage, variance: FloatImage | None) -> tuple[Mask, Mask]:
    """Pixels of ``(H, W)`` that differ from their neighbours, and those of them that are noisy."""
    height, width = a.shape
    padded = np.pad(a, 2, mode="edge")
    at = {
        (i, j): padded[2 + i : 2 + i + height, 2 + j : 2 + j + width]
        for i in range(-2, 3)
        for j in range(-2, 3)
    }
    around = [at[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)]
    low, high = around[0].copy(), around[0].copy()
    for image in around[1:]:
        np.minimum(low, image, out=low)
        np.maximum(high, image, out=high)
    extent = high - low
    differing = extent > 2 * FLOOR
    if not differing.any():
        return differing, differing
    if variance is not None:
        return differing, differing & (np.sqrt(_mean_3x3(variance)) > MEASURED * extent)
    noisy = differing & (np.abs(a - _median(around)) > np.maximum(TOLERANCE * extent, FLOOR))
    agreeing = np.full(a.shape, -1, np.int8)  # the pixel agrees with itself
    for image in around:
        agreeing += np.abs(image - a) <= AGREE * extent
    noisy &= agreeing < AGREEING
    noisy &= _roughness(at) > SMOOTH * extent
    for lean in (-1, 0, 1):
        for down in (True, False):
            sums = [
                sum(at[(lean * k + i, k) if down else (k, lean * k + i)] for i in (-1, 0, 1))
                for k in (-1, 0, 1)
            ]
            noisy &= np.ptp(np.stack(sums), axis=0) > LINE * extent
    return differing, noisy


def _roughness(at: dict[tuple[int, int], FloatImage]) -> FloatImage:
    """What no polynomial of second degree holds of 3x3 pixels, as a deviation of their noise."""
    second = {k: at[k, -1] - 2 * at[k, 0] + at[k, 1] for k in (-1, 0, 1)}
    slope = {k: at[k, 1] - at[k, -1] for k in (-1, 0, 1)}
    both = np.abs(second[-1] - 2 * second[0] + second[1]) / 6  # √36, the weights' square sum
    across = np.abs(second[1] - second[-1]) / np.float32(12**0.5)
    down = np.abs(slope[-1] - 2 * slope[0] + slope[1]) / np.float32(12**0.5)
    return np.asarray(np.maximum(both, np.maximum(across, down)))


def _median(around: list[FloatImage]) -> FloatImage:
    found = list(around)
    for i, j in _MEDIAN:
        found[i], found[j] = np.minimum(found[i], found[j]), np.maximum(found[i], found[j])
    return found[4]


def _mean_3x3(image: FloatImage) -> FloatImage:
    padded = np.pad(image, 1, mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9)
