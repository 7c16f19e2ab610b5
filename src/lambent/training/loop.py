"""The one training loop.

Adam with decoupled weight decay (Loshchilov and Hutter 2019) or stochastic gradient descent, as the
schedule has it, warm-up and a cosine, gradients held to a norm, a running mean of the weights
(Polyak and Juditsky 1992) that is what gets validated and shipped. A task's batches follow from
seed and step, the learning rate from the step, and PyTorch's random numbers are part of the state,
so a run that is stopped and resumed takes the steps that it would have taken.

A run is a folder (`training.run`). ``state.pt`` is replaced in one step, so a stop at any moment
loses no more than `SAVE_EVERY` seconds. With ``torchrun`` each process takes its share of every
batch, and gradients are averaged.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from lambent.errors import FileError, OptionError
from lambent.frame.atomic import atomic
from lambent.frame.tonemap import to_png
from lambent.progress import Progress
from lambent.training.graphed import Graphed
from lambent.training.log import Log, note
from lambent.training.process import Process, join
from lambent.training.run import Run, load
from lambent.training.schedule import Schedule
from lambent.training.task import RecordableTask, Task, Weights

#: Seconds from one saved state to the next.
SAVE_EVERY = 120.0
#: More steps than any run takes: one that ends by the clock.
ENDLESS = 1 << 60


def train(
    schedule: Schedule,
    task: Task,
    folder: Path,
    device: str = "auto",
    start: Weights | None = None,
    steps: int | None = None,
    seconds: float | None = None,
    check_first: bool = False,
    progress: Progress | None = None,
    settings: Mapping[str, Any] | None = None,
    may_differ: Collection[str] = (),
) -> Run:
    """Train, or go on training, in ``folder``.

    ``start``: weights to begin with (fine-tuning). ``steps``: stop after so many in all, though
    the schedule stays what it is. ``seconds``: stop after so long instead; the learning rate then
    follows the clock, which starts anew with each call. ``check_first``: validate before the first
    step too. ``settings``: what the run is kept
    with (its ``name`` is used in messages); None: the schedule. A run is gone on with only where
    all but ``may_differ`` are the same.
    Raises `OptionError` for a folder that holds a run with other settings, and for weights of
    another network.
    """
    run, here = Run(folder), join(device)
    kept = asdict(schedule) if settings is None else settings
    if here.first:
        run.prepare(kept, may_differ)
    loop = _Loop(schedule, task, run, here, start)
    end = _End(schedule, steps, seconds, str(kept.get("name", folder.name)))
    try:
        loop.go_on(end, check_first, progress)
    finally:
        if here.world > 1:
            torch.distributed.destroy_process_group()
    return run


# ------------------------------------------------------------------- private


class _End:
    """When a call of `train` is over: by steps, by the clock, or by what comes first."""

    def __init__(
        self, schedule: Schedule, steps: int | None, seconds: float | None, name: str
    ) -> None:
        self._steps, self._seconds, self._name = steps, seconds, name
        last = schedule.steps if seconds is None else ENDLESS
        self.last = min(last, steps if steps is not None else last)
        #: Where the run itself is over, rather than this call.
        self.whole = schedule.steps if seconds is None else self.last
        self._began = time.monotonic()

    def share(self, step: int) -> float | None:
        """How much is over of a run that has a time; None for one that has steps alone."""
        if self._seconds is None:
            return None
        share = (time.monotonic() - self._began) / self._seconds
        return share if self._steps is None else max(share, step / self._steps)

    def progress(self, first: int, step: int) -> tuple[float, float, str]:
        """What is done, of how much, in words; ``first``: where this call began."""
        words = f"training {self._name}, step {step}"
        if self._seconds is not None and self.last == ENDLESS:
            return min(time.monotonic() - self._began, self._seconds), self._seconds, words
        return step - first, self.last - first, f"{words} of {self.last}"


class _Loop:
    """A run at work: all that is in ``state.pt``, and the steps."""

    def __init__(
        self, schedule: Schedule, task: Task, run: Run, here: Process, start: Weights | None
    ) -> None:
        self.schedule, self.task, self.run, self.here = schedule, task, run, here
        task.device = str(here.device)
        torch.manual_seed(schedule.seed)
        if here.device.type == "cuda":
            torch.backends.cudnn.benchmark = True  # batches are all of one shape
        resumed = run.state.exists()
        self.model = self._network()
        weights = None if resumed else task.started(start)
        if weights is not None:
            _begin_with(self.model, weights)
        self.mean = {name: p.detach().clone() for name, p in self.model.state_dict().items()}
        self.optimiser = _optimiser(schedule, self.model)
        self.step, self.best, self.spent = 0, math.inf, 0.0
        if resumed:
            self._resume()
        self.began = self.saved = time.monotonic()
        self.log = Log(run, self.step) if here.first else None

    def go_on(
        self,
        end: _End,
        check_first: bool,
        progress: Progress | None,
    ) -> None:
        """Take steps until the end, whatever it is; then save."""
        here, schedule, first = self.here, self.schedule, self.step
        if check_first and first == 0:
            self._check()
        batches = self.task.batches(first, here.rank, here.world)
        learn = self._learner()
        try:
            while self.step < end.last:
                share = end.share(self.step)
                if share is not None and share >= 1:
                    self._check()
                    break
                for group in self.optimiser.param_groups:
                    group["lr"] = schedule.rate_at(self.step, share)
                loss, terms = learn(next(batches))
                norm = nn.utils.clip_grad_norm_(self.model.parameters(), schedule.clip)
                _step(self.optimiser, norm)
                self.step += 1
                self._average()
                if self.log is not None:
                    rate = self.optimiser.param_groups[0]["lr"]
                    self.log.add(self.step, loss.detach(), terms, norm, rate)
                if progress is not None and here.first:
                    progress(*end.progress(first, self.step))
                if self.step % schedule.check_every == 0 or self.step == end.whole:
                    self._check()
                    self._save()
                    here.wait()
                elif time.monotonic() - self.saved > SAVE_EVERY:
                    self._save()
        finally:
            self._save()
            batches.close()
            if self.log is not None:
                self.log.close()

    def _network(self) -> nn.Module:
        return self.task.network().to(self.here.device).to(memory_format=torch.channels_last)

    def _learner(self) -> Callable[[Any], tuple[Tensor, Mapping[str, Tensor]]]:
        """A function of a batch to its loss and terms, which sets the gradients."""
        task, model = self.task, self.model
        alone = self.here.device.type == "cuda" and self.here.world == 1
        if alone and isinstance(task, RecordableTask):
            tensors, graphed = task.tensors, Graphed(model, task.loss_of)
            return lambda batch: graphed(tensors(batch))
        parallel: nn.Module = DistributedDataParallel(model) if self.here.world > 1 else model

        def learn(batch: Any) -> tuple[Tensor, Mapping[str, Tensor]]:
            loss, terms = task.loss(parallel, batch)
            self.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            return loss, terms

        return learn

    def _resume(self) -> None:
        """Take up the state. Raises `FileError` where it is of another network or version."""
        state, file = load(self.run.state), self.run.state
        own = {name: p.shape for name, p in self.model.state_dict().items()}
        if own != {name: p.shape for name, p in state["model"].items()}:
            raise _earlier("a run of another network", file)
        if "random" not in state:
            raise _earlier("the state of a run", file)
        self.model.load_state_dict(state["model"])
        self.mean = {k: v.to(self.here.device) for k, v in state["mean"].items()}
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.best, self.spent = state["step"], state["best"], state["spent"]
        torch.set_rng_state(state["random"]["cpu"])
        if self.here.device.type == "cuda" and "cuda" in state["random"]:
            torch.cuda.set_rng_state(state["random"]["cuda"], self.here.device)
        self.task.resume(state["task"])

    def _save(self) -> None:
        if self.here.first:
            random = {"cpu": torch.get_rng_state()}
            if self.here.device.type == "cuda":
                random["cuda"] = torch.cuda.get_rng_state(self.here.device)
            spent = self.spent + time.monotonic() - self.began
            state = {
                "model": self.model.state_dict(), "mean": self.mean,
                "optimiser": self.optimiser.state_dict(), "step": self.step, "best": self.best,
                "spent": spent, "random": random, "task": dict(self.task.state()),
            }  # fmt: skip
            with atomic(self.run.state, overwrite=True) as handle:
                torch.save(state, handle)
            note(self.run, spent)
        self.saved = time.monotonic()

    def _average(self) -> None:
        decay = min(self.schedule.decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            now = self.model.state_dict()
            names = [name for name, value in now.items() if value.is_floating_point()]
            torch._foreach_lerp_([self.mean[n] for n in names], [now[n] for n in names], 1 - decay)
            for name in now.keys() - set(names):
                self.mean[name].copy_(now[name])

    def _check(self) -> None:
        """Validate the mean weights; keep them if they are the best so far."""
        if self.log is None:
            return
        model = self._network()
        model.load_state_dict(self.mean)
        with torch.no_grad():
            scores, pictures = self.task.score(model.eval())
        self.log.check(self.step, scores)
        self.run.pictures.mkdir(exist_ok=True)
        for number, image in enumerate(pictures.values()):
            with atomic(self.run.pictures / f"{number}.png", overwrite=True) as handle:
                handle.write(to_png(np.asarray(image)))
        if scores["score"] < self.best:
            self.best = scores["score"]
            kept = {"weights": self.mean, "step": self.step, "scores": dict(scores)}
            with atomic(self.run.best, overwrite=True) as handle:
                torch.save(kept, handle)


def _begin_with(model: nn.Module, start: Weights) -> None:
    """Take the weights over. Raises `OptionError` where they are not this network's."""
    own = model.state_dict()
    lacking = [k for k, v in own.items() if k not in start or start[k].shape != v.shape]
    if lacking:
        raise OptionError(
            f"the weights to start from belong to another network: {lacking[0]} is not among them"
            + (f", nor are {len(lacking) - 1} others" if len(lacking) > 1 else ""),
            remedy="name the folder of a run of this network; model files of networks with "
            "normalisation cannot be trained on",
        )
    model.load_state_dict({name: start[name] for name in own})


