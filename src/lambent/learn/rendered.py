"""The task of the papers' networks: crops of data sets in, cleaned radiance out.

One task for all of them, so that they learn from the same crops in the same order and are judged
by the same numbers (`learn.held_out`); a network says what it reads, what it makes of a batch, and
what its loss is (`RenderedNetwork`). What they may look at is in `denoise.lobes`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from lambent.denoise.inputs import Signals
from lambent.denoise.lobes import parts_of, whole_of
from lambent.errors import OptionError
from lambent.frame.layer import FloatImage
from lambent.learn.augment import Example, turned
from lambent.learn.batches import Sampler, ahead
from lambent.learn.cache import Cached, stills_of
from lambent.learn.held_out import about_sets, by_oidn, errors_of, parted, spread
from lambent.learn.recipe import TrainRecipe
from lambent.learn.task import Exportable, Pictures
from lambent.progress import Progress
from lambent.registry import Registry
from lambent.settings import Range, record_from

#: Networks that learn from rendered crops, by the ``task`` of their recipes.
NETWORKS = Registry(
    "network",
    {
        "kpcn": "lambent.learn.networks.kpcn:KPCN",
        "dpcn": "lambent.learn.networks.kpcn:DPCN",
        "modular": "lambent.learn.networks.modular:Modular",
        "blocks": "lambent.learn.networks.blocks:Blocks",
    },
)
#: Crops that int8 is calibrated with.
CALIBRATION = 64
#: Exposures of training crops differ by up to so many stops.
STOPS = 1.0
_RANGES: tuple[Range, ...] = (
    ("width", 1, 1024),
    ("hidden", 1, 64),
    ("filter", 1, 31),
    ("kernel", 1, 63),
    ("alone", 0, 1),
    ("patch", 16, 1024),
    ("blocks", 0, 64),
    ("scales", 1, 6),
)


@dataclass(frozen=True)
class Crop:
    """One example for the networks of the papers, channels first; see `denoise.lobes.Parts`.

    ``noisy``, ``target`` ``(3, H, W)`` radiance, ``target_diffuse``, ``target_specular``: the
    target's parts in the terms of c̃; ``whole``, ``whole_albedo``, ``whole_planes``: the same of
    the light as one part; ``deviation`` ``(1, H, W)`` of the target; ``preference``: λ in [0, 1],
    for networks that have it.
    """

    diffuse: FloatImage
    specular: FloatImage
    albedo: FloatImage
    diffuse_planes: FloatImage
    specular_planes: FloatImage
    noisy: FloatImage
    target: FloatImage
    target_diffuse: FloatImage
    target_specular: FloatImage
    deviation: FloatImage
    whole: FloatImage
    whole_albedo: FloatImage
    whole_planes: FloatImage
    preference: float = 0.0


@dataclass
class RenderedBatch:
    """Crops put together: the fields of `Crop` with a batch axis.

    ``preference`` ``(B,)``; ``progress``: share of the training that is over.
    """

    diffuse: Tensor
    specular: Tensor
    albedo: Tensor
    diffuse_planes: Tensor
    specular_planes: Tensor
    noisy: Tensor
    target: Tensor
    target_diffuse: Tensor
    target_specular: Tensor
    deviation: Tensor
    whole: Tensor
    whole_albedo: Tensor
    whole_planes: Tensor
    preference: Tensor
    progress: float

    @classmethod
    def of(
        cls, crops: Sequence[Crop], device: torch.device, progress: float = 1.0
    ) -> RenderedBatch:
        """Crops as tensors on a device, what a network reads channels last."""
        found: dict[str, Any] = {}
        for name in _IMAGES:
            tensor = torch.from_numpy(np.stack([getattr(c, name) for c in crops])).to(device)
            if name.endswith("_planes"):
                tensor = tensor.to(memory_format=torch.channels_last)
            found[name] = tensor
        preference = torch.tensor([c.preference for c in crops], device=device)
        return cls(**found, preference=preference, progress=progress)


_IMAGES = tuple(name for name in Crop.__dataclass_fields__ if name != "preference")


class RenderedNetwork(Protocol):
    """What this task asks of a network, beside being a module.

    ``options_of``: the dataclass of its options, which has a ``patch``. ``uses_preference``:
    whether crops come with a λ drawn at random.
    """

    options_of: ClassVar[type]

    def inputs(self, b: RenderedBatch) -> tuple[Tensor, ...]:
        """What `forward` takes of a batch."""

    def cleaned(self, outputs: Any, b: RenderedBatch) -> Tensor:
        """Radiance ``(B, 3, H, W)`` from what `forward` gave."""

    def loss(self, outputs: Any, b: RenderedBatch) -> dict[str, Tensor]:
        """Terms of the loss, to be summed."""

    def reach(self) -> int:
        """Pixels that a result may depend on, to each side."""


def rendered_task(
    recipe: TrainRecipe, place: Path, progress: Progress | None = None
) -> RenderedTask:
    """The task with the data of a recipe, cached below ``place``.

    Raises `OptionError` without data, and what reading data sets raises.
    """
    return RenderedTask(recipe, stills_of(recipe, place, progress))


class RenderedTask:
    """Learn to clean renders: `Task` for a network of `NETWORKS`, the one named by the recipe.

    Raises `OptionError` for options that make no sense and for too few scenes.
    """

    def __init__(self, recipe: TrainRecipe, stills: Sequence[Cached]) -> None:
        self.recipe = recipe
        self.kind = NETWORKS[recipe.task]
        self.options = options_for(recipe)
        network = self.network()
        multiple = int(getattr(network, "multiple", 1))
        if int(self.options.patch) % multiple:
            raise OptionError(
                f"a patch of {self.options.patch} pixels does not suit '{recipe.task}'",
                remedy=f"take a multiple of {multiple}",
            )
        if getattr(network, "needs_lobes", False) and not all(
            "diffuse" in names for still in stills for names in still.layers
        ):
            raise OptionError(
                f"'{recipe.task}' learns from diffuse and specular light apart, and some data "
                "do not have them",
                remedy="make the data by lambent dataset make",
            )
        kept, held = parted(stills, recipe.held_out)
        self.sampler = Sampler(kept, lobes=True)
        self.checked = spread(held or kept, recipe.checked, lobes=True)
        self._yardstick: tuple[float, float] | None = None

    def network(self) -> nn.Module:
        """A fresh network with the recipe's options."""
        found = self.kind(self.options)
        assert isinstance(found, nn.Module)
        return found

    def started(self, weights: Mapping[str, Tensor] | None) -> dict[str, Tensor] | None:
        """All weights to begin with, from those of another run or model; None: fresh ones.

        Raises `OptionError` for a network of which a part is frozen and has to come from there.
        """
        own: Any = self.network()
        if weights is None and getattr(self.options, "frozen", False):
            raise OptionError(
                "frozen = true keeps what a run begins with, and it begins with nothing",
                remedy="add --from RUN, the folder of the run that made the rest",
            )
        if weights is None:
            return None
        return own.started(weights) if hasattr(own, "started") else dict(weights)

    def batches(self, first: int, rank: int, world: int) -> Iterator[tuple[int, list[Crop]]]:
        """Steps with the crops of this process's share."""
        rows = ahead(self.crop, first, self.recipe.batch, rank, world)
        for number, crops in enumerate(rows):
            yield first + number, crops

    def crop(self, step: int, number: int) -> Crop:
        """Crop ``number`` of the batch of ``step``."""
        rng = np.random.default_rng((self.recipe.seed, step, number))
        example = turned(self.sampler.draw(rng), rng)
        side = min(int(self.options.patch), *example.target.shape[1:])
        y, x = (int(rng.integers(n - side + 1)) for n in example.target.shape[1:])
        example = _exposed(_cut(example, y, x, side), rng)
        preference = float(rng.random()) if getattr(self.kind, "uses_preference", False) else 0.0
        return ready(example, preference)

    def loss(
        self, model: nn.Module, batch: tuple[int, list[Crop]], device: torch.device
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The network's own loss; its convolutions in bf16, what filters in float32."""
        step, crops = batch
        b = RenderedBatch.of(crops, device, step / self.recipe.steps)
        own: Any = getattr(model, "module", model)
        with torch.autocast(device.type, torch.bfloat16):
            outputs = model(*own.inputs(b))
        terms = own.loss(outputs, b)
        return sum(terms.values()), terms

    @torch.no_grad()
    def clean(self, model: Any, example: Example, device: torch.device) -> FloatImage:
        """What a network makes of an example ``(3, H, W)``, in float32."""
        b = RenderedBatch.of([ready(example)], device)
        found: FloatImage = model.cleaned(model(*model.inputs(b)), b)[0].float().cpu().numpy()
        return found

    @torch.no_grad()
    def score(self, model: nn.Module, device: torch.device) -> tuple[dict[str, float], Pictures]:
        """Trimmed relMSE and SMAPE on held-out crops, and as ratios to OIDN High's.

        ``score``: the geometric mean of both ratios.
        """
        if self._yardstick is None:
            self._yardstick = self._oidn()
        errors = []
        pictures: dict[str, FloatImage] = {}
        for example, spp in self.checked:
            x = self.clean(model, example, device)
            errors.append(errors_of(x, example))
            if len(pictures) < 8:
                row = np.concatenate([example.noisy.colour, x, example.target[:3]], 2)
                pictures[f"{len(pictures)}: {spp:g} spp"] = row.transpose(1, 2, 0)
        relmse, smape = (float(max(v, 1e-6)) for v in np.mean(errors, 0))
        ratios = relmse / self._yardstick[0], smape / self._yardstick[1]
        found = {
            "relmse": relmse,
            "smape": smape,
            "relmse/oidn": ratios[0],
            "smape/oidn": ratios[1],
            "score": float(np.sqrt(ratios[0] * ratios[1])),
        }
        return found, pictures

    def exportable(self, model: nn.Module) -> Exportable:
        """The network, reading the planes that it asks for."""
        own: Any = model
        example, _ = self.checked[0]
        b = RenderedBatch.of([ready(_cut(example, 0, 0, 64))], torch.device("cpu"))
        examples = tuple(t.contiguous() for t in own.inputs(b))
        about = {"margin": own.reach(), "options": asdict(self.options)}
        return Exportable(model, examples, "lobes", about)

    def says(self, scores: Mapping[str, float]) -> str:
        """For the card: the score in words."""
        return f"{scores['score']:.3f} of OIDN High's error on held-out crops of its own data"

    def calibration(self) -> list[tuple[FloatImage, ...]]:
        """What the network reads of training crops."""
        own: Any = self.network()
        crops = [self.crop(0, n) for n in range(CALIBRATION)]
        batches = [RenderedBatch.of([crop], torch.device("cpu")) for crop in crops]
        return [tuple(t[0].contiguous().numpy() for t in own.inputs(b)) for b in batches]

    def about_data(self) -> list[dict[str, Any]]:
        """For the card: what each data set is, how much of it, made of what."""
        return about_sets(self.recipe.data)

    # --------------------------------------------------------------- private

    def _oidn(self) -> tuple[float, float]:
        errors = [errors_of(by_oidn(e, ("albedo", "normal")), e) for e, _ in self.checked]
        relmse, smape = (float(max(v, 1e-6)) for v in np.mean(errors, 0))
        return relmse, smape


def options_for(recipe: TrainRecipe) -> Any:
    """The options of the recipe's network. Raises `OptionError` for those that make no sense."""
    kind = NETWORKS[recipe.task].options_of
    ranges = [r for r in _RANGES if r[0] in kind.__dataclass_fields__]
    return record_from(kind, dict(recipe.options), ranges)


def ready(example: Example, preference: float = 0.0) -> Crop:
    """An example with lobes as arrays for the networks."""
    parts, whole = parts_of(np, example.noisy), whole_of(np, example.noisy)
    target, diffuse = example.target[:3], example.target[3:]
    if "diffuse" not in example.noisy.layers:
        diffuse = target  # a frame without lobes counts as diffuse
    return Crop(
        parts.diffuse,
        parts.specular,
        parts.albedo,
        parts.diffuse_planes,
        parts.specular_planes,
        example.noisy.colour,
        target,
        (diffuse / parts.albedo).astype(np.float32),
        np.log1p(np.maximum(target - diffuse, 0)),
        example.deviation,
        whole.diffuse,
        whole.albedo,
        whole.diffuse_planes,
        preference,
    )


# ------------------------------------------------------------------- private


def _cut(example: Example, y: int, x: int, side: int) -> Example:
    """The square at row y and column x."""

    def cut(image: FloatImage) -> FloatImage:
        return np.ascontiguousarray(image[:, y : y + side, x : x + side])

    noisy = example.noisy
    layers = {name: cut(layer) for name, layer in noisy.layers.items()}
    return Example(
        replace(noisy, colour=cut(noisy.colour), layers=layers),
        cut(example.target),
        cut(example.deviation),
    )


def _exposed(example: Example, rng: np.random.Generator) -> Example:
    """Another exposure, and the channels of colour in another order."""
    gain = np.float32(np.exp2(rng.uniform(-STOPS, STOPS)))
    order = rng.permutation(3)
    layers = dict(example.noisy.layers)
    for name in ("diffuse", "colour_std", "diffuse_std", "specular_std"):
        if name in layers:
            layers[name] = layers[name] * gain
    for name in ("diffuse", "albedo", "diffuse_albedo"):
        if name in layers:
            layers[name] = layers[name][order]
    signals: Signals = replace(
        example.noisy, colour=example.noisy.colour[order] * gain, layers=layers
    )
    both = np.concatenate([order, 3 + order])[: len(example.target)]
    return Example(signals, example.target[both] * gain, example.deviation * gain)
