"""Statistics of the samples of every pixel of a Mitsuba scene, in one Dr.Jit kernel a pass.

Mitsuba's film keeps sums only, and a filter wants to know more: the variance of every layer, two
half buffers, and for the statistical filter (StatMC) the first three moments of the Box-Cox
transformed radiance x = (√c - 1) / 0.5. `sample` therefore asks the sensor for rays and the
integrator for radiance itself, with the loop over the samples *inside* the kernel: the moments stay
in registers, are updated stably (Welford; third moment after Pébay, "Formulas for robust, one-pass
parallel computation of covariances and arbitrary-order statistical moments", 2008, equations 2.1
and 2.2), and NumPy sees one array a pass. Samples lie uniformly in their pixel: a box filter,
nothing is splatted into neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

#: Layers in the order in which `sample` stacks them, with the names of their channels.
RADIANCE = (("colour", "RGB"),)
FEATURES = (
    ("colour", "RGB"),
    ("albedo", "RGB"),
    ("normal", "XYZ"),
    ("depth", "Z"),
    ("position", "XYZ"),
    ("boxcox", "RGB"),
)


@dataclass(frozen=True)
class Moments:
    """Count, mean, and sums of squared and cubed deviations of samples: ``(H, W, C)`` float64.

    ``half_a`` and ``half_b`` are the means of the samples with even and with odd numbers.
    """

    count: int
    mean: NDArray[np.float64]
    m2: NDArray[np.float64]
    m3: NDArray[np.float64]
    half_a: NDArray[np.float64]
    half_b: NDArray[np.float64]

    def __add__(self, other: Moments) -> Moments:
        """The moments of both sets of samples together (Pébay 2008, equation 2.1)."""
        a, b = self.count, other.count
        n, d = a + b, other.mean - self.mean
        return Moments(
            n,
            self.mean + d * (b / n),
            self.m2 + other.m2 + d * d * (a * b / n),
            self.m3
            + other.m3
            + d**3 * (a * b * (a - b) / n**2)
            + 3 * d * (a * other.m2 - b * self.m2) / n,
            (self.half_a * a + other.half_a * b) / n,
            (self.half_b * a + other.half_b * b) / n,
        )

    @property
    def variance(self) -> NDArray[np.float64]:
        """Unbiased variance of the mean; zero where one sample tells nothing."""
        return self.m2 / max(self.count - 1, 1) / self.count

    @property
    def skew(self) -> NDArray[np.float64]:
        """Third central moment of the samples."""
        return self.m3 / self.count


def _loop(scene, sensor, integrator, sampler, x, y, size, spp, full):
    """All samples of one pass: lists of means, second and third moments, and sums of halves."""

    def step(i, sampler, mean, m2, m3, half_a, half_b):
        at = mi.Point2f(x, y) + sampler.next_2d()
        ray, weight = sensor.sample_ray(
            mi.Float(0), sampler.next_1d(), at / size, sampler.next_2d()
        )
        ray = mi.RayDifferential3f(ray)
        features = _features(scene, sampler, ray) if full else []
        radiance, _, _ = integrator.sample(scene, sampler, ray)
        colour = list(radiance * weight)
        if full:
            features += [(dr.sqrt(dr.maximum(c, 0)) - 1) * 2 for c in colour]
        mean, m2, m3 = _welford(mi.Float(i + 1), colour + features, mean, m2, m3)
        even = (i & 1) == 0
        half_a = [h + dr.select(even, c, 0) for h, c in zip(half_a, colour, strict=True)]
        half_b = [h + dr.select(even, 0, c) for h, c in zip(half_b, colour, strict=True)]
        return i + 1, sampler, mean, m2, m3, half_a, half_b

    zeros = [[mi.Float(0) for _ in range(n)] for n in _lengths(full)]
    done = dr.while_loop(
        (mi.UInt32(0), sampler, *zeros), lambda i, *_: i < spp, step, label="samples of a pixel"
    )
    return done[2:]


def _lengths(full):
    channels = sum(len(names) for _, names in (FEATURES if full else RADIANCE))
    return channels, channels, 3 if full else 0, 3, 3


def _welford(n, values, mean, m2, m3):
    """Welford's update; the third moment is kept for the last channels only (Box-Cox)."""
    delta = [v - m for v, m in zip(values, mean, strict=True)]
    step = [d / n for d in delta]
    term = [d * s * (n - 1) for d, s in zip(delta, step, strict=True)]
    tail = len(values) - len(m3)
    m3 = [
        c + t * s * (n - 2) - 3 * s * q
        for c, t, s, q in zip(m3, term[tail:], step[tail:], m2[tail:], strict=True)
    ]
    mean = [m + s for m, s in zip(mean, step, strict=True)]
    return mean, [q + t for q, t in zip(m2, term, strict=True)], m3


def _features(scene, sampler, ray):
    """Albedo, world-space shading normal, depth and position of the first hit; 0 for a miss.

    Albedo is the diffuse reflectance where a surface has a diffuse part, and otherwise the share
    of light that a sampled reflection keeps: a mirror or glass is white, not black, as the makers
    of denoisers ask for.
    """
    hit = scene.ray_intersect(ray)
    valid = hit.is_valid()
    bsdf = hit.bsdf(ray)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    diffuse = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
    sampled = bsdf.sample(context, hit, sampler.next_1d(), sampler.next_2d(), valid & ~diffuse)[1]
    albedo = dr.select(diffuse, bsdf.eval_diffuse_reflectance(hit, valid & diffuse), sampled)
    albedo = dr.clip(albedo, 0, 1)
    normal, position, depth = hit.sh_frame.n, hit.p, hit.t
    values = [*albedo, *normal, depth, *position]
    return [dr.select(valid, v, 0) for v in values]


def sample(
    scene: Any, spp: int, seed: int, *, features: bool = True, integrator: Any = None
) -> Moments:
    """Trace ``spp`` samples in every pixel of the scene's (first) sensor.

    The same seed gives the same samples; different seeds give independent ones. The channels are
    those of `FEATURES`, or of `RADIANCE` alone.
    """
    sensor = scene.sensors()[0]
    width, height = (int(v) for v in sensor.film().size())
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, width * height)
    pixel = dr.arange(mi.UInt32, width * height)
    y = pixel // width
    with dr.suspend_grad():
        sums = _loop(
            scene,
            sensor,
            integrator or scene.integrator(),
            sampler,
            mi.Float(pixel - y * width),
            mi.Float(y),
            mi.ScalarVector2f(width, height),
            mi.UInt32(spp),
            features,
        )
    dr.eval(sums)
    mean, m2, m3, half_a, half_b = (
        np.stack([np.array(c, np.float64) for c in part], -1).reshape(height, width, -1)
        if part
        else np.zeros((height, width, 0))
        for part in sums
    )
    cubed = np.zeros_like(mean)
    cubed[..., mean.shape[2] - m3.shape[2] :] = m3
    return Moments(spp, mean, m2, cubed, half_a / max((spp + 1) // 2, 1), half_b / max(spp // 2, 1))
