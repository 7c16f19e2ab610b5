"""The networks of the papers at run time: KPCN, DPCN and modular kernel prediction.

How each works is in its file under `lambent.learn.networks`; what they read, and the transforms of
diffuse and specular light, in `denoise.lobes`. Here: planes of the frame → network
(`denoise.runtime`) → the predicted means (`kernels.predicted`) → radiance. They run in tiles, whose
margin the model's card knows.

Negative light (a light that subtracts, colours outside the gamut) has no logarithm: KPCN filters
the negative part of the specular light like the positive one, with the same kernels, and takes it
away; DPCN, which has no kernels, leaves the negative part of each lobe as it is.

Other lighting layers get the kernels of the diffuse light (of the whole, where there is one part),
divided by the albedo and multiplied again; alpha the same without the albedo.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from lambent.denoise import prepare, runtime
from lambent.denoise.inputs import Signals, signals_of
from lambent.denoise.lobes import Parts, lobes_of, parts_of, together, whole_of
from lambent.denoise.model_file import ModelFile, loaded_model
from lambent.errors import FileError, OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.sums import has_negative_light
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import Role
from lambent.kernels.predicted import predicted_window, weights_at

_RADIANCE = ("colour_std", "diffuse", "diffuse_std", "specular_std")
_USES = (
    "diffuse", "specular", "diffuse_albedo", "diffuse.variance", "specular.variance",
    "albedo", "normal", "depth",
    "colour.variance", "albedo.variance", "normal.variance", "depth.variance",
)  # fmt: skip


@dataclass(frozen=True)
class NetworkDenoiser(Denoiser):
    """A denoiser that computes with an exported network whose model file reads ``lobes``.

    A subclass says what becomes of the network's `outputs` (``filter_layers``, ``about``).
    ``weights``: another model file, such as `lambent train` makes. ``threads``: of the network.
    """

    weights: str | None = None
    threads: int | None = None
    _whole: prepare.Whole | None = field(default=None, repr=False, compare=False)

    def margin(self) -> int:
        """What the model's card says that a result depends on."""
        return int(self.card()["margin"])

    def fitted(self, frame: Frame) -> Denoiser:
        """A copy with the exposure and the depth of the whole frame."""
        return dataclasses.replace(self, _whole=prepare.Whole.of(frame))

    def model(self) -> ModelFile:
        """The model file. Raises `FileError` and `DamagedFileError`."""
        found = loaded_model(self.weights or self.about.name, "lobes")
        task = found.card.get("recipe", {}).get("task")
        if task != self.about.name:
            raise FileError(
                f"holds a network of the task '{task}', not '{self.about.name}'",
                file=found.path,
                remedy=f"use it with --model {task}",
            )
        return found

    def card(self) -> dict[str, Any]:
        """The card of the model file."""
        return dict(self.model().card)

    def bytes_per_pixel(self, channels: int) -> int:
        """Planes, activations, logits, and the filter's planes."""
        options = self.card()["options"]
        logits = 2 * int(options.get("kernel", 2)) ** 2
        return 4 * (3 * 34 + 4 * int(options.get("width", 32)) + 2 * logits + 6 * channels)

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter a stack of channels, in groups of three; the first three may be the beauty."""
        count = targets.shape[2]
        edges = [*range(0, count - count % 3, 3), *range(count - count % 3, count + 1)]
        layers = []
        for a, b in itertools.pairwise(edges):
            piece = targets[:, :, a:b]
            is_beauty = a == 0 and piece.shape[2] == 3 and np.array_equal(piece, frame.colour)
            role = Role.COLOUR if is_beauty else Role.LIGHTING
            layers.append(Layer(role, piece))
        return np.concatenate(self.filter_layers(frame, layers), axis=2)

    # --------------------------------------------------------- for subclasses

    def signals(self, frame: Frame) -> tuple[Signals, float]:
        """The frame's signals with lobes, at a fixed exposure; and that exposure."""
        whole = self._whole or prepare.Whole.of(frame)
        signals = signals_of(frame, whole.depth)
        if len(signals.colour) == 1:
            signals = replace(signals, colour=signals.colour.repeat(3, axis=0))
        factor = np.float32(whole.exposure)
        layers = {
            name: layer * factor if name in _RADIANCE else layer
            for name, layer in {**signals.layers, **lobes_of(frame)}.items()
        }
        return replace(signals, colour=signals.colour * factor, layers=layers), float(factor)

    def shapes(self) -> list[tuple[int, int]]:
        """Of each output of the network: its channels, and by what it is smaller than the frame.

        Here: the taps of one predicted window. A file whose network has others is refused.
        """
        return [(self._option("kernel") ** 2, 1)]

    def outputs(self, *planes: FloatImage) -> list[FloatImage]:
        """What the network makes of its inputs ``(C, H, W)``: each output ``(C, H, W)``."""
        with runtime.network(self.model(), self.shapes(), "f32", self.threads) as network:
            ready = [np.ascontiguousarray(p[None], np.float32) for p in planes]
            return [out[0].copy() for out in network.outputs(*ready)]

    def _option(self, name: str) -> int:
        return int(self.card()["options"].get(name, 1))


