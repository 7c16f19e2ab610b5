"""How strong the noise of an image is, and whether neighbouring pixels share it.

Pixels of a render are independent when each sample counts for one pixel (box filter, or a filter
that is importance-sampled). A renderer that *splats* a sample into all pixels under a wider filter
makes neighbours alike; denoisers that expect white noise then leave it standing.

Method. The mixed difference of a pixel and its three neighbours to the right and below,

    r = x(i, j) - x(i, j+1) - x(i+1, j) + x(i+1, j+1),

is 0 for constant and linear images and for straight horizontal and vertical edges. With noise of
variance s² whose neighbours correlate by ρ, and those two apart by ρ₂, the correlation of r with
itself one pixel along the axis is

    c = (2ρ - 1 - ρ₂) / (2 - 2ρ)     (white: -1/2; tent of radius 1, ρ = 1/4: -1/3).

Filters that splat are near Gaussian, for which ρ₂ = ρ⁴; that equation is solved for ρ by a table.
x is the logarithm of luminance (a function of each pixel alone keeps independent pixels
independent, and calms fireflies), with the albedo divided out where there is one. c is measured in
tiles, and the median of the tiles without edges in the guides counts, so that texture and shadows
in some tiles do no harm. Where the file has half buffers, their difference is nothing but noise and
ρ is measured on it directly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.luma import luminance
from lambent.frame.role import Role, Stat

#: Side of a tile in pixels, and how many tiles (and which share of them) with noise in them it
#: takes for a judgement: in a quiet image only the tiles with edges look noisy.
TILE = 16
ENOUGH = 20
SHARE = 0.3
#: Neighbours of splatted pixel filters correlate by more (tent: 0.25, box in scenes: < 0.1), those
#: of images without independent noise (denoised, photographs, enlarged) by still more.
SPLATTED, SMOOTH = 0.16, 0.6
#: Tiles with a smaller deviation of the logarithm hold no noise to judge by.
QUIET = 2e-3


@dataclass(frozen=True)
class Noise:
    """``level``: standard deviation relative to the value. ``across``, ``down``: correlation of
    horizontal and vertical neighbours (0 for white noise), None where it cannot be told.
    ``tiles``: how many tiles were judged. ``source``: what it was measured on.
    """

    level: float
    across: float | None
    down: float | None
    tiles: int
    source: str

    @property
    def correlation(self) -> float | None:
        """Mean of both directions."""
        if self.across is None or self.down is None:
            return None
        return 0.5 * (self.across + self.down)

    @property
    def splatted(self) -> bool:
        """Whether neighbours share noise as a splatted pixel filter makes them."""
        return self.correlation is not None and SPLATTED <= self.correlation < SMOOTH


def noise_of(frame: Frame) -> Noise:
    """The noise of a frame's colour."""
    a, b = frame.get(Role.COLOUR, Stat.HALF_A), frame.get(Role.COLOUR, Stat.HALF_B)
    if a is not None and b is not None:
        return _of_halves(_log(luminance(a)), _log(luminance(b)))
    image = _log(luminance(frame.colour))
    albedo = frame.get(Role.ALBEDO)
    if albedo is not None:
        image = image - np.log(np.maximum(luminance(albedo), 0.01))
    return noise_in(image, flat_tiles(frame))


def noise_in(image: NDArray[np.float32], flat: NDArray[np.bool_] | None = None) -> Noise:
    """The noise of one channel ``(H, W)``; ``flat``: which tiles count (None: all)."""
    r = _mixed(image)
    tiles = _tiles(r)
    if tiles.size == 0:
        return Noise(0.0, None, None, 0, "nothing: the image is too small")
    variance = tiles.var(axis=(2, 3))
    level = np.sqrt(variance) / 2  # r has four times the variance of the noise
    chosen = np.isfinite(variance)
    if flat is not None and np.count_nonzero(flat & chosen) >= ENOUGH:
        chosen &= flat
    typical = float(np.median(level[chosen])) if chosen.any() else 0.0
    considered = int(np.count_nonzero(chosen))
    chosen &= level > QUIET
    count = int(np.count_nonzero(chosen))
    if count < max(ENOUGH, SHARE * considered):
        return Noise(typical, None, None, count, "differences of pixels")
    some = tiles[chosen]
    across = _neighbour(float(np.median(_correlation(some[:, :, :-1], some[:, :, 1:]))))
    down = _neighbour(float(np.median(_correlation(some[:, :-1], some[:, 1:]))))
    return Noise(typical, across, down, count, "differences of pixels")


