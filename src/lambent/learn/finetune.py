"""A model tuned to somebody's own renders, in minutes.

From pairs, ``shot.exr`` with ``shot.reference.exr`` beside it, by their squared relative error with
the ε of `metrics.relmse`. That is a radiance of the frame, and the network sees frames at an
exposure: in a dim frame all that is darker than ε hardly counts. From noisy frames alone, if they
have two half buffers: the kernels predicted from one half are applied to it and compared with the
other half, whose noise is independent (Lehtinen et al. 2018).

With little data only the first layers are free (Vogels et al. 2018, sec. 5.5: what differs from
renderer to renderer is what the input looks like). Some tiles of every frame are held out. If the
model is better on these after a part of the time, they are learned from as well until the end: of
eight frames, the brightest lamps may lie there. Else the result is the best model on them, the one
that it began with included (of equals, the last).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from lambent.denoise.inputs import MASKS, Signals, signals_of
from lambent.denoise.model_file import find_model, read_model
from lambent.denoise.samples import seeming_samples
from lambent.errors import LayerError, OptionError
from lambent.frame.exposure import block_exposure
from lambent.frame.files import read
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role, Stat
from lambent.learn import changes, losses
from lambent.learn.batches import ready
from lambent.learn.denoising import Batch, cleaned
from lambent.learn.export import export, float_weights
from lambent.learn.networks.lambent import LambentNet
from lambent.learn.networks.rounded import RoundedNet
from lambent.learn.rows import Example, Rows, generator, rows_of
from lambent.metrics.relmse import EPSILON, TRIM, relative, trimmed_mean
from lambent.progress import Progress
from lambent.training.ahead import ahead
from lambent.training.loop import train
from lambent.training.schedule import Schedule
from lambent.training.task import Pictures, Task

#: Side of a crop, in pixels, and of the tiles that are held out.
CROP = 128
#: Of so many tiles one is held out.
HELD_OUT = 6
#: Side of the squares that halves' errors are compared in; by how many standard errors it has to be
#: less, of many checks the best.
BLOCK, SURE = 32, 2.0
#: The pixels are seen so often at most: after three times as many the eight frames of
#: `benchmarks/finetune.py` were known by heart.
PASSES = 180
CHECK_EVERY = 40
#: After this share of the time it is decided whether held-out tiles are learned from.
DECIDED = 0.4
#: With fewer pixels than this only `FIRST` is free (Vogels 2018); with more, all layers do better.
LITTLE = 1 << 18
FIRST = ("stem", "enc0")
BATCH = 8
#: The learning rate; against halves, whose noise is most of every gradient, a careful one.
RATE, CAREFUL = 2e-3, 3e-4
#: Seconds of the time asked for that are left for the last check and the export (a tenth at most).
LAST = 20.0
#: The weights of the squared error and of the logarithm, which alone minds what is below ε.
SQUARE, LOGARITHM = 16.0, 0.4
#: Scores of a few tiles that differ by less are the same: then the last weights are taken, which
#: have seen most and whose rate is the lowest.
ALIKE = 0.02
SUFFIX = ".reference"


@dataclass(frozen=True)
class Pair:
    """A noisy picture and what to compare with, at an exposure.

    ``shot``: the frame's file. ``noisy_target``: what to compare with is the other half.
    ``epsilon``: relMSE's, at that exposure.
    """

    shot: str
    noisy: Signals
    target: FloatImage
    noisy_target: bool
    epsilon: float


@dataclass(frozen=True)
class Crops:
    """A batch for the network; ``noisy_target``: some targets are halves.

    ``epsilon`` ``(B, 1, 1, 1)``: relMSE's, at the rows' exposure.
    """

    inputs: Batch
    noisy_target: bool
    epsilon: Tensor


def finetune(
    paths: Sequence[Path],
    start: str,
    output: Path,
    seconds: float,
    device: str = "auto",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, float]:
    """Tune the model ``start`` to the frames in ``paths`` and write it to ``output``.

    For ``seconds``, or until the pixels have been seen `PASSES` times.

    Returns the error on held-out tiles before and after (when they were last held out), steps and
    seconds. Raises `OptionError` for too little data, `LayerError` for a frame with neither
    reference nor half buffers, and what reading frames raises.
    """
    began = time.monotonic()
    pairs = [pair for path in paths if SUFFIX not in path.name for pair in pairs_of(path)]
    card = dict(read_model(find_model(start), "signals").card)
    weights = float_weights(start, steps=True)
    size = str(card.get("recipe", {}).get("size", "default"))
    most = round(PASSES * sum(p.target[0].size for p in pairs) / (BATCH * CROP**2))
    task = FinetuneTask(
        pairs, size, int8="steps.input" in weights, tell_after=DECIDED * seconds,
        tell_from=round(DECIDED * most / CHECK_EVERY),
    )  # fmt: skip
    schedule = Schedule(
        steps=1 << 20, rate=CAREFUL if task.noisy else RATE, warmup=20, decay=0.99,
        check_every=CHECK_EVERY, last_rate=0.05,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        run = train(
            schedule, task, Path(folder) / "finetuned", device, start=weights,
            seconds=max(1.0, seconds - (time.monotonic() - began) - min(LAST, 0.1 * seconds)),
            steps=most, check_first=True, progress=_timed(progress, seconds, began),
        )  # fmt: skip
        checks = run.checks()
        scores = [line["check"]["score"] for line in checks]
        held_out = scores[: task.told_at]
        # later ones are of tiles that have been learned from: better says little, worse is worse
        last = settled(held_out) and scores[-1] <= held_out[-1] * (1 + ALIKE)
        before, after = held_out[0], held_out[-1] if last else min(held_out)
        model = task.network()
        model.load_state_dict(run.last_weights() if last else run.weights())
    steps = checks[-1]["step"]
    judged = checks[len(held_out) - 1]["step"]
    card |= {
        "finetuned_from": card.get("name"),
        "finetuned_on": {"frames": len(paths), "pairs": len(pairs), "steps": steps},
        "finetuned_error": {"before": before, "after": after, "at_step": judged},
    }
    export(model, output, card, None, overwrite, half=True)
    spent = time.monotonic() - began
    if progress is not None:
        progress(seconds, seconds, "done")
    return {"before": before, "after": after, "steps": float(steps), "seconds": spent}


def settled(scores: Sequence[float]) -> bool:
    """Whether the last score is better than the first, and as good as the best or nearly so."""
    return scores[-1] < scores[0] and scores[-1] <= min(scores) * (1 + ALIKE)


def pairs_of(path: Path) -> list[Pair]:
    """The pairs of a frame: with its reference, or its two halves either way round."""
    frame = read(path)
    other = path.with_name(f"{path.stem}{SUFFIX}{path.suffix}")
    factor = np.float32(block_exposure(frame.colour))
    epsilon = EPSILON * float(factor) ** 2
    if other.exists():
        reference = read(other).colour
        if reference.shape != frame.colour.shape:
            raise LayerError(
                f"is {reference.shape[1]}x{reference.shape[0]}, the frame is "
                f"{frame.width}x{frame.height}",
                file=other,
                remedy="a reference needs the size of its frame",
            )
        guess = seeming_samples(frame, float(factor))
        noisy = replace(_exposed(signals_of(frame), factor), guess=guess)
        return [Pair(str(path), noisy, _planes(reference) * factor, False, epsilon)]
    a, b = frame.get(Role.COLOUR, Stat.HALF_A), frame.get(Role.COLOUR, Stat.HALF_B)
    if a is None or b is None:
        raise LayerError(
            "has neither a reference beside it nor half buffers",
            file=path,
            remedy=f"render {other.name} with many samples, or let the renderer write halves",
        )
    return [
        Pair(str(path), _exposed(_half(frame, one), factor), _planes(two) * factor, True, epsilon)
        for one, two in ((a, b), (b, a))
    ]


class FinetuneTask(Task):
    """Crops of a few frames: a `training.task.Task`.

    ``tell_after``, ``tell_from``: seconds or scores after which held-out tiles may be learned from,
    once the scores are `settled`; not of noisy targets. ``told_at``: how many scores there were by
    then, or None.
    """

    def __init__(
        self,
        pairs: Sequence[Pair],
        size: str,
        int8: bool = False,
        tell_after: float = float("inf"),
        tell_from: float = float("inf"),
    ) -> None:
        self.pairs = [p for p in pairs if min(p.target.shape[1:]) >= CROP]
        if not self.pairs:
            raise OptionError(
                "there is nothing to learn from",
                remedy=f"give frames of at least {CROP}x{CROP} pixels",
            )
        self.size, self.int8 = size, int8
        shots = list(dict.fromkeys(p.shot for p in self.pairs))
        # of both halves the same tiles: what one is compared with is the other's input
        self._held = [
            (n, y, x)
            for n, pair in enumerate(self.pairs)
            for k, (y, x) in enumerate(_tiles(pair.target))
            if (k + shots.index(pair.shot)) % HELD_OUT == 0
        ]
        #: The targets, without (NaN) what is held out.
        self._told = [pair.target.copy() for pair in self.pairs]
        for n, y, x in self._held:
            self._told[n][:, y : y + CROP, x : x + CROP] = np.nan
        #: Some targets are halves.
        self.noisy = any(p.noisy_target for p in self.pairs)
        self._first: list[Tensor] = []
        self._tell_at, self._tell_from = time.monotonic() + tell_after, tell_from
        self._scores: list[float] = []
        self.told_at: int | None = None

    def network(self) -> nn.Module:
        """The network; with little data or noisy targets only its first layers learn."""
        model = RoundedNet(self.size) if self.int8 else LambentNet(self.size)
        if self.noisy or sum(p.target[0].size for p in self.pairs) < LITTLE:
            for name, parameter in model.named_parameters():
                parameter.requires_grad = name.split(".")[0] in FIRST
        return model

    def batches(self, first: int, rank: int, world: int) -> Generator[Crops, None, None]:
        """Crops from anywhere; of held-out tiles the target is not told, until `told_at`."""
        return ahead(lambda step: self.made(step, range(rank, BATCH, world)), first)

    def made(self, step: int, numbers: Sequence[int]) -> Crops:
        """Those rows of the batch of a step."""
        crops, which = [], []
        for number in numbers:
            rng = np.random.default_rng((step, number))
            which.append(int(rng.integers(len(self.pairs))))
            pair = self.pairs[which[-1]]
            height, width = pair.target.shape[1:]
            y, x = int(rng.integers(height - CROP + 1)), int(rng.integers(width - CROP + 1))
            if self.told_at is None:
                pair = replace(pair, target=self._told[which[-1]])
            crops.append(_cut(pair, y, x))
        dice = generator("cpu", step, *numbers)
        rows = changes.turned(rows_of(crops), dice)
        before = rows.target[:, :3].nansum((1, 2, 3))
        changes.recoloured(rows, dice)
        after = rows.target[:, :3].nansum((1, 2, 3))
        return self._crops(rows, which, torch.where(before > 0, after / before, 1.0))

    def _crops(self, rows: Rows, which: Sequence[int], gain: Tensor) -> Crops:
        """Rows of those pairs, at ``gain`` times their exposure, as the network reads them."""
        pairs = [self.pairs[n] for n in which]
        guess = torch.tensor([float(p.noisy.guess or 0) for p in pairs])
        masks = torch.ones(len(pairs), len(MASKS))
        parts = ready(rows, masks, rows.spp, torch.zeros(len(pairs)), guess)
        epsilon = torch.tensor([p.epsilon for p in pairs]) * gain**2
        return Crops(
            Batch.of(*(part.to(self.device) for part in parts)),
            any(p.noisy_target for p in pairs),
            epsilon[:, None, None, None].to(self.device),
        )

    def loss(self, model: nn.Module, batch: Crops) -> tuple[Tensor, dict[str, Tensor]]:
        """The squared error, which is what frames are judged by, and a little of the logarithm.

        Relative to the reference; to the output where targets are halves. The loss of training
        moved well-trained weights away from it.
        """
        b = batch.inputs
        x = cleaned(model, b)
        target = torch.where(torch.isnan(b.target), x.detach(), b.target)  # held out: no error
        if batch.noisy_target:
            return losses.unbiased(x, target, batch.epsilon), {}
        square = losses.relative_square(x, target, b.deviation, batch.epsilon).mean()
        return SQUARE * square + LOGARITHM * losses.logarithmic(x, target).mean(), {}

    @torch.no_grad()
    def score(self, model: nn.Module) -> tuple[dict[str, float], Pictures]:
        """Mean trimmed relMSE on the held-out tiles.

        Of halves: the error against them, all pixels, and the standard error of how it changed.
        """
        outputs = []
        for n, y, x in self._held:
            pair = self.pairs[n]
            b = self._crops(rows_of([_cut(pair, y, x)]), [n], torch.ones(1)).inputs
            outputs.append((pair, cleaned(model, b), b.target))
        if not self._first:
            self._first = [out for _, out, _ in outputs]
        errors, unsure = [], []
        for (pair, out, target), first in zip(outputs, self._first, strict=True):
            if pair.noisy_target:
                error, change = _against_half(out, target, first, pair.epsilon)
                unsure.append(change)
                errors.append(float(error.mean()))
            else:
                error = relative((out - target) ** 2, target.mean(1, keepdim=True), pair.epsilon)
                # a lamp's rim would outweigh all else: the trimmed error, as everywhere
                errors.append(trimmed_mean(error.mean(1).cpu().numpy(), TRIM))
        score = float(np.mean(errors))
        if unsure:  # what may be better by chance alone is not
            changes = torch.cat(unsure)
            score += SURE * float(changes.std() / len(changes) ** 0.5)
        if self.told_at is None:
            self._scores.append(score)
            due = time.monotonic() > self._tell_at or len(self._scores) > self._tell_from
            if due and not self.noisy and settled(self._scores):
                self.told_at = len(self._scores)
        return {"score": score}, {}


# ------------------------------------------------------------------- private


def _tiles(image: FloatImage) -> list[tuple[int, int]]:
    height, width = image.shape[1:]
    return [
        (y, x) for y in range(0, height - CROP + 1, CROP) for x in range(0, width - CROP + 1, CROP)
    ]


def _cut(pair: Pair, y: int, x: int) -> Example:
    def cut(image: FloatImage) -> FloatImage:
        return np.ascontiguousarray(image[:, y : y + CROP, x : x + CROP])

    layers = {name: cut(layer) for name, layer in pair.noisy.layers.items()}
    noisy = replace(pair.noisy, colour=cut(pair.noisy.colour), layers=layers)
    return Example(noisy, cut(pair.target), np.zeros((1, CROP, CROP), np.float32))


def _against_half(
    out: Tensor, half: Tensor, first: Tensor, epsilon: float
) -> tuple[Tensor, Tensor]:
    """Squared relative error against a noisy half, and how it changed, in squares of `BLOCK`.

    Relative to the ``first`` output, which knows nothing of that half and stays the same: relative
    to each output a brighter one would be the better one. The half's noise is in both errors; what
    is left of it in the change is so much smaller as the outputs are alike.
    """
    centre = first.mean(1, keepdim=True)
    before = relative((first - half) ** 2, centre, epsilon).mean(1, keepdim=True)
    after = relative((out - half) ** 2, centre, epsilon).mean(1, keepdim=True)
    return after, F.avg_pool2d(after - before, BLOCK).flatten()


def _exposed(signals: Signals, factor: np.float32) -> Signals:
    layers = dict(signals.layers)
    if "colour_std" in layers:
        layers["colour_std"] = layers["colour_std"] * factor
    return replace(signals, colour=signals.colour * factor, layers=layers)


def _half(frame: Frame, half: FloatImage) -> Signals:
    """A frame as it would be with half of its samples: that half's colour, twice the variance.

    The guides are the whole frame's: their noise matters less, and halves of them are rare.
    """
    signals = signals_of(frame)
    layers = dict(signals.layers)
    if "colour_std" in layers:
        layers["colour_std"] = layers["colour_std"] * np.float32(np.sqrt(2))
    spp = signals.spp / 2 if signals.spp else None
    return replace(signals, colour=_planes(half), layers=layers, spp=spp)


def _planes(image: FloatImage) -> FloatImage:
    if image.shape[2] == 1:
        image = np.repeat(image, 3, axis=2)
    return np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)


def _timed(progress: Progress | None, seconds: float, began: float) -> Any:
    """Progress by the clock or by steps, whichever ends first; never more than all of it."""
    if progress is None:
        return None

    def report(done: float, total: float, text: str) -> None:
        share = max(time.monotonic() - began, seconds * done / total)
        progress(min(share, seconds), seconds, text)

    return report
