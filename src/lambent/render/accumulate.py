"""A picture that grows: passes of samples until enough of them, of time, or of quality.

The EXR itself is the checkpoint: it holds means, variances, half buffers and the number of samples
of every pixel, which is all that `Moments` are made of. It is written once a minute (or less often,
where writing takes long), in one step; so a stop at any moment leaves the picture as it was at the
last checkpoint, and a later run goes on from there, with samples of its own.

A pass has the random numbers of its first sample's number, so a render that was stopped and gone on
with never takes a sample twice.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lambent.errors import LayerError, OptionError, OutputError, by_interrupt
from lambent.frame.files import read, write
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role, Stat
from lambent.frame.windows import Windows
from lambent.render.channels import Group
from lambent.render.moments import Moments
from lambent.settings import parse_json

if TYPE_CHECKING:
    from lambent.render.sampling import FrameSampler

#: Paths a pass traces, about: some seconds on two cores.
PASS_PATHS = 3_000_000
#: Seconds between checkpoints, and the most of the time that writing them may take.
CHECKPOINT_SECONDS, CHECKPOINT_SHARE = 60.0, 0.05
#: Where the EXR keeps what it was rendered from.
ATTRIBUTE = "lambent_render"


@dataclass(frozen=True)
class Goal:
    """When a picture is done: at ``spp`` samples, after ``seconds``, or below ``error`` (relMSE).

    What is None does not count; whichever comes first ends the render.
    """

    spp: int | None = 64
    seconds: float | None = None
    error: float | None = None

    def __post_init__(self) -> None:
        for name, least in (("spp", 1), ("seconds", 0), ("error", 0)):
            value = getattr(self, name)
            if value is not None and (not value > 0 or value < least):
                raise OptionError(
                    f"'{name}' must be more than zero, not {value}",
                    remedy="take --spp 64, --time 60 or --target-error 0.01",
                )
        if self.spp is None and self.seconds is None and self.error is None:
            raise OptionError(
                "the render would never end", remedy="give --spp, --time or --target-error"
            )


@dataclass(frozen=True)
class Stamp:
    """What a picture was rendered from; only pictures of equal stamps are added up."""

    scene: str
    width: int
    height: int
    depth: int
    seed: int
    camera: str
    layers: tuple[str, ...]
    integrator: str = "path"
    frame: float = 0
    version: int = 1

    def text(self) -> str:
        """As the EXR's header keeps it."""
        return json.dumps(asdict(self), sort_keys=True)


@dataclass(frozen=True)
class State:
    """How far a render is. ``left``: seconds to go, None where nobody can tell."""

    moments: Moments
    goal: Goal
    seconds: float
    paths_per_second: float
    left: float | None
    share: float

    def text(self) -> str:
        """One line for a progress display."""
        wanted = f"/{self.goal.spp}" if self.goal.spp else ""
        return (
            f"{self.moments.spp}{wanted} spp, {self.paths_per_second / 1e6:.2f} M paths/s, "
            f"relMSE about {self.moments.error():.2g}"
        )


def accumulate(
    sampler: FrameSampler,
    goal: Goal,
    *,
    seed: int = 0,
    start: Moments | None = None,
    report: Callable[[State], None] | None = None,
    checkpoint: Callable[[Moments], None] | None = None,
    every: float = CHECKPOINT_SECONDS,
) -> Moments:
    """Trace passes until the goal is met; ``start`` is what there is already.

    ``report`` is called after every pass, ``checkpoint`` after
    ``every`` seconds (a minute). On Ctrl-C the samples so
    far are handed to ``checkpoint`` before `KeyboardInterrupt` goes on.
    """
    moments, began = start, time.monotonic()
    traced = 0
    saved_at, save_seconds = began, 0.0
    try:
        while True:
            done = moments.spp if moments else 0
            spent = time.monotonic() - began
            if moments is not None and _met(moments, goal, spent):
                return moments
            spp = _pass_spp(sampler, goal, done, traced, spent)
            found = sampler.sample(spp, pass_seed(seed, done))
            moments = found if moments is None else moments + found
            traced += spp
            now = time.monotonic()
            if report:
                report(_state(moments, goal, traced, now - began, start))
            if checkpoint and now - saved_at > max(every, save_seconds / CHECKPOINT_SHARE):
                checkpoint(moments)
                saved_at, save_seconds = time.monotonic(), time.monotonic() - now
    except BaseException as error:  # Dr.Jit makes an error of its own of Ctrl-C
        if not by_interrupt(error):
            raise
        if checkpoint and moments is not None and moments is not start:
            checkpoint(moments)
        raise KeyboardInterrupt from error


def pass_seed(seed: int, first: int) -> int:
    """The seed of the pass whose first sample has this number: 32 bits, well mixed (SplitMix64)."""
    z = (seed * 0x9E3779B97F4A7C15 + first * 0xD1B54A32D192ED03 + 0x632BE59BD9B4E019) % 2**64
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) % 2**64
    return (z ^ (z >> 31)) >> 32


# --------------------------------------------------------------- the checkpoint


def save(path: str | Path, moments: Moments, stamp: Stamp, windows: Windows | None = None) -> Frame:
    """Write the picture so far, in one step, over an older one. Returns its frame.

    ``windows``: where its pixels lie in the whole picture.
    """
    frame = moments.frame(windows=windows)
    counts = [("samples", moments.count), ("half_samples", moments.half_count)]
    if moments.dropped:  # else all pixels have the same, which spp tells
        for name, image in counts:
            frame = frame.with_layer(Layer(Role.OTHER, image, name=name))
    write(path, frame, overwrite=True, attributes={ATTRIBUTE: stamp.text()})
    return frame


