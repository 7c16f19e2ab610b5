"""The task of the papers' networks: crops of data sets in, cleaned radiance out.

One task for all of them, so that they learn from the same crops in the same order and are judged
by the same numbers (`learn.held_out`); a network says what it reads, what it makes of a batch, and
what its loss is (`RenderedNetwork`). What they may look at is in `denoise.lobes`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

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
from lambent.learn.task import Exportable, Learnable, ShippedTask
from lambent.learn.tasks import TASKS
from lambent.progress import Progress
from lambent.training.ahead import ahead
from lambent.training.task import Pictures, Weights

#: Crops that int8 is calibrated with.
CALIBRATION = 64
#: Exposures of training crops differ by up to so many stops.
STOPS = 1.0


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


class RenderedNetwork(nn.Module, ABC):
    """What this task asks of a network, beside being a module.

    ``uses_preference``: whether crops come with a λ drawn at random. ``needs_lobes``: whether it
    learns from diffuse and specular light apart.
    """

    uses_preference: ClassVar[bool] = False
    needs_lobes: ClassVar[bool] = False

    @property
    def multiple(self) -> int:
        """Height and width must be multiples of this."""
        return 1

    def started(self, weights: Weights | None) -> Weights | None:
        """All weights to begin with, from those of another run or model; None: fresh ones."""
        return weights

    @abstractmethod
    def inputs(self, b: RenderedBatch) -> tuple[Tensor, ...]:
        """What `forward` takes of a batch."""

    @abstractmethod
    def cleaned(self, outputs: Any, b: RenderedBatch) -> Tensor:
        """Radiance ``(B, 3, H, W)`` from what `forward` gave."""

    @abstractmethod
    def loss(self, outputs: Any, b: RenderedBatch) -> dict[str, Tensor]:
        """Terms of the loss, to be summed."""

    @abstractmethod
    def reach(self) -> int:
        """Pixels that a result may depend on, to each side."""


def rendered_task(
    recipe: TrainRecipe, place: Path, progress: Progress | None = None
) -> RenderedTask:
    """The task with the data of a recipe, cached below ``place``.

    Raises `OptionError` without data, and what reading data sets raises.
    """
    return RenderedTask(recipe, stills_of(recipe, place, progress))


class RenderedTask(ShippedTask):
    """Learn to clean renders: `Task` for a `RenderedNetwork`, the one named by the recipe.

    Raises `OptionError` for options that make no sense and for too few scenes.
    """

    def __init__(self, recipe: TrainRecipe, stills: Sequence[Cached]) -> None:
        self.recipe = recipe
        self.entry: Learnable = TASKS[recipe.task]
        self.options = self.entry.options_from(recipe.options)
        network = self.network()
        multiple = network.multiple
        if int(self.options.patch) % multiple:
            raise OptionError(
                f"a patch of {self.options.patch} pixels does not suit '{recipe.task}'",
                remedy=f"take a multiple of {multiple}",
            )
        if network.needs_lobes and not all(
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
        self._yardstick: tuple[float, float, float] | None = None

    def network(self) -> RenderedNetwork:
        """A fresh network with the recipe's options."""
        found = self.entry.network(self.options)
        assert isinstance(found, RenderedNetwork)
        return found

    def started(self, weights: Weights | None) -> Weights | None:
        """What the network makes of them. Raises `OptionError` where it needs some."""
        return self.network().started(weights)

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
        if self.entry.network.uses_preference:
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

    @torch.no_grad()
    def score(self, model: nn.Module) -> tuple[dict[str, float], Pictures]:
        """Trimmed relMSE and SMAPE on held-out crops, as ratios to OIDN High's and to the input's.

        ``score``: the geometric mean of both ratios.
        """
        if self._yardstick is None:
            noisy = [errors_of(e.noisy.colour, e)[0] for e, _ in self.checked]
            self._yardstick = (*self._oidn(), max(float(np.mean(noisy)), 1e-6))
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
            "relmse/noisy": relmse / self._yardstick[2],
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
