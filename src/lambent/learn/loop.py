"""The one training loop.

Adam with decoupled weight decay (Loshchilov and Hutter 2019) or stochastic gradient descent, as the
recipe says, warm-up and a cosine, gradients held to a norm, a running mean of the weights (Polyak
and Juditsky 1992) that is what gets validated and shipped. Batches follow from seed and step
(`learn.batches`), the schedule from the step, so a run that is stopped and resumed takes the steps
that it would have taken.

A run is a folder::

    recipe.json      the settings        run.json       version, hardware, seconds spent
    log.jsonl        one line now and then: step, loss and its terms, or a validation
    state.pt         weights, mean weights, optimiser, step: all that resuming needs
    best.pt          the mean weights with the best validation score so far
    pictures/        validation pictures of the newest validation

``state.pt`` is replaced in one step, so a stop at any moment loses no more than `SAVE_EVERY`
seconds. With ``torchrun`` each process takes its share of every batch, and gradients are averaged.
"""

from __future__ import annotations

import datetime
import json
import math
import os
import platform
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from lambent import __version__
from lambent.device import choose_device
from lambent.errors import (
    DamagedFileError,
    FileError,
    OptionError,
    stop_by_interrupt,
)
from lambent.frame.atomic import atomic
from lambent.frame.tonemap import to_png
from lambent.learn.graphed import Graphed
from lambent.learn.recipe import TrainRecipe
from lambent.learn.task import RecordableTask, Task
from lambent.progress import Progress
from lambent.settings import fits, parse_json, read_json, read_text

#: Seconds from one saved state to the next.
SAVE_EVERY = 120.0
#: Steps from one line of the log to the next.
LOG_EVERY = 50
WEIGHT_DECAY = 1e-4
#: More steps than any run takes: one that ends by the clock.
ENDLESS = 1 << 60
#: The first process may have data to make before the others can go on.
PATIENCE = datetime.timedelta(days=7)


@dataclass(frozen=True)
class Run:
    """A training run on disk."""

    folder: Path

    @property
    def state(self) -> Path:
        """All that resuming needs."""
        return self.folder / "state.pt"

    @property
    def best(self) -> Path:
        """The best weights so far."""
        return self.folder / "best.pt"

    @property
    def log(self) -> Path:
        """What has happened, a JSON object a line."""
        return self.folder / "log.jsonl"

    @property
    def begun(self) -> Path:
        """What the first weights were, where they were not random: the runs before, oldest first.

        A JSON list of objects with the keys of `told`.
        """
        return self.folder / "begun_with.json"

    def before(self) -> list[dict[str, Any]]:
        """What is in `begun`; nothing if the run began with random weights."""
        if not self.begun.exists():
            return []
        remedy = "begin the run anew"
        try:
            found = parse_json(read_text(self.begun, "account of a run", remedy))
        except ValueError as error:
            raise FileError(f"is no JSON: {error}", file=self.begun, remedy=remedy) from None
        if not fits(found, list[dict[str, Any]]):
            raise FileError("is no list of runs", file=self.begun, remedy=remedy)
        return list(found)

    def told(self) -> dict[str, Any]:
        """What a card says of a run: recipe, hours, machine, best step and score, the curve.

        Raises `FileError` where there is no run, `ValueError` before the first validation.
        """
        recipe = self.recipe()
        recipe["data"] = [Path(folder).name for folder in recipe["data"]]
        about = read_json(self.folder / "run.json", "account of a run", "begin the run anew")
        checks = [ln for ln in self.lines() if "check" in ln]
        best = min(checks, key=lambda ln: ln["check"]["score"])
        return {
            "name": recipe["name"],
            "recipe": recipe,
            "step": best["step"],
            "hours": round(about["seconds"] / 3600, 2),
            "trained_with": {k: about[k] for k in ("lambent", "torch", "processor", "cuda")},
            "score": best["check"],
            "curve": [[ln["step"], ln["check"]["score"]] for ln in checks],
        }

    def lines(self) -> list[dict[str, Any]]:
        """The log; a last line that was cut off is left out."""
        found = []
        if self.log.exists():
            for line in self.log.read_text(encoding="utf-8").splitlines():
                with suppress(ValueError):
                    found.append(parse_json(line))
        return found

    def recipe(self) -> dict[str, Any]:
        """The settings of the run. Raises `FileError`."""
        return read_json(self.folder / "recipe.json", "recipe of a run", "name a run's folder")

    def weights(self) -> dict[str, torch.Tensor]:
        """The best mean weights. Raises `FileError` before the first validation."""
        found = _load(self.best)
        return dict(found["weights"])

    def last_weights(self) -> dict[str, torch.Tensor]:
        """The mean weights where the run stopped. Raises `FileError` before the first step."""
        return dict(_load(self.state)["mean"])


