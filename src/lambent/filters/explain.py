"""The weights of a denoiser at one pixel: the generic filter made visible.

Every linear denoiser computes ĉ_p = Σ_q w_pq c_q with weights from the frame (the lecture's generic
denoiser, equation 1 in `lambent.filters.denoiser`). To see the weights of pixel p, the frame stays
the guide and delta images are filtered as targets: the one that is 1 at q gives w_pq at p. Filters
with long reach give the row themselves (``weights_at``, exact).

What the numbers say, with independent pixels of equal variance σ²:
- Σ_q w_pq: 1, or the filter brightens or darkens.
- Σ_q w_pq²: the variance of the result in σ²; its inverse is the number of pixels that a plain mean
  of the same variance would have taken.
- bias_p ≈ Σ_q w_pq e_q - e_p: what the filter would get wrong without any noise, where e stands
  for the expectation of the colour: the reference if given, else the denoised image itself. The
  latter is smooth already where the filter blurs, so that it tells less bias than there is.
Weights may be negative (first-order regression). Those of kpcn are of light divided by the albedo,
or of the logarithm of specular light: of these no bias of the picture follows, and none is told.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import LayerError, OptionError, OutputError
from lambent.filters.denoiser import DENOISERS, Denoiser, create
from lambent.frame.exposure import auto_exposure
from lambent.frame.files import read
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.tonemap import png_of, to_uint8

#: Delta images that are filtered together.
_CHUNK = 512
#: Side of each half of the picture, in pixels, at least.
_PICTURE = 384
#: The legend under the picture: its height, that of its bar, and the size of its letters.
_LEGEND, _BAR, _LETTERS = 50, 14, 13
#: Paper and ink of the legend, and the frame around the pixel.
_PAPER, _INK, _MARK = (24, 24, 24), (225, 225, 225), (0, 255, 128)


@dataclass(frozen=True, eq=False)
class Explanation:
    """The weights at a pixel.

    ``weights`` ``(h, w)`` cover the pixels from ``origin`` = (x, y) of the patch's corner;
    ``pixel`` = (x, y); ``sum`` Σw; ``least``, ``greatest``; ``variance_reduction`` Σw²;
    ``effective_pixels`` 1/Σw²; ``bias`` ``(3,)`` in radiance, estimated with ``bias_from``
    ("reference" or "denoised"), None where the result is no mean of the picture; ``crop``
    ``(h, w, 3)``: the beauty under the weights; ``exposure``: at which the picture shows it.
    """

    model: str
    pixel: tuple[int, int]
    origin: tuple[int, int]
    weights: FloatImage = field(repr=False)
    crop: FloatImage = field(repr=False)
    sum: float
    least: float = field(repr=False)
    greatest: float = field(repr=False)
    variance_reduction: float = field(repr=False)
    effective_pixels: float
    bias: tuple[float, float, float] | None = field(repr=False)
    bias_from: str = field(repr=False)
    exposure: float

    def as_dict(self) -> dict[str, Any]:
        """Everything but the picture, for JSON; the weights as nested lists."""
        return {
            "model": self.model,
            "pixel": list(self.pixel),
            "origin": list(self.origin),
            "sum": self.sum,
            "least": self.least,
            "greatest": self.greatest,
            "variance_reduction": self.variance_reduction,
            "effective_pixels": self.effective_pixels,
            "bias": None if self.bias is None else list(self.bias),
            "bias_from": self.bias_from,
            "weights": self.weights.tolist(),
        }

    def picture(self) -> NDArray[np.uint8]:
        """``(h, w, 3)``: the weights as a heat map beside the beauty, the pixel marked in both.

        Brightness goes with the square root of |w| (small weights stay visible): black, red,
        yellow, white for positive ones; blue for negative ones. Below them a legend: the colours
        from the smallest weight to the greatest, and the mark of the pixel.
        """
        zoom = max(1, _PICTURE // max(self.weights.shape))
        x, y = self.pixel[0] - self.origin[0], self.pixel[1] - self.origin[1]
        pictures = []
        for image in (heat(self.weights), to_uint8(self.crop, self.exposure)):
            large = np.repeat(np.repeat(image, zoom, axis=0), zoom, axis=1)
            pictures.append(_marked(large, x, y, zoom))
        gap = np.full((pictures[0].shape[0], 8, 3), 128, np.uint8)
        both = np.concatenate([pictures[0], gap, pictures[1]], axis=1)
        return np.concatenate([both, self._legend(both.shape[1])], axis=0)

    def _legend(self, width: int) -> NDArray[np.uint8]:
        """``(_LEGEND, width, 3)``: a bar of the weights' colours, and what the mark stands for."""
        from PIL import Image, ImageDraw, ImageFont

        paper = Image.new("RGB", (width, _LEGEND), _PAPER)
        pen, font = ImageDraw.Draw(paper), ImageFont.load_default(_LETTERS)
        low, high = min(self.least, 0.0), max(self.greatest, 0.0)
        left, right, top = 12, width // 2 - 24, 9
        scale = np.linspace(low, high, right - left)[None].repeat(_BAR, axis=0)
        most = max(-self.least, self.greatest)
        paper.paste(Image.fromarray(heat(scale, most)), (left, top))
        pen.rectangle((left - 1, top - 1, right, top + _BAR), outline=(110, 110, 110))
        below = top + _BAR + 4
        words: dict[float, tuple[str, float]] = {low: ("la", left), high: ("ra", right)}
        if low < 0 < high:
            zero = left + (right - left) * -low / (high - low)
            # not where it would run into the ends
            if min(zero - left, right - zero) > 70:
                words[0.0] = ("ma", zero)
        for value, (anchor, at) in words.items():
            said = "w = 0" if value == 0 else f"w = {value:.3g}"
            pen.text((at, below), said, _INK, font, anchor=anchor)
        start = width // 2 + 12
        pen.rectangle((start, top, start + _BAR - 1, top + _BAR - 1), outline=_MARK)
        x, y = self.pixel
        pen.text((start + _BAR + 8, top - 1), f"pixel {x},{y} of {self.model}", _INK, font)
        pen.text((start, below), "left: its weights; right: the frame", _INK, font)
        return np.asarray(paper)

    def png(self) -> bytes:
        """The picture as the bytes of a PNG."""
        return png_of(self.picture())

    def save(self, path: str | Path) -> Path:
        """Write the picture as a PNG. Raises `OutputError`, for another ending, too."""
        path = check_picture(path)
        try:
            path.write_bytes(self.png())
        except OSError as error:
            raise OutputError(
                f"the picture cannot be written: {error.strerror}",
                file=path,
                remedy="choose another place with -o",
            ) from error
        return path

    def _repr_png_(self) -> bytes:
        """For Jupyter."""
        return self.png()


