"""The model for the file at hand: what `lambent denoise` takes unless it is asked for another.

A renderer that splats samples with a wide pixel filter makes noise that neighbouring pixels share.
Open Image Denoise takes it for texture; Lambent's network knows it. Everywhere else the mean of
both has the least error (docs/notes/denoiser.md). So a frame with such noise (`frame.noise`) gets
`lambent`, any other `lambent-oidn`. Photographs, whose neighbours are alike by nature, get `oidn`,
which is ahead where grain is weak (docs/guides/photographs.md); strong grain is for `dncnn`, which
nothing here chooses. Where Open Image Denoise is not installed it is always `lambent`.
The choice is one for all views of a file and all frames of a shot.
"""

from __future__ import annotations

import dataclasses
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from lambent.denoise.learned import Lambent
from lambent.device import Device
from lambent.filters.denoiser import About, Denoiser, create
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.ldr import is_display
from lambent.frame.noise import noise_of


@dataclass(frozen=True)
class Choice:
    """The name of a model, and the reason in a few words."""

    model: str
    reason: str

    def sentence(self) -> str:
        """The line that a person reads."""
        return f"chose the model {self.model}: {self.reason}"


def choose(frame: Frame) -> Choice:
    """The model for a frame that has a colour; damaged pixels do no harm."""
    if importlib.util.find_spec("mitsuba_oidn") is None:
        return Choice("lambent", "Open Image Denoise is not installed (package mitsuba-oidn)")
    if is_display(frame):
        return Choice("oidn", "the file holds display values, as photographs do")
    noise = noise_of(frame)
    if noise.splatted:
        return Choice(
            "lambent",
            f"the noise of neighbouring pixels correlates by {noise.correlation:.2f}, as splatted "
            "pixel filters make it",
        )
    return Choice("lambent-oidn", "no sign of a splatted pixel filter")


@dataclass(frozen=True)
class Auto(Denoiser):
    """`lambent` for splatted pixel filters, `oidn` for photographs, else `lambent-oidn`.

    ``threads``, ``device``: theirs.

    The choice is made by `fitted`, from the whole frame.
    """

    about: ClassVar[About] = About(
        name="auto",
        title="The better of lambent and lambent-oidn for the file at hand; oidn for photographs",
        paper="none: it chooses by the file",
        group="work",
        uses=Lambent.about.uses,
        cost="that of the model it takes",
        when="always, unless you know better",
        linear=False,
    )

    threads: int | None = None
    device: Device = "auto"
    _chosen: Denoiser | None = field(default=None, repr=False, compare=False)

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """By the chosen model."""
        return self._model(frame).filter(frame, targets)

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """By the chosen model."""
        return self._model(frame).filter_layers(frame, layers)

    def margin(self) -> int:
        """The larger of both."""
        return (self._chosen or create("lambent-oidn")).margin()

    def alignment(self) -> int:
        """The larger of both."""
        return (self._chosen or create("lambent-oidn")).alignment()

    def fitted(self, frame: Frame) -> Auto:
        """A copy that has chosen."""
        return dataclasses.replace(self, _chosen=self._model(frame).fitted(frame))

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """The choice and the reason, and what the chosen model has to say."""
        return (choose(frame).sentence(), *self._model(frame).remarks(frame))

    def bytes_per_pixel(self, channels: int) -> int:
        """At most what both need together."""
        return (self._chosen or create("lambent-oidn")).bytes_per_pixel(channels)

    def _model(self, frame: Frame) -> Denoiser:
        if self._chosen is not None:
            return self._chosen
        return create(choose(frame).model, threads=self.threads, device=self.device)
