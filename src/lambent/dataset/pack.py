"""An item as the bytes of one EXR file, and back.

Parts ``noisy n1 n2 … target``, packed with ZIP; a clip goes on with ``f1.n0 … f1.target f2.n0 …``.
The first part has the channel names that Lambent writes everywhere, so that any viewer, ``lambent
inspect`` and ``lambent denoise`` take the item for the noisy picture that it is; in the others the
part's name stands in front (``target.albedo.R``), so that nothing is mixed up.
What an item says of itself is a text (JSON) in the header of the first part, ``lambentItem``.

Compact, and exact where it counts:

- A channel is half float where that keeps every value to half precision (11 bits), or the error is
  far below the channel's typical value; motion to 1/64 pixel. Else it is float32; nothing is
  clamped.
- Variances are estimates that are off by tens of percent: 4 bits of their mantissa are kept
  (3 %), in half floats where their range allows; the zeros compress away. Of all but the colour's,
  the mean over the channels is stored, and read back as the variance of each.
- What follows from other layers is not stored: specular = colour - diffuse, indirect = colour -
  direct, half_b = 2 colour - half_a, and likewise the specular albedo. Read back, the sums hold to
  float precision, and each layer to half precision of the colour; where rounding takes one below
  zero it is zero. Only where the frame breaks such a sum is the layer stored.
- A target has no half buffers, and no variance of features.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.dataset.item import Item, Still
from lambent.errors import DamagedFileError
from lambent.frame.exr import ExrFile, ExrPart, decode
from lambent.frame.exr.module import module
from lambent.frame.exr.new import channel_names
from lambent.frame.frame import Frame, Key
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.role import INFO, Role, Space, Stat
from lambent.settings import parse_json

#: Part of the first header that says what the item is.
ABOUT = "lambentItem"
#: Bits of a variance's mantissa that are kept.
VARIANCE_BITS = 4
#: The largest error of motion, in pixels.
MOTION_ERROR = 1 / 64
#: Largest value of a half.
HALF_MAX = 65504.0
#: Layers that are made from others when read: what, from what, minus what; halves differ in factor.
DERIVED: dict[Key, tuple[Key, Key, float]] = {
    (Role.SPECULAR, Stat.MEAN): ((Role.COLOUR, Stat.MEAN), (Role.DIFFUSE, Stat.MEAN), 1.0),
    (Role.INDIRECT, Stat.MEAN): ((Role.COLOUR, Stat.MEAN), (Role.DIRECT, Stat.MEAN), 1.0),
    (Role.SPECULAR_ALBEDO, Stat.MEAN): (
        (Role.ALBEDO, Stat.MEAN),
        (Role.DIFFUSE_ALBEDO, Stat.MEAN),
        1.0,
    ),
    (Role.COLOUR, Stat.HALF_B): ((Role.COLOUR, Stat.MEAN), (Role.COLOUR, Stat.HALF_A), 2.0),
}
TARGET = "target"
#: The name of the first part, by which Lambent knows the beauty.
FIRST = "noisy"


def packed(item: Item) -> bytes:
    """The file of an item."""
    exr = module()
    parts: list[Any] = []
    for name, frame in _named(item):
        header: dict[str, Any] = {
            "compression": exr.ZIP_COMPRESSION,
            "type": exr.scanlineimage,
            "spp": int(frame.spp or 0),
        }
        if not parts:
            header[ABOUT] = json.dumps(dict(item.about), sort_keys=True)
        front = f"{name}." if parts else ""
        planes = _planes(frame, is_target=name.endswith(TARGET))
        channels = {front + channel: plane for channel, plane in planes.items()}
        parts.append(exr.Part(header, channels, name))
    stream = io.BytesIO()
    exr.File(parts).write(stream)
    return stream.getvalue()


def unpacked(path: Path) -> Item:
    """The item in a file; layers are decoded when they are looked at.

    Raises `FileError` and `DamagedFileError`, at once for what is wrong with the structure, and
    where a layer is looked at for its pixels.
    """
    exr = decode(path)
    about = _about(exr)
    stills: dict[str, dict[str, Frame]] = {}
    for part in exr.parts:
        still, _, name = part.name.rpartition(".")
        stills.setdefault(still, {})[name] = _frame(part, about)
    made = []
    for frames in stills.values():
        if TARGET not in frames:
            raise DamagedFileError("has no target", file=path, remedy=REMAKE)
        levels = [frame for name, frame in frames.items() if name != TARGET]
        made.append(Still(tuple(levels), frames[TARGET]))
    return Item(tuple(made), about)


def about_file(path: Path) -> dict[str, Any]:
    """What the file of an item says of itself. Raises `FileError`, `DamagedFileError`."""
    return _about(decode(path))


def check_pixels(path: Path, edge: int) -> None:
    """Decode everything in a file of crops ``edge`` pixels wide.

    Raises `FileError` or `DamagedFileError`.
    """
    exr = decode(path)
    _about(exr)
    for part in exr.parts:
        if (part.width, part.height) != (edge, edge):
            raise DamagedFileError(
                f"is {part.width}x{part.height} pixels in place of {edge}x{edge}",
                file=path,
                remedy="delete it, then " + REMAKE.removeprefix("make it again: "),
            )
        for channel in part.channels.values():
            assert channel.data.shape == (part.height, part.width)


REMAKE = "make it again: lambent dataset make, the same command"


def _about(exr: ExrFile) -> dict[str, Any]:
    try:
        found = parse_json(exr.parts[0].header[ABOUT])
        if isinstance(found, dict):
            return found
    except (KeyError, TypeError, ValueError):
        pass
    raise DamagedFileError("is not an item of a data set", file=exr.path, remedy=REMAKE)


# -------------------------------------------------------------------- packing


def _named(item: Item) -> list[tuple[str, Frame]]:
    """Every frame with the name of its part."""
    found = []
    for k, still in enumerate(item.stills):
        front = f"f{k}." if k else ""
        found += [(f"{front}n{n}", frame) for n, frame in enumerate(still.levels)]
        found.append((front + TARGET, still.target))
    return [(FIRST, found[0][1]), *found[1:]]


def _planes(frame: Frame, is_target: bool) -> dict[str, NDArray[Any]]:
    """The channels of a part, each in the type that suffices."""
    planes = {}
    for key, layer in frame.layers.items():
        if _left_out(frame, key, is_target):
            continue
        image = layer.data
        if key[1] is Stat.VARIANCE and key[0] is not Role.COLOUR:
            image = image.mean(axis=2, keepdims=True)
        pixels = _compact(image, *key)
        for n, name in enumerate(channel_names(Layer(key[0], image, key[1]), image.shape[2])):
            planes[name] = np.ascontiguousarray(pixels[:, :, n])
    return planes


def _left_out(frame: Frame, key: Key, is_target: bool) -> bool:
    role, stat = key
    if stat in (Stat.HALF_A, Stat.HALF_B) and (is_target or role is not Role.COLOUR):
        return True
    if stat is not Stat.MEAN and (frame.spp or 2) < 2:
        return True  # one sample has neither variance nor halves
    if stat is Stat.VARIANCE and is_target and not INFO[role].radiance:
        return True
    return key in DERIVED and follows(frame, key)


def follows(frame: Frame, key: Key) -> bool:
    """Whether a layer follows from two others that are there, to half precision of the first."""
    whole, part, factor = DERIVED[key]
    a, b, found = frame.get(*whole), frame.get(*part), frame.get(*key)
    if a is None or b is None or found is None or not a.shape == b.shape == found.shape:
        return False
    error = np.abs(factor * a - b - found)
    scale = np.maximum(np.abs(factor * a), np.abs(b))
    return bool((error <= 2.0**-11 * scale + 1e-7 * float(np.abs(a).mean())).all())


def _compact(image: FloatImage, role: Role, stat: Stat) -> NDArray[Any]:
    """The image as half floats if they suffice, else float32."""
    if stat is Stat.VARIANCE:
        image = rounded(image, VARIANCE_BITS)
        return _half_or_not(image, lambda size: 2.0 ** -(VARIANCE_BITS + 2) * size)
    if role is Role.MOTION:
        return _half_or_not(image, lambda size: np.full_like(size, MOTION_ERROR))
    return _half_or_not(image, _half_precision)


def _half_precision(size: FloatImage) -> FloatImage:
    """The error that is allowed: half an ulp, or a ten-thousandth of the typical value."""
    lit = size[(size > 0) & np.isfinite(size)]
    typical = float(np.median(lit)) if lit.size else 0.0
    return np.maximum(size * 2.0**-11, typical * 1e-4)


def _half_or_not(
    image: FloatImage, allowed: Callable[[FloatImage], FloatImage]
) -> NDArray[np.float16] | FloatImage:
    with np.errstate(over="ignore"):
        half = image.astype(np.float16)
    finite = np.isfinite(image)
    if not np.isfinite(half[finite]).all():
        return image
    sound = np.where(finite, image, 0)
    size, error = np.abs(sound), np.abs(np.where(finite, half, 0).astype(np.float32) - sound)
    return half if (error <= allowed(size)).all() else image


def rounded(image: FloatImage, bits: int) -> FloatImage:
    """float32 values with so many bits of mantissa, to nearest; infinities and NaN stay."""
    drop = 23 - bits
    words = np.ascontiguousarray(image, np.float32).view(np.uint32)
    near = ((words + np.uint32(1 << (drop - 1))) >> np.uint32(drop)) << np.uint32(drop)
    return np.where(np.isfinite(image), near.view(np.float32), image)


# ------------------------------------------------------------------ unpacking


def _bases() -> dict[str, Key]:
    """The name of a layer in the file -> its role and statistic."""
    found = {}
    dot = np.zeros((1, 1, 1), np.float32)
    for role in Role:
        for stat in Stat:
            for count in {1, *INFO[role].channels} if INFO[role].channels else ():
                for name in channel_names(Layer(role, dot, stat), count):
                    found[name] = (role, stat)
    return found


_KEYS = _bases()
_ORDER = {letter: n for n, letter in enumerate("RGBAXYZW")}


def _frame(part: ExrPart, about: Mapping[str, Any]) -> Frame:
    names: dict[Key, list[str]] = {}
    front = f"{part.name}."
    for name in part.channels:
        key = _KEYS.get(name.removeprefix(front))
        if key is not None:
            names.setdefault(key, []).append(name)
    layers: dict[Key, Layer] = {}
    for key, channels in names.items():
        channels.sort(key=lambda name: _ORDER.get(name.rpartition(".")[2], 0))
        space = _space(key[0], about)
        alike = len(channels) == 1 and 3 in INFO[key[0]].channels
        pixels = _Stored(part, channels, 3 if alike else 1)
        layers[key] = Layer(key[0], pixels, key[1], space=space)
    for key, (whole, minus, factor) in DERIVED.items():
        if key not in layers and whole in layers and minus in layers:
            layers[key] = Layer(key[0], _Rest(layers[whole], layers[minus], factor), key[1])
    spp = part.header.get("spp")
    return Frame(layers=layers, spp=spp if isinstance(spp, int) and spp > 0 else None)


def _space(role: Role, about: Mapping[str, Any]) -> Space | None:
    if role is not Role.NORMAL:
        return None
    named = about.get("normals", Space.WORLD.value)
    return Space(named) if named in {space.value for space in Space} else Space.UNKNOWN


@dataclass(frozen=True)
class _Stored:
    """Channels of a part as one image, when asked for; one channel ``repeat`` times."""

    part: ExrPart
    names: Sequence[str]
    repeat: int = 1

    def __call__(self) -> FloatImage:
        planes = [self.part.channels[name].data for name in self.names] * self.repeat
        return np.stack(planes, axis=2).astype(np.float32)


@dataclass(frozen=True)
class _Rest:
    """``factor * whole - part``, never below zero unless one of them is."""

    whole: Layer
    part: Layer
    factor: float

    def __call__(self) -> FloatImage:
        a, b = self.whole.data, self.part.data
        rest = np.float32(self.factor) * a - b
        return np.where((rest < 0) & (a >= 0) & (b >= 0), np.float32(0), rest)