def explain(
    frame: Frame | str | Path,
    model: str | Denoiser,
    x: int | None = None,
    y: int | None = None,
    *,
    pixel: tuple[int, int] | None = None,
    reference: Frame | NDArray[Any] | str | Path | None = None,
    **params: Any,
) -> Explanation:
    """The weights that a linear denoiser gives the pixels around a pixel of a frame or a file.

    ``pixel``: column and row ``(x, y)``, or ``x`` and ``y`` by themselves: of the pixels that there
    are, from 0, 0 at the upper left of the data window, as in arrays; in a crop these are not the
    coordinates of the whole picture. ``model``: a name (with ``params``) or a denoiser.
    ``reference``: the converged image ``(H, W, 3)`` of the same pixels or its file, if there is
    one, for the bias. Raises `OptionError` for a pixel outside the frame, or a model whose result
    is no weighted mean (OIDN), `LayerError` where the frame lacks a layer or the reference has
    other pixels, and what `lambent.read` raises.
    """
    x, y = _one_pixel(x, y, pixel)
    denoiser = create(model, **params) if isinstance(model, str) else model
    frame = read(frame) if isinstance(frame, (str, Path)) else frame
    name = denoiser.about.name
    if not denoiser.about.linear and getattr(denoiser, "weights_at", None) is None:
        linear = [n for n in DENOISERS if DENOISERS[n].about.linear]
        raise OptionError(
            f"the result of '{name}' is not a weighted mean of pixels: it has no weights to show",
            remedy=f"take one of {', '.join(linear)}",
        )
    if not (0 <= x < frame.width and 0 <= y < frame.height):
        raise OptionError(
            f"pixel {x},{y} lies outside the frame",
            file=frame.path,
            remedy=f"the frame has {frame.width}x{frame.height} pixels; they count from 0,0 at the "
            "upper left of its data window",
        )
    expected_all = None if reference is None else _reference(reference, frame)
    denoiser.check(frame)
    fitted = denoiser.fitted(frame)
    margin = fitted.margin()
    weights, left, top = _weights(frame, fitted, x, y, margin)
    height, width = weights.shape
    inside = (slice(top, top + height), slice(left, left + width))
    crop = np.asarray(frame.colour[inside])
    exact = weights.astype(np.float64)
    bias: tuple[float, float, float] | None = None
    if denoiser.about.linear:
        if expected_all is not None:
            expected = expected_all[inside]
        else:
            expected = _denoised(frame, fitted, left, top, width, height, margin)
        own = expected[y - top, x - left]
        # what is not known counts as the pixel itself
        known = np.where(np.isfinite(expected).all(axis=2, keepdims=True), expected, own)
        red, green, blue = ((exact[:, :, None] * known).sum(axis=(0, 1)) - own).tolist()
        bias = red, green, blue
    energy = float((exact**2).sum())
    return Explanation(
        model=name,
        pixel=(x, y),
        origin=(left, top),
        weights=weights,
        crop=crop,
        sum=float(exact.sum()),
        least=float(exact.min()),
        greatest=float(exact.max()),
        variance_reduction=energy,
        effective_pixels=1.0 / energy if energy > 0 else float("inf"),
        bias=bias,
        bias_from="reference" if reference is not None else "denoised",
        exposure=auto_exposure(frame.colour),
    )