@dataclass
class Process:
    """Which of how many processes this is (``torchrun`` tells), and where it computes."""

    rank: int
    world: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Whether it is the one that writes."""
        return self.rank == 0

    def wait(self) -> None:
        """Until all processes are here."""
        if self.world > 1:
            torch.distributed.all_reduce(torch.zeros(1))


def train(
    recipe: TrainRecipe,
    task: Task,
    folder: Path,
    device: str = "auto",
    start: Mapping[str, torch.Tensor] | None = None,
    steps: int | None = None,
    seconds: float | None = None,
    check_first: bool = False,
    progress: Progress | None = None,
    after_check: Callable[[Run], None] | None = None,
) -> Run:
    """Train, or go on training, in ``folder``.

    ``start``: weights to begin with (fine-tuning). ``steps``: stop after so many in all, though
    the schedule is the recipe's. ``seconds``: stop after so long instead; the schedule then follows
    the clock, which starts anew with each call. ``check_first``: validate before the first step
    too. ``after_check`` is called after each validation.
    Raises `OptionError` for a folder that holds a run with another recipe, and for weights of
    another network.
    """
    here = join(device)
    run = Run(folder)
    if here.first:
        _prepare(run, recipe)
    torch.manual_seed(recipe.seed)
    if hasattr(task, "device"):
        task.device = here.device.type
    if here.device.type == "cuda":
        torch.backends.cudnn.benchmark = True  # batches are all of one shape
    model = task.network().to(here.device).to(memory_format=torch.channels_last)
    if start is not None:
        _begin_with(model, start)
    mean = {name: p.detach().clone() for name, p in model.state_dict().items()}
    optimiser = _optimiser(recipe, model)
    step, best, spent = 0, math.inf, 0.0
    if run.state.exists():
        state = _load(run.state)
        _fits(model, state["model"], run.state)
        model.load_state_dict(state["model"])
        mean = {k: v.to(here.device) for k, v in state["mean"].items()}
        optimiser.load_state_dict(state["optimiser"])
        step, best, spent = state["step"], state["best"], state["spent"]
    first = step
    last = recipe.steps if seconds is None else ENDLESS
    last = min(last, steps if steps is not None else last)
    parallel: nn.Module = DistributedDataParallel(model) if here.world > 1 else model
    recorded: tuple[RecordableTask, Graphed] | None = None
    if here.device.type == "cuda" and here.world == 1 and isinstance(task, RecordableTask):
        recorded = task, Graphed(model, task.loss_of)
    log = _Log(run, step) if here.first else None
    began = saved = time.monotonic()

    def save() -> None:
        nonlocal saved
        if here.first:
            state = {
                "model": model.state_dict(), "mean": mean, "optimiser": optimiser.state_dict(),
                "step": step, "best": best, "spent": spent + time.monotonic() - began,
            }  # fmt: skip
            with atomic(run.state, overwrite=True) as handle:
                torch.save(state, handle)
            _note(run, spent + time.monotonic() - began)
        saved = time.monotonic()

    if check_first and step == 0 and log is not None:
        best = _check(run, task, mean, here.device, step, best, log)
    batches = task.batches(step, here.rank, here.world)
    try:
        while step < last:
            share = None if seconds is None else (time.monotonic() - began) / seconds
            if share is not None and steps is not None:  # whichever ends first
                share = max(share, step / steps)
            if share is not None and share >= 1:
                last = step
                if log is not None:
                    best = _check(run, task, mean, here.device, step, best, log)
                break
            for group in optimiser.param_groups:
                group["lr"] = recipe.rate * schedule(recipe, step, share)
            if recorded is not None:
                maker, graphed = recorded
                loss, terms = graphed(maker.tensors(next(batches), here.device))
            else:
                loss, terms = task.loss(parallel, next(batches), here.device)
                optimiser.zero_grad(set_to_none=True)
                loss.backward()
            norm = nn.utils.clip_grad_norm_(model.parameters(), recipe.clip)
            _step(optimiser, norm)
            step += 1
            _average(mean, model, min(recipe.decay, (1 + step) / (10 + step)))
            if log is not None:
                log.add(step, loss.detach(), terms, norm, optimiser.param_groups[0]["lr"])
            if progress is not None and here.first:
                if seconds is not None and last == ENDLESS:
                    gone = min(time.monotonic() - began, seconds)
                    progress(gone, seconds, f"training {recipe.name}, step {step}")
                else:
                    words = f"training {recipe.name}, step {step} of {last}"
                    progress(step - first, last - first, words)
            ended = step == (recipe.steps if seconds is None else last)
            if step % recipe.check_every == 0 or ended:
                if here.first and log is not None:
                    best = _check(run, task, mean, here.device, step, best, log)
                    save()
                    if after_check is not None:
                        after_check(run)
                here.wait()
            elif time.monotonic() - saved > SAVE_EVERY:
                save()
    finally:
        save()
        close = getattr(batches, "close", None)
        if close is not None:
            close()
        if log is not None:
            log.close()
        if here.world > 1:
            torch.distributed.destroy_process_group()
    return run


def schedule(recipe: TrainRecipe, step: int, share: float | None = None) -> float:
    """The learning rate as a share of the highest: a ramp, then half a cosine.

    ``share``: of the run that is over, where it has a time rather than a number of steps.
    """
    if step < recipe.warmup:
        return (step + 1) / recipe.warmup
    done = (
        share
        if share is not None
        else (step - recipe.warmup) / max(1, recipe.steps - recipe.warmup)
    )
    return recipe.last_rate + (1 - recipe.last_rate) * 0.5 * (1 + math.cos(math.pi * min(done, 1)))


def join(device: str) -> Process:
    """This process among those of ``torchrun``; alone without it.

    Raises `OptionError` for an unknown device, `EngineError` for one that is not there.
    """
    kind = choose_device(device, torch.cuda.is_available)
    world, rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
    here = int(os.environ.get("LOCAL_RANK", 0))
    place = torch.device("cuda", here) if kind == "cuda" else torch.device("cpu")
    if world > 1 and not torch.distributed.is_initialized():
        backend = "cpu:gloo,cuda:nccl" if kind == "cuda" else "gloo"
        torch.distributed.init_process_group(backend, timeout=PATIENCE)
    return Process(rank, world, place)


def use_threads(count: int) -> None:
    """Let PyTorch use so many processors."""
    torch.set_num_threads(count)


# ------------------------------------------------------------------- private


def _begin_with(model: nn.Module, start: Mapping[str, torch.Tensor]) -> None:
    """Take the weights over. Raises `OptionError` where they are not this network's."""
    own = model.state_dict()
    lacking = [k for k, v in own.items() if k not in start or start[k].shape != v.shape]
    if lacking:
        raise OptionError(
            f"the weights to begin with are of another network: {lacking[0]} is not among them"
            + (f", nor are {len(lacking) - 1} others" if len(lacking) > 1 else ""),
            remedy="name the folder of a run of this network; model files of networks with "
            "normalisation cannot be trained on",
        )
    model.load_state_dict({name: start[name] for name in own})


