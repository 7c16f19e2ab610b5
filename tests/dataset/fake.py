"""A source without a renderer: pictures made of formulas and seeded noise, in milliseconds."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

import numpy as np

from lambent.dataset.source import UnfitSceneError, Window
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.role import Role, Space, Stat


def truth(seed: int, size: tuple[int, int], scale: float = 1.0, shift: float = 0.0):
    """The noise-free layers of a scene; its left third is black, its right third has no detail."""
    width, height = size
    x = (np.arange(width) + 0.5) / scale
    y = (np.arange(height) + 0.5) / scale
    x, y = np.meshgrid(x, y)
    rng = np.random.default_rng(seed)
    fx, fy = rng.uniform(0.1, 0.4, 2)
    pattern = 0.5 + 0.5 * np.sin(fx * (x + shift)) * np.cos(fy * y)
    full = width / scale
    middle = ((x > full / 3) & (x < 2 * full / 3)).astype(float)
    lit = (x > full / 3).astype(float)
    albedo = np.stack([pattern * middle + 0.3 * (1 - middle)] * 3, -1) * [0.9, 0.7, 0.5]
    diffuse = albedo * lit[..., None] * rng.uniform(0.5, 2)
    specular = 0.2 * np.stack([pattern**4 * middle] * 3, -1)
    tilt = pattern * middle
    normal = np.stack([np.sin(tilt), np.cos(tilt), np.zeros_like(tilt)], -1)
    depth = (2 + tilt)[..., None]
    return {
        Role.COLOUR: diffuse + specular,
        Role.DIFFUSE: diffuse,
        Role.SPECULAR: specular,
        Role.DIRECT: 0.7 * diffuse,
        Role.INDIRECT: 0.3 * diffuse + specular,
        Role.ALBEDO: albedo,
        Role.NORMAL: normal,
        Role.DEPTH: depth,
    }, middle


@dataclass
class FakeSamples:
    """Sums of samples of every channel."""

    count: int
    sums: dict
    squares: dict
    half: np.ndarray
    half_count: int

    @property
    def spp(self) -> int:
        return self.count

    def __add__(self, other: FakeSamples) -> FakeSamples:
        return FakeSamples(
            self.count + other.count,
            {k: self.sums[k] + other.sums[k] for k in self.sums},
            {k: self.squares[k] + other.squares[k] for k in self.sums},
            self.half + other.half,
            self.half_count + other.half_count,
        )

    def frame(self) -> Frame:
        n = self.count
        layers = []
        for role, total in self.sums.items():
            mean = total / n
            variance = np.maximum(self.squares[role] / n - mean**2, 0) / max(n - 1, 1)
            space = Space.WORLD if role is Role.NORMAL else None
            layers.append(Layer(role, mean.astype(np.float32), space=space))
            layers.append(Layer(role, variance.astype(np.float32), Stat.VARIANCE, space=space))
        if n > 1:
            a = self.half / self.half_count
            b = (self.sums[Role.COLOUR] - self.half) / (n - self.half_count)
            layers += [Layer(Role.COLOUR, a, Stat.HALF_A), Layer(Role.COLOUR, b, Stat.HALF_B)]
        return Frame.from_layers(layers, spp=n)


@dataclass
class FakeView:
    seed: int
    size: tuple[int, int]
    shift: float = 0.0
    motion: bool = False

    def pilot(self, size, spp, seed):
        layers, middle = truth(self.seed, size, size[0] / self.size[0], self.shift)
        return self._sampled(layers, middle, spp, seed).frame()

    def sample(self, draws) -> list[FakeSamples]:
        return [self.one(draw.window, draw.spp, draw.seed) for draw in draws]

    def one(self, window: Window, spp: int, seed: int) -> FakeSamples:
        time.sleep(float(os.environ.get("LAMBENT_FAKE_SLEEP", "0")))
        layers, middle = truth(self.seed, self.size, 1.0, self.shift)
        rows = slice(window.y, window.y + window.edge)
        columns = slice(window.x, window.x + window.edge)
        cut = {role: image[rows, columns] for role, image in layers.items()}
        return self._sampled(cut, middle[rows, columns], spp, seed)

    def _sampled(self, layers, middle, spp, seed):
        """Noise of the pattern's part only; the same numbers scale light of all kinds."""
        rng = np.random.default_rng(seed)
        shape = middle.shape
        factors = 1 + (rng.exponential(1, (min(spp, 8), *shape)) - 1) * middle
        factors = np.repeat(factors, -(-spp // len(factors)), axis=0)[:spp]
        light = {Role.COLOUR, Role.DIFFUSE, Role.SPECULAR, Role.DIRECT, Role.INDIRECT}
        total, squares = factors.sum(0)[..., None], (factors**2).sum(0)[..., None]
        sums, square_sums = {}, {}
        for role, image in layers.items():
            sums[role] = image * (total if role in light else spp)
            square_sums[role] = image**2 * (squares if role in light else spp)
        if self.motion:
            sums[Role.MOTION] = np.full((*shape, 2), [1.5, 0.0]) * spp
            square_sums[Role.MOTION] = sums[Role.MOTION] ** 2 / spp
        half = layers[Role.COLOUR] * factors[::2].sum(0)[..., None]
        return FakeSamples(spp, sums, square_sums, half, (spp + 1) // 2)


class FakeScene:
    cameras = 3

    def __init__(self, seed: int, size: tuple[int, int], frames: int) -> None:
        self.seed, self.size, self.frames = seed, size, frames
        self.about = {"kind": "stripes" if seed % 2 else "waves", "seed": seed}

    def views(self, camera: int):
        moving = self.frames > 1
        return [
            FakeView(self.seed + camera, self.size, 1.5 * k, moving) for k in range(self.frames)
        ]


class FakeSource:
    """Every seventh scene is unfit. ``kinds = ["crash"]`` in the recipe kills the process once."""

    licences = ("CC0-1.0",)

    def __init__(self, recipe, device, phases) -> None:
        self.recipe = recipe

    def versions(self):
        return {"fake": "1"}

    def scene(self, seed: int, job: int, frames: int) -> FakeScene:
        if seed % 7 == 0:
            raise UnfitSceneError("a multiple of seven")
        flag = os.environ.get("LAMBENT_FAKE_CRASH")
        if flag and "crash" in self.recipe.kinds and job == 1 and not os.path.exists(flag):
            with open(flag, "w"):
                os._exit(9)
        return FakeScene(seed, self.recipe.view, frames)


class BrokenSource(FakeSource):
    """All scenes fail in the end."""

    def scene(self, seed: int, job: int, frames: int) -> FakeScene:
        if job == 0:
            raise RuntimeError("no such plug-in")
        return super().scene(seed, job, frames)


class SlowView(FakeView):
    """Takes its time, so that something can happen meanwhile."""

    def one(self, window: Window, spp: int, seed: int) -> FakeSamples:
        time.sleep(0.05)
        return super().one(window, spp, seed)


class SlowSource(FakeSource):
    """Like the fake source, slowly."""

    def scene(self, seed: int, job: int, frames: int) -> FakeScene:
        made = super().scene(seed, job, frames)
        quick = made.views
        made.views = lambda camera: [SlowView(**vars(view)) for view in quick(camera)]
        return made
