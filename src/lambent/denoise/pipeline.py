"""From a noisy frame to a clean one: repair, filter, blend, and what to do about alpha.

The order and the reasons:

1. *Repair*: NaN, infinite, negative and huge pixels are counted and mended before any filter
   could spread them (`lambent.frame.repair`).
2. *Filter*: one call for the beauty and all chosen lighting layers, so that a linear filter gives
   all of them the same weights and they still sum. Fitted once to the whole frame, then in tiles
   where memory is short.
3. *Alpha*: coverage is filtered along with the colour in those pixels where it is noisy (smoke,
   depth of field, motion blur: `denoise.coverage`), unless the caller decides; all others keep it
   bit for bit. What is filtered is held to [0, 1]; elsewhere colour (premultiplied) is kept from
   spilling to where there was neither coverage nor light.
4. *Strength*: a denoiser that can keep more of the input is asked to (`Denoiser.at_strength`);
   then ``(1 − s) · input + s · result``, for every layer alike, so sums hold here too.

What is repaired is written where the layer is filtered, and in alpha; guides, and layers that were
not chosen, are repaired for the filter only and come back as they were, which the notes say.

How much light the beauty has gained or lost is told: a filter redistributes fireflies, and what it
gives their surroundings is less than they had. Where it is asked for, they get all of it
(`denoise.light`), before 4.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from lambent import memory
from lambent.denoise.coverage import Mask, exact, noisy_coverage
from lambent.denoise.light import keep_light
from lambent.denoise.model_file import as_denoiser
from lambent.denoise.tiles import Plan, filter_tiles, plan_tiles
from lambent.device import check_device
from lambent.errors import LayerError, OptionError
from lambent.filters.denoiser import (
    DEFAULT_MODEL,
    DENOISERS,
    Denoiser,
    choose_passes,
    create,
    parameters,
)
from lambent.frame.frame import Frame
from lambent.frame.guides import split
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Stat, parse_role
from lambent.progress import Progress

if TYPE_CHECKING:
    from lambent.frame.repair import Repairs

#: A change of the total light below this is not worth a word.
LIGHT_CHANGE = 0.03

#: Without a limit from the caller, filtering may take this share of the memory that is free.
FREE_SHARE = 0.8

#: Of a memory limit, this share is left for what no plan foresees.
RESERVE = 0.1

#: A filter that cannot tell how far it is works on large frames in tiles of so many pixels, for
#: the sake of a progress that moves, if its margin is small enough to cost next to nothing.
SILENT_PIXELS = 1 << 20
SMALL_MARGIN = 40


@dataclass(frozen=True)
class Settings:
    """What to do to a frame. `checked` makes one from loose options and refuses nonsense.

    ``passes``: ``"beauty"``, ``"all"`` or names. ``strength`` in [0, 1]. ``keep_light``: give light
    that was lost back to where it was lost (`denoise.light`). ``alpha``: filter the
    coverage too, or None for "where it is noisy". ``roles``: role to layer name or guide file, as
    in ``--map``. ``spp``: samples per pixel, None for what the file tells. ``max_memory`` in
    bytes, for the whole process. ``threads``: None for all. ``params``: of the model. ``remark``:
    what to note on every frame, such as why this model was chosen for it.
    """

    model: str = DEFAULT_MODEL
    passes: str | tuple[str, ...] = "all"
    strength: float = 1.0
    keep_light: bool = False
    alpha: bool | None = None
    roles: Mapping[str, str] = field(default_factory=dict)
    spp: int | None = None
    max_memory: int | None = None
    threads: int | None = None
    device: str = "auto"
    params: Mapping[str, Any] = field(default_factory=dict)
    remark: str = ""

    @classmethod
    def checked(
        cls,
        model: str = DEFAULT_MODEL,
        passes: str | Iterable[str] = "all",
        strength: float = 1.0,
        keep_light: bool = False,
        alpha: bool | None = None,
        roles: Mapping[str, str] | None = None,
        albedo: str | Path | None = None,
        normal: str | Path | None = None,
        spp: int | None = None,
        max_memory: str | int | None = None,
        threads: int | None = None,
        device: str = "auto",
        params: Mapping[str, Any] | None = None,
    ) -> Settings:
        """Settings from options as people give them.

        ``model`` may be the path of a model file. Raises `UnknownNameError` for an unknown model,
        role or parameter, `OptionError` for a value that makes no sense, `FileError` for a file
        that holds no model.
        """
        model, named = as_denoiser(model, params or {})
        if model not in DENOISERS:
            DENOISERS[model]  # raises, naming the nearest
        if not 0.0 <= strength <= 1.0:
            raise OptionError(
                f"strength {strength:g} is outside 0 to 1",
                remedy="0 leaves the frame as it is, 1 takes the denoised one",
            )
        check_device(device)
        if threads is not None and threads < 1:
            raise OptionError(
                f"threads must be 1 or more, not {threads}", remedy="leave it out for all of them"
            )
        if spp is not None and spp < 1:
            raise OptionError(f"samples per pixel must be 1 or more, not {spp}")
        chosen = {role: str(name) for role, name in (roles or {}).items()}
        if albedo is not None:
            chosen["albedo"] = str(albedo)
        if normal is not None:
            chosen["normal"] = str(normal)
        for role in chosen:
            parse_role(role)
        split(chosen)
        settings = cls(
            model=model,
            passes=passes if isinstance(passes, str) else tuple(passes),
            strength=float(strength),
            keep_light=keep_light,
            alpha=alpha,
            roles=chosen,
            spp=spp,
            max_memory=None if max_memory is None else memory.parse_size(max_memory),
            threads=threads,
            device=device,
            params=named,
        )
        settings.denoiser()
        return settings

    def suited(self, frame: Frame) -> Settings:
        """These settings with a model for this frame in place of `auto`, and the reason."""
        if self.model != "auto":
            return self
        from lambent.denoise.auto import choose

        choice = choose(frame)
        return dataclasses.replace(self, model=choice.model, remark=choice.sentence())

    def denoiser(self) -> Denoiser:
        """A new denoiser as these settings want it."""
        options = dict(self.params)
        known = parameters(self.model)
        if "device" in known and self.device != "auto":
            options.setdefault("device", self.device)
        if "threads" in known and self.threads is not None:
            options.setdefault("threads", self.threads)
        return create(self.model, **options)

    @property
    def label(self) -> str:
        """The model for a person's eyes, with the file of its weights where one was named."""
        weights = self.params.get("weights")
        return self.model if weights is None else f"{self.model} ({weights})"

    def key(self) -> dict[str, Any]:
        """What decides how the result looks; memory, threads and device do not."""
        return {
            "model": self.model,
            "passes": self.passes if isinstance(self.passes, str) else ",".join(self.passes),
            "strength": self.strength,
            **({"keep_light": True} if self.keep_light else {}),
            "alpha": self.alpha,
            "roles": dict(sorted(self.roles.items())),
            **({"spp": self.spp} if self.spp is not None else {}),
            "params": {name: str(value) for name, value in sorted(self.params.items())},
        }


