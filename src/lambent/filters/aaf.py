"""Axis-aligned filtering of soft shadows.

Soham Uday Mehta, Brandon Wang, Ravi Ramamoorthi, "Axis-aligned filtering for interactive sampled
soft shadows", SIGGRAPH Asia 2012. A point of the receiver at distance d1 from the light sees it
past occluders at distances d2 from the light, between d2min and d2max. In position and light
coordinates the spectrum of visibility then lies in a wedge of slopes

    s1 = d1/d2min − 1,   s2 = d1/d2max − 1.                                                      (1)

A light of Gaussian shape with deviation σ cuts it at Ω ≈ 1/(σ s2): that is all the detail the
shadow has, and noise above it can be filtered away with a Gaussian along image axes, of width

    β = 1/(k μ) · max(σ s2, 1/Ω_x),   1/Ω_x = (1 + s2) · d / α                                   (2)

(k = 3, μ = 2, α = 1 in the paper), where d is the distance on the receiver between neighbouring
pixels, so that the second term is the pixel's own resolution. β is a length on the receiver. The
Gaussian runs over the distances between the points that the pixels show, first along rows, then
along columns, and leaves out pixels with another normal. Width changes per pixel; weights come
from geometry alone, so that all targets get the same ones and layers still sum.

What the frame must carry, besides position and normal, as extra layers of one channel:
``light_distance`` (d1), ``occluder_min`` and ``occluder_max`` (d2min, d2max; 0 or infinity where
no shadow ray was blocked), all in scene units, measured from the light. Renderers do not write
them by themselves: a shadow shader or an AOV script does. One light only.

Where we depart: the paper filters visibility and multiplies with shading afterwards. Here the
colour is divided by the albedo's luminance where the frame has it, and multiplied afterwards.
Pixels without a blocked ray take the least slope found around them (5x5), else they stay as they
are. The paper's choice of more samples where s1/s2 is large cannot be made for a finished frame.
Not implemented: the companion of 2013 for indirect diffuse light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lambent.device import Device
from lambent.errors import LayerError, OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.luma import luminance
from lambent.frame.misses import miss_mask
from lambent.frame.role import Role

#: The layers of distances, by name.
LAYERS = ("light_distance", "occluder_min", "occluder_max")

#: Pixels around a pixel without a blocked ray in which a slope is looked for.
SEARCH = 2


@dataclass(frozen=True)
class AxisAligned(Denoiser):
    """Separable Gaussian along the image axes, its width from the distances of light and occluders.

    ``light_sigma``: deviation of the light's Gaussian in scene units (half the width of a
    rectangle, by the paper's fit of two deviations a side). ``k``, ``mu``, ``alpha``: see the
    equations. ``radius``: of the window in pixels. ``normal_angle``: degrees above which two
    normals belong to different surfaces. ``demodulate``: divide by the albedo's luminance first.
    """

    light_sigma: float = 1.0
    k: float = 3.0
    mu: float = 2.0
    alpha: float = 1.0
    radius: int = 15
    normal_angle: float = 20.0
    demodulate: bool = True
    device: Device = "auto"

    about: ClassVar[About] = About(
        name="aaf",
        title="Axis-aligned filter for soft shadows",
        paper="Mehta, Wang and Ramamoorthi 2012",
        needs=("colour", "position", "normal"),
        uses=("albedo", *LAYERS),
        cost="2·(2·radius + 1) taps a pixel",
        when="soft shadows of one light, where the frame has light and occluder distances",
    )

    def __post_init__(self) -> None:
        for name in ("light_sigma", "k", "mu", "alpha"):
            if not getattr(self, name) > 0:
                raise OptionError(
                    f"'{name}' of 'aaf' cannot be {getattr(self, name)}",
                    remedy="give a positive number",
                )

    def margin(self) -> int:
        """The window, the search for slopes, and the neighbour that the footprint looks at."""
        return self.radius + SEARCH + 1

    def check(self, frame: Frame) -> None:
        """As every denoiser; also for the layers of distances."""
        super().check(frame)
        distances(frame)

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """The targets ``(H, W, C)``, filtered along rows, then along columns."""
        from lambent.kernels.taps import weighted_taps

        self.check(frame)
        width = self.widths(frame)
        with np.errstate(divide="ignore"):
            inverse = np.where(width > 0, 1 / (math.sqrt(2) * width), np.float32(1e15))
        scale = self._texture(frame)
        image = targets / scale
        guide = np.concatenate(
            [frame[Role.POSITION], _unit(frame[Role.NORMAL]), inverse[:, :, None]], axis=2
        )
        limit = np.full((*width.shape, 1), math.cos(math.radians(self.normal_angle)), np.float32)
        guide = np.concatenate([guide, limit], axis=2).astype(np.float32)
        miss = miss_mask(frame)
        guide[miss] = np.nan  # takes no part
        steps = range(-self.radius, self.radius + 1)
        for offsets in ([(s, 0) for s in steps], [(0, s) for s in steps]):
            image, _ = weighted_taps(image, guide, offsets, _weight, device=self.device)
        return np.where(miss[:, :, None], targets, image * scale)

    def widths(self, frame: Frame) -> FloatImage:
        """β of equation 2 in scene units ``(H, W)``; 0 where nothing is to be filtered."""
        d1, _, d2_max = distances(frame)
        blocked = np.isfinite(d2_max) & (d2_max > 0) & np.isfinite(d1)
        slope = np.where(blocked, d1 / np.where(blocked, d2_max, 1) - 1, np.inf)
        slope = np.maximum(_least_around(slope, blocked), 0)
        known = np.isfinite(slope)
        slope = np.where(known, slope, 0)
        step = footprint(frame[Role.POSITION])
        pixel = (1 + slope) * step / self.alpha
        width = np.maximum(self.light_sigma * slope, pixel) / (self.k * self.mu)
        return np.where(known, width, 0).astype(np.float32)

    def _texture(self, frame: Frame) -> FloatImage:
        """What targets are divided by ``(H, W, 1)``: albedo's luminance, 1 where it is black.

        One number for all channels, so that layers of any kind still sum.
        """
        albedo = frame.get(Role.ALBEDO) if self.demodulate else None
        if albedo is None:
            return np.ones((frame.height, frame.width, 1), np.float32)
        level = luminance(albedo)[:, :, None]
        return np.where(level > 1e-3, level, np.float32(1))


def distances(frame: Frame) -> tuple[FloatImage, FloatImage, FloatImage]:
    """d1, d2min and d2max ``(H, W)`` from the extra layers named in `LAYERS`.

    A name may be the last part of a layer's name ("shadow.light_distance").
    Raises `LayerError` naming those that are not there.
    """
    found: dict[str, Any] = {}
    for name, layer in frame.extras.items():
        for wanted in LAYERS:
            if name.lower() == wanted or name.lower().endswith("." + wanted):
                found.setdefault(wanted, layer)
    missing = [name for name in LAYERS if name not in found]
    if missing:
        raise LayerError(
            f"the model 'aaf' needs layers that this frame lacks: {', '.join(missing)}",
            file=frame.path,
            remedy="render the distances from the light to the receiver and to its nearest and "
            "farthest occluder under these names, or take another model (lambent models)",
        )
    d1, low, high = (found[name].data[:, :, 0] for name in LAYERS)
    return d1, low, high


def footprint(position: FloatImage) -> FloatImage:
    """Distance between the points of neighbouring pixels ``(H, W)``, in scene units.

    The least of the steps to the left, right, up and down, so that silhouettes do not count. 0
    for an image of a single pixel.
    """
    height, width = position.shape[:2]
    least = np.full((height, width), np.inf)
    with np.errstate(invalid="ignore"):
        along = np.sqrt(((position[:, 1:] - position[:, :-1]) ** 2).sum(axis=2))
        across = np.sqrt(((position[1:] - position[:-1]) ** 2).sum(axis=2))
    along, across = (np.where(np.isnan(d), np.inf, d) for d in (along, across))
    for part, step in (
        (np.s_[:, 1:], along),
        (np.s_[:, :-1], along),
        (np.s_[1:], across),
        (np.s_[:-1], across),
    ):
        least[part] = np.minimum(least[part], step)
    return np.where(np.isfinite(least), least, 0).astype(np.float32)


# ------------------------------------------------------------------- private


def _least_around(slope: NDArray[Any], blocked: NDArray[np.bool_]) -> NDArray[Any]:
    """The slope where a ray was blocked; elsewhere the least within `SEARCH` pixels."""
    if blocked.all():
        return slope
    padded = np.pad(slope, SEARCH, constant_values=np.inf)
    height, width = slope.shape
    least = slope
    for dy in range(2 * SEARCH + 1):
        for dx in range(2 * SEARCH + 1):
            least = np.minimum(least, padded[dy : dy + height, dx : dx + width])
    return np.where(blocked, slope, least)


def _unit(normal: FloatImage) -> FloatImage:
    length = np.sqrt((normal**2).sum(axis=2, keepdims=True))
    return normal / np.maximum(length, 1e-6)


def _weight(p: list[Any], q: list[Any], k: list[Any], s: Any) -> Any:
    """exp(−|P_p − P_q|²/2β_p²), 0 across normals; the guide: P, n, 1/(√2 β), cosine limit."""
    import drjit as dr

    from lambent.kernels.exponential import exp_weight

    distance = sum(((a - b) * (a - b) for a, b in zip(p[:3], q[:3], strict=True)), type(s)(0))
    cosine = sum((a * b for a, b in zip(p[3:6], q[3:6], strict=True)), type(s)(0))
    # the pixel itself always counts, also where it has no normal
    same = (cosine >= p[7]) | (distance == 0)
    return dr.select(same, exp_weight(-distance * p[6] * p[6]), 0)
