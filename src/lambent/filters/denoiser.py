"""What a denoiser is, and the one registry of them.

A denoiser maps a `Frame` to a `Frame`. Classical filters, networks and OIDN are all of this form;
other people's packages join through the entry-point group ``lambent.denoisers`` (an entry names a
subclass of `Denoiser`; see ``docs/guides/plugins.md``).

The generic filter behind most of them is the weighted average

    ĉ_p = Σ_q w_pq c_q,   Σ_q w_pq = 1                                            (1)

whose weights come from the frame (its colour, its features, their variances) and are then applied
to *every* target layer alike. That is why `Denoiser.filter` gets the targets apart from the frame:
lighting layers filtered with the weights of the beauty still sum to the beauty, and a delta image
as a target shows the weights themselves (`lambent.filters.explain`).
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from lambent.errors import LayerError, OptionError, UnknownNameError
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Stat
from lambent.progress import Progress
from lambent.registry import Registry


@dataclass(frozen=True)
class About:
    """What `lambent models` prints of a denoiser.

    ``needs`` and ``uses``: roles (``"colour"``, ``"colour.variance"``) without which it cannot
    work, and that it profits from. A need with alternatives is written ``"a|b"``.
    ``linear``: whether the output is linear in the targets, with weights from the frame alone.
    ``cost``: in words a person can compare ("441 taps a pixel"). ``when``: when to take it.
    ``group``: for work, a paper's method as published, or the floor of a comparison.
    """

    name: str
    title: str
    paper: str
    needs: tuple[str, ...] = ("colour",)
    uses: tuple[str, ...] = ()
    cost: str = ""
    when: str = ""
    linear: bool = True
    group: Literal["work", "paper", "floor"] = "paper"


class Denoiser:
    """Base of all denoisers. Subclasses are frozen dataclasses whose fields are the parameters.

    A subclass gives `about`, `filter` and `margin`; `fitted` where something is measured over the
    whole frame. `__call__` does the rest.
    """

    about: ClassVar[About]

    # ------------------------------------------------------- for subclasses

    def filter(self, frame: Frame, targets: FloatImage) -> FloatImage:
        """Filter ``targets`` ``(H, W, C)`` float32 with weights found from ``frame``.

        The first three channels of ``targets`` are the beauty when `__call__` asks; a linear
        denoiser must treat all channels alike. Arguments are never changed.
        """
        raise NotImplementedError

    def filter_layers(self, frame: Frame, layers: Sequence[Layer]) -> list[FloatImage]:
        """Filter whole layers, the beauty first; one image for each, channels as they were.

        What pipelines call. Here: all layers in one stack through `filter`, so that they get the
        same weights; a beauty of one channel counts as a grey one of three. A denoiser that is
        not linear overrides this, since it must know which channels belong together.
        """
        images = [layer.data for layer in layers]
        grey = images[0].shape[2] == 1
        if grey:
            images[0] = np.repeat(images[0], 3, axis=2)
        stack = images[0] if len(images) == 1 else np.concatenate(images, axis=2)
        ends = np.cumsum([image.shape[2] for image in images])
        pieces = np.split(self.filter(frame, stack), ends[:-1], axis=2)
        if grey:
            pieces[0] = pieces[0].mean(axis=2, keepdims=True, dtype=np.float32)
        return pieces

    def margin(self) -> int:
        """Radius in pixels of what a result pixel may depend on: the margin that tiles need."""
        raise NotImplementedError

    def alignment(self) -> int:
        """A part of a frame must begin at multiples of this, or its weights are others."""
        return 1

    def fitted(self, frame: Frame) -> Denoiser:
        """A copy whose frame-wide constants (exposure, depth range) are those of ``frame``.

        Called once for a whole frame before it is cut into tiles, so that tiles agree.
        """
        return self

    def watched(self, progress: Progress | None) -> Denoiser:
        """A copy that tells ``progress`` how much of a filtering is done.

        Denoisers that cannot tell return themselves.
        """
        return self

    def card(self) -> Mapping[str, Any]:
        """How a learned model came about: data, recipe, hours, scores. Nothing for the others."""
        return {}

    def at_strength(self, strength: float) -> tuple[Denoiser, float]:
        """The denoiser for a strength in (0, 1], and the share of its result in the blend.

        Here: itself, and the strength. A denoiser that can be asked to keep more of the input
        does that first, before anything is blended.
        """
        return self, strength

    def remarks(self, frame: Frame) -> tuple[str, ...]:
        """What a person should know about this frame with this model, one sentence each."""
        return ()

    def bytes_per_pixel(self, channels: int) -> int:
        """Working memory for a pixel with ``channels`` target channels, for choosing tiles."""
        return 4 * (4 * channels + 64)

    # ------------------------------------------------------------ for users

    def __call__(self, frame: Frame, passes: str | Iterable[str] = "all") -> Frame:
        """The frame with its beauty and the chosen lighting layers denoised.

        ``passes``: ``"beauty"``, ``"all"`` or names of layers. Variances and half buffers of what
        was filtered are dropped: they no longer describe it.
        Raises `LayerError` where the frame lacks what the denoiser needs.
        """
        self.check(frame)
        chosen = choose_passes(frame, passes)
        cleaned = self.fitted(frame).filter_layers(frame, chosen)
        result = frame.noted(*self.remarks(frame))
        for layer, image in zip(chosen, cleaned, strict=True):
            result = result.with_layer(layer.with_data(image))
        stale = [
            (layer.role, stat)
            for layer in chosen
            for stat in (Stat.VARIANCE, Stat.HALF_A, Stat.HALF_B)
        ]
        return result.without(*stale)

    def check(self, frame: Frame) -> None:
        """Raise `LayerError` unless the frame has everything in ``about.needs``."""
        from lambent.frame.role import parse_role

        for need in self.about.needs:
            keys = [parse_role(n) for n in need.split("|")]
            if not any(frame.has(*key) for key in keys):
                error = frame.missing(*keys[0])
                remedy, ours = error.remedy, f"{self.about.name}-tuned"
                if ours in DENOISERS and need not in DENOISERS[ours].about.needs:
                    remedy = f"take the model {ours}, which does without; or {remedy}"
                raise LayerError(
                    f"the model '{self.about.name}' needs {need.replace('|', ' or ')}: "
                    f"{error.message}",
                    file=frame.path,
                    remedy=remedy,
                )


def choose_passes(frame: Frame, passes: str | Iterable[str] = "all") -> list[Layer]:
    """The layers that a choice of passes names, the beauty first.

    Names may be full ("ViewLayer.Diffuse Direct"), the last part ("Diffuse Direct") or a role.
    Raises `UnknownNameError` for a name that is no layer of radiance in this frame.
    """
    beauty = frame.layer(Role.COLOUR)
    if beauty is None:
        raise frame.missing(Role.COLOUR)
    lighting = frame.lighting()
    alpha = frame.layer(Role.ALPHA)
    if isinstance(passes, str):
        if passes == "beauty":
            return [beauty]
        if passes == "all":
            return [beauty, *lighting.values()]
        if not passes.strip(" ,"):
            raise OptionError("no pass is named", remedy="take 'beauty', 'all' or names of layers")
        passes = [p.strip() for p in passes.split(",") if p.strip()]
    by_name = dict(lighting)
    if alpha is not None:
        by_name["alpha"] = alpha
    chosen = [beauty]
    for name in passes:
        if name in ("beauty", "colour", "color", beauty.name):
            continue
        layer = by_name.get(name)
        if layer is None:
            low = name.lower()
            for full, candidate in by_name.items():
                if low in (full.lower(), full.lower().rsplit(".", 1)[-1], candidate.role.value):
                    layer = candidate
                    break
        if layer is None:
            known = ["beauty", "all", *by_name]
            raise UnknownNameError("pass", name, known, file=frame.path)
        if layer not in chosen:
            chosen.append(layer)
    return chosen


# ------------------------------------------------------------------ registry

#: Every denoiser by name. An entry is the class; `create` makes an instance.
#: A name alone is the paper's form; with "-tuned" it is ours.
DENOISERS = Registry(
    "model",
    {
        "auto": "lambent.denoise.auto:Auto",
        "lambent-oidn": "lambent.denoise.mean:Mean",
        "lambent": "lambent.denoise.learned:Lambent",
        "lambent-fast": "lambent.denoise.learned:LambentFast",
        "lambent-best": "lambent.denoise.learned:LambentBest",
        "kpcn": "lambent.denoise.papers:KPCN",
        "dpcn": "lambent.denoise.papers:DPCN",
        "modular": "lambent.denoise.papers:Modular",
        "dncnn": "lambent.denoise.dncnn:DnCNN",
        "oidn": "lambent.filters.oidn:OIDN",
        "oidn-balanced": "lambent.filters.oidn:OIDNBalanced",
        "oidn-fast": "lambent.filters.oidn:OIDNFast",
        "oidn-best": "lambent.filters.oidn:OIDNBest",
        "box": "lambent.filters.box:Box",
        "gaussian": "lambent.filters.gaussian:Gaussian",
        "bilateral": "lambent.filters.bilateral:Bilateral",
        "cross-bilateral": "lambent.filters.cross_bilateral:CrossBilateral",
        "nlm": "lambent.filters.nlm:NonLocalMeans",
        "joint-nlm": "lambent.filters.nlm:JointNonLocalMeans",
        "atrous": "lambent.filters.atrous:ATrous",
        "atrous-tuned": "lambent.filters.atrous_tuned:ATrousTuned",
        "sbf": "lambent.filters.sbf:SUREFilter",
        "sbf-tuned": "lambent.filters.sbf_tuned:SUREFilterTuned",
        "aaf": "lambent.filters.aaf:AxisAligned",
        "nfor": "lambent.filters.nfor:NFOR",
        "nfor-tuned": "lambent.filters.nfor_tuned:NFORTuned",
        "statmc": "lambent.filters.statmc:StatMC",
        "statmc-tuned": "lambent.filters.statmc_tuned:StatMCTuned",
    },
    group="lambent.denoisers",
)

#: How far a denoiser may look, in pixels: kernels are compiled tap by tap, and tiles need margins.
FARTHEST = 256

#: What `lambent denoise` takes unless told otherwise.
DEFAULT_MODEL = "auto"


def parameters(model: str) -> dict[str, tuple[Any, Any]]:
    """Name -> (type, default) of every parameter of a model."""
    kind = DENOISERS[model]
    hints = typing.get_type_hints(kind)
    return {
        f.name: (hints[f.name], f.default)
        for f in dataclasses.fields(kind)
        if not f.name.startswith("_")
    }


def create(model: str, **options: Any) -> Denoiser:
    """A denoiser by name, with parameters: ``create("nlm", radius=7)``.

    Values may be strings (from the command line); they are converted to the parameter's type.
    Raises `UnknownNameError` for an unknown model or parameter, `OptionError` for a bad value.
    """
    kind = DENOISERS[model]
    known = parameters(model)
    values = {}
    for name, value in options.items():
        key = name.replace("-", "_")
        if key not in known:
            if model == DEFAULT_MODEL:
                raise OptionError(
                    f"'{model}' has no parameter '{name}'",
                    remedy="name the model that has it: --model nlm, or model='nlm'",
                )
            raise UnknownNameError("parameter", name, known, owner=model)
        values[key] = _sound(model, key, _convert(model, key, value, known[key][0]))
    denoiser = kind(**values)
    assert isinstance(denoiser, Denoiser)
    if denoiser.margin() > FARTHEST:
        asked = ", ".join(f"{key}={value}" for key, value in values.items()) or "these defaults"
        raise OptionError(
            f"'{model}' with {asked} would look {denoiser.margin()} pixels far",
            remedy=f"take a smaller window: it may reach {FARTHEST} pixels",
        )
    return denoiser


def _sound(model: str, name: str, value: Any) -> Any:
    """The value, unless it is a number that no parameter can be."""
    if isinstance(value, (int, float)) and not (math.isfinite(value) and value >= 0):
        raise OptionError(
            f"'{name}' of '{model}' cannot be {value:g}",
            remedy=f"its default is {parameters(model)[name][1]}; see lambent models {model}",
        )
    return value


def _convert(model: str, name: str, value: Any, wanted: Any) -> Any:
    if not isinstance(value, str):
        return value
    text = value.strip()
    choices = typing.get_args(wanted)
    if type(None) in choices:
        if text.lower() in ("none", "auto"):
            return None
        wanted = next(c for c in choices if c is not type(None))
        choices = typing.get_args(wanted)
    try:
        if typing.get_origin(wanted) is Literal:
            named = {str(choice): choice for choice in choices}  # numbers come as text, too
            if text not in named:
                raise OptionError(
                    f"'{name}' of '{model}' cannot be '{text}'",
                    remedy=f"take one of {', '.join(named)}",
                )
            return named[text]
        if wanted is bool:
            return {
                "1": True,
                "true": True,
                "yes": True,
                "on": True,
                "0": False,
                "false": False,
                "no": False,
                "off": False,
            }[text.lower()]
        if wanted in (int, float):
            return wanted(text)
    except (KeyError, ValueError):
        kind = getattr(wanted, "__name__", str(wanted))
        raise OptionError(
            f"'{name}' of '{model}' needs a value of type {kind}, not '{text}'"
        ) from None
    return text


def guides(frame: Frame) -> list[Layer]:
    """The feature layers of a frame that filters may look at (means), in order of `Role`."""
    return [layer for role in Role if INFO[role].guide and (layer := frame.layer(role)) is not None]
