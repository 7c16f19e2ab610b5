"""What a metric is, and the one registry of them.

A metric maps a `Pair` (image under test and reference) to one number, and most to a map of the
error in each pixel. Other people's packages join through the entry-point group
``lambent.metrics``: an entry names a `Metric`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from lambent.errors import OptionError
from lambent.metrics.pair import FloatArray, Pair
from lambent.registry import Registry


@dataclass(frozen=True)
class Metric:
    """A named measure of the distance between an image and its reference.

    ``score``: the number. ``error_map``: ``(H, W)`` float32, or None where the metric has none.
    ``better``: which way is good. ``scale`` and ``limits``: how a map is best shown ("log" needs
    positive limits). ``about``: one sentence with epsilon, transfer and data range.
    """

    name: str
    title: str
    score: Callable[[Pair], float]
    error_map: Callable[[Pair], FloatArray] | None = None
    better: Literal["lower", "higher"] = "lower"
    scale: Literal["linear", "log"] = "linear"
    limits: tuple[float, float] = (0.0, 1.0)
    unit: str = ""
    about: str = ""

    def best(self, values: dict[str, float]) -> frozenset[str]:
        """Names with the best value; none among fewer than two, NaN never wins."""
        sound = {name: v for name, v in values.items() if not math.isnan(v)}
        if len(values) < 2 or not sound:
            return frozenset()
        top = min(sound.values()) if self.better == "lower" else max(sound.values())
        return frozenset(name for name, v in sound.items() if v == top)


#: Every metric by name.
METRICS = Registry(
    "metric",
    {
        "relmse": "lambent.metrics.relmse:RELMSE",
        "relmse-trimmed": "lambent.metrics.relmse:RELMSE_TRIMMED",
        "smape": "lambent.metrics.smape:SMAPE",
        "rmse": "lambent.metrics.rmse:RMSE",
        "psnr": "lambent.metrics.psnr:PSNR",
        "ssim": "lambent.metrics.ssim:SSIM",
        "dssim": "lambent.metrics.ssim:DSSIM",
        "flip-ldr": "lambent.metrics.flip:FLIP_LDR",
        "flip-hdr": "lambent.metrics.flip:FLIP_HDR",
    },
    group="lambent.metrics",
)


def chosen(metrics: str | Iterable[str] | None) -> list[Metric]:
    """The metrics that a wish names, each once: None for all, names, or one text with commas.

    ``flip`` stands for all metrics whose names begin with ``flip-``, and so on; capital letters
    and underscores do not matter. Raises `UnknownNameError` that lists what there is.
    """
    if metrics is None:
        return [METRICS[name] for name in METRICS]
    found: dict[str, Metric] = {}
    for wish in metrics.split(",") if isinstance(metrics, str) else metrics:
        name = wish.strip() if wish.strip() in METRICS else wish.strip().lower().replace("_", "-")
        if not name and isinstance(metrics, str):
            continue
        family = [] if name in METRICS else [n for n in METRICS if n.startswith(f"{name}-")]
        for one in family or [name]:
            found[one] = METRICS[one]
    if not found and isinstance(metrics, str):
        raise OptionError("no metric is named", remedy=f"take some of {', '.join(METRICS)}")
    return list(found.values())
