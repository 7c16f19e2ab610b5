"""All samples of a picture in one kernel: a lane is a pixel, the loop over samples is inside.

Mitsuba's own ``render`` launches a lane a sample and adds the results up in memory; means only.
Here sums stay in registers, so that twenty layers with their variances cost hardly more than the
colour, and memory does not grow with the samples. Means and squared deviations are updated stably
(Welford, "Note on a method for calculating corrected sums of squares and products", 1962).

Samples lie uniformly in their pixel: a box filter. Every pass has random numbers of its own
(`lambent.render.stream`), so variances and half buffers are what they claim to be. A sample whose
radiance is not finite is left out and counted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lambent.errors import OptionError
from lambent.frame.layer import FloatImage
from lambent.render.books import Books, PathOptions
from lambent.render.channels import COLOUR, MOTION, PREVIOUS_DEPTH, Group, chosen, light_group
from lambent.render.complaint import explaining
from lambent.render.lights import group_table
from lambent.render.moments import Moments
from lambent.render.motion import Motion, pixel_motion
from lambent.render.path import look_ahead, trace
from lambent.render.stream import streams
from lambent.render.volume import has_media, trace_media

#: Layers that an integrator of Mitsuba's, of which only the radiance is known, cannot split.
_NEEDS_OUR_PATH = frozenset({"diffuse", "specular", "direct", "indirect", "emission"})


@dataclass(frozen=True)
class Request:
    """Samples of a window: its first column and row within the film's crop, and its size.

    ``spp`` samples a pixel, with the random numbers of ``seed`` (32 bits count).
    """

    x: int
    y: int
    width: int
    height: int
    spp: int
    seed: int = 0


@dataclass
class _Sums:
    """Registers of one lane: counts, means and squared deviations so far."""

    count: Any
    mean: list[Any]
    spread: list[Any]
    half_a: list[Any]
    half_b: list[Any]
    half_count: Any


class FrameSampler:
    """Samples the pictures of one sensor of a Mitsuba scene.

    ``features``: what to keep beside the colour, as `lambent.render.channels.chosen` reads it.
    ``depth``, ``rr_depth``: as of Mitsuba's ``path``; depth -1 is endless. ``integrator``: one of
    Mitsuba's, whose ``sample`` gives the radiance in place of our paths; then light is not split.
    ``light_groups``: name -> patterns of emitter ids. ``motion``: the previous camera and
    positions, for motion vectors. ``file``: the scene's, for errors.
    """

    def __init__(
        self,
        scene: Any,
        sensor: int | Any = 0,
        *,
        features: str | Iterable[str] = "all",
        depth: int = 12,
        rr_depth: int = 5,
        integrator: Any = None,
        light_groups: Mapping[str, Iterable[str]] | None = None,
        motion: Motion | None = None,
        file: object = None,
    ) -> None:
        if depth == 0 or depth < -1 or rr_depth < 1:
            raise OptionError(
                f"a path needs depth >= 1 (or -1, endless) and rr_depth >= 1, "
                f"not {depth} and {rr_depth}",
                remedy="take --depth 8",
            )
        self.scene, self.file = scene, file or "the scene"
        self.sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        self.integrator = integrator
        self.motion = motion
        self.media = has_media(scene)
        groups = [g for g in chosen(features) if g not in (MOTION, PREVIOUS_DEPTH)]
        self.left_out: tuple[str, ...] = ()
        if integrator is not None:
            self.left_out = tuple(g.name for g in groups if g.name in _NEEDS_OUR_PATH)
            groups = [g for g in groups if g.name not in _NEEDS_OUR_PATH]
            light_groups = None
        names, table = group_table(scene, light_groups or {})
        self.groups: tuple[Group, ...] = (
            COLOUR,
            *groups,
            *([MOTION, PREVIOUS_DEPTH] if motion is not None else []),
            *(light_group(n, name) for n, name in enumerate(names)),
        )
        kept = {g.name for g in self.groups}
        lighting = bool(kept & _NEEDS_OUR_PATH) or bool(names)
        seen = kept - _NEEDS_OUR_PATH - {"colour"}
        self.options = PathOptions(
            depth=2**31 - 1 if depth == -1 else depth,
            rr_depth=rr_depth,
            lighting=lighting,
            features=bool(seen),
            first=motion is not None or any(n.startswith("first") for n in seen),
            groups=table,
            group_count=len(names),
        )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the film's crop window."""
        width, height = self.sensor.film().crop_size()
        return int(width), int(height)

    def sample(self, spp: int, seed: int = 0) -> Moments:
        """Trace ``spp`` samples in every pixel of the film's crop window.

        The same seed gives the same samples, another seed independent ones.
        Raises `OptionError` for fewer than one sample.
        """
        return self.sample_windows([Request(0, 0, *self.size, spp, seed)])[0]

    def sample_windows(self, requests: Sequence[Request]) -> list[Moments]:
        """Several windows with samples of their own, in one launch of one kernel.

        Recording a kernel takes longer than a small picture; a launch of many shares it. What a
        request gives does not depend on the others. Raises `OptionError`,
        and `DamagedFileError` with Mitsuba's complaint.
        """
        for request in requests:
            if request.spp < 1:
                raise OptionError(f"a picture needs at least 1 sample a pixel, not {request.spp}")
        if self.integrator is not None and len(requests) > 1:
            return [self.sample_windows([request])[0] for request in requests]
        # The longest first: threads take blocks of lanes in turn, and end together.
        order = sorted(range(len(requests)), key=lambda k: -requests[k].spp)
        lanes = [_lanes(requests[k]) for k in order]
        x, y, number, seed, limit = (
            _owned(kind, np.concatenate([lane[k] for lane in lanes]))
            for k, kind in enumerate((mi.Float, mi.Float, mi.UInt32, mi.UInt32, mi.UInt32))
        )
        if self.integrator is None:
            sampler: Any = streams(seed, number)
        else:
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(requests[0].seed & 0xFFFFFFFF, len(x))
        size = mi.Vector2f(self.sensor.film().crop_size())
        with explaining(self.file), dr.suspend_grad():
            sums = self._loop(sampler, mi.Point2f(x, y), size, limit)
            dr.eval(sums)
        return self._moments(sums, [requests[k] for k in order], order)

    # --------------------------------------------------------------- private

    def _moments(
        self, sums: _Sums, requests: Sequence[Request], order: Sequence[int]
    ) -> list[Moments]:
        """The sums of all lanes, taken apart by request, in the order they were asked for."""
        parts = [
            _table(part)
            for part in (
                [sums.count], sums.mean, sums.spread, sums.half_a, sums.half_b, [sums.half_count]
            )
        ]  # fmt: skip
        made: dict[int, Moments] = {}
        start = 0
        for place, request in zip(order, requests, strict=True):
            end = start + request.width * request.height
            # Planes stay planes in memory; what one sees is (H, W, C).
            shape = -1, request.height, request.width
            count, mean, spread, half_a, half_b, half_count = (
                part[:, start:end].reshape(shape).transpose(1, 2, 0) for part in parts
            )
            asked = request.spp * request.width * request.height
            made[place] = Moments(
                self.groups,
                request.spp,
                count[:, :, 0],
                mean,
                spread,
                half_a,
                half_b,
                half_count[:, :, 0],
                round(asked - float(count.sum(dtype=np.float64))),
            )
            start = end
        return [made[k] for k in range(len(requests))]

    def _loop(self, sampler: Any, corner: Any, size: Any, limit: Any) -> _Sums:
        """The loop over samples; all that a lane knows at its end."""
        channels = sum(g.channels for g in self.groups)

        def step(i: Any, sampler: Any, sums: _Sums) -> tuple[Any, Any, _Sums]:
            values, sampler = self._one(sampler, corner, size)
            return i + 1, sampler, _updated(sums, values, (i & 1) == 0)

        sums = _Sums(
            mi.Float(0),
            [mi.Float(0) for _ in range(channels)],
            [mi.Float(0) for _ in range(channels)],
            [mi.Float(0) for _ in range(3)],
            [mi.Float(0) for _ in range(3)],
            mi.Float(0),
        )
        # The limit is data, not code: another number of samples is the same kernel.
        done = dr.while_loop(
            (mi.UInt32(0), sampler, sums),
            lambda i, *_: i < limit,
            step,
            label="samples of a pixel",
        )
        result: _Sums = done[2]
        return result

    def _one(self, sampler: Any, corner: Any, size: Any) -> tuple[list[Any], Any]:
        """One sample: the values of all channels."""
        at = corner + sampler.next_2d()
        time = mi.Float(self.sensor.shutter_open())
        if self.sensor.shutter_open_time() > 0:
            time += self.sensor.shutter_open_time() * sampler.next_1d()
        lens = mi.Point2f(0.5)
        if self.sensor.needs_aperture_sample():
            lens = sampler.next_2d()
        ray, weight = self.sensor.sample_ray(time, mi.Float(0.5), at / size, lens)
        if self.media and self.integrator is None:
            medium = self.sensor.get_medium()
            books, sampler = trace_media(self.scene, sampler, ray, self.options, medium)
        elif self.integrator is None:
            books, sampler = trace(self.scene, sampler, ray, self.options)
        else:
            books, sampler = self._wrapped(sampler, ray)
        if self.motion is not None:
            books.motion, books.previous_depth = pixel_motion(self.motion, books, ray, size)
        for light in ("colour", "diffuse", "direct", "emission"):
            setattr(books, light, getattr(books, light) * weight)
        books.groups = [g * weight for g in books.groups]
        values: list[Any] = []
        for group in self.groups:
            values += list(group.take(books))
        return values, sampler

    def _wrapped(self, sampler: Any, ray: Any) -> tuple[Books, Any]:
        """Radiance by an integrator of Mitsuba's, features by ours."""
        books, sampler = look_ahead(self.scene, sampler, ray, self.options)
        differential = mi.RayDifferential3f(ray)
        medium = self.sensor.get_medium()
        radiance, _, _ = self.integrator.sample(self.scene, sampler, differential, medium)
        books.colour = mi.Color3f(radiance)
        return books, sampler


