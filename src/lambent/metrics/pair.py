"""An image under test and its reference, prepared once for all metrics.

What is agreed here holds for every metric:

- Images are ``(H, W, 3)`` linear Rec. 709 radiance, float32. One-channel images are repeated.
- A pixel of the *image* that is NaN or infinite in any channel counts as the worst there is: the
  bounded metrics (SMAPE, FLIP) give it their maximum 1; relMSE and RMSE give it the larger of the
  error of a black pixel and the largest error of any finite pixel of the image; the display-range
  metrics (PSNR, SSIM) see the display value farthest from the reference. It is counted in
  `Pair.bad`, so that a table can say so. It is never dropped: a filter that answers NaN where it
  is hard shall not win.
- A pixel of the *reference* that is not finite has no truth to compare with: it is left out of all
  means (`Pair.counted`), and both images are black there for metrics with a window.
- Display values are `lambent.frame.tonemap.display` at one exposure, by default the reference's
  automatic one, for both images.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError
from lambent.frame.exposure import auto_exposure
from lambent.frame.tonemap import display

FloatArray = NDArray[np.float32]


def as_rgb(image: Any, name: str = "image") -> FloatArray:
    """``(H, W)``, ``(H, W, 1)``, ``(H, W, 3)`` or ``(H, W, 4)`` to float32 ``(H, W, 3)``.

    A fourth channel (coverage) is left out. Raises `LayerError` for any other shape and for an
    image without pixels.
    """
    array = np.asarray(image)
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4) or array.size == 0:
        raise LayerError(
            f"has shape {np.shape(image)}",
            file=name,
            remedy="metrics compare images (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) with pixels",
        )
    if array.shape[2] == 1:
        array = np.repeat(array, 3, axis=2)
    return np.ascontiguousarray(array[:, :, :3], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Pair:
    """An image under test with its reference. Make it with `Pair.of`; derived images are cached.

    ``raw`` and ``truth``: ``(H, W, 3)`` float32 linear radiance. ``exposure``: factor before the
    tone map. ``reference_variance``: variance of the reference's pixel means ``(H, W, 3)``, or
    None.
    """

    raw: FloatArray
    truth: FloatArray
    exposure: float
    reference_variance: FloatArray | None = None
    _kept: dict[str, FloatArray] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        image: Any,
        reference: Any,
        exposure: float | None = None,
        reference_variance: Any = None,
        names: tuple[str, str] = ("the image", "the reference"),
    ) -> Pair:
        """Check shapes and find the exposure.

        Raises `LayerError` naming both images and their sizes where these differ.
        """
        raw = as_rgb(image, names[0])
        truth = as_rgb(reference, names[1])
        if raw.shape != truth.shape:
            raise LayerError(
                f"{names[0]} is {raw.shape[1]}x{raw.shape[0]}, "
                f"{names[1]} is {truth.shape[1]}x{truth.shape[0]}",
                remedy="only images of one size can be compared: render or crop both alike",
            )
        variance = None
        if reference_variance is not None:
            variance = as_rgb(reference_variance, f"variance of {names[1]}")
            if variance.shape != truth.shape:
                raise LayerError(
                    f"variance of {names[1]} is {variance.shape[1]}x{variance.shape[0]}, "
                    f"the reference is {truth.shape[1]}x{truth.shape[0]}",
                    remedy="give the variance of the same picture",
                )
        factor = auto_exposure(truth) if exposure is None else float(exposure)
        return cls(raw, truth, factor, variance)

    @cached_property
    def bad(self) -> NDArray[np.bool_]:
        """``(H, W)``: pixels of the image that are NaN or infinite (where the reference is not)."""
        return ~_finite(self.raw) & self.counted

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """``(H, W)``: pixels where the reference is finite."""
        return _finite(self.truth)

    @cached_property
    def image(self) -> FloatArray:
        """The image with pixels that are not finite, here or in the reference, set to black."""
        return _blacked(self.raw, self.bad | ~self.counted)

    @cached_property
    def reference(self) -> FloatArray:
        """The reference with pixels that are not finite set to black."""
        return _blacked(self.truth, ~self.counted)

    @cached_property
    def display_reference(self) -> FloatArray:
        """The reference in display values [0, 1]."""
        return display(self.reference, self.exposure)

    @cached_property
    def display_image(self) -> FloatArray:
        """The image in display values [0, 1]; bad pixels as far from the reference as possible."""
        shown = display(self.image, self.exposure)
        if self.bad.any():
            there = self.display_reference[self.bad]
            shown[self.bad] = np.where(there > 0.5, 0.0, 1.0).astype(np.float32)
        return shown

    def mean(self, per_pixel: NDArray[Any]) -> float:
        """Mean of ``(H, W)`` over the counted pixels; NaN where there is none."""
        if self.counted.all():
            return float(per_pixel.mean(dtype=np.float64))
        chosen = per_pixel[self.counted]
        return float(chosen.mean(dtype=np.float64)) if chosen.size else float("nan")

    def kept(self, name: str, make: Callable[[], FloatArray]) -> FloatArray:
        """A map made once per pair: the score and the picture of a metric share it."""
        if name not in self._kept:
            made = make()
            made.flags.writeable = False
            self._kept[name] = made
        return self._kept[name]


def _finite(image: FloatArray) -> NDArray[np.bool_]:
    # A sum is finite only where every term is, bar an overflow; three tests cost more.
    with np.errstate(invalid="ignore", over="ignore"):
        total = np.abs(image[..., 0]) + np.abs(image[..., 1]) + np.abs(image[..., 2])
    sound = np.isfinite(total)
    if not sound.all():
        sound = np.isfinite(image).all(axis=2)
    return np.asarray(sound)


def _blacked(image: FloatArray, where: NDArray[np.bool_]) -> FloatArray:
    if not where.any():
        return image
    return np.where(where[:, :, None], np.float32(0), image)