@dataclass(frozen=True)
class Cleaned:
    """A denoised frame and how it came about.

    ``layers``: names of the layers that were filtered. ``seconds``: by stage. ``plan``: tiles, or
    None where nothing was filtered.
    """

    frame: Frame
    layers: tuple[str, ...]
    repairs: Repairs
    plan: Plan | None
    seconds: Mapping[str, float]


def denoise(
    thing: Frame | np.ndarray[Any, Any] | str | Path,
    model: str = DEFAULT_MODEL,
    passes: str | Iterable[str] = "all",
    strength: float = 1.0,
    keep_light: bool = False,
    alpha: bool | None = None,
    roles: Mapping[str, str] | None = None,
    albedo: Any = None,
    normal: Any = None,
    spp: int | None = None,
    max_memory: str | int | None = None,
    threads: int | None = None,
    device: str = "auto",
    progress: Progress | None = None,
    **params: Any,
) -> Frame:
    """Denoise a frame, a file, or an array of linear radiance ``(H, W, 3)``.

    ``model`` and its ``params`` as listed by ``lambent models``, or the path of a model file
    (``"mine.lambent"``); ``"auto"`` takes the better one for this frame, and notes which and why.
    ``passes``: ``"beauty"``,
    ``"all"`` lighting layers, or names. ``strength`` blends from the input (0) to the result (1).
    ``keep_light``: the light of fireflies, which every filter loses, goes to their surroundings.
    ``alpha``: filter coverage too; None: where it is noisy. ``albedo`` and ``normal``: names of
    layers, files (``"albedo.exr"``), or arrays ``(H, W, 3)`` (albedo in [0, 1], unit normals).
    ``roles``: role to layer name, or to a file for any guide. ``spp``: samples per pixel.
    ``max_memory``: bytes, or text such as ``"4G"``.
    ``threads``: of the engine; Dr.Jit has one pool, so its limit stays until another is set.
    Of a stereo file the main view is taken, or the first that has a beauty (a note says so).

    Returns the whole frame with the filtered layers replaced. Raises `lambent.LambentError` and
    its kinds. Example::

        clean = lambent.denoise("noisy.exr", strength=0.9)
        lambent.write("clean.exr", clean)
    """
    arrays = {
        role: given
        for role, given in ((Role.ALBEDO, albedo), (Role.NORMAL, normal))
        if given is not None and not isinstance(given, (str, Path))
    }
    settings = Settings.checked(
        model=model,
        passes=passes,
        strength=strength,
        keep_light=keep_light,
        alpha=alpha,
        roles=roles,
        albedo=None if Role.ALBEDO in arrays else albedo,
        normal=None if Role.NORMAL in arrays else normal,
        spp=spp,
        max_memory=max_memory,
        threads=threads,
        device=device,
        params=params,
    )
    frame = _as_frame(thing, settings, arrays)
    return clean(frame, settings, progress=progress).frame


