"""Open Image Denoise as a denoiser: the yardstick of Lambent's own network.

"Intel Open Image Denoise", Attila T. Áfra, 2019-2025, version 2.5 (``openimagedenoise.org``): a
U-Net that maps colour, albedo and normal to clean colour. Four models:

- ``oidn``: quality high, guides as they are.
- ``oidn-best``: albedo and normal are denoised first, each on its own, and then taken as clean
  (``clean_aux``): OIDN's strongest form.
- ``oidn-balanced``, ``oidn-fast``: smaller networks.

What Lambent adds around it:

- *Layers that sum.* OIDN is not linear: layers filtered one by one no longer add up. Every
  layer is filtered on its own with the same guides; where layers of the input add up to the
  beauty (`lambent.filters.sums`), what is missing afterwards is shared out among them.
- *Negative light.* OIDN takes it for 0. A layer that has some (light that subtracts, colours
  outside the gamut) is filtered as two, its positive part and its negative one turned positive,
  each with its own exposure; the result is their difference.
- *Grey stays grey.* A colour with three equal channels goes in as one channel; given three, OIDN
  tints it.
- *Coverage.* Alpha is filtered as radiance of one channel with the same guides, at a fixed
  exposure, and held to [0, 1]. As a display-referred image, which it resembles, noise of few
  samples would stay: OIDN takes an image of 0 and 1 for a clean one (error at 1, 4, 16, 64
  samples of a smooth cover: 0.53, 0.15, 0.026, 0.010; as radiance: 0.042, 0.021, 0.012, 0.009).
- *Tiles that agree.* OIDN exposes each image by itself. `OIDN.fitted` takes the exposure from the
  whole frame (`lambent.frame.exposure`). With tiles that begin at multiples of 16 and the
  margin that OIDN's own tiling uses (96 pixels; 112 for quality high with clean guides), tiled
  and untiled results are bit for bit equal. Measured on noise over texture, as the largest
  difference from the untiled pixel relative to it: margin 16: 0.15, 32: 0.1, 64: 0.02,
  80: 0 (high and fast); with clean guides 0.35, 0.25, 0.16, 0.04, and 0 from 96.
  A tile that begins elsewhere differs by up to 0.4 whatever the margin.

NaN counts as 0 in OIDN and an infinity spreads: repair frames first (`lambent.frame.repair`).
Colour below 0 by less than a thousandth of the mean counts as 0, albedo is held to [0, 1] and
normals to [-1, 1] by OIDN itself.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from lambent.device import Device
from lambent.errors import OptionError
from lambent.filters.denoiser import About, Denoiser
from lambent.filters.sums import FrameSums, has_negative_light, keep_sums, lighting_among
from lambent.frame.exposure import block_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import Role, Space
from lambent.kernels import oidn
from lambent.kernels.oidn import Options
from lambent.progress import Progress, part_of

#: Working memory of OIDN per pixel in bytes, measured at 1280x720 with both guides.
_BYTES = {"fast": 330, "balanced": 590, "high": 590}
_BYTES_LARGE = 735
#: The exposure of alpha, at which it is in the middle of the range that OIDN knows.
_ALPHA_SCALE = 0.3


@dataclass(frozen=True)
class _Look:
    """Facts of an image that decide how it is filtered; ``exposure`` None means automatic.

    ``lit``, ``grey`` and ``exposure`` are those of the positive part; ``negative``: of the other
    one turned positive, None where there is no negative light.
    """

    lit: bool
    grey: bool
    exposure: float | None = None
    negative: _Look | None = None


class _Whole:
    """What is known of the whole frame while its tiles are filtered; found when first asked."""

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self._looks: dict[str, _Look] = {}
        self.sums = FrameSums(frame)

    def look(self, layer: Layer) -> _Look:
        """The facts of the whole layer of that name, exposure included."""
        if layer.name not in self._looks:
            found = [own for own in self.frame.all_layers() if own.name == layer.name]
            if not found:  # not a layer of the frame: all there is to see is the tile
                return _look(layer.data)
            self._looks[layer.name] = _look(found[0].data, exposed=True)
        return self._looks[layer.name]


@dataclass(frozen=True)
class OIDN(Denoiser):
    """Open Image Denoise.

    ``quality``: the network's size. ``clean_aux``: albedo and normal have no noise.
    ``prefilter``: denoise them first (then they count as clean). ``albedo``, ``normal``: whether
    to look at them. ``hdr``, ``srgb``: None decides by the colour's space. ``input_scale``: None
    for automatic exposure. ``keep_grey``: filter grey colour as one channel.
    ``max_memory_mb``: limit for OIDN's own tiling. ``device``, ``threads``: where it runs.
    """

    about: ClassVar[About] = About(
        name="oidn",
        title="Open Image Denoise, high quality",
        paper="A. T. Áfra: Intel Open Image Denoise, 2019-2025 (version 2.5)",
        uses=("albedo", "normal", "alpha"),
        cost="a U-Net, 125 kMAC a pixel, for every layer",
        when="finished pictures with albedo and normal",
        group="work",
        linear=False,
    )

    quality: Literal["high", "balanced", "fast"] = "high"
    clean_aux: bool = False
    prefilter: bool = False
    albedo: bool = True
    normal: bool = True
    hdr: bool | None = None
    srgb: bool | None = None
    input_scale: float | None = None
    keep_grey: bool = True
    max_memory_mb: int | None = None
    device: Device = "auto"
    threads: int | None = None
    _whole: _Whole | None = field(default=None, repr=False, compare=False)
    _progress: Progress | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        model = self.about.name
        if self.quality not in _BYTES:
            raise OptionError(
                f"'quality' of '{model}' cannot be '{self.quality}'",
                remedy=f"take one of {', '.join(_BYTES)}",
            )
        for name in ("input_scale", "max_memory_mb", "threads"):
            value = getattr(self, name)
            if value is not None and not (value > 0 and np.isfinite(value)):
                raise OptionError(
                    f"'{name}' of '{model}' cannot be {value}",
                    remedy="give a positive number, or leave it out",
                )

    # ------------------------------------------------------------- denoising

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter a stack: three channels of beauty, then layers of three channels, or of one.

        Layers of three are assumed where the number of channels allows it; `filter_layers` needs
        no assumption. Does not keep sums.
        """
        count = targets.shape[2]
        step = 3 if count % 3 == 0 else 1
        first = 3 if count > 3 else count if count != 2 else 1
        edges = [0, *range(first, count, step), count]
        beauty = frame.layer(Role.COLOUR) or Layer(Role.COLOUR, targets[:, :, :first])
        guides = self._guides(frame)
        result = np.empty_like(targets)
        for begin, end in itertools.pairwise(edges):
            layer = beauty if begin == 0 else Layer(Role.LIGHTING, np.empty(0))
            layer = layer.with_data(targets[:, :, begin:end])
            result[:, :, begin:end] = self._clean(frame, layer, guides)
        return result

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """Each layer on its own with the same guides; sums of the input hold in the result."""
        guides = self._guides(frame)
        cleaned = []
        for index, layer in enumerate(layers):
            watch = part_of(self._progress, index, 1, len(layers)) if self._progress else None
            cleaned.append(self._clean(frame, layer, guides, watch))
        lighting = lighting_among(layers)
        if len(lighting) < 2:
            return cleaned
        whole = self._whole.sums if self._whole is not None else FrameSums(frame)
        sums = whole.among(frame, [layers[0], *(layers[i] for i in lighting)])
        kept = keep_sums(cleaned[0], [cleaned[i] for i in lighting], sums)
        for i, image in zip(lighting, kept, strict=True):
            cleaned[i] = image
        return cleaned

    def margin(self) -> int:
        """96 or 112: the overlap of OIDN's own tiles. Tiles begin at multiples of 16."""
        return oidn.overlap(Options(quality=self.quality, clean_aux=self._clean_guides))

    def fitted(self, frame: Frame) -> OIDN:
        """A copy that exposes every layer, and finds the sums, as in the whole of ``frame``."""
        return dataclasses.replace(self, _whole=_Whole(frame))

    def watched(self, progress: Progress | None) -> OIDN:
        """A copy that reports its progress; what the callback raises ends it."""
        return dataclasses.replace(self, _progress=progress)

    def bytes_per_pixel(self, channels: int) -> int:
        """OIDN's scratch memory (measured), the results, and prefiltered guides."""
        large = self.quality == "high" and self._clean_guides
        guides = 24 if self.prefilter else 0
        return (_BYTES_LARGE if large else _BYTES[self.quality]) + 4 * channels + guides

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """What OIDN makes of guides that are not what it expects."""
        found = []
        albedo = frame.get(Role.ALBEDO) if self.albedo else None
        if albedo is not None and float(albedo.max(initial=0)) > 1:
            count = int(np.count_nonzero((albedo > 1).any(axis=2)))
            found.append(f"OIDN holds albedo to 1: {count} pixels lie above")
        if self.normal and frame.has(Role.NORMAL) and not (self.albedo and frame.has(Role.ALBEDO)):
            found.append("OIDN takes normals only together with albedo: they were not used")
        light = [frame.layer(Role.COLOUR), *frame.lighting().values()]
        names = [la.name for la in light if la is not None and has_negative_light(la.data)]
        if names:
            found.append(
                "OIDN takes no negative light: what is positive and what is negative in "
                f"{', '.join(names)} is filtered apart"
            )
        return tuple(found)

    # --------------------------------------------------------------- private

    @property
    def _clean_guides(self) -> bool:
        return self.clean_aux or self.prefilter

    def _options(self, **changes: object) -> Options:
        plain = Options(
            quality=self.quality,
            max_memory_mb=self.max_memory_mb,
            device=self.device,
            threads=self.threads,
        )
        return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]

    def _guides(self, frame: Frame) -> dict[str, FloatImage]:
        albedo = frame.get(Role.ALBEDO) if self.albedo else None
        if albedo is None:  # OIDN refuses normals without albedo
            return {}
        guides = {"albedo": albedo}
        normal = frame.get(Role.NORMAL) if self.normal else None
        if normal is not None:
            guides["normal"] = normal
        if self.prefilter:
            options = self._options(hdr=False)
            guides = {name: oidn.clean({name: image}, options) for name, image in guides.items()}
        return guides

    def _clean(
        self,
        frame: Frame,
        layer: Layer,
        guides: dict[str, FloatImage],
        watch: Progress | None = None,
    ) -> FloatImage:
        image = layer.data
        whole = self._whole
        tiled = whole is not None and whole.frame is not frame
        look = whole.look(layer) if whole is not None and tiled else _look(image)
        alpha = layer.role is Role.ALPHA
        hdr = alpha or (layer.space is not Space.SRGB if self.hdr is None else self.hdr)
        srgb = layer.space is Space.SRGB if self.srgb is None else self.srgb
        options = self._options(
            hdr=hdr,
            srgb=srgb and not hdr and not alpha,
            clean_aux=self._clean_guides and bool(guides),
        )
        if alpha:
            options = dataclasses.replace(options, input_scale=_ALPHA_SCALE)
            return np.clip(self._clean_part(image, look, guides, options, watch), 0, 1)
        if look.negative is None or not hdr:
            return self._clean_part(image, look, guides, options, watch)
        watches = [part_of(watch, half, 1, 2) if watch else None for half in (0, 1)]
        above, below = np.maximum(image, 0), np.maximum(-image, 0)
        above = self._clean_part(above, look, guides, options, watches[0])
        below = self._clean_part(below, look.negative, guides, options, watches[1])
        return above - below

    def _clean_part(
        self,
        image: FloatImage,
        look: _Look,
        guides: dict[str, FloatImage],
        options: Options,
        watch: Progress | None,
    ) -> FloatImage:
        """An image without negative light."""
        if not look.lit:  # OIDN would return a faint glow
            return np.zeros_like(image)
        if options.hdr and options.input_scale is None:
            scale = look.exposure if self.input_scale is None else self.input_scale
            options = dataclasses.replace(options, input_scale=scale)
        grey = self.keep_grey and look.grey
        seen = image[:, :, :1] if grey else image
        result = oidn.clean({"color": seen, **guides}, options, watch)
        return np.repeat(result, 3, axis=2) if grey else result


