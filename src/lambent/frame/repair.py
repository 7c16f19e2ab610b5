"""Values that no filter can work with are found, counted, and replaced by their neighbours.

What counts as damage depends on what the layer means:

=================== ============================================================================
light, its halves   NaN; infinities; negative beyond a thousandth of the median of the layer or the
                    beauty, where it is isolated (see below; less is rounding, or what pixel filters
                    with negative lobes make: kept and counted); huge: above 1e8 or exactly 65504,
                    the largest half, alone or as a pair (an area of such values is a light: kept
                    and counted)
variances           NaN, infinities, negative
albedo, roughness   NaN, infinities, negative beyond 0.001
alpha               NaN, infinities, negative beyond 0.001 where it is isolated, beyond 0.25
                    everywhere: no pixel filter's lobes go there
normal, motion      NaN, infinities
depth, position     NaN; infinities are misses (`lambent.frame.misses`)
ids, others         never looked at
=================== ============================================================================

Negative light may belong there: a light group can subtract, and colours outside the gamut of the
file's primaries have negative channels. Such light comes in areas. A negative value is isolated,
and damage, where fewer than three of its channel's values in the 5x5 pixels around are negative, or
fewer than a sixth of those that are not 0. All negative light is kept in a layer that has more of
it than of positive light, and where another layer of light keeps a negative value in the same
pixel: the beauty, too, is negative where a light subtracts more than there is. Below -1e8 it is
damage everywhere.

A damaged value becomes the median of the sound values of its channel in the 3x3 pixels around, else
in 5x5, else 0. Only damaged values change, and none of them enters another pixel.

Normals encoded as 0.5 + 0.5 n (integer image formats need that) are decoded where that is certain:
all values lie in [0, 1] and the decoded vectors, unlike the raw ones, have length 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Stat

Mask = NDArray[np.bool_]

#: Light above this, or exactly the largest half, is no light.
HUGE = 1e8
HALF_MAX = 65504.0
#: Negative light down to this fraction of the median is kept.
NEGATIVE_SHARE = 1e-3
#: Negative values that lie together: so many in 5x5 pixels, and such a share of what is not 0.
TOGETHER, TOGETHER_SHARE = 3, 1 / 6
#: A layer of light subtracts where so many values are negative, and fewer are positive.
SUBTRACTING = 9
#: Alpha below this is not due to a pixel filter.
LEAST_ALPHA = -0.25
#: Neighbours are gathered for so many values at a time, which bounds the memory.
CHUNK = 1 << 17


@dataclass(frozen=True)
class LayerRepairs:
    """What was found in one layer: counts of values (a pixel has one for each channel).

    ``nan``, ``infinite``, ``negative``, ``huge`` were replaced, ``pixels`` of them in all;
    ``zeroed`` of the values had no sound neighbour. ``kept_negative`` (slightly negative),
    ``kept_together`` (negative in areas) and ``kept_huge`` are not damage; they are told all the
    same. ``written`` False: the repair served the filter only, the layer itself stays as it was.
    """

    name: str
    role: Role
    stat: Stat
    nan: int = 0
    infinite: int = 0
    negative: int = 0
    huge: int = 0
    pixels: int = 0
    zeroed: int = 0
    kept_negative: int = 0
    kept_together: int = 0
    kept_huge: int = 0
    written: bool = True

    @property
    def replaced(self) -> int:
        """How many values were replaced."""
        return self.nan + self.infinite + self.negative + self.huge

    def sentence(self) -> str:
        """``"'RGB': 12 NaN, 3 infinite values in 5 pixels, …"``."""
        counts = [
            f"{count} {word}"
            for count, word in (
                (self.nan, "NaN"),
                (self.infinite, "infinite"),
                (self.negative, "negative"),
                (self.huge, "huge"),
            )
            if count
        ]
        values = "value" if self.replaced == 1 else "values"
        pixels = "1 pixel" if self.pixels == 1 else f"{self.pixels} pixels"
        text = f"'{self.name}': {', '.join(counts)} {values} in {pixels}, replaced by neighbours"
        if not self.written:
            text += " for filtering only"
        if self.zeroed:
            text += f" ({self.zeroed} without a sound neighbour are now 0)"
        return text

    def remarks(self) -> list[str]:
        """Sentences on what was kept although it is unusual."""
        said = []
        if self.kept_negative:
            said.append(
                f"'{self.name}' has {self.kept_negative} slightly negative values (rounding, or a "
                "pixel filter with negative lobes); they were kept."
            )
        if self.kept_together:
            said.append(
                f"'{self.name}' has {self.kept_together} negative values that lie together, as "
                "light that subtracts and colours outside the gamut do; they were kept."
            )
        if self.kept_huge:
            said.append(
                f"'{self.name}' has {self.kept_huge} values at the largest half or above 1e8 that "
                "form areas, as lights do; they were kept."
            )
        return said


@dataclass(frozen=True)
class Repairs:
    """What `repair` found, layer by layer; true where anything was replaced."""

    layers: tuple[LayerRepairs, ...] = ()

    def __bool__(self) -> bool:
        return self.total > 0

    @property
    def total(self) -> int:
        """How many values were replaced in all layers."""
        return sum(layer.replaced for layer in self.layers)

    def sentences(self) -> list[str]:
        """One sentence for each layer with replaced values."""
        return [layer.sentence() for layer in self.layers if layer.replaced]

    def notes(self) -> list[str]:
        """The sentences as remarks on a frame."""
        return [f"repaired {sentence}" for sentence in self.sentences()]

    def written(self, layers: Iterable[Layer]) -> Repairs:
        """The same where only ``layers`` go on repaired; the others were for filtering only."""
        kept = {(layer.name, layer.role, layer.stat) for layer in layers}
        return Repairs(
            tuple(
                replace(one, written=(one.name, one.role, one.stat) in kept) for one in self.layers
            )
        )

    def as_dict(self) -> dict[str, dict[str, int]]:
        """Counts by layer name, for JSON."""
        counted = [f.name for f in fields(LayerRepairs) if f.type == "int"]
        return {la.name: {n: getattr(la, n) for n in counted} for la in self.layers}


def repair(frame: Frame, layers: Iterable[str] | None = None) -> tuple[Frame, Repairs]:
    """The frame with sound values only, and what was replaced.

    ``layers``: names of the layers to look at (None: all that have a role but ids and unknown
    ones). A clean layer is handed on as it is; looking at one costs two passes over it.
    Nothing raises: a layer that is all NaN becomes 0, which the counts tell.
    """
    only = None if layers is None else set(layers)
    beauty = _Median(frame)
    looked_at = [
        layer
        for layer in frame.all_layers()
        if layer.role not in (Role.ID, Role.OTHER) and (only is None or layer.name in only)
    ]
    together = _negative_together(looked_at, beauty)
    found: list[LayerRepairs] = []
    notes: list[str] = []
    result = frame
    for layer in looked_at:
        pixels, counts = repaired(layer, beauty, together)
        if layer.role is Role.NORMAL and layer.stat is not Stat.VARIANCE:
            decoded = decoded_normals(layer.data if pixels is None else pixels)
            if decoded is not None:
                pixels = decoded
                notes.append(
                    f"'{layer.name}' holds normals encoded as 0.5 + 0.5 n; they were decoded for "
                    "filtering only."
                )
        if pixels is not None:
            result = result.with_layer(layer.with_data(pixels))
        if counts is not None:
            found.append(counts)
            notes += counts.remarks()
    return result.noted(*notes), Repairs(tuple(found))


def repaired(
    layer: Layer, beauty: Callable[[], float] = float, together: Mask | None = None
) -> tuple[FloatImage | None, LayerRepairs | None]:
    """New pixels ``(H, W, C)`` of a layer (None: as they were) and counts (None: nothing found).

    ``beauty`` gives the median of the beauty; asked only where light is negative. ``together``
    ``(H, W, 3)``: where other layers of light are negative in areas.
    """
    image = layer.data
    if image.size == 0:
        return None, None
    with np.errstate(invalid="ignore"):
        low, high = float(image.min()), float(image.max())  # both are NaN if any value is
    light = INFO[layer.role].radiance and layer.stat is not Stat.VARIANCE
    floor = _floor(layer, light)
    sound = np.isfinite(low) and np.isfinite(high) and low >= min(floor, 0.0)
    if sound and (not light or high < HALF_MAX):
        return None, None
    counts: dict[str, Any] = {}
    bad = _broken(layer, image, counts)
    if light and not low >= 0:
        floor = -NEGATIVE_SHARE * max(_median(image), beauty())
    if floor > -np.inf:
        with np.errstate(invalid="ignore"):
            below = image < 0 if light else image < floor
            negative = below & (image < floor) & ~bad
        if light:
            counts["kept_negative"] = int(np.count_nonzero(below & ~negative & ~bad))
        if light or (layer.role is Role.ALPHA and layer.stat is not Stat.VARIANCE):
            kept = _together(image, negative, floor, light)
            if together is not None and light and together.shape[:2] == image.shape[:2]:
                kept |= negative & _as_channels(together, image.shape[2])
            kept &= image >= (-HUGE if light else LEAST_ALPHA)
            counts["kept_together"] = int(np.count_nonzero(kept))
            negative &= ~kept
        counts["negative"] = int(np.count_nonzero(negative))
        bad |= negative
    if light:
        huge = ((image > HUGE) | (image == np.float32(HALF_MAX))) & ~bad
        if huge.any():
            alone = huge & (_neighbours(huge) <= 1)
            counts["huge"] = int(np.count_nonzero(alone))
            counts["kept_huge"] = int(np.count_nonzero(huge)) - counts["huge"]
            bad |= alone
    if not bad.any():
        if not any(counts.values()):
            return None, None
        return None, LayerRepairs(layer.name, layer.role, layer.stat, **counts)
    fixed, zeroed = replaced(image, bad)
    return fixed, LayerRepairs(
        layer.name,
        layer.role,
        layer.stat,
        pixels=int(np.count_nonzero(bad.any(axis=2))),
        zeroed=zeroed,
        **counts,
    )


def replaced(image: FloatImage, bad: Mask) -> tuple[FloatImage, int]:
    """A copy of ``image`` ``(H, W, C)`` in which values marked ``bad`` (same shape) are replaced.

    By the median of the values around that are not bad: 3x3, else 5x5, else 0. The second result
    counts the last.
    """
    fixed = image.copy()
    padded = np.pad(np.where(bad, np.nan, image), ((2, 2), (2, 2), (0, 0)), constant_values=np.nan)
    rows, columns, channels = np.nonzero(bad)
    zeroed = 0
    for start in range(0, rows.size, CHUNK):
        y, x, c = (part[start : start + CHUNK] for part in (rows, columns, channels))
        value, known = _median_around(padded, y, x, c, 1)
        if not known.all():
            far = ~known
            value[far], known[far] = _median_around(padded, y[far], x[far], c[far], 2)
        zeroed += int(np.count_nonzero(~known))
        fixed[y, x, c] = value
    return fixed, zeroed


def decoded_normals(image: FloatImage) -> FloatImage | None:
    """Normals in [-1, 1] from ones encoded in [0, 1], or None where these are not (certainly).

    Pixels without a normal (all 0, or all 0.5) become 0.
    """
    if image.shape[2] != 3 or not float(image.min()) >= 0.0 or float(image.max()) > 1.0:
        return None
    decoded = 2.0 * image - 1.0
    none = (image == 0).all(axis=2) | (np.abs(decoded) < 0.02).all(axis=2)
    if none.all():
        return None
    raw = np.linalg.norm(image[~none], axis=1)
    length = np.linalg.norm(decoded[~none], axis=1)
    # Raw vectors in the positive octant of length 1 are normals of a scene seen that way.
    unit = np.mean(np.abs(length - 1) < 0.05)
    if unit < 0.9 or np.mean(np.abs(raw - 1) < 0.05) > 0.5:
        return None
    decoded[none] = 0.0
    return np.asarray(decoded, np.float32)


# ------------------------------------------------------------------------------------------- parts


class _Median:
    """The median of a frame's beauty, measured when first asked for."""

    def __init__(self, frame: Frame) -> None:
        self.frame, self.value = frame, -1.0

    def __call__(self) -> float:
        if self.value < 0:
            colour = self.frame.get(Role.COLOUR)
            self.value = 0.0 if colour is None else _median(colour)
        return self.value