def flat_tiles(frame: Frame) -> NDArray[np.bool_] | None:
    """Tiles in which albedo, normal and depth hardly change; None without any of them."""
    flat: NDArray[np.bool_] | None = None
    for role, bound in ((Role.ALBEDO, 0.02), (Role.NORMAL, 0.02), (Role.DEPTH, 0.02)):
        guide = frame.get(role)
        if guide is None:
            continue
        with np.errstate(invalid="ignore"):
            tiles = _tiles(guide[:-1, :-1].transpose(2, 0, 1))
            spread = tiles.max(axis=(-2, -1)) - tiles.min(axis=(-2, -1))
            size = np.abs(tiles).mean(axis=(-2, -1)) if role is Role.DEPTH else 10.0 * bound
            here = (spread <= bound * (size + 1e-6) * 10).all(axis=0)
        flat = here if flat is None else flat & here
    return flat


# ------------------------------------------------------------------------------------------- parts


def _of_halves(a: NDArray[np.float32], b: NDArray[np.float32]) -> Noise:
    difference = a - b
    tiles = _tiles(difference)
    if tiles.size == 0:
        return Noise(0.0, None, None, 0, "nothing: the image is too small")
    variance = tiles.var(axis=(2, 3))
    level = float(np.median(np.sqrt(variance))) / 2  # each half has twice the frame's variance
    some = tiles[np.sqrt(variance) > QUIET]
    if len(some) < max(ENOUGH, SHARE * variance.size):
        return Noise(level, None, None, len(some), "half buffers")
    across = float(np.median(_correlation(some[:, :, :-1], some[:, :, 1:])))
    down = float(np.median(_correlation(some[:, :-1], some[:, 1:])))
    return Noise(level, across, down, len(some), "half buffers")


def _log(y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithm of a luminance, with a floor far below what is seen."""
    finite = y[np.isfinite(y) & (y > 0)]
    floor = 1e-3 * float(np.median(finite)) if finite.size else 1.0
    with np.errstate(invalid="ignore"):
        return np.log(np.maximum(np.nan_to_num(y, posinf=0.0), 0.0) + np.float32(floor))


def _mixed(x: FloatImage) -> FloatImage:
    return np.asarray(x[:-1, :-1] - x[:-1, 1:] - x[1:, :-1] + x[1:, 1:])


def _tiles(x: FloatImage) -> FloatImage:
    """``(..., H, W)`` as ``(..., rows, columns, TILE, TILE)``; a rest at the edges is lost."""
    rows, columns = x.shape[-2] // TILE, x.shape[-1] // TILE
    cut = x[..., : rows * TILE, : columns * TILE]
    cut = cut.reshape(*x.shape[:-2], rows, TILE, columns, TILE)
    return np.asarray(np.swapaxes(cut, -3, -2))


def _correlation(a: FloatImage, b: FloatImage) -> NDArray[np.float64]:
    """Correlation of two sets of tiles ``(N, h, w)``, tile by tile."""
    a = a - a.mean(axis=(1, 2), keepdims=True)
    b = b - b.mean(axis=(1, 2), keepdims=True)
    product = (a * b).mean(axis=(1, 2), dtype=np.float64)
    size = np.sqrt((a**2).mean(axis=(1, 2)) * (b**2).mean(axis=(1, 2)))
    return np.asarray(product / np.maximum(size, 1e-30))


def _neighbour(c: float) -> float:
    """The correlation ρ of neighbours from that of mixed differences (module docstring)."""
    rho = np.linspace(-0.4, 0.95, 271)
    model = (2 * rho - 1 - np.abs(rho) ** 4) / (2 - 2 * rho)
    return float(np.interp(c, model, rho))
