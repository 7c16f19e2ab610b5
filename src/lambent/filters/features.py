"""The features of a frame as every filter sees them: scaled alike, misses told apart.

========== ============================================== ==========================
role       becomes                                        its variance is divided by
========== ============================================== ==========================
albedo     as it is, reflectance                          1
normal     as it is, components in [-1, 1]                1
roughness  as it is                                       1
depth      ln(depth / median depth): 0.1 is ten per cent  depth²
position   (P - centre) / extent of the scene             extent²
miss       1 where nothing was hit, else 0                (none: exact)
========== ============================================== ==========================

Logarithm, not depth itself: a step of ten per cent is as visible far away as near, and the feature
does not depend on the scene's unit. Misses of depth (0, infinity, 1e10 and the like) are put one
unit behind the farthest hit, misses of position in the centre; a channel ``miss`` is added where
the frame has any. All frame-wide numbers are in a `Scales`, so that a tile can be given those of
its whole frame.

Variances are those of the pixel means. Where a layer has none but two half buffers, the variance
is estimated as (a - b)²/4, averaged over 5x5 pixels (Rousselle et al. 2012 smooth theirs as well,
by another filter).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError, OptionError
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.misses import miss_mask
from lambent.frame.role import INFO, Role, Stat

#: Pixels around a pixel that its features may depend on (the variance from half buffers).
MARGIN = 2
#: σ of the channel that tells misses: they are nobody's neighbours but each other's.
MISS_SIGMA = 0.25
#: Noise below this share of the mean does not count in `smoothed_variance`.
_FLOOR = 1e-3


@dataclass(frozen=True)
class Scales:
    """Frame-wide numbers: depth in scene units, the scene's centre and extent, any misses."""

    depth_median: float = 1.0
    depth_far: float = 1.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    extent: float = 1.0
    misses: bool = False


@dataclass(frozen=True, eq=False)
class Features:
    """Feature channels of a frame.

    ``stack`` ``(H, W, F)`` float32, always finite, plane after plane in memory. ``variance``
    ``(H, W, F)`` of the pixel means in the same scale (0 where a layer tells none), or None where
    no layer does. ``names``: one a channel ("albedo.r", "depth", "miss"). ``valid`` ``(H, W)``:
    False where a layer held NaN or an infinity that is no miss; such values are 0 in the stack.
    """

    stack: FloatImage
    variance: FloatImage | None
    names: tuple[str, ...]
    valid: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.names)

    def index(self, role: Role) -> list[int]:
        """The channels that come from a role."""
        return [i for i, n in enumerate(self.names) if n.partition(".")[0] == role.value]

    def per_sigma(self, times: float = 1.0, **sigma: float) -> FloatImage:
        """1/(times·σ) of each channel ``(F,)``, with which distances count in σ.

        ``sigma``: one a role, in the units of the stack, as in ``per_sigma(normal=0.1)``. That of
        the albedo is the diffuse and the specular one's, too; that of ``miss`` is `MISS_SIGMA`.
        """
        table = {"miss": MISS_SIGMA, **sigma}
        roles = [n.partition(".")[0] for n in self.names]
        roles = ["albedo" if role.endswith("_albedo") else role for role in roles]
        return np.array([1 / (times * table[role]) for role in roles], np.float32)


def default_roles(frame: Frame) -> tuple[Role, ...]:
    """The guides taken unless told otherwise.

    Albedo (the diffuse and specular ones where there is no whole one), normal, depth (position
    where there is no depth: both say the same), roughness.
    """
    have = [role for role in Role if INFO[role].guide and frame.has(role)]
    if Role.ALBEDO in have:
        have = [r for r in have if r not in (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)]
    if Role.DEPTH in have:
        have = [r for r in have if r is not Role.POSITION]
    return tuple(have)


def features(
    frame: Frame, roles: Iterable[Role] | None = None, scales: Scales | None = None
) -> Features:
    """Normalised features of a frame.

    ``roles``: which guides (None: `default_roles`; a role the frame lacks raises `LayerError`).
    ``scales``: those of the whole frame where ``frame`` is a tile (None: measured here).
    A frame without guides gives zero channels.
    """
    chosen = tuple(roles) if roles is not None else default_roles(frame)
    for role in chosen:
        if not INFO[role].guide:
            raise OptionError(
                f"'{role.value}' is not a feature",
                remedy=f"take some of {', '.join(r.value for r in Role if INFO[r].guide)}",
            )
    scales = scales or fit_scales(frame)
    miss = miss_mask(frame)
    images = [frame[role] for role in chosen]
    variances = [variance_of(frame, role) for role in chosen]
    names = [n for r, i in zip(chosen, images, strict=True) for n in channel_names(r, i.shape[2])]
    if scales.misses and any(r in (Role.DEPTH, Role.POSITION) for r in chosen):
        names.append("miss")
    # plane after plane in memory: what works on one channel, as most does, finds it in one piece
    memory = np.zeros((len(names), frame.height, frame.width), np.float32)
    spread = None if all(v is None for v in variances) else np.zeros_like(memory)
    valid = np.ones(memory.shape[1:], bool)
    first = 0
    for role, image, variance in zip(chosen, images, variances, strict=True):
        part = slice(first, first + image.shape[2])
        first = part.stop
        size = None
        if spread is not None and variance is not None:
            size = spread[part]
            size[...] = variance.transpose(2, 0, 1)
        _scale(role, image.transpose(2, 0, 1), scales, miss, memory[part], size)
        if not np.isfinite(memory[part].sum()):
            bad = ~np.isfinite(memory[part]).all(axis=0)
            valid &= ~bad
            memory[part, bad] = 0
            if size is not None:
                size[:, bad] = 0
    if names and names[-1] == "miss":
        memory[-1] = miss
    stack = memory.transpose(1, 2, 0)
    return Features(
        stack, None if spread is None else spread.transpose(1, 2, 0), tuple(names), valid
    )