def _fits(model: nn.Module, weights: Mapping[str, torch.Tensor], file: Path) -> None:
    """Raises `FileError` where a run's weights are those of another version's network."""
    own = {name: p.shape for name, p in model.state_dict().items()}
    if own != {name: p.shape for name, p in weights.items()}:
        raise FileError(
            "holds a run of another network, as an earlier version of Lambent had it",
            file=file,
            remedy="train into another folder with --run, or delete this one",
        )


def _optimiser(recipe: TrainRecipe, model: nn.Module) -> torch.optim.Optimizer:
    """Of the parameters that are free to learn."""
    free = [p for p in model.parameters() if p.requires_grad]
    if recipe.optimiser == "adam":
        return torch.optim.AdamW(
            free, lr=recipe.rate, weight_decay=WEIGHT_DECAY, betas=(0.9, 0.99),
            fused=True if free[0].is_cuda else None,
        )  # fmt: skip
    momentum = 0.9 if recipe.optimiser == "momentum" else 0.0
    return torch.optim.SGD(free, lr=recipe.rate, weight_decay=WEIGHT_DECAY, momentum=momentum)


def _step(optimiser: torch.optim.Optimizer, norm: torch.Tensor) -> None:
    """A step, unless its gradients are not finite: one from a bad batch would be the last one."""
    if optimiser.defaults.get("fused"):
        # asking the device would hold up the processor; the fused step takes the answer there
        optimiser.found_inf = (~torch.isfinite(norm)).float()  # type: ignore[attr-defined]
        optimiser.grad_scale = None  # type: ignore[attr-defined]
        optimiser.step()
    elif bool(torch.isfinite(norm)):
        optimiser.step()


