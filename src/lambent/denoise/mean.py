"""The mean of Open Image Denoise and Lambent's own network, with layers that still sum.

One denoiser predicts pixels, the other kernels; their errors have little to do with each other, and
the mean of both has less error than either (docs/notes/denoiser.md has the figures).

Let F be Lambent's kernels and O Open Image Denoise (quality high). For the beauty c

    out = (F(c) + O(c)) / 2.

Lighting layers lᵢ and alpha are cleaned by F alone, with the same kernels as the beauty, which
costs no further network. Where lᵢ (times factors aᵢ, see `filters.sums`) add up to the beauty,
the difference (O(c) − F(c)) / 2 is shared out among them in proportion to |aᵢ F(lᵢ)|; so they add
up to ``out`` to float rounding, and one that is dark stays dark. Where all layers of a sum are 0 in
a pixel there is nothing to share by, and the beauty keeps F(c). Layers in no sum keep F(lᵢ).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from lambent.denoise.learned import Lambent
from lambent.device import Device
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.oidn import OIDN
from lambent.filters.sums import FrameSums, keep_sums, lighting_among
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.progress import Progress, part_of

#: The share of the time that the network takes; the rest is OIDN's.
_NETWORK = 0.25


@dataclass(frozen=True)
class Mean(Denoiser):
    """The mean of `oidn` and `lambent`.

    ``threads``: of both. ``device``: of the network, as for `lambent`; OIDN takes the fastest
    device it has unless that is ``"cpu"``.
    """

    about: ClassVar[About] = About(
        name="lambent-oidn",
        title="The mean of Open Image Denoise and lambent",
        paper="docs/notes/denoiser",
        group="work",
        uses=Lambent.about.uses,
        cost="both networks, 223 kMAC a pixel, once for all layers",
        when="pixel filters that are not splatted; what `auto` takes for them",
        linear=False,
    )

    threads: int | None = None
    device: Device = "auto"
    _fitted: tuple[Lambent, OIDN, FrameSums] | None = field(default=None, repr=False, compare=False)
    _progress: Progress | None = field(default=None, repr=False, compare=False)

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """The mean of both for a whole stack. Does not keep sums, as `filter_layers` does."""
        one, other = (part.filter(frame, targets) for part in self._parts())
        return (one + other) * np.float32(0.5)

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """The mean for the beauty; the others by kernels, and what the sums ask for."""
        kernels, oidn = self._parts()
        cleaned = kernels.filter_layers(frame, layers)
        if self._progress is not None:
            self._progress(_NETWORK, 1, "filtering")
        (other,) = oidn.filter_layers(frame, layers[:1])
        mean = (cleaned[0] + other) * np.float32(0.5)
        lighting = lighting_among(layers)
        if len(lighting) > 1:
            whole = self._fitted[2] if self._fitted is not None else FrameSums(frame)
            sums = whole.among(frame, [layers[0], *(layers[i] for i in lighting)])
            images = [cleaned[i] for i in lighting]
            for members in sums:
                size = sum((np.abs(t.of(images)) for t in members), start=np.float32(0))
                mean = np.where(size > np.finfo(np.float32).tiny, mean, cleaned[0])
            for i, image in zip(lighting, keep_sums(mean, images, sums), strict=True):
                cleaned[i] = image
        return [mean, *cleaned[1:]]

    def margin(self) -> int:
        """The larger of both."""
        return max(part.margin() for part in self._parts())

    def alignment(self) -> int:
        """The larger of both, which are powers of two."""
        return max(part.alignment() for part in self._parts())

    def fitted(self, frame: Frame) -> Mean:
        """A copy with the exposures and sums of the whole frame."""
        kernels, oidn = self._parts()
        parts = (kernels.fitted(frame), oidn.fitted(frame), FrameSums(frame))
        return dataclasses.replace(self, _fitted=parts)

    def watched(self, progress: Progress | None) -> Mean:
        """A copy that reports its progress."""
        return dataclasses.replace(self, _progress=progress)

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """Those of OIDN."""
        return self._parts()[1].remarks(frame)

    def bytes_per_pixel(self, channels: int) -> int:
        """Both keep their memory for the next frame."""
        return sum(part.bytes_per_pixel(channels) for part in self._parts())

    # --------------------------------------------------------------- private

    def _parts(self) -> tuple[Lambent, OIDN]:
        """Both denoisers, fitted if this one is, OIDN with the progress."""
        if self._fitted is not None:
            kernels, oidn, _ = self._fitted
        else:
            kernels = Lambent(threads=self.threads, device=self.device)
            device: Device = "cpu" if self.device == "cpu" else "auto"
            oidn = OIDN(threads=self.threads, device=device)
        return kernels, oidn.watched(self._rest())

    def _rest(self) -> Progress | None:
        """Progress of OIDN as progress of the whole."""
        if self._progress is None:
            return None
        return part_of(self._progress, _NETWORK, 1 - _NETWORK, 1)