def _median(image: FloatImage) -> float:
    """Median of the positive finite values, which no single value moves; 0 if there is none."""
    with np.errstate(invalid="ignore"):
        positive = image[(image > 0) & (image < np.inf)]
    return float(np.median(positive)) if positive.size else 0.0


def _floor(layer: Layer, light: bool) -> float:
    """Values below this are damage; -inf where a role has no such bound.

    For light a first answer: a layer without negative values need not be measured.
    """
    if light or layer.stat is Stat.VARIANCE:
        return 0.0
    if layer.role is Role.DEPTH or INFO[layer.role].low is None:
        return -np.inf  # a camera that looks along -z has negative depths
    return -NEGATIVE_SHARE


def _negative_together(layers: Iterable[Layer], beauty: Callable[[], float]) -> Mask | None:
    """Where any layer of light is negative in areas ``(H, W, 3)``; None where none is."""
    found: Mask | None = None
    for layer in layers:
        image = layer.data
        if not INFO[layer.role].radiance or layer.stat is not Stat.MEAN or image.size == 0:
            continue
        with np.errstate(invalid="ignore"):
            if not (image < 0).any():
                continue
            floor = -NEGATIVE_SHARE * max(_median(image), beauty())
            negative = (image < floor) & (image >= -HUGE)
        own = _as_channels(_together(image, negative, floor, True), 3)
        if found is not None and found.shape != own.shape:
            continue  # another data window
        found = own if found is None else found | own
    return found


