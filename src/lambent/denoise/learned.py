"""Lambent's own denoiser: kernels predicted by a small network, applied to every layer alike.

prepare (`denoise.prepare`) → predict (`denoise.runtime`) → filter (`kernels.pyramid`) → merge, done
by the engine of a device (`denoise.engines`). The
network looks once at colour, guides and variances, whatever of them there is. Its kernels are
weights of averages, and the same ones filter the beauty, all lighting layers and alpha:

    out = g · d · F(layer / d) + (1 - g) · F(layer)

with F the pyramid of kernels, d the albedo, cleaned by kernels of its own, g a gate; alpha is
F(alpha). Each is linear in the layer, so layers that sum to the beauty still do, grey stays grey,
and coverage stays in [0, 1].
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from lambent.denoise import prepare, runtime
from lambent.denoise.engines import Work, engine
from lambent.denoise.model_file import ModelFile, loaded_model
from lambent.denoise.processor import AT_ONCE, GATE
from lambent.device import Device
from lambent.errors import OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import Role
from lambent.kernels.pyramid import as_floats, compile_all, padded
from lambent.kernels.pyramid import weights_at as pyramid_weights

#: Pixels that a result may depend on, measured (tests/denoise/test_learned.py).
_MARGIN = 192
_BYTES, _BYTES_A_CHANNEL = 600, 16


@dataclass(frozen=True)
class Lambent(Denoiser):
    """Lambent's own network.

    ``preference``: 0 asks for the least error; towards 1 for keeping what might be detail, and
    with it some noise. ``weights``: another model file, such as `lambent train` makes.
    ``views``: 2 looks at the frame once more, turned by half, and takes the mean (`denoise.views`):
    mostly some hundredths of the error less, for nearly twice the time of the network.
    ``precision``: ``"f32"`` computes in float32 where bfloat16 would be faster. ``threads``: of
    the network. ``device``: ``"cuda"`` computes with PyTorch on an NVIDIA GPU; else the processor
    does it (`denoise.engines`).
    """

    about: ClassVar[About] = About(
        name="lambent",
        title="Lambent's own network, kernels on a pyramid",
        paper="after Bako 2017, Vogels 2018, Balint 2023",
        uses=(
            "albedo", "normal", "depth", "roughness", "alpha",
            "colour.variance", "albedo.variance", "normal.variance", "depth.variance",
        ),
        cost="a U-Net, 98 kMAC a pixel, once for all layers; 34 taps on five scales",
        when="frames with many layers, splatted pixel filters",
        group="work",
    )  # fmt: skip

    #: Name of the model file.
    file: ClassVar[str] = "lambent"

    preference: float = 0.0
    weights: str | None = None
    views: Literal[1, 2] = 1
    precision: Literal["auto", "f32"] = "auto"
    threads: int | None = None
    device: Device = "auto"
    _whole: prepare.Whole | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not 0 <= self.preference <= 1:
            raise OptionError(
                f"'preference' of '{self.about.name}' cannot be {self.preference:g}",
                remedy="0 for the least error, up to 1 for keeping what might be detail",
            )

    # ------------------------------------------------------------- denoising

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter a stack of channels; each group of three is divided by the albedo's channels."""
        count = targets.shape[2]
        edges = [*range(0, count - count % 3, 3), *range(count - count % 3, count + 1)]
        pieces = [targets[:, :, a:b] for a, b in itertools.pairwise(edges)]
        return np.concatenate(self._filter(frame, pieces, [True] * len(pieces)), axis=2)

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """Every layer with the same kernels; alpha without the albedo."""
        images = [layer.data for layer in layers]
        return self._filter(frame, images, [layer.role is not Role.ALPHA for layer in layers])

    def weights_at(self, frame: Frame, x: int, y: int) -> FloatImage:
        """The weights ``(H, W)`` of pixel (x, y), all scales put together, with the mean albedo."""
        whole = self._whole or prepare.Whole.of(frame)
        given = prepare.Given.of(frame)
        with self._network() as network:
            packed = prepare.packed_inputs(given, whole, self.preference, "cpu", step=network.step)
            *levels, of_albedo = network(packed)
            d = prepare.divisors(given, of_albedo, "cpu")
            levels = [level.copy() for level in levels]
        height, width = frame.height, frame.width
        mask = np.zeros((padded(height), padded(width)), np.float32)
        mask[:height, :width] = 1
        found = pyramid_weights(levels, mask, x, y)[:height, :width]
        if d is None:
            return found
        own = d.planes[:, :height, :width].mean(axis=0)
        channel = GATE + 2 * (y % 2) + x % 2
        gate = 1 / (1 + np.exp(-float(as_floats(levels[0][channel])[y // 2, x // 2])))
        return np.asarray(found * (gate * own[y, x] / own + 1 - gate), np.float32)

    def at_strength(self, strength: float) -> tuple[Lambent, float]:
        """From 1 to 1/2 the preference rises to 1; below, its result is blended with the input.

        A preference that was set stays, and the strength blends.
        """
        if self.preference:
            return self, strength
        preference = min(1.0, 2 * (1 - strength))
        return dataclasses.replace(self, preference=preference), min(1.0, 2 * strength)

    def margin(self) -> int:
        """192: the reach of the network and of its coarsest kernels."""
        return _MARGIN

    def alignment(self) -> int:
        """32: a pixel of the coarsest level, and the two that the network packs into one."""
        return 32

    def fitted(self, frame: Frame) -> Lambent:
        """A copy with the exposure and the depth of the whole frame."""
        return dataclasses.replace(self, _whole=prepare.Whole.of(frame))

    def bytes_per_pixel(self, channels: int) -> int:
        """Inputs, activations, logits, and the planes of up to four layers (measured)."""
        return _BYTES + _BYTES_A_CHANNEL * min(2 * channels, 6 * AT_ONCE) + 4 * channels

    def model(self) -> ModelFile:
        """The model file. Raises `FileError` and `DamagedFileError`."""
        return _model(self.weights or self.file)

    def card(self) -> dict[str, Any]:
        """The card of the model file."""
        return dict(self.model().card)

    # --------------------------------------------------------------- private

    def _network(self) -> runtime.PyramidNetwork:
        return runtime.pyramid_network(self.model(), self.precision, self.threads, self.views)

    def _filter(
        self, frame: Frame, images: Sequence[FloatImage], divided: Sequence[bool]
    ) -> list[FloatImage]:
        work = Work(
            self.model(), prepare.Given.of(frame), self._whole or prepare.Whole.of(frame), images,
            divided, self.preference, self.views, self.precision, self.threads,
        )  # fmt: skip
        return engine(self.device)(work)


@dataclass(frozen=True)
class LambentFast(Lambent):
    """The same with a quarter of the work."""

    about: ClassVar[About] = dataclasses.replace(
        Lambent.about,
        name="lambent-fast",
        title="Lambent's own network, the small one",
        cost="a U-Net, 28 kMAC a pixel, once for all layers; 34 taps on five scales",
        when="previews, and many frames on a slow machine",
    )
    file: ClassVar[str] = "lambent-fast"


@dataclass(frozen=True)
class LambentBest(Lambent):
    """The same with two looks at the frame."""

    about: ClassVar[About] = dataclasses.replace(
        Lambent.about,
        name="lambent-best",
        title="Lambent's own network, with two looks",
        cost="a U-Net, 2 x 98 kMAC a pixel, once for all layers; 34 taps on five scales",
        when="final frames with splatted pixel filters",
    )
    views: Literal[1, 2] = 2


def prefetch(name: str) -> None:
    """Load a model, its network and its kernels, so that the first frame need not wait."""
    kind = {"lambent-fast": LambentFast, "lambent-best": LambentBest}.get(name, Lambent)
    kind()._network()
    compile_all()


def _model(name: str) -> ModelFile:
    return loaded_model(name, "signals")