def _earlier(what: str, file: Path) -> FileError:
    return FileError(
        f"holds {what}, in the form of an earlier version of Lambent",
        file=file,
        remedy="train into another folder with --run, or delete this one",
    )


def _optimiser(schedule: Schedule, model: nn.Module) -> torch.optim.Optimizer:
    """Of the parameters that are free to learn."""
    free = [p for p in model.parameters() if p.requires_grad]
    decay = schedule.weight_decay
    if schedule.optimiser == "adam":
        return torch.optim.AdamW(
            free, lr=schedule.rate, weight_decay=decay, betas=(0.9, 0.99),
            fused=True if free[0].is_cuda else None,
        )  # fmt: skip
    momentum = 0.9 if schedule.optimiser == "momentum" else 0.0
    return torch.optim.SGD(free, lr=schedule.rate, weight_decay=decay, momentum=momentum)


def _step(optimiser: torch.optim.Optimizer, norm: Tensor) -> None:
    """A step, unless its gradients are not finite: one from a bad batch would be the last one."""
    if optimiser.defaults.get("fused"):
        # asking the device would hold up the processor; the fused step takes the answer there
        optimiser.found_inf = (~torch.isfinite(norm)).float()  # type: ignore[attr-defined]
        optimiser.grad_scale = None  # type: ignore[attr-defined]
        optimiser.step()
    elif bool(torch.isfinite(norm)):
        optimiser.step()