def clean(frame: Frame, settings: Settings, progress: Progress | None = None) -> Cleaned:
    """Repair, filter and blend one frame (one view of a stereo pair)."""
    from lambent.frame.repair import repair

    clock = _Stages()
    if not frame.has(Role.COLOUR):
        raise frame.missing(Role.COLOUR)
    settings = settings.suited(frame)
    denoiser = settings.denoiser()
    denoiser.check(frame)
    repaired, repairs = repair(frame, layers=looked_at(frame, denoiser))
    clock.done("repair")
    chosen, where = _chosen(repaired, settings)
    repairs = repairs.written(written_layers(repaired, chosen, settings))
    repaired = repaired.noted(*repairs.notes())
    if settings.strength == 0.0 or not _any_light(chosen):
        why = "strength is 0" if settings.strength == 0.0 else "the image is black all over"
        same = frame.noted(*repaired.notes[len(frame.notes) :], f"{why}: nothing was filtered")
        for layer in written_layers(repaired, chosen, settings):
            if layer in chosen or layer is not frame.layer(*layer.key):
                same = same.with_layer(layer)
        return Cleaned(same, (), repairs, None, clock.seconds)
    repaired = repaired.noted(*filter(None, [settings.remark]), *denoiser.remarks(repaired))
    if settings.device == "cuda" and "device" not in parameters(settings.model):
        repaired = repaired.noted(f"the model '{settings.model}' runs on the processor only")
    denoiser, share = denoiser.at_strength(settings.strength)
    if settings.threads is not None and "threads" not in parameters(settings.model):
        _limit_drjit(settings)
    fitted = denoiser.fitted(repaired)
    plan = plan_frame(repaired, fitted, chosen, settings)
    if progress is not None:
        progress(0, 1, "filtering")
    cleaned = filter_tiles(fitted, repaired, chosen, plan, progress)
    if where is not None and not where.all():
        repaired = repaired.noted(f"alpha was filtered in {_share(where)} of the pixels")
    if settings.keep_light:
        cleaned = keep_light(chosen, cleaned)
    clock.done("filter")
    finished = _finish(
        frame.noted(*repaired.notes[len(frame.notes) :]),
        repaired,
        chosen,
        cleaned,
        share,
        where,
    )
    for layer in written_layers(repaired, chosen, settings):
        if layer not in chosen and layer is not frame.layer(*layer.key):
            finished = finished.with_layer(layer)
    finished = finished.noted(*_light_note(chosen[0].data, finished[Role.COLOUR]))
    clock.done("blend")
    names = tuple(layer.name for layer in chosen)
    return Cleaned(finished, names, repairs, plan, clock.seconds)


def choose_layers(frame: Frame, settings: Settings) -> list[Layer]:
    """The layers that the settings filter, the beauty first, alpha last."""
    return _chosen(frame, settings)[0]


def written_layers(repaired: Frame, chosen: list[Layer], settings: Settings) -> list[Layer]:
    """The layers whose repairs belong in the result: those that are filtered, and alpha.

    Alpha is part of the picture as the beauty is; it stays damaged only where the caller wants
    it, or the passes, left alone.
    """
    alpha = repaired.layer(Role.ALPHA)
    if alpha is None or alpha in chosen or settings.alpha is False or settings.passes != "all":
        return chosen
    return [*chosen, alpha]