def _together(image: FloatImage, negative: Mask, floor: float, light: bool) -> Mask:
    """Which ``negative`` values (below ``floor``) lie together; ``light``: a layer may subtract."""
    if not negative.any():
        return negative.copy()
    with np.errstate(invalid="ignore"):
        positive = np.isfinite(image) & (image > -floor)
    if light and SUBTRACTING <= np.count_nonzero(negative) > np.count_nonzero(positive):
        return negative.copy()
    below, above = _count_5x5(negative), _count_5x5(positive)
    enough = (below >= TOGETHER) & (below >= TOGETHER_SHARE * (below.astype(np.float32) + above))
    return np.asarray(negative & enough)


def _as_channels(mask: Mask, count: int) -> Mask:
    """``(H, W, 1 or 3)`` as ``(H, W, count)``: grey stands for all three, and any for grey."""
    if mask.shape[2] == count:
        return mask
    if count == 1:
        return np.asarray(mask.any(axis=2, keepdims=True))
    return np.repeat(mask.any(axis=2, keepdims=True), count, axis=2)


def _count_5x5(mask: Mask) -> NDArray[np.uint8]:
    """How many of the 25 values around are set, in each channel."""
    total = mask.astype(np.uint8)
    for axis in (0, 1):
        size = total.shape[axis]
        padded = np.pad(total, [(2, 2) if i == axis else (0, 0) for i in range(3)])
        total = np.zeros(mask.shape, np.uint8)
        for shift in range(5):
            part = [slice(None)] * 3
            part[axis] = slice(shift, shift + size)
            total += padded[tuple(part)]
    return total