def channel_names(role: Role, count: int) -> list[str]:
    """Names of a role's channels: "depth", "albedo.r", "normal.x"."""
    if count == 1:
        return [role.value]
    letters = "xyz" if role in (Role.NORMAL, Role.POSITION) else "rgb"
    return [f"{role.value}.{letter}" for letter in letters[:count]]


def fit_scales(frame: Frame) -> Scales:
    """Frame-wide numbers of a frame, measured where something was hit."""
    miss = miss_mask(frame)
    hit = ~miss
    values: dict[str, float] = {}
    if frame.has(Role.DEPTH):
        depth = np.abs(frame[Role.DEPTH][:, :, 0])
        depth = depth[hit & np.isfinite(depth) & (depth > 0)]
        if depth.size:
            values["depth_median"] = float(np.median(depth))
            values["depth_far"] = float(depth.max())
    centre = (0.0, 0.0, 0.0)
    if frame.has(Role.POSITION):
        points = frame[Role.POSITION][hit & np.isfinite(frame[Role.POSITION]).all(axis=2)]
        if len(points):
            low, high = np.percentile(points, [2.0, 98.0], axis=0)
            middle = (low + high) / 2
            centre = (float(middle[0]), float(middle[1]), float(middle[2]))
            values["extent"] = float(max((high - low).max(), 1e-6 * abs(middle).max(), 1e-20))
    return Scales(centre=centre, misses=bool(miss.any()), **values)


def variance_of(frame: Frame, role: Role) -> FloatImage | None:
    """The variance of a role's pixel means ``(H, W, C)``: its layer, else from half buffers."""
    variance = frame.get(role, Stat.VARIANCE)
    if variance is not None:
        if variance.size and variance.min() >= 0 and np.isfinite(variance.sum()):
            return variance
        return np.maximum(np.nan_to_num(variance, nan=0.0, posinf=0.0, neginf=0.0), 0.0)
    a, b = frame.get(role, Stat.HALF_A), frame.get(role, Stat.HALF_B)
    if a is None or b is None:
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        raw = np.nan_to_num((a - b) ** 2 / 4, nan=0.0, posinf=0.0, neginf=0.0)
    return _mean_5x5(raw.astype(np.float32))


def smoothed_variance(frame: Frame) -> FloatImage:
    """The variance of the colour ``(H, W)``, over 3x3 pixels and channels; positive.

    A variance from n samples of heavy-tailed light is unreliable, and low where the mean is low by
    chance; hence the 3x3 pixels. A thousandth of the mean is added as deviation: less noise than
    that is all the same, and two pixels without any weigh alike.
    """
    variance = variance_of(frame, Role.COLOUR)
    if variance is None:
        raise LayerError(
            "the noise level needs colour.variance, or both colour.half_a and colour.half_b",
            file=frame.path,
            remedy="let the renderer write a variance pass",
        )
    mean = np.nan_to_num(frame.colour, nan=0.0, posinf=0.0, neginf=0.0)
    floor = (_FLOOR * mean.mean(axis=2)) ** 2
    level = _mean_3x3(variance.mean(axis=2) + floor)
    return np.clip(level, 1e-18, 1e18).astype(np.float32)


def _mean_3x3(image: FloatImage) -> FloatImage:
    padded = np.pad(image, 1, mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9, np.float32)


def _mean_5x5(image: FloatImage) -> FloatImage:
    # running along one axis, then the other; the count at the borders is smaller
    for axis in (0, 1):
        total, count = np.zeros_like(image), np.zeros(image.shape[axis], np.float32)
        for shift in range(-MARGIN, MARGIN + 1):
            size = image.shape[axis]
            to = slice(max(0, -shift), min(size, size - shift))
            if to.start >= to.stop:
                continue
            source = slice(to.start + shift, to.stop + shift)
            if axis == 0:
                total[to] += image[source]
            else:
                total[:, to] += image[:, source]
            count[to] += 1
        image = total / (count[:, None, None] if axis == 0 else count[None, :, None])
    return image


def _scale(
    role: Role,
    image: NDArray[np.float32],
    scales: Scales,
    miss: NDArray[np.bool_],
    out: NDArray[np.float32],
    variance: NDArray[np.float32] | None,
) -> None:
    """Write planes ``(C, H, W)`` of a role in the scale of the table; scale the variance in place.

    What is not sound (and no miss) stays not finite.
    """
    if role not in (Role.DEPTH, Role.POSITION):
        out[...] = image
        return
    if role is Role.DEPTH:
        z = np.abs(image)
        z[:, miss] = 1
        np.divide(z, np.float32(scales.depth_median), out=out)
        with np.errstate(invalid="ignore"):
            np.log(out, out=out)
        gone = np.float32(math.log(max(scales.depth_far / scales.depth_median, 1e-20)) + 1)
        square = z * z
    else:
        with np.errstate(invalid="ignore"):
            np.subtract(image, np.array(scales.centre, np.float32)[:, None, None], out=out)
        out /= np.float32(scales.extent)
        gone = np.float32(0)
        square = np.float32(scales.extent**2)
    out[:, miss] = gone
    if variance is not None:
        variance /= square
        variance[:, miss] = 0