def stamp_of(path: str | Path) -> Stamp | None:
    """What an EXR was rendered from; None for a file of other origin."""
    from lambent.frame.exr import decode

    text = decode(Path(path)).parts[0].header.get(ATTRIBUTE)
    if text is None:
        return None
    try:
        found = parse_json(text)
        return Stamp(**{**found, "layers": tuple(found["layers"])})
    except (ValueError, TypeError, KeyError):
        return None


def resume(path: str | Path, stamp: Stamp, groups: tuple[Group, ...]) -> Moments:
    """The samples in an EXR that `save` wrote, to go on from.

    Raises `OutputError` if it is of another scene, size, seed or version: never mixed.
    """
    there = stamp_of(path)
    if there is None:
        raise OutputError(
            "was not rendered by lambent, so nothing can be added to it",
            file=path,
            remedy="name another output, or start again with --overwrite",
        )
    for name, mine in asdict(stamp).items():
        theirs = getattr(there, name)
        if mine != theirs:
            raise OutputError(
                f"was rendered with another {name} ({_short(theirs)}, now {_short(mine)}), "
                "so nothing can be added to it",
                file=path,
                remedy=f"give the same {name}, name another output, or start again with "
                "--overwrite",
            )
    return _moments_of(read(path), groups)


def _short(value: Any) -> str:
    text = ", ".join(value) if isinstance(value, tuple) else str(value)
    return text if len(text) < 60 else text[:57] + "..."


def _moments_of(frame: Frame, groups: tuple[Group, ...]) -> Moments:
    spp = frame.spp or 0
    shape = frame.height, frame.width
    count = frame.extras["samples"].data[:, :, 0] if "samples" in frame.extras else None
    halves = frame.extras["half_samples"].data[:, :, 0] if "half_samples" in frame.extras else None
    dropped = 0
    if count is None or halves is None:
        count = np.full(shape, spp, np.float32)
        halves = np.full(shape, (spp + 1) // 2, np.float32)
    else:
        dropped = round(spp * count.size - float(count.sum(dtype=np.float64)))
    means: list[Any] = []
    variances: list[Any] = []
    for group in groups:
        for stat, into in ((Stat.MEAN, means), (Stat.VARIANCE, variances)):
            into.append(_layer_of(frame, group, stat))
    spread = np.concatenate(variances, axis=2)
    spread = spread * (np.maximum(count - 1, 1) * np.maximum(count, 1))[:, :, None]
    mean = np.concatenate(means, axis=2)
    colour = mean[:, :, :3]  # one sample has no halves: it is half A
    half_a = frame.get(Role.COLOUR, Stat.HALF_A)
    half_b = frame.get(Role.COLOUR, Stat.HALF_B)
    half_a = colour if half_a is None else half_a
    half_b = np.zeros_like(colour) if half_b is None else half_b
    return Moments(groups, spp, count, mean, spread, half_a, half_b, halves, dropped)


def _layer_of(frame: Frame, group: Group, stat: Stat) -> Any:
    if group.role in (Role.OTHER, Role.LIGHTING):
        name = group.name if stat is Stat.MEAN else f"{group.name}_variance"
        found = frame.extras.get(name)
        image = None if found is None else found.data
    else:
        image = frame.get(group.role, stat)
    if image is None and stat is Stat.VARIANCE and (frame.spp or 0) < 2:
        return np.zeros_like(_layer_of(frame, group, Stat.MEAN))  # one sample has none
    if image is None:
        raise LayerError("is missing in the picture to go on from", layer=group.name)
    return image


# ------------------------------------------------------------------- private


def _met(moments: Moments, goal: Goal, spent: float) -> bool:
    if goal.spp is not None and moments.spp >= goal.spp:
        return True
    if goal.seconds is not None and spent >= goal.seconds:
        return True
    # Two samples say nothing about their spread.
    return goal.error is not None and moments.spp >= 8 and moments.error() <= goal.error


def _pass_spp(sampler: FrameSampler, goal: Goal, done: int, traced: int, spent: float) -> int:
    """How many samples next: few at first, so that there is a picture soon, then twice as many."""
    width, height = sampler.size
    spp = min(max(1, PASS_PATHS // (width * height)), max(4, done))
    if goal.spp is not None:
        spp = min(spp, goal.spp - done)
    if goal.seconds is not None and traced and spent > 0:
        spp = min(spp, max(1, int((goal.seconds - spent) * traced / spent)))
    return max(spp, 1)


def _state(
    moments: Moments, goal: Goal, traced: int, seconds: float, start: Moments | None
) -> State:
    width, height = moments.size
    pace = traced / max(seconds, 1e-6)
    already = start.spp if start else 0
    left, share = [], [0.0]
    if goal.spp is not None:
        left.append((goal.spp - moments.spp) / pace)
        share.append((moments.spp - already) / max(goal.spp - already, 1))
    if goal.seconds is not None:
        left.append(goal.seconds - seconds)
        share.append(seconds / goal.seconds)
    if goal.error is not None and moments.spp >= 8:
        error = moments.error()
        wanted = moments.spp * error / goal.error  # error falls as 1/spp
        left.append((wanted - moments.spp) / pace)
        share.append(min(1.0, goal.error / max(error, 1e-12)))
    return State(
        moments,
        goal,
        seconds,
        pace * width * height,
        max(0.0, min(left)) if left else None,
        min(1.0, max(share)),
    )