def _updated(sums: _Sums, values: list[Any], even: Any) -> _Sums:
    """Welford's update with one sample, if its radiance is finite."""
    finite = dr.isfinite(values[0]) & dr.isfinite(values[1]) & dr.isfinite(values[2])
    count = sums.count + dr.select(finite, 1, 0)
    weight = dr.select(finite, dr.rcp(count), 0)
    mean, spread = [], []
    for value, m, s in zip(values, sums.mean, sums.spread, strict=True):
        apart = dr.select(finite, value - m, 0)
        new = dr.fma(apart, weight, m)
        mean.append(new)
        spread.append(dr.fma(apart, dr.select(finite, value - new, 0), s))
    half_count = sums.half_count + dr.select(finite & even, 1, 0)
    half_a = _mean_with(sums.half_a, values, half_count, finite & even)
    half_b = _mean_with(sums.half_b, values, count - half_count, finite & ~even)
    return _Sums(count, mean, spread, half_a, half_b, half_count)


def _mean_with(mean: list[Any], values: list[Any], count: Any, takes: Any) -> list[Any]:
    """Means after one more sample where ``takes``; ``count`` includes it."""
    weight = dr.select(takes, dr.rcp(count), 0)
    return [
        dr.fma(dr.select(takes, v - m, 0), weight, m)
        for v, m in zip(values, mean, strict=False)  # the colour is first among the values
    ]


def _lanes(request: Request) -> tuple[NDArray[Any], ...]:
    """Column, row, number of the pixel in its window, seed and samples of every lane."""
    number = np.arange(request.width * request.height, dtype=np.uint32)
    row, column = np.divmod(number, np.uint32(request.width))
    return (
        (column + request.x).astype(np.float32),
        (row + request.y).astype(np.float32),
        number,
        np.full(number.size, request.seed & 0xFFFFFFFF, np.uint32),
        np.full(number.size, request.spp, np.uint32),
    )


def _owned(kind: Any, array: NDArray[Any]) -> Any:
    """An array in Dr.Jit's own memory.

    Dr.Jit takes NumPy's memory as it is and compiles its alignment into the kernel: without the
    copy, the same picture would be compiled again whenever the memory falls otherwise.
    """
    copy = kind(array) + dr.opaque(kind, 0)
    dr.eval(copy)
    return copy


def _table(planes: list[Any]) -> FloatImage:
    """Registers ``(C, lanes)``, copied once."""
    table = np.empty((len(planes), len(planes[0])), np.float32)
    for row, plane in zip(table, planes, strict=True):
        row[:] = plane.numpy()  # Dr.Jit's own memory
    return table