@dataclass(frozen=True, eq=False)
class _Said:
    """A frame in two parts at a fixed exposure (``factor``), and what the networks say of each.

    ``whole``: the frame has no lobes, and all of it is the diffuse part. ``below``: the negative
    part of the specular light, turned positive, ``(3, H, W)``.
    """

    parts: Parts
    predicted: list[FloatImage]
    whole: bool
    factor: np.float32
    below: FloatImage


@dataclass(frozen=True)
class _TwoParts(NetworkDenoiser):
    """KPCN and its twin: diffuse and specular light through networks of their own."""

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """Whether there is what the networks were made for."""
        if lobes_of(frame):
            return ()
        return (
            f"{self.about.name} works best with separate diffuse and specular light: all light "
            "went through the diffuse network",
        )

    def _said(self, frame: Frame) -> _Said:
        signals, factor = self.signals(frame)
        parts = parts_of(np, signals)
        predicted = self.outputs(parts.diffuse_planes, parts.specular_planes)
        diffuse = signals.layers.get("diffuse", signals.colour)
        below = np.maximum(diffuse - signals.colour, 0)
        whole = "diffuse" not in signals.layers
        return _Said(parts, predicted, whole, np.float32(factor), below)


@dataclass(frozen=True)
class KPCN(_TwoParts):
    """Kernel-predicting network. ``part``: whose kernels `lambent explain` shows."""

    about: ClassVar[About] = About(
        name="kpcn",
        title="Kernel-predicting convolutional network, lean",
        paper="Bako et al. 2017",
        uses=_USES,
        cost="two stacks of nine convolutions, and a window each",
        when="to see what learned kernels do; diffuse and specular light apart",
        linear=False,
    )

    part: Literal["diffuse", "specular"] = "diffuse"

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """The beauty from both parts, the other layers each as the part that it is."""
        said = self._said(frame)
        return [self._layer(layer, said) for layer in layers]

    def shapes(self) -> list[tuple[int, int]]:
        """A window for each part."""
        return 2 * super().shapes()

    def weights_at(self, frame: Frame, x: int, y: int) -> FloatImage:
        """The weights ``(H, W)`` of the chosen part's c̃ at pixel (x, y)."""
        return weights_at(self._said(frame).predicted[0 if self.part == "diffuse" else 1], x, y)

    # --------------------------------------------------------------- private

    def _layer(self, layer: Layer, said: _Said) -> FloatImage:
        parts, predicted, factor = said.parts, said.predicted, said.factor
        if layer.role is Role.COLOUR:
            diffuse, specular = (
                predicted_window(image.transpose(1, 2, 0), logits).transpose(2, 0, 1)
                for image, logits in zip((parts.diffuse, parts.specular), predicted, strict=True)
            )
            light = together(np, diffuse, specular, parts.albedo)
            if said.below.any():
                below = said.below.transpose(1, 2, 0)
                light = light - _by_logarithm(below, predicted[1]).transpose(2, 0, 1)
            return _image(light / factor, layer)
        if layer.role is Role.SPECULAR and not said.whole:
            own = layer.data * factor
            found = _by_logarithm(np.maximum(own, 0), predicted[1])
            if float(own.min(initial=0)) < 0:
                found = found - _by_logarithm(np.maximum(-own, 0), predicted[1])
            return np.asarray(found / factor)
        albedo = _albedo_for(parts.albedo, layer)
        return predicted_window(layer.data / albedo, predicted[0]) * albedo