def looked_at(frame: Frame, denoiser: Denoiser) -> list[str]:
    """Names of the layers that matter here: light, alpha, and what the model says it looks at.

    Only these are checked for damage; the others are neither decoded nor changed.
    """
    roles = {
        parse_role(name)
        for need in (*denoiser.about.needs, *denoiser.about.uses)
        for name in need.split("|")
    }
    return [
        layer.name
        for layer in frame.all_layers()
        if INFO[layer.role].radiance or layer.role is Role.ALPHA or layer.key in roles
    ]


def plan_frame(frame: Frame, denoiser: Denoiser, layers: list[Layer], settings: Settings) -> Plan:
    """The tiles for filtering ``layers``, within ``settings.max_memory`` or what is free.

    Of a limit, what the process holds already and what it will need for results and for writing
    is set aside first.
    """
    height, width = layers[0].data.shape[:2]
    channels = sum(layer.data.shape[2] for layer in layers)
    result_bytes = 4 * channels * height * width
    if settings.max_memory is not None:
        allowed = int((1 - RESERVE) * settings.max_memory)
        budget: int | None = allowed - memory.used() - result_bytes
    else:
        free = memory.available()
        budget = None if free is None else int(FREE_SHARE * free) - result_bytes
    per_pixel = denoiser.bytes_per_pixel(max(channels, 3))
    silent = type(denoiser).watched is Denoiser.watched
    if silent and denoiser.margin() <= SMALL_MARGIN and height * width > 2 * SILENT_PIXELS:
        most = SILENT_PIXELS * per_pixel
        budget = most if budget is None else min(budget, most)
    return plan_tiles(height, width, per_pixel, denoiser.margin(), budget)


def view_with_beauty(views: Mapping[str, Frame]) -> str:
    """The first view that has a beauty. Raises `LayerError` if there is none."""
    for name, frame in views.items():
        if frame.has(Role.COLOUR):
            return name
    raise next(iter(views.values())).missing(Role.COLOUR)


def without_beauty(view: str) -> str:
    """How a view that there is nothing to filter in is named in notes."""
    return f"the view '{view}' has no beauty"


# ------------------------------------------------------------------- private


def _chosen(frame: Frame, settings: Settings) -> tuple[list[Layer], Mask | None]:
    """The layers that are filtered, and the pixels ``(H, W)`` in which alpha is, if any."""
    layers = choose_passes(frame, settings.passes)
    alpha = frame.layer(Role.ALPHA)
    if alpha is None:
        if settings.alpha is True:
            raise frame.missing(Role.ALPHA)
        return layers, None
    if alpha in layers or settings.alpha is True:
        where = ~exact(alpha.data)
        return (layers if alpha in layers else [*layers, alpha]), where
    if settings.alpha is False or settings.passes != "all":
        return layers, None
    where = noisy_coverage(frame)
    return ([*layers, alpha], where) if where.any() else (layers, None)


def _limit_drjit(settings: Settings) -> None:
    """Dr.Jit's pool is one for the process, so the limit stays until another is set."""
    from lambent.startup import engine

    engine(settings.device)
    import drjit as dr

    assert settings.threads is not None
    dr.set_thread_count(settings.threads)