@dataclass(frozen=True)
class OIDNBalanced(OIDN):
    """Open Image Denoise with quality balanced."""

    about: ClassVar[About] = dataclasses.replace(
        OIDN.about,
        name="oidn-balanced",
        title="Open Image Denoise, balanced",
        when="on a processor the same as oidn, in result and time",
    )
    quality: Literal["high", "balanced", "fast"] = "balanced"


@dataclass(frozen=True)
class OIDNFast(OIDN):
    """Open Image Denoise with quality fast."""

    about: ClassVar[About] = dataclasses.replace(
        OIDN.about,
        name="oidn-fast",
        title="Open Image Denoise, fast",
        cost="a U-Net, 62 kMAC a pixel, for every layer",
        when="previews",
    )
    quality: Literal["high", "balanced", "fast"] = "fast"


@dataclass(frozen=True)
class OIDNBest(OIDN):
    """Open Image Denoise with albedo and normal denoised first and then taken as clean."""

    about: ClassVar[About] = dataclasses.replace(
        OIDN.about,
        name="oidn-best",
        title="Open Image Denoise, prefiltered guides",
        cost="a U-Net, 312 kMAC a pixel, for albedo, normal and every layer",
        when="final frames, at seven times the time of oidn",
    )
    prefilter: bool = True


def is_grey(image: FloatImage) -> bool:
    """Whether the three channels of ``(H, W, 3)`` are equal in every pixel."""
    sparse = image[::16, ::16]  # nearly every coloured picture ends here
    for part in (sparse, image):
        first = part[:, :, :1]
        if not bool((part[:, :, 1:] == first).all()):
            return False
    return True


def _look(image: FloatImage, exposed: bool = False) -> _Look:
    """The facts of an image; ``exposed``: with its exposure."""
    negative = None
    if has_negative_light(image):
        negative = _look(np.maximum(-image, 0), exposed)
        image = np.maximum(image, 0)
    lit = bool(image.any())
    grey = lit and image.shape[2] == 3 and is_grey(image)
    return _Look(lit, grey, block_exposure(image) if exposed and lit else None, negative)
