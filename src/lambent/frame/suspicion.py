"""What in a frame is likely to spoil denoising, with the reason and what to do about it.

Each check looks at one thing and returns a `Suspicion` or nothing. Thresholds stand beside their
check; they were set on renders with known filters (`benchmarks/frames.py`) and on synthetic images
(`tests/frame/test_inspection.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage, Layer
from lambent.frame.ldr import is_display
from lambent.frame.misses import miss_mask
from lambent.frame.noise import SMOOTH, SPLATTED, Noise, noise_in, noise_of
from lambent.frame.repair import HALF_MAX, decoded_normals
from lambent.frame.role import Role, Stat

#: Compressions that lose values.
LOSSY = ("b44", "b44a", "dwaa", "dwab", "pxr24")


@dataclass(frozen=True)
class Suspicion:
    """``name`` is short and stays the same; ``level`` is "warning" (the result suffers) or "hint".

    ``layer``: where, or "". ``explanation`` and ``remedy``: sentences.
    """

    name: str
    level: str
    layer: str
    explanation: str
    remedy: str


Check = Callable[[Frame, Noise | None], Suspicion | None]


def suspicions(frame: Frame) -> list[Suspicion]:
    """Everything suspicious about a frame; a frame without colour is asked about its guides."""
    noise = None
    if frame.has(Role.COLOUR) and frame.colour.size and _lit(frame):
        noise = noise_of(frame)
    found = [check(frame, noise) for check in CHECKS]
    return [one for one in found if one is not None] + list(_unclaimed(frame))


# ------------------------------------------------------------------------------------- the colour


def no_colour(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Nothing to denoise."""
    if frame.has(Role.COLOUR):
        return None
    error = frame.missing(Role.COLOUR)
    return Suspicion("no colour", "warning", "", f"{error.message}.", error.remedy or "")


