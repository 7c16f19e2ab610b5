"""The task of Lambent's own denoiser: stills of data sets in, `networks.lambent` out."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from lambent.denoise.inputs import CHANNELS, MASKS
from lambent.errors import EngineError, OptionError
from lambent.frame.layer import FloatImage
from lambent.learn import lamps, losses
from lambent.learn.batches import batch_of, ready
from lambent.learn.cache import Cached, stills_of
from lambent.learn.follow import Follower
from lambent.learn.held_out import about_sets, by_oidn, errors_of, is_held_out, parted, spread
from lambent.learn.networks.lambent import WIDTHS, LambentNet, denoised
from lambent.learn.networks.rounded import RoundedNet
from lambent.learn.recipe import TrainRecipe
from lambent.learn.rows import Rows, generator, rows_of
from lambent.learn.stills import Stills
from lambent.learn.task import Exportable, Learnable, ShippedTask
from lambent.progress import Progress
from lambent.training.task import Pictures, RecordableTask, Weights

#: Subsets of layers that a network is scored with.
SUBSETS = {"full": tuple(MASKS), "plain": ("albedo", "normal"), "colour": ()}
#: Where few, some and many samples begin.
BANDS = (1, 8, 64)
#: Rows that int8 is calibrated with, in batches of 16.
CALIBRATION = 128
#: Batches that a GPU makes at once: for each alone it waits for the launches of a thousand kernels.
TOGETHER = {"cuda": 4}
#: Seconds from one look for new crops to the next, where a run follows its data.
LOOK_EVERY = 5.0


@dataclass(frozen=True)
class Options:
    """The ``[options]`` of a recipe with ``task = "denoise"``.

    ``int8``: train with weights and activations rounded as int8 rounds them, to be begun with the
    weights of a float run (``--from``). ``follow``: take in crops that are added to the data while
    the run goes on; the run then cannot be repeated exactly.
    """

    int8: bool = False
    follow: bool = False


@dataclass
class Batch:
    """Rows as the network reads them: see `batches.ready`, and `denoise.inputs`.

    ``packed`` ``(B, CHANNELS, H/2, W/2)``, channels last; ``colour``, ``divisor``, ``target``
    ``(B, 3, H, W)``; ``deviation`` ``(B, 1, H, W)`` of the target; ``preference`` λ ``(B,)``.
    """

    packed: Tensor
    colour: Tensor
    divisor: Tensor
    target: Tensor
    deviation: Tensor
    preference: Tensor

    @classmethod
    def of(cls, packed: Tensor, *rest: Tensor) -> Batch:
        """What `batches.batch_of` and `batches.ready` make."""
        return cls(packed.contiguous(memory_format=torch.channels_last), *rest)


def cleaned(model: nn.Module, b: Batch) -> Tensor:
    """What a network makes of a batch ``(B, 3, H, W)``: in bf16, the filter in float32."""
    with torch.autocast(b.packed.device.type, torch.bfloat16):
        outputs = model(b.packed)
    return denoised(outputs, b.colour, b.divisor)


def denoising_task(
    recipe: TrainRecipe, place: Path, progress: Progress | None = None
) -> DenoisingTask:
    """The task with the data of a recipe, cached below ``place``.

    Raises `OptionError` without data, and what reading data sets raises.
    """
    found: list[Cached] = []
    if recipe.options.get("follow"):
        found = stills_of(recipe, place, unpack=False)
    task = DenoisingTask(recipe, found or stills_of(recipe, place, progress))
    if task.options.follow:
        task.follow(place)
    return task


class DenoisingTask(RecordableTask, ShippedTask):
    """Learn to filter: `Task` for `LambentNet`.

    Raises `OptionError` for a size that there is not, and for too few scenes.
    """

    def __init__(self, recipe: TrainRecipe, stills: Sequence[Cached]) -> None:
        self.recipe = recipe
        self.options: Options = DENOISE.options_from(recipe.options)
        if recipe.size not in WIDTHS:
            raise OptionError(
                f"there is no size '{recipe.size}'", remedy=f"take one of {', '.join(WIDTHS)}"
            )
        kept, held = parted(stills, recipe.held_out)
        self._kept = kept
        self._made: Stills | None = None
        self.checked = spread(held or kept, recipe.checked)
        self._yardstick: dict[str, float] | None = None
        self._place: Path | None = None
        self._follower: Follower | None = None
        self._looked = 0.0
        self._drawn: tuple[int, list[tuple[Tensor, ...]]] | None = None

    @property
    def stills(self) -> Stills:
        """What is learned from, on the device."""
        if self._made is None:
            self._made = Stills(self._kept, self.device)
        return self._made

    def network(self) -> nn.Module:
        """A fresh network of the recipe's size."""
        if self.options.int8:
            return RoundedNet(self.recipe.size)
        return LambentNet(self.recipe.size)

    def started(self, weights: Weights | None) -> Weights | None:
        """Weights to begin with: for int8, those of a float run with steps that fit the data.

        Raises `OptionError` where an int8 run has none.
        """
        if not self.options.int8 or (weights is not None and "steps.input" in weights):
            return weights
        if weights is None:
            raise OptionError(
                "rounding is learned last", remedy="begin with trained weights: --from RUN or MODEL"
            )
        model = RoundedNet(self.recipe.size)
        model.load_state_dict(dict(weights), strict=False)
        model.to(self.device).fit(self._packed(CALIBRATION // 2))
        return model.state_dict()

    def follow(self, place: Path) -> None:
        """Take in what is added to the data from now on, and unpacked below ``place``."""
        self._place = place
        self._follower = Follower(self.recipe.data, place, max(1, (os.cpu_count() or 1) // 4))

    def close(self) -> None:
        """Stop following the data."""
        if self._follower is not None:
            self._follower.close()

    def batches(self, first: int, rank: int, world: int) -> Generator[Any, None, None]:
        """The numbers of a process's share of each batch, which `tensors` makes."""
        for step in itertools.count(first):
            yield step, rank, self.recipe.batch // world

    def tensors(self, batch: tuple[int, int, int]) -> tuple[Tensor, ...]:
        """The fields of a `Batch`, on the device."""
        step, rank, size = batch
        if self._place is not None and time.monotonic() - self._looked > LOOK_EVERY:
            self._looked = time.monotonic()
            stills = stills_of(self.recipe, self._place, unpack=False)
            self.stills.add([s for s in stills if not is_held_out(s.scene, self.recipe.held_out)])
        together = TOGETHER.get(torch.device(self.device).type, 1)
        draw, part = divmod(step, together)
        if self._drawn is None or self._drawn[0] != draw:
            made = batch_of(self.stills, self.recipe.seed, draw, size * together, rank)
            self._drawn = draw, [t.chunk(together) for t in made]
        b = Batch.of(*(chunks[part] for chunks in self._drawn[1]))
        return tuple(getattr(b, field.name) for field in fields(Batch))

    def loss_of(
        self, model: nn.Module, tensors: Sequence[Tensor]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of `losses.denoising`; the network in bf16, the filter in float32."""
        b = Batch(*tensors)
        x = cleaned(model, b)
        return losses.denoising(x, b.target, b.colour, b.deviation, b.preference)

    def exportable(self, model: nn.Module) -> Exportable:
        """The network, reading packed signals."""
        examples = (torch.zeros(1, CHANNELS, 64, 64),)
        return Exportable(model, examples, "signals")

    def says(self, scores: Mapping[str, float]) -> str:
        """For the card: the score in words."""
        whose = "OIDN High's" if "full relmse/oidn" in scores else "the noisy input's"
        which = "held-out crops of its own data" if self.recipe.held_out else "crops it has seen"
        return f"{scores['score']:.3f} of {whose} error on {which}"

    def calibration(self) -> list[FloatImage]:
        """Packed inputs to measure the ranges of activations on: training rows as they come."""
        return list(self._packed(CALIBRATION).cpu().numpy())

    def _packed(self, count: int) -> Tensor:
        """Packed inputs of so many training rows, which no batch has."""
        parts = [batch_of(self.stills, self.recipe.seed + 1, n, 16)[0] for n in range(count // 16)]
        edge = min(part.shape[2] for part in parts)
        return torch.cat([part[:16, :, :edge, :edge] for part in parts])

    def about_data(self) -> list[dict[str, Any]]:
        """For the card: what each data set is, how much of it, made of what."""
        return about_sets(self.recipe.data)

    # ------------------------------------------------------------- validation

    @torch.no_grad()
    def score(self, model: nn.Module) -> tuple[dict[str, float], Pictures]:
        """Errors on held-out crops for each subset of layers, and as ratios to OIDN High's.

        Where OIDN is not installed: to those of the noisy input.
        ``score``: geometric mean over the subsets of the ratios of trimmed relMSE and of SMAPE, the
        latter for few, some and many samples apart: a mean over all is that of the noisiest.
        ``lamps``: the share of their light that small lamps put into the crops keep.
        """
        if self._yardstick is None:
            self._yardstick = self._oidn()
        found: dict[str, float] = {}
        pictures: dict[str, FloatImage] = {}
        for subset in SUBSETS:
            errors = []
            for example, spp in self.checked:
                x = self._clean(model, rows_of([example], self.device), subset)
                errors.append(errors_of(x, example))
                if subset == "full" and len(pictures) < 8:
                    row = [example.noisy.colour, x, example.target]
                    name = f"{spp:g} spp"
                    pictures[f"{len(pictures)}: {name}"] = np.concatenate(row, 2).transpose(1, 2, 0)
            self._put(found, subset, errors)
        found["lamps"] = self._lamps_kept(model)
        by = "noisy" if self._yardstick.get("noisy") else "oidn"
        logs = []
        for subset in SUBSETS:
            parts = {what: found[what] / self._yardstick[what] for what in _names(found, subset)}
            found |= {f"{what}/{by}": ratio for what, ratio in parts.items()}
            relmse = parts.pop(f"{subset} relmse")
            parts.pop(f"{subset} smape")
            logs += [np.log(relmse), np.mean(np.log(list(parts.values())))]
        found["score"] = float(np.exp(np.mean(logs)))
        return found, pictures

    def _clean(self, model: nn.Module, rows: Rows, subset: str) -> FloatImage:
        """What the network makes of one row ``(3, H, W)``, with the layers of a subset."""
        masks = torch.tensor([[float(n in SUBSETS[subset]) for n in MASKS]], device=self.device)
        spp = rows.spp if subset == "full" else torch.zeros_like(rows.spp)
        b = Batch.of(*ready(rows, masks, spp, torch.zeros_like(spp)))
        clean: FloatImage = cleaned(model, b)[0].float().cpu().numpy()
        return clean

    def _lamps_kept(self, model: nn.Module) -> float:
        """Mean over lamps of kept light, more than all of it counted as all, for every subset."""
        kept = []
        for number, (example, _) in enumerate(self.checked):
            rows, rng = rows_of([example], self.device), generator(self.device, number)
            height, width = rows.planes.shape[2:]
            lamp = lamps.draw(1, height, width, rng)
            lamps.add(rows, lamp, rng)
            noisy = rows.planes[0, :3].cpu().numpy()
            hit = noisy.mean(0) > 0.5 * float(lamp.radiance.mean())
            if hit.any():
                x = self._clean(model, rows, list(SUBSETS)[number % len(SUBSETS)])
                kept.append(min(1.0, float(x[:, hit].sum() / noisy[:, hit].sum())))
        return float(np.mean(kept)) if kept else 1.0

    def _oidn(self) -> dict[str, float]:
        """The same errors of OIDN, which gets the albedo and normal where the subset has them."""
        found: dict[str, float] = {}
        examples = [example for example, _ in self.checked]
        try:
            plain = [errors_of(by_oidn(e, ("albedo", "normal")), e) for e in examples]
            colour = [errors_of(by_oidn(e, ()), e) for e in examples]
        except EngineError:
            plain = colour = [errors_of(e.noisy.colour, e) for e in examples]
            found["noisy"] = 1.0
        self._put(found, "full", plain)
        self._put(found, "plain", plain)
        self._put(found, "colour", colour)
        return found

    def _put(self, found: dict[str, float], subset: str, errors: list[tuple[float, float]]) -> None:
        """Means over the examples: less the targets' noise, one alone may come out below 0."""
        relmse, smape = np.array(errors).T
        found[f"{subset} relmse"] = float(max(relmse.mean(), 1e-6))
        found[f"{subset} smape"] = float(smape.mean())
        spp = np.array([spp for _, spp in self.checked])
        for low, high in itertools.pairwise((*BANDS, np.inf)):
            within = (spp >= low) & (spp < high)
            if within.any():
                found[f"{subset} smape from {low} spp"] = float(smape[within].mean())


DENOISE = Learnable(Options, (), LambentNet, denoising_task)


# ------------------------------------------------------------------- private


def _names(found: Mapping[str, float], subset: str) -> list[str]:
    """The errors of a subset."""
    return [name for name in found if name.startswith(subset + " ")]