@dataclass(frozen=True)
class DPCN(_TwoParts):
    """Direct-predicting network."""

    about: ClassVar[About] = About(
        name="dpcn",
        title="Direct-predicting convolutional network, the twin of kpcn",
        paper="Bako et al. 2017",
        uses=_USES,
        cost="two stacks of nine convolutions",
        when="to compare with kpcn: the same networks, giving colours instead of kernels",
        linear=False,
    )

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """Whether there is light that the network cannot say."""
        if not has_negative_light(frame.colour):
            return super().remarks(frame)
        return (
            *super().remarks(frame),
            "dpcn predicts no negative light: it was left as it is",
        )

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """As KPCN. Raises `OptionError` for layers that it does not say: it has no kernels."""
        specular = frame.get(Role.SPECULAR)
        for layer in layers:
            known = layer.role is Role.COLOUR
            if layer.role in (Role.DIFFUSE, Role.SPECULAR) and specular is not None:
                rest = frame.colour - specular
                own = rest if layer.role is Role.DIFFUSE else specular
                known = bool(np.allclose(layer.data, own, rtol=1e-3, atol=1e-4))
            if not known:
                raise OptionError(
                    f"'{self.about.name}' gives the colour and its two parts, no kernels for "
                    f"'{layer.name}'",
                    remedy="add --passes beauty, or take another model",
                )
        said = self._said(frame)
        return [self._layer(layer, said) for layer in layers]

    def shapes(self) -> list[tuple[int, int]]:
        """A colour for each part."""
        return [(3, 1), (3, 1)]

    # --------------------------------------------------------------- private

    def _layer(self, layer: Layer, said: _Said) -> FloatImage:
        below = np.minimum(said.parts.diffuse, 0)
        diffuse = (np.maximum(np.expm1(said.predicted[0]), 0) + below) * said.parts.albedo
        # what it says of a part that is not there means nothing
        specular = np.zeros_like(diffuse)
        if not said.whole:
            specular = np.maximum(np.expm1(said.predicted[1]), 0) - said.below
        light = {Role.DIFFUSE: diffuse, Role.SPECULAR: specular}.get(layer.role, diffuse + specular)
        return _image(light / said.factor, layer)


@dataclass(frozen=True)
class Modular(NetworkDenoiser):
    """Modular kernel prediction.

    ``preference``: 0 for the least error, towards 1 for rather leaving noise than losing detail.
    """

    about: ClassVar[About] = About(
        name="modular",
        title="Modular kernel prediction, still frames, lean",
        paper="Vogels et al. 2018",
        uses=_USES[5:],
        cost="residual blocks at three scales, windows of 7x7",
        when="to see the asymmetric loss at work: its preference trades noise for bias",
    )

    preference: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.preference <= 1:
            raise OptionError(
                f"'preference' of '{self.about.name}' cannot be {self.preference:g}",
                remedy="0 for the least error, up to 1 for keeping what might be detail",
            )

    def at_strength(self, strength: float) -> tuple[Denoiser, float]:
        """From 1 to 1/2 the preference rises to 1; below, the result is blended with the input."""
        if self.preference:
            return self, strength
        preference = min(1.0, 2 * (1 - strength))
        return dataclasses.replace(self, preference=preference), min(1.0, 2 * strength)

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """Every layer with the same kernels on all scales."""
        whole, logits = self._predicted(frame)
        height, width = frame.height, frame.width
        # channels of all layers together: the weights are made once
        albedos = [_albedo_for(whole.albedo, layer) for layer in layers]
        ratios = [layer.data / albedo for layer, albedo in zip(layers, albedos, strict=True)]
        stack = np.concatenate(ratios, axis=2).transpose(2, 0, 1)
        out = _pyramid(_continued(stack, self._multiple()), logits)[:, :height, :width]
        ends = np.cumsum([r.shape[2] for r in ratios])[:-1]
        pieces = np.split(out.transpose(1, 2, 0), ends, axis=2)
        return [piece * albedo for piece, albedo in zip(pieces, albedos, strict=True)]

    def weights_at(self, frame: Frame, x: int, y: int) -> FloatImage:
        """The weights ``(H, W)`` of pixel (x, y), all scales put together.

        With the mean albedo: a pixel's weight is that of its light, times a_p / a_q.
        """
        whole, logits = self._predicted(frame)
        found = _folded(_row(logits, x, y), frame.height, frame.width)
        albedo = whole.albedo.mean(0)
        return np.asarray(found * albedo[y, x] / albedo, np.float32)

    def shapes(self) -> list[tuple[int, int]]:
        """Kernels on every scale, and beside all but the coarsest a blend."""
        ((taps, _),), scales = super().shapes(), self._option("scales")
        return [(taps + (n < scales - 1), 2**n) for n in range(scales)]

    def alignment(self) -> int:
        """The side of a pixel of the coarsest scale."""
        return self._multiple()

    # --------------------------------------------------------------- private

    def _predicted(self, frame: Frame) -> tuple[Parts, list[FloatImage]]:
        """The frame as one part, and the logits of every scale."""
        whole = whole_of(np, self.signals(frame)[0])
        preference = np.full((1, frame.height, frame.width), self.preference, np.float32)
        planes = np.concatenate([whole.diffuse_planes, preference])
        return whole, self.outputs(_continued(planes, self._multiple()))

    def _multiple(self) -> int:
        return int(2 ** (self._option("scales") - 1))


