"""DnCNN at run time: a denoiser for photographs and tone-mapped renders.

The network, its paper and its training are in `lambent.learn.networks.dncnn` and `learn.photo`. It
reads display values in [0, 1] and knows nothing of light, so colour goes through the sRGB transfer
and back. Radiance (an EXR) is shown first: at the exposure of `frame.tonemap`; what is brighter
than white keeps what it has beyond white, untouched, so that no light is lost without a word.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from lambent.denoise import runtime
from lambent.denoise.model_file import ModelFile, loaded_model
from lambent.errors import LayerError
from lambent.filters.denoiser import About, Denoiser
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.ldr import exposure_of, is_display
from lambent.frame.role import Role
from lambent.frame.tonemap import inverse_srgb, srgb


@dataclass(frozen=True)
class DnCNN(Denoiser):
    """Residual learning of additive noise, of any level up to 55/255.

    ``weights``: another model file, such as `lambent train` makes. ``threads``: of the network.
    """

    about: ClassVar[About] = About(
        name="dncnn",
        title="DnCNN, for photographs",
        paper="Zhang et al. 2017",
        cost="20 convolutions of 64 filters, 667 kMAC a pixel",
        when="photographs with strong grain (sigma above 25 of 255; weaker: oidn); not renders",
        group="work",
        linear=False,
    )

    weights: str | None = None
    threads: int | None = None
    _exposure: float | None = field(default=None, repr=False, compare=False)

    def margin(self) -> int:
        """A pixel for each layer."""
        return int(self.card()["margin"])

    def fitted(self, frame: Frame) -> DnCNN:
        """A copy that shows tiles at the exposure of the whole frame."""
        return dataclasses.replace(self, _exposure=exposure_of(frame))

    def model(self) -> ModelFile:
        """The model file. Raises `FileError` and `DamagedFileError`."""
        return loaded_model(self.weights or self.about.name, "pixels")

    def card(self) -> dict[str, Any]:
        """The card of the model file."""
        return dict(self.model().card)

    def bytes_per_pixel(self, channels: int) -> int:
        """Two layers of 64 activations, and the pictures."""
        return 4 * (3 * 64 + 8 * channels)

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """Whether the frame is what the network knows."""
        if is_display(frame):
            return ()
        return (
            "dncnn is for photographs: radiance was tone-mapped for it, and what is brighter than "
            "white was left as it is",
        )

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter a stack of channels, three by three as colours, what is left as grey."""
        count = targets.shape[2]
        edges = [*range(0, count - count % 3, 3), *range(count - count % 3, count)]
        pieces = [targets[:, :, a : a + (3 if a + 3 <= count else 1)] for a in edges]
        return np.concatenate([self._clean(frame, p, False) for p in pieces], axis=2)

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """Every layer by itself; alpha as the linear grey picture that it is."""
        return [self._clean(frame, la.data, la.role is Role.ALPHA) for la in layers]

    def clean_display(self, picture: FloatImage) -> FloatImage:
        """Display values ``(H, W, C)``, nominally in [0, 1], cleaned; one or three channels.

        Whatever number of channels the network reads. Raises `LayerError` for others.
        """
        channels = int(self.card()["channels"])
        own = picture.shape[2]
        if channels == 3:
            stack = np.repeat(picture, 3, axis=2) if own == 1 else picture
            if stack.shape[2] != 3:
                raise LayerError(f"dncnn cleans one or three channels, not {own}")
            found = self._run(stack.transpose(2, 0, 1))
            return found.mean(0)[:, :, None] if own == 1 else found.transpose(1, 2, 0)
        each = [self._run(picture[:, :, c][None])[0] for c in range(own)]
        return np.stack(each, axis=2)

    # --------------------------------------------------------------- private

    def _clean(self, frame: Frame, image: FloatImage, is_alpha: bool) -> FloatImage:
        if is_alpha:
            return self.clean_display(image).astype(np.float32)
        exposure = exposure_of(frame) if self._exposure is None else self._exposure
        linear = image * np.float32(exposure)
        within = np.clip(linear, 0, 1)
        clean = inverse_srgb(np.clip(self.clean_display(srgb(within)), 0, 1))
        beyond = linear - within
        return ((clean + beyond) / np.float32(exposure)).astype(np.float32)

    def _run(self, planes: FloatImage) -> FloatImage:
        shapes = [(int(self.card()["channels"]), 1)]
        with runtime.network(self.model(), shapes, "f32", self.threads) as network:
            ready = np.ascontiguousarray(planes[None], np.float32)
            return network.outputs(ready)[0][0].copy()