def all_black(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """A render that failed, or a file that holds other things."""
    beauty = frame.layer(Role.COLOUR)
    if beauty is None or _lit(frame):
        return None
    return Suspicion(
        "all black",
        "warning",
        beauty.name,
        "Every pixel of the colour is 0.",
        "There is nothing to denoise; check the render, or name another layer: --map colour=NAME.",
    )


def splatted_filter(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Noise that neighbours share."""
    if noise is None or not noise.splatted or _eight_bit(frame):
        return None  # photographs are smooth; that they are 8-bit images is said elsewhere
    return Suspicion(
        "splatted pixel filter",
        "warning",
        frame.layers[Role.COLOUR, Stat.MEAN].name,
        f"The noise of neighbouring pixels correlates by {noise.correlation:.2f} (white noise: 0, "
        "a splatted tent filter: 0.25), so that every denoiser takes part of it for texture.",
        "Render with a box filter of one pixel, or with filter importance sampling; blur the "
        "clean picture afterwards if the wider filter is wanted.",
    )


def already_denoised(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """No independent noise left."""
    if noise is None:
        return None
    beauty = frame.layers[Role.COLOUR, Stat.MEAN].name
    rho = noise.correlation
    if rho is not None and rho >= SMOOTH:
        return Suspicion(
            "smooth",
            "warning",
            beauty,
            f"What varies from pixel to pixel is shared by neighbours ({rho:.2f}): the picture "
            "looks denoised, enlarged, or like a photograph.",
            "Give the renderer's noisy picture; a second denoising only removes detail.",
        )
    large = min(frame.colour.shape[:2]) > 64
    if rho is not None or noise.level >= 1e-3 or not large:
        return None
    if frame.spp is None or frame.spp > 1024:
        return None  # a reference has none
    return Suspicion(
        "hardly any noise",
        "hint",
        beauty,
        f"With {frame.spp} samples per pixel noise would be seen, but there is none "
        f"({100 * noise.level:.2f} %): the picture may be denoised already.",
        "Give the renderer's noisy picture if there is one.",
    )


def tone_mapped(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Values cut at 1, or on the grid of an 8-bit image."""
    beauty = frame.layer(Role.COLOUR)
    if beauty is None or beauty.data.size < 3000 or not _lit(frame) or is_display(frame):
        return None
    image = beauty.data
    high = float(np.nanmax(image))
    if high > 1.0 + 1e-3:
        return None
    share = float(np.mean(image >= 0.999))
    eight_bit = _eight_bit(frame)
    if share < 2e-3 and not eight_bit:
        return None
    what = (
        "The colour has no more than 256 different values, as 8-bit images have"
        if eight_bit
        else f"{100 * share:.1f} % of the colour lies at exactly 1 and nothing above"
    )
    return Suspicion(
        "tone-mapped",
        "warning",
        beauty.name,
        f"{what}: a tone map or clip was applied, which bends the noise and cuts the lights.",
        "Save scene-linear radiance in float or half; apply the view transform after denoising.",
    )


def clamped(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Several pixels at one largest value."""
    beauty = frame.layer(Role.COLOUR)
    if beauty is None or beauty.data.size < 3000 or not _lit(frame):
        return None
    image = beauty.data
    finite = image[np.isfinite(image)]
    high = float(finite.max()) if finite.size else 0.0
    if high <= 1.0 + 1e-3:
        return None
    count = int(np.count_nonzero(finite == np.float32(high)))
    if high == HALF_MAX:
        return Suspicion(
            "clamped half",
            "warning",
            beauty.name,
            f"{count} values are 65504, the largest a half can hold: brighter light was cut.",
            "Save float (32 bit), or lower the exposure of the lights in view.",
        )
    channels = [image[:, :, c] for c in range(image.shape[2])]
    tops = [int(np.count_nonzero(c == c.max())) for c in channels if np.isfinite(c).all()]
    if len(tops) < len(channels) or min(tops) < max(16, 2e-4 * channels[0].size):
        return None
    if _is_area(image, high):
        return None  # a lamp in view has one radiance
    return Suspicion(
        "clamped",
        "hint",
        beauty.name,
        f"{min(tops)} pixels have the same largest value in every channel, {high:.4g}: "
        "light seems to be clamped.",
        "That is fine against fireflies, but the result cannot be brighter than the clamp.",
    )


def constant_alpha(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Coverage that says nothing, or the wrong thing."""
    alpha = frame.get(Role.ALPHA)
    if alpha is None or alpha.size == 0 or float(np.ptp(alpha)) > 0:
        return None
    value = float(alpha.flat[0])
    if value == 1.0:
        return None  # the usual opaque picture
    return Suspicion(
        "constant alpha",
        "hint",
        frame.layers[Role.ALPHA, Stat.MEAN].name,
        f"The coverage is {value:g} in every pixel.",
        "Programs that multiply by it will show nothing; save an alpha of 1, or none.",
    )


# ------------------------------------------------------------------------------------- the guides


def no_guides(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Colour only."""
    if not frame.has(Role.COLOUR) or frame.has(Role.ALBEDO) or frame.has(Role.NORMAL):
        return None
    if is_display(frame):  # a photograph, or a picture for the screen, has none
        return None
    return Suspicion(
        "no guides",
        "hint",
        "",
        "The file has neither an albedo nor a normal layer.",
        "Render both (in Blender: Denoising Data): texture and edges stay much sharper. If they "
        "are there under another name: --map albedo=NAME --map normal=NAME.",
    )


def albedo_above_one(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Reflectance that gives more than it gets."""
    albedo = frame.layer(Role.ALBEDO)
    if albedo is None or albedo.data.size == 0:
        return None
    with np.errstate(invalid="ignore"):
        share = float(np.mean((albedo.data > 1.01).any(axis=2)))
    if share < 1e-3:
        return None
    return Suspicion(
        "albedo above 1",
        "hint",
        albedo.name,
        f"{100 * share:.1f} % of the pixels have an albedo above 1 "
        f"(largest {float(np.nanmax(albedo.data)):.3g}): emission may be mixed in, or it is light.",
        "Nothing to do if these are lamps; otherwise name another layer: --map albedo=NAME.",
    )


def normals_of_odd_length(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """Encoded or scaled normals."""
    layer = frame.layer(Role.NORMAL)
    if layer is None or layer.data.size == 0 or not np.isfinite(layer.data).all():
        return None
    if decoded_normals(layer.data) is not None:
        return Suspicion(
            "encoded normals",
            "hint",
            layer.name,
            "The normals are stored as 0.5 + 0.5 n.",
            "They are decoded before use; nothing to do.",
        )
    length = np.linalg.norm(layer.data, axis=2)[~miss_mask(frame)]
    length = length[length > 0.05]
    if length.size < 64:
        return None
    longer = float(np.mean(length > 1.05))
    if longer > 0.05:
        return Suspicion(
            "normals are not unit vectors",
            "warning",
            layer.name,
            f"{100 * longer:.0f} % of them are longer than 1 (median {np.median(length):.3g}).",
            "Check that the layer is a normal: --map normal=NAME.",
        )
    return None


def noisy_guides(frame: Frame, noise: Noise | None) -> Suspicion | None:
    """White noise in albedo or normal."""
    for role, bound in ((Role.ALBEDO, 0.01), (Role.NORMAL, 0.02)):
        layer = frame.layer(role)
        if layer is None or not np.isfinite(layer.data).all() or min(layer.data.shape[:2]) < 32:
            continue
        found = noise_in(np.ascontiguousarray(layer.data.mean(axis=2)))
        rho = found.correlation
        if found.level > bound and rho is not None and abs(rho) < SPLATTED:
            return Suspicion(
                "noisy guides",
                "hint",
                layer.name,
                f"The {role.value} has noise of its own (deviation {found.level:.3f}), from motion "
                "blur, depth of field or glossy surfaces.",
                "Take a model that prefilters its guides (--model oidn-best).",
            )
    return None


# ------------------------------------------------------------------------------------------- parts


CHECKS: tuple[Check, ...] = (
    no_colour,
    all_black,
    splatted_filter,
    already_denoised,
    tone_mapped,
    clamped,
    constant_alpha,
    no_guides,
    albedo_above_one,
    normals_of_odd_length,
    noisy_guides,
)


def _lit(frame: Frame) -> bool:
    image = frame.get(Role.COLOUR)
    if image is None or image.size == 0:
        return False
    with np.errstate(invalid="ignore"):
        return bool((np.abs(image) > 0).any())


def _eight_bit(frame: Frame) -> bool:
    """Whether the first channel of a large image has 256 different values at most."""
    first = frame.colour[:, :, 0].ravel()[:200_000]
    return bool(first.size > 1000 and np.unique(first).size <= 256)


def _is_area(image: FloatImage, high: float) -> bool:
    """Whether the brightest pixels touch each other, as those of a lamp do."""
    top = (image == np.float32(high)).any(axis=2)
    touching = (top[:, 1:] & top[:, :-1]).sum() + (top[1:] & top[:-1]).sum()
    return bool(touching > 0.5 * top.sum())


def _unclaimed(frame: Frame) -> Iterator[Suspicion]:
    """Layers without a role that look like a normal where the frame has none."""
    if frame.has(Role.NORMAL):
        return
    for layer in frame.extras.values():
        if layer.role is Role.OTHER and layer.data.shape[2] == 3 and _unit(layer):
            yield Suspicion(
                "a normal, perhaps",
                "hint",
                layer.name,
                "All its vectors have length 1, but its name is not known to mean a normal.",
                f"If it is one: --map normal={layer.name!r}",
            )


def _unit(layer: Layer) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(layer.data, axis=2)
        hit = length[length > 0]
        return hit.size > 64 and float(np.mean(np.abs(hit - 1) < 0.01)) > 0.95