def _prepare(run: Run, recipe: TrainRecipe) -> None:
    """Make the folder, or make sure that it is this recipe's."""
    path = run.folder / "recipe.json"
    if path.exists():
        known = run.recipe()
        different = sorted(k for k, v in recipe.as_dict().items() if known.get(k) != v)
        different = [k for k in different if k not in ("data", "checked", "known_failures")]
        if different:
            raise OptionError(
                f"holds a run with another recipe: {', '.join(different)} differ",
                file=run.folder,
                remedy="train into another folder with --run, or delete this one",
            )
        return
    run.folder.mkdir(parents=True, exist_ok=True)
    with atomic(path) as handle:
        handle.write(json.dumps(recipe.as_dict(), indent=1).encode())


def _check(
    run: Run,
    task: Task,
    mean: Mapping[str, torch.Tensor],
    device: torch.device,
    step: int,
    best: float,
    log: _Log,
) -> float:
    """Validate the mean weights; keep them if they are the best so far."""
    model = task.network().to(device).to(memory_format=torch.channels_last)
    model.load_state_dict(dict(mean))
    model.eval()
    scores, pictures = task.score(model, device)
    log.check(step, scores)
    place = run.folder / "pictures"
    place.mkdir(exist_ok=True)
    for number, image in enumerate(pictures.values()):
        with atomic(place / f"{number}.png", overwrite=True) as handle:
            handle.write(to_png(np.asarray(image)))
    if scores["score"] < best:
        best = scores["score"]
        with atomic(run.best, overwrite=True) as handle:
            torch.save({"weights": dict(mean), "step": step, "scores": scores}, handle)
    return best


def _average(mean: dict[str, torch.Tensor], model: nn.Module, decay: float) -> None:
    with torch.no_grad():
        now = model.state_dict()
        names = [name for name, value in now.items() if value.is_floating_point()]
        torch._foreach_lerp_([mean[n] for n in names], [now[n] for n in names], 1 - decay)
        for name in now.keys() - set(names):
            mean[name].copy_(now[name])


def _load(path: Path) -> dict[str, Any]:
    """A file of tensors and numbers; nothing in it is run."""
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise FileError("is not there yet", file=path, remedy="train first") from None
    except Exception as error:
        stop_by_interrupt(error)
        raise DamagedFileError(
            f"cannot be read: {error}", file=path, remedy="delete it, or the whole run"
        ) from None
    assert isinstance(found, dict)
    return found


def _note(run: Run, seconds: float) -> None:
    about = {
        "lambent": __version__,
        "torch": torch.__version__,
        "machine": platform.machine(),
        "processor": _processor(),
        "threads": torch.get_num_threads(),
        "cuda": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "seconds": round(seconds, 1),
    }
    with atomic(run.folder / "run.json", overwrite=True) as handle:
        handle.write(json.dumps(about, indent=1).encode())


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


class _Log:
    """The log file, and TensorBoard's where it is installed."""

    def __init__(self, run: Run, step: int) -> None:
        # what was logged after the state that is resumed will be logged again
        kept = [line for line in run.lines() if line["step"] <= step]
        with atomic(run.log, overwrite=True) as handle:
            handle.write("".join(json.dumps(line) + "\n" for line in kept).encode())
        self._file = run.log.open("a", encoding="utf-8")
        self._sums: dict[str, Any] = {}
        self._count = 0
        self._since = time.monotonic()
        self._board: Any = None
        with suppress(ImportError):
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(run.folder / "tensorboard"), purge_step=step)

    def add(
        self,
        step: int,
        loss: torch.Tensor,
        terms: Mapping[str, Any],
        norm: torch.Tensor,
        rate: float,
    ) -> None:
        """Take a step into the means; write them now and then."""
        for name, value in {"loss": loss, **terms}.items():
            # sums stay on the device: to read one is to wait for it
            self._sums[name] = self._sums.get(name, 0.0) + value.detach().double()
        self._count += 1
        if step % LOG_EVERY:
            return
        now = time.monotonic()
        line = {name: round(float(total) / self._count, 6) for name, total in self._sums.items()}
        line |= {"rate": rate, "norm": round(float(norm), 4)}
        line["steps_a_second"] = round(self._count / max(now - self._since, 1e-9), 3)
        self._write({"step": step, **line}, "train")
        self._sums, self._count, self._since = {}, 0, now

    def check(self, step: int, scores: Mapping[str, float]) -> None:
        """Write a validation."""
        rounded = {name: round(value, 6) for name, value in scores.items()}
        self._write({"step": step, "check": rounded}, "check")
        self._since = time.monotonic()

    def close(self) -> None:
        """Close the files."""
        self._file.close()
        if self._board is not None:
            self._board.close()

    def _write(self, line: Mapping[str, Any], kind: str) -> None:
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
        if self._board is not None:
            for name, value in line.get("check", line).items():
                if isinstance(value, float):
                    self._board.add_scalar(f"{kind}/{name}", value, line["step"])
