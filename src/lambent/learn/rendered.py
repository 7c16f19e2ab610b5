"""The task of the papers' networks: crops of data sets in, cleaned radiance out.

One task for all of them, so that they learn from the same crops in the same order and are judged
by the same numbers (`learn.held_out`); a network says what it reads, what it makes of a batch, and
what its loss is (`RenderedNetwork`). What they may look at is in `denoise.lobes`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from lambent.denoise.inputs import Signals
from lambent.denoise.lobes import parts_of, whole_of
from lambent.errors import OptionError
from lambent.frame.layer import FloatImage
from lambent.learn import changes
from lambent.learn.cache import STORED, Cached, stills_of
from lambent.learn.held_out import about_sets, by_oidn, errors_of, parted, spread
from lambent.learn.recipe import TrainRecipe
from lambent.learn.rows import Example, Rows, generator, random, rows_of
from lambent.learn.stills import Stills
from lambent.learn.task import Exportable, ShippedTask
from lambent.registry import Registry
from lambent.settings import Range, record_from
from lambent.training.ahead import ahead
from lambent.training.task import Pictures, Weights

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
class RenderedBatch:
    """Crops for the networks of the papers; see `denoise.lobes.Parts`.

    ``noisy``, ``target`` ``(B, 3, H, W)`` radiance, ``target_diffuse``, ``target_specular``: the
    target's parts in the terms of c̃; ``whole``, ``whole_albedo``, ``whole_planes``: the same of
    the light as one part; ``deviation`` ``(B, 1, H, W)`` of the target; ``preference`` ``(B,)``: λ
    in [0, 1], for networks that have it. ``progress``: share of the training that is over.
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
    progress: float = 1.0

    @classmethod
    def of(
        cls, rows: Rows, preference: Tensor | None = None, progress: float = 1.0
    ) -> RenderedBatch:
        """Rows with lobes as the networks read them; ``preference`` None: 0."""
        signals = _signals(rows)
        parts, whole = parts_of(torch, signals), whole_of(torch, signals)
        target = rows.target[:, :3]
        # a frame without lobes counts as diffuse
        diffuse = torch.where(rows.known("diffuse"), rows.target[:, 4:], target)
        return cls(
            parts.diffuse,
            parts.specular,
            parts.albedo,
            parts.diffuse_planes,
            parts.specular_planes,
            signals.colour,
            target,
            diffuse / parts.albedo,
            torch.log1p((target - diffuse).clamp_min(0)),
            rows.target[:, 3:4],
            whole.diffuse,
            whole.albedo,
            whole.diffuse_planes,
            torch.zeros_like(rows.spp) if preference is None else preference,
            progress,
        )

    def to(self, device: str) -> RenderedBatch:
        """The batch on a device, what a network reads channels last."""
        moved: dict[str, Any] = {}
        for field in fields(self):
            if field.name != "progress":
                tensor = getattr(self, field.name).to(device)
                if field.name.endswith("_planes"):
                    tensor = tensor.to(memory_format=torch.channels_last)
                moved[field.name] = tensor
        return replace(self, **moved)


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
    recipe: TrainRecipe, place: Path, progress: Callable[..., None] | None = None
) -> RenderedTask:
    """The task with the data of a recipe, cached below ``place``.

    Raises `OptionError` without data, and what reading data sets raises.
    """
    return RenderedTask(recipe, stills_of(recipe, place, progress))


class RenderedTask(ShippedTask):
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
        self.stills = Stills(kept, lobes=True)
        self.checked = spread(held or kept, recipe.checked, lobes=True)
        self._yardstick: tuple[float, float] | None = None

    def network(self) -> nn.Module:
        """A fresh network with the recipe's options."""
        found = self.kind(self.options)
        assert isinstance(found, nn.Module)
        return found

    def started(self, weights: Weights | None) -> Weights | None:
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

    def batches(self, first: int, rank: int, world: int) -> Generator[RenderedBatch, None, None]:
        """This process's share of each batch."""
        count = self.recipe.batch // world
        return ahead(lambda step: self.made(step, count, rank), first)

    def made(self, step: int, count: int, rank: int = 0) -> RenderedBatch:
        """The crops of a step: they follow from seed, step and process."""
        rng = generator("cpu", self.recipe.seed, step, rank)
        rows = changes.turned(self.stills.rows(count, rng), rng)
        rows = changes.cut(rows, int(self.options.patch), rng)
        changes.exposed(rows, STOPS, rng)
        preference = None
        if getattr(self.kind, "uses_preference", False):
            preference = random(count, 1, rng)[:, 0]
        return RenderedBatch.of(rows, preference, step / self.recipe.steps)

    def loss(self, model: nn.Module, batch: RenderedBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """The network's own loss; its convolutions in bf16, what filters in float32."""
        b = batch.to(self.device)
        own: Any = getattr(model, "module", model)
        with torch.autocast(torch.device(self.device).type, torch.bfloat16):
            outputs = model(*own.inputs(b))
        terms = own.loss(outputs, b)
        return sum(terms.values()), terms

    @torch.no_grad()
    def clean(self, model: Any, example: Example) -> FloatImage:
        """What a network makes of an example ``(3, H, W)``, in float32."""
        b = RenderedBatch.of(rows_of([example])).to(self.device)
        found: FloatImage = model.cleaned(model(*model.inputs(b)), b)[0].float().cpu().numpy()
        return found

    def score(self, model: nn.Module) -> tuple[dict[str, float], Pictures]:
        """Trimmed relMSE and SMAPE on held-out crops, and as ratios to OIDN High's.

        ``score``: the geometric mean of both ratios.
        """
        if self._yardstick is None:
            self._yardstick = self._oidn()
        errors = []
        pictures: dict[str, FloatImage] = {}
        for example, spp in self.checked:
            x = self.clean(model, example)
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
        rows = rows_of([example])
        rows.planes, rows.target = (t[:, :, :64, :64] for t in (rows.planes, rows.target))
        b = RenderedBatch.of(rows)
        examples = tuple(t.contiguous() for t in own.inputs(b))
        about = {"margin": own.reach(), "options": asdict(self.options)}
        return Exportable(model, examples, "lobes", about)

    def says(self, scores: Mapping[str, float]) -> str:
        """For the card: the score in words."""
        return f"{scores['score']:.3f} of OIDN High's error on held-out crops of its own data"

    def calibration(self) -> list[tuple[FloatImage, ...]]:
        """What the network reads of training crops."""
        own: Any = self.network()
        planes = own.inputs(self.made(0, CALIBRATION))
        return [tuple(t[i].contiguous().numpy() for t in planes) for i in range(CALIBRATION)]

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


# ------------------------------------------------------------------- private


def _signals(rows: Rows) -> Signals:
    """Rows as signals with lobes: what a row does not have is what `lobes.parts_of` puts there."""
    layers = {name: rows.layer(name) for name in STORED}
    lobes = rows.known("diffuse")
    layers["diffuse"] = torch.where(lobes, layers["diffuse"], rows.planes[:, :3])
    layers["diffuse_albedo"] = torch.where(
        rows.known("diffuse_albedo"), layers["diffuse_albedo"], layers["albedo"]
    )
    layers["diffuse_std"] = torch.where(lobes, layers["diffuse_std"], layers["colour_std"])
    return Signals(rows.planes[:, :3], layers)