def check_picture(path: str | Path) -> Path:
    """The path of a picture of weights. Raises `OutputError` unless its ending says PNG."""
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise OutputError(
            f"weights are drawn as a PNG, not as '{path.suffix or path.name}'",
            file=path,
            remedy="end the name in .png; the weights themselves are in --json",
        )
    return path


#: Classical filters whose weights stand beside those of a learned one, from the plainest on.
CLASSICAL = ("gaussian", "cross-bilateral", "nlm", "joint-nlm")


def classical_for(frame: Frame) -> list[str]:
    """Those of `CLASSICAL` that find in the frame what they need."""
    found = []
    for name in CLASSICAL:
        try:
            create(name).check(frame)
        except LayerError:
            continue
        found.append(name)
    return found


def side_by_side(explanations: Sequence[Explanation], half: int = 12) -> NDArray[np.uint8]:
    """The weights of several models at one pixel as one picture ``(h, w, 3)``, named.

    Each panel shows the weights of the ``2·half + 1`` pixels a side around the pixel, brightest
    where that model's own greatest weight is; the last panel is the frame there.
    """
    from PIL import Image, ImageDraw, ImageFont

    side, zoom, caption, gap = 2 * half + 1, max(2, 260 // (2 * half + 1)), 40, 8
    panels = []
    for found in explanations:
        panels.append((found.model, _window(found, heat(found.weights), half)))
    widest = max(explanations, key=lambda found: found.crop.size)
    shown = to_uint8(widest.crop, widest.exposure)
    panels.append(("the frame", _window(widest, shown, half)))
    size = side * zoom
    paper = Image.new("RGB", (len(panels) * (size + gap) - gap, size + caption), _PAPER)
    pen, font = ImageDraw.Draw(paper), ImageFont.load_default(_LETTERS)
    for number, (name, window) in enumerate(panels):
        large = np.repeat(np.repeat(window, zoom, axis=0), zoom, axis=1)
        left = number * (size + gap)
        paper.paste(Image.fromarray(_marked(large, half, half, zoom)), (left, 0))
        pen.text((left + 4, size + 4), name, _INK, font)
        if number < len(explanations):
            worth = f"worth {explanations[number].effective_pixels:.1f} pixels"
            pen.text((left + 4, size + 20), worth, (150, 150, 150), font)
    return np.asarray(paper)


def heat(weights: NDArray[Any], most: float | None = None) -> NDArray[np.uint8]:
    """Weights ``(h, w)`` as colours ``(h, w, 3)``: see `Explanation.picture`.

    ``most``: the absolute weight that is brightest; by default the greatest that there is.
    """
    most = (float(np.abs(weights).max()) if most is None else most) or 1.0
    t = np.sqrt(np.abs(weights) / most)
    red, green, blue = np.clip(3 * t, 0, 1), np.clip(3 * t - 1, 0, 1), np.clip(3 * t - 2, 0, 1)
    positive = np.stack([red, green, blue], axis=2)
    negative = np.stack([green, green, np.clip(0.3 + t, 0, 1) * (t > 0)], axis=2)
    chosen = np.where((weights >= 0)[:, :, None], positive, negative)
    return (chosen * 255 + 0.5).astype(np.uint8)


# ------------------------------------------------------------------ private


def _one_pixel(x: Any, y: Any, pixel: Any) -> tuple[int, int]:
    """Column and row, whichever way they were given. Raises `OptionError`."""
    given = (x, y) if pixel is None else pixel
    if pixel is None or (x is None and y is None):
        try:
            column, row = (operator.index(value) for value in given)
            return column, row
        except (TypeError, ValueError):
            pass
    raise OptionError(
        "explain needs one pixel, by its column and row" + (f", not {pixel!r}" if pixel else ""),
        remedy="give pixel=(120, 80), or x=120, y=80",
    )


def _reference(reference: Frame | NDArray[Any] | str | Path, frame: Frame) -> FloatImage:
    """The colour of the reference ``(H, W, 3)``. Raises `LayerError` for other pixels."""
    path, windows = None, None
    if isinstance(reference, (str, Path)):
        reference = read(reference)
    if isinstance(reference, Frame):
        path, windows, reference = reference.path, reference.windows, reference.colour
    image = np.asarray(reference, np.float32)
    if image.ndim != 3 or image.shape[:2] != (frame.height, frame.width) or image.shape[2] < 3:
        raise LayerError(
            f"the reference has shape {image.shape}, the frame ({frame.height}, {frame.width}, 3)",
            file=path,
            remedy="give the same picture: render or crop both alike",
        )
    if windows and frame.windows and windows.data != frame.windows.data:
        raise LayerError(
            f"the reference is {windows}, the frame {frame.windows}: other pixels",
            file=path,
            remedy="render or crop both alike",
        )
    return image[:, :, :3]


def _window(found: Explanation, image: NDArray[np.uint8], half: int) -> NDArray[np.uint8]:
    """The pixels of ``image``, which covers what the explanation covers, around its pixel."""
    x, y = found.pixel[0] - found.origin[0], found.pixel[1] - found.origin[1]
    grown = np.pad(image, ((half, half), (half, half), (0, 0)))
    return grown[y : y + 2 * half + 1, x : x + 2 * half + 1]


def _box(
    frame: Frame, x0: int, y0: int, x1: int, y1: int, margin: int, alignment: int
) -> tuple[int, ...]:
    """Left, top, right, bottom of a box grown by a margin and cut at the frame.

    Left and top are multiples of ``alignment``, so that pyramids are built from the same pixels.
    """
    left, top = max(0, x0 - margin), max(0, y0 - margin)
    return (
        left - left % alignment,
        top - top % alignment,
        min(frame.width, x1 + margin),
        min(frame.height, y1 + margin),
    )


def _weights(
    frame: Frame, denoiser: Denoiser, x: int, y: int, margin: int
) -> tuple[FloatImage, int, int]:
    """The weights, and the left and top of the part of the frame that they cover.

    All that the result at p depends on lies within the margin, so a crop of that radius has the
    same weights at p (weights at *other* pixels of the crop may differ; nobody looks at those).
    """
    own = getattr(denoiser, "weights_at", None)
    left, top, right, bottom = _box(frame, x, y, x + 1, y + 1, margin, denoiser.alignment())
    part = frame.crop(top, bottom, left, right)
    if own is not None:
        return np.asarray(own(part, x - left, y - top), np.float32), left, top
    height, width = part.height, part.width
    row = np.zeros(height * width, np.float32)
    for first in range(0, height * width, _CHUNK):
        count = min(_CHUNK, height * width - first)
        deltas = np.zeros((height * width, count), np.float32)
        deltas[np.arange(first, first + count), np.arange(count)] = 1.0
        filtered = denoiser.filter(part, deltas.reshape(height, width, count))
        row[first : first + count] = filtered[y - top, x - left]
    return row.reshape(height, width), left, top


def _denoised(
    frame: Frame, denoiser: Denoiser, left: int, top: int, width: int, height: int, margin: int
) -> FloatImage:
    """The denoised beauty under the weights."""
    x0, y0, x1, y1 = _box(
        frame, left, top, left + width, top + height, margin, denoiser.alignment()
    )
    part = frame.crop(y0, y1, x0, x1)
    result = denoiser.filter(part, part.colour)
    return result[top - y0 : top - y0 + height, left - x0 : left - x0 + width, :3]


def _marked(image: NDArray[np.uint8], x: int, y: int, zoom: int) -> NDArray[np.uint8]:
    """The image with a frame around the pixel (x, y) of ``zoom`` screen pixels."""
    image = image.copy()
    y0, y1, x0, x1 = y * zoom, (y + 1) * zoom - 1, x * zoom, (x + 1) * zoom - 1
    image[y0, x0 : x1 + 1] = image[y1, x0 : x1 + 1] = _MARK
    image[y0 : y1 + 1, x0] = image[y0 : y1 + 1, x1] = _MARK
    return image
