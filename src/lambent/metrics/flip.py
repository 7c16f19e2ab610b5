"""FLIP: the difference that a person sees when flipping between two images.

LDR: P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild,
"FLIP: A Difference Evaluator for Alternating Images", 2020. HDR: P. Andersson, J. Nilsson,
P. Shirley, T. Akenine-Möller, "Visualizing Errors in Rendered High Dynamic Range Images", 2021.
Computed by the authors' own ``flip-evaluator``; here are only the settings:

- Viewing: `PPD` = 67.02 pixels a degree (0.7 m from a 0.7 m wide display of 3840 pixels), the
  papers' default. Range: [0, 1], 0 is best. Epsilon: none.
- `flip_ldr` sees display values of `lambent.frame.tonemap` (sRGB, clipped to [0, 1], the
  reference's exposure for both).
- `flip_hdr` sees linear radiance, negative values as 0, and takes the largest LDR-FLIP over a
  range of exposures that the reference defines: from the one at which its brightest luminance
  reaches the shoulder of the ACES tone map to the one at which its median does, in steps of about
  a stop. Departure: where the median is below `DARK` of the brightest (a picture mostly black),
  that range would be dozens of stops deep into black; the median of the brighter pixels is
  taken instead. A black reference is seen at exposures 0 to 1.
- It is slow: about three seconds for a megapixel and an exposure, on one core; HDR-FLIP of a
  frame with ten stops between its median and its lamps takes ten times that.
- A pixel of the image that is not finite is black to FLIP and then counts 1.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from lambent.errors import EngineError
from lambent.frame.luma import luminance
from lambent.metrics.metric import Metric
from lambent.metrics.pair import FloatArray, Pair

#: Pixels per degree of visual angle.
PPD = 0.7 * 3840 / 0.7 * math.pi / 180

#: Luminance, as part of the brightest, below which a median says nothing of the picture.
DARK = 1e-4


def flip_ldr(
    image: Any, reference: Any, exposure: float | None = None, *, ppd: float = PPD
) -> float:
    """Mean LDR-FLIP of the display values, in [0, 1].

    ``image``, ``reference``: ``(H, W, 3)`` linear radiance. ``exposure``: the factor before the
    tone map (None: the reference's automatic one). ``ppd``: pixels per degree.
    Raises `LayerError` for shapes that differ.
    """
    pair = Pair.of(image, reference, exposure)
    return pair.mean(_ldr(pair, ppd))


def flip_ldr_map(
    image: Any, reference: Any, exposure: float | None = None, *, ppd: float = PPD
) -> FloatArray:
    """LDR-FLIP for each pixel ``(H, W)``; arguments as in `flip_ldr`."""
    return _ldr(Pair.of(image, reference, exposure), ppd)


def flip_hdr(image: Any, reference: Any, *, ppd: float = PPD) -> float:
    """Mean HDR-FLIP, in [0, 1], over the exposures that the reference defines.

    ``image``, ``reference``: ``(H, W, 3)`` linear radiance. Raises `LayerError` for shapes that
    differ.
    """
    pair = Pair.of(image, reference, 1.0)
    return pair.mean(_hdr(pair, ppd))


def flip_hdr_map(image: Any, reference: Any, *, ppd: float = PPD) -> FloatArray:
    """HDR-FLIP for each pixel ``(H, W)``; arguments as in `flip_hdr`."""
    return _hdr(Pair.of(image, reference, 1.0), ppd)


def hdr_exposures(reference: Any) -> dict[str, float]:
    """The exposure range for HDR-FLIP where the default one would make no sense, else empty.

    ``reference``: ``(H, W, 3)`` finite, not negative.
    """
    y = luminance(np.asarray(reference, np.float32))
    brightest = float(y.max())
    if brightest <= 0:
        return {"startExposure": 0.0, "stopExposure": 1.0}
    if float(np.median(y)) > DARK * brightest:
        return {}
    median = float(np.median(y[y > DARK * brightest]))
    shoulder = _shoulder()
    return {
        "startExposure": shoulder - math.log2(brightest),
        "stopExposure": shoulder - math.log2(median),
    }


def _ldr(pair: Pair, ppd: float = PPD) -> FloatArray:
    return pair.kept(
        f"flip ldr {ppd}",
        lambda: _evaluate(pair, pair.display_image, pair.display_reference, "LDR", {"ppd": ppd}),
    )


def _hdr(pair: Pair, ppd: float = PPD) -> FloatArray:
    def make() -> FloatArray:
        # flip-evaluator ends the process on values its exposures cannot hold: keep it in range.
        r = np.clip(pair.reference, 0, 1e30)
        x = np.clip(pair.image, 0, 1e30)
        return _evaluate(pair, x, r, "HDR", {"ppd": ppd, **hdr_exposures(r)})

    return pair.kept(f"flip hdr {ppd}", make)


def _evaluate(
    pair: Pair, x: FloatArray, r: FloatArray, kind: str, parameters: dict[str, float]
) -> FloatArray:
    error, _, _ = _engine().evaluate(
        np.ascontiguousarray(r),
        np.ascontiguousarray(x),
        kind,
        inputsRGB=True,
        applyMagma=False,
        computeMeanError=False,
        parameters=parameters,
    )
    error = np.array(error[:, :, 0], np.float32)
    error[~np.isfinite(error)] = 1.0
    error[pair.bad] = 1.0
    error[~pair.counted] = 0.0
    return error


@lru_cache(maxsize=1)
def _shoulder() -> float:
    """The exposure, in stops, at which radiance 1 reaches the shoulder: FLIP's own start for it."""
    white = np.ones((1, 1, 3), np.float32)
    _, _, used = _engine().evaluate(white, white, "HDR", applyMagma=False, computeMeanError=False)
    return float(used["startExposure"])


def _engine() -> Any:
    try:
        import flip_evaluator
    except ImportError as error:
        raise EngineError(
            f"flip-evaluator cannot be loaded: {error}", remedy="pip install flip-evaluator"
        ) from error
    return flip_evaluator


FLIP_LDR = Metric(
    "flip-ldr",
    "FLIP",
    score=lambda pair: pair.mean(_ldr(pair)),
    error_map=_ldr,
    about="LDR-FLIP of display values (sRGB, the reference's exposure), 67 pixels a degree; "
    "0 is best, 1 the worst.",
)

FLIP_HDR = Metric(
    "flip-hdr",
    "HDR-FLIP",
    score=lambda pair: pair.mean(_hdr(pair)),
    error_map=_hdr,
    about="HDR-FLIP of linear radiance over the reference's exposure range, 67 pixels a degree; "
    "0 is best, 1 the worst.",
)