class _Stages:
    """A stopwatch that names what it measured."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def done(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = now - self._last
        self._last = now


def _as_frame(thing: Any, settings: Settings, arrays: Mapping[Role, Any]) -> Frame:
    if isinstance(thing, (str, Path)):
        frame = _read(Path(thing), settings)
    else:
        frame = thing if isinstance(thing, Frame) else _of_array(thing)
        if settings.spp is not None:
            frame = frame.replace(spp=settings.spp)
        frame = _remap(frame, settings)
    for role, image in arrays.items():
        frame = frame.with_layer(Layer(role, _of_numbers(np.asarray(image), role.value)))
    return frame.checked() if arrays else frame


def _of_array(thing: Any) -> Frame:
    image = np.asarray(thing)
    if image.dtype == object or image.ndim not in (2, 3):
        raise OptionError(
            f"cannot denoise a {type(thing).__name__} of shape {image.shape}",
            remedy="give a Frame, a path, or an array (H, W, 3) of linear radiance",
        )
    _of_numbers(image, "linear radiance")
    if image.ndim == 3 and image.shape[2] == 4:
        return Frame.from_arrays(colour=image[:, :, :3], alpha=image[:, :, 3:])
    return Frame.from_arrays(colour=image)


def _read(path: Path, settings: Settings) -> Frame:
    """The main view of a file; if it has no beauty, the first view that has one, with a note."""
    from lambent.denoise.files import roles_of
    from lambent.frame.files import read, read_views

    roles = roles_of(path, settings) or None
    frame = read(path, roles=roles, spp=settings.spp)
    if frame.has(Role.COLOUR) or not frame.view:
        return frame
    views = read_views(path, roles=roles, spp=settings.spp)
    name = view_with_beauty(views)
    return views[name].noted(f"{without_beauty(frame.view)}: this is the view '{name}'")


def _of_numbers(image: np.ndarray[Any, Any], what: str) -> np.ndarray[Any, Any]:
    """The array, unless it holds whole numbers, as pictures of display values do."""
    if image.dtype.kind in "iub":
        raise OptionError(
            f"an array of {image.dtype} cannot be {what}",
            remedy="for display values: lambent.frame.tonemap.inverse_srgb(array / 255)",
        )
    return image


def _remap(frame: Frame, settings: Settings) -> Frame:
    """Give layers of a frame in memory other roles, by their names; guides from their files."""
    from lambent.frame.files import read_views
    from lambent.frame.guides import attach

    own, guides = split(settings.roles)
    by_name = {layer.name: layer for layer in frame.all_layers()}
    for role_name, layer_name in own.items():
        role, stat = parse_role(role_name)
        if layer_name not in by_name:
            raise LayerError(
                "there is no such layer",
                file=frame.path,
                layer=layer_name,
                remedy=f"the frame has: {', '.join(sorted(by_name))}",
            )
        source = by_name[layer_name]
        mapped = Layer(role, source.data, stat=stat, name=layer_name, source=source.source)
        frame = frame.replace(layers={**frame.layers, (role, stat): mapped})
    return attach(
        {frame.view: frame},
        guides,
        lambda path, roles: read_views(path, roles=roles, spp=settings.spp),
    )[frame.view]


def _light_note(before: FloatImage, after: FloatImage) -> tuple[str, ...]:
    """A sentence on the change of the beauty's total light, where it is `LIGHT_CHANGE` and more."""
    one, two = (float(image.sum(dtype=np.float64)) for image in (before, after))
    change = two / one - 1 if one > 0 else 0.0
    if abs(change) < LIGHT_CHANGE:
        return ()
    word = "less" if change < 0 else "more"
    return (f"the denoised beauty holds {100 * abs(change):.1f} % {word} light than the noisy one",)


def _any_light(layers: list[Layer]) -> bool:
    return any(layer.data.any() for layer in layers if layer.role is not Role.ALPHA)


def _share(where: Mask) -> str:
    share = float(where.mean())
    return f"{100 * share:.0f} %" if share >= 0.01 else f"{100 * share:.2f} %"


def _finish(
    original: Frame,
    repaired: Frame,
    chosen: list[Layer],
    cleaned: list[FloatImage],
    strength: float,
    where: Mask | None,
) -> Frame:
    """Blend, keep alpha where it has no noise and colour where there was coverage, replace.

    ``where``: the pixels in which alpha is filtered. Pixels without coverage and without light in
    the beauty get their input back in every layer, so that sums hold there, too. What was not
    filtered comes from the original, unrepaired: it is no business of ours.
    """
    alpha = repaired.layer(Role.ALPHA)
    empty = None
    if alpha is not None:
        empty = (alpha.data[..., 0] <= 0) & ~repaired[Role.COLOUR].any(axis=2)
        if where is not None:
            empty &= ~where
        if not empty.any():
            empty = None
    s = np.float32(strength)
    result = original
    for layer, image in zip(chosen, cleaned, strict=True):
        if strength < 1.0:
            image = layer.data * (1 - s) + image * s
        if layer.role is Role.ALPHA:
            assert where is not None
            image = np.where(where[:, :, None], np.clip(image, 0.0, 1.0), layer.data)
        elif empty is not None:
            image = np.where(empty[:, :, None], layer.data, image)
        result = result.with_layer(layer.with_data(image))
    stale = [
        (layer.role, stat) for layer in chosen for stat in (Stat.VARIANCE, Stat.HALF_A, Stat.HALF_B)
    ]
    return result.without(*cast("list[Any]", stale))