# ------------------------------------------------------------------- private


def _pyramid(image: FloatImage, logits: Sequence[FloatImage]) -> FloatImage:
    """`networks.modular`, equation (1), for an image ``(C, H, W)``."""
    taps = len(logits[-1])
    images = [image]
    for _ in logits[1:]:
        images.append(_halved(images[-1]))
    out: FloatImage | None = None
    for own, level in zip(reversed(logits), reversed(images), strict=True):
        mean = predicted_window(level.transpose(1, 2, 0), own[:taps]).transpose(2, 0, 1)
        if out is not None:
            alpha = 1 / (1 + np.exp(-own[taps:]))
            mean = mean + alpha * (out - _halved(mean)).repeat(2, axis=1).repeat(2, axis=2)
        out = mean
    assert out is not None
    return out


def _row(logits: Sequence[FloatImage], x: int, y: int) -> FloatImage:
    """The weights ``(H, W)`` by which `_pyramid` makes the pixel (x, y)."""
    own, coarser = logits[0], logits[1:]
    if not coarser:
        return weights_at(own, x, y)
    taps = len(logits[-1])
    kernels, alpha = own[:taps], 1 / (1 + np.exp(-own[taps, y, x]))
    found = weights_at(kernels, x, y)
    left, top = x - x % 2, y - y % 2
    for j in (top, top + 1):
        for i in (left, left + 1):
            found = found - alpha / 4 * weights_at(kernels, i, j)
    below = _row(coarser, x // 2, y // 2) / 4
    found = found + alpha * below.repeat(2, axis=0).repeat(2, axis=1)
    return np.asarray(found, np.float32)


def _halved(image: FloatImage) -> FloatImage:
    """Means of 2x2 pixels of ``(C, H, W)``."""
    count, height, width = image.shape
    return image.reshape(count, height // 2, 2, width // 2, 2).mean(axis=(2, 4), dtype=np.float32)


def _continued(planes: FloatImage, multiple: int) -> FloatImage:
    """Repeated at the right and lower border until the sides are multiples of a number."""
    more = [-n % multiple for n in planes.shape[1:]]
    return np.pad(planes, ((0, 0), (0, more[0]), (0, more[1])), "edge") if any(more) else planes


def _folded(weights: FloatImage, height: int, width: int) -> FloatImage:
    """Weights of a continued frame as those of the frame: repeated pixels count as the last."""
    found = weights[:height, :width].copy()
    found[-1] += weights[height:, :width].sum(0)
    found[:, -1] += weights[:height, width:].sum(1)
    found[-1, -1] += weights[height:, width:].sum()
    return found


def _by_logarithm(light: FloatImage, logits: FloatImage) -> FloatImage:
    """Light ``(H, W, C)`` from 0 on, averaged as its logarithm (equation 9)."""
    return np.asarray(np.expm1(predicted_window(np.log1p(light), logits)), np.float32)


def _albedo_for(albedo: FloatImage, layer: Layer) -> FloatImage:
    """``(H, W, C)``: what a layer is divided by, 1 for alpha."""
    if layer.role is Role.ALPHA:
        return np.ones_like(layer.data)
    image = albedo.transpose(1, 2, 0)
    channels = layer.data.shape[2]
    if channels != 3:
        image = np.repeat(image.mean(axis=2, keepdims=True), channels, axis=2)
    return np.ascontiguousarray(image)


def _image(planes: FloatImage, layer: Layer) -> FloatImage:
    """``(3, H, W)`` as ``(H, W, C)`` with as many channels as the layer has."""
    image = planes.transpose(1, 2, 0)
    if layer.data.shape[2] == 1:
        image = image.mean(axis=2, keepdims=True)
    return np.ascontiguousarray(image, np.float32)
