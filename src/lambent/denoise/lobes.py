"""What the networks of the papers read: diffuse and specular light apart, each in its own terms.

"Kernel-Predicting Convolutional Networks for Denoising Monte Carlo Renderings" (Bako et al. 2017,
sec. 4.2) splits the picture at the first hit, because the two parts want different treatment::

    diffuse:   c̃ = c / (f_albedo + ε)       untextured light, smooth                   (eq. 8)
    specular:  c̃ = log(1 + c)               a range that spans orders of magnitude      (eq. 9)

and multiplies, or takes the exponential, after filtering. Each part is given to its own network
with its standard deviation, the features and theirs, and the gradients of all of them (sec. 4.2).

Planes of a part, `PLANES` in all: value (3) and its deviation (1); normal (3), albedo (3), depth
(1) and their deviations (3); the differences to the right and to the lower neighbour of the first
ten of these. What the paper leaves open, or what departs from it:

- The frame is brought to one exposure first (`frame.exposure.block_exposure`), so that brightness
  means the same in every scene.
- The network sees log(1 + c̃) of the diffuse light, too: a network that is fed values of 1 and of
  10,000 learns from the latter alone. What its kernels filter is c̃ itself, as in the paper.
- ε is 0.05, the paper's 0.00316. Emitters and misses have no albedo, and would come out 300 times
  as bright as they are; not to divide them at all left dashed lines where they meet a surface.
- A single sample has no variance; its deviation is 0 everywhere, as that of a noise-free frame.
- All that is not specular counts as diffuse, emission too; so does a frame without lobes.

All functions take NumPy arrays and PyTorch tensors alike (``xp`` is the module), channels first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from lambent.denoise.inputs import Signals
from lambent.filters.features import variance_of
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role

#: Layers that a frame's signals get in addition, with their channels.
LOBES: Mapping[str, int] = {
    "diffuse": 3,
    "diffuse_albedo": 3,
    "diffuse_std": 1,
    "specular_std": 1,
}
#: Counts up when a network trained for one description could not read the other.
VERSION = 1
#: Added to the albedo (eq. 8).
EPSILON = 0.05
#: Planes of one part that have gradients, and all of them.
VALUES = 10
PLANES = VALUES + 4 + 2 * VALUES


@dataclass(frozen=True)
class Parts:
    """Both parts of a frame as the networks want them, channels first.

    ``diffuse``, ``specular`` ``(…, 3, H, W)``: what the kernels filter, c̃. ``albedo``: what turns
    the diffuse part back into light. ``diffuse_planes``, ``specular_planes`` ``(…, PLANES, H, W)``.
    """

    diffuse: Any
    specular: Any
    albedo: Any
    diffuse_planes: Any
    specular_planes: Any


def lobes_of(frame: Frame) -> dict[str, FloatImage]:
    """The layers of `LOBES` that the frame has, channels first."""
    found: dict[str, FloatImage] = {}
    specular, diffuse = frame.get(Role.SPECULAR), frame.get(Role.DIFFUSE)
    if specular is not None:  # what is not specular counts as diffuse, emission too
        diffuse = frame.colour - specular
    if diffuse is not None:
        found["diffuse"] = _three(_planes(diffuse))
        if (albedo := frame.get(Role.DIFFUSE_ALBEDO)) is not None:
            found["diffuse_albedo"] = _three(_planes(albedo))
        for name, role in (("diffuse_std", Role.DIFFUSE), ("specular_std", Role.SPECULAR)):
            if (variance := variance_of(frame, role)) is not None:
                found[name] = np.sqrt(_planes(variance).mean(0, keepdims=True))
    return found


def parts_of(xp: ModuleType, signals: Signals) -> Parts:
    """The parts of ``signals`` (with what `lobes_of` adds), which are at a fixed exposure."""
    colour, layers = signals.colour, signals.layers
    none = xp.zeros_like(colour[..., :1, :, :])
    three = xp.zeros_like(colour)
    diffuse = layers.get("diffuse", colour)
    specular = colour - diffuse
    albedo = layers.get("diffuse_albedo", layers.get("albedo", three))
    divisor = albedo + EPSILON
    whole = "diffuse" not in layers
    diffuse_std = layers.get("diffuse_std", layers.get("colour_std", none) if whole else none)
    size = divisor.mean(-3)[..., None, :, :]
    features = [layers.get("normal", three), layers.get("albedo", three), layers.get("depth", none)]
    spread = [layers.get(f"{name}_std", none) for name in ("normal", "albedo", "depth")]
    c_diffuse = diffuse / divisor
    c_specular = xp.log1p(positive(xp, specular))
    spec_mean = positive(xp, specular).mean(-3)[..., None, :, :]
    return Parts(
        c_diffuse,
        c_specular,
        divisor,
        _with_gradients(
            xp, xp.log1p(positive(xp, c_diffuse)), xp.log1p(diffuse_std / size), features, spread
        ),
        _with_gradients(
            # the deviation of a logarithm, to first order
            xp,
            c_specular,
            layers.get("specular_std", none) / (1 + spec_mean),
            features,
            spread,
        ),
    )


def whole_of(xp: ModuleType, signals: Signals) -> Parts:
    """The light as one part: all of it counts as diffuse, divided by the albedo of both lobes."""
    layers = {name: layer for name, layer in signals.layers.items() if name not in LOBES}
    return parts_of(xp, replace(signals, layers=layers))


def together(xp: ModuleType, diffuse: Any, specular: Any, albedo: Any) -> Any:
    """Radiance again from the filtered parts (eq. 8 and 9 backwards)."""
    return diffuse * albedo + xp.expm1(specular)


def positive(xp: ModuleType, values: Any) -> Any:
    """Values below 0 as 0."""
    return xp.where(values > 0, values, xp.zeros_like(values))


# ------------------------------------------------------------------- private


def _with_gradients(
    xp: ModuleType, value: Any, deviation: Any, features: list[Any], spread: list[Any]
) -> Any:
    values = xp.concatenate([value, *features], -3)
    right = xp.zeros_like(values)
    right[..., :, :, :-1] = values[..., :, :, 1:] - values[..., :, :, :-1]
    below = xp.zeros_like(values)
    below[..., :, :-1, :] = values[..., :, 1:, :] - values[..., :, :-1, :]
    return xp.concatenate([values, deviation, *spread, right, below], -3)


def _three(planes: FloatImage) -> FloatImage:
    return planes.repeat(3, axis=0) if len(planes) == 1 else planes


def _planes(image: FloatImage) -> FloatImage:
    planes = np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)
    return np.nan_to_num(planes, nan=0.0, posinf=0.0, neginf=0.0)