def _broken(layer: Layer, image: FloatImage, counts: dict[str, Any]) -> Mask:
    nan = np.isnan(image)
    counts["nan"] = int(np.count_nonzero(nan))
    if layer.role in (Role.DEPTH, Role.POSITION) and layer.stat is not Stat.VARIANCE:
        return nan
    infinite = np.isinf(image)
    counts["infinite"] = int(np.count_nonzero(infinite))
    return np.asarray(nan | infinite)


def _neighbours(mask: Mask) -> NDArray[np.uint8]:
    """How many of the eight neighbours are set, in each channel."""
    height, width = mask.shape[:2]
    padded = np.pad(mask.astype(np.uint8), ((1, 1), (1, 1), (0, 0)))
    total = np.zeros(mask.shape, np.uint8)
    for dy in range(3):
        for dx in range(3):
            if (dy, dx) != (1, 1):
                total += padded[dy : dy + height, dx : dx + width]
    return total


def _median_around(
    padded: FloatImage, y: NDArray[Any], x: NDArray[Any], c: NDArray[Any], radius: int
) -> tuple[NDArray[np.float32], Mask]:
    """Median of the numbers in the window around each value, 0 where there is none."""
    offsets = range(2 - radius, 3 + radius)
    around = np.stack([padded[y + dy, x + dx, c] for dy in offsets for dx in offsets], axis=1)
    around.sort(axis=1)  # NaN goes last
    count = np.count_nonzero(~np.isnan(around), axis=1)
    known = count > 0
    row = np.arange(len(count))
    below = around[row, np.maximum(count - 1, 0) // 2]
    above = around[row, count // 2]
    middle = np.where(above == below, below, 0.5 * below + 0.5 * above)
    return np.where(known, middle, 0.0).astype(np.float32), known
