"""Inspection: known defects are found, sound frames are left in peace."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lambent.errors import DamagedFileError, DeepFileError, FileError, UnknownNameError
from lambent.frame.frame import Frame
from lambent.frame.inspection import inspect_file
from lambent.frame.layer import Layer
from lambent.frame.noise import noise_in, noise_of
from lambent.frame.role import Role
from lambent.frame.sums import layer_sums
from lambent.frame.suspicion import suspicions

CYCLES = Path(__file__).parent.parent / "data" / "cycles_50_multilayer.exr"
SIZE = (160, 224)


def scene(seed: int = 0, spp: int = 8, width: float = 0.0) -> np.ndarray:
    """A picture of smooth shading with edges and Monte Carlo noise ``(H, W, 3)``.

    Each sample falls on a random place of its pixel. ``width`` 0: it counts for that pixel alone
    (box filter); else it is splatted into its neighbours under a tent of that radius.
    """
    rng = np.random.default_rng(seed)
    height, wide = SIZE
    total, weights = np.zeros(SIZE), np.zeros(SIZE)
    rows, columns = np.mgrid[:height, :wide]
    for _ in range(spp):
        x, y = columns + rng.random(SIZE), rows + rng.random(SIZE)
        truth = 0.4 + 0.3 * np.sin(x / 60) + 0.5 * (x + y > 150) + 0.8 * (np.abs(x - 90) < 12)
        value = truth * rng.exponential(1.0, SIZE)
        if width == 0:
            total += value
            weights += 1
            continue
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                weight = np.maximum(0, 1 - np.abs(columns + dx + 0.5 - x) / width) * np.maximum(
                    0, 1 - np.abs(rows + dy + 0.5 - y) / width
                )
                total += np.roll(weight * value, (dy, dx), (0, 1))
                weights += np.roll(weight, (dy, dx), (0, 1))
    mean = total / weights
    return np.repeat(mean[:, :, None], 3, axis=2).astype(np.float32)


def names(frame: Frame) -> set[str]:
    return {one.name for one in suspicions(frame)}


def guided(colour: np.ndarray, **more: np.ndarray) -> Frame:
    """A frame with sound guides, so that only its colour can be suspicious."""
    albedo = np.full((*SIZE, 3), 0.5, np.float32)
    normal = np.zeros((*SIZE, 3), np.float32)
    normal[..., 2] = 1
    return Frame.from_arrays(**{"colour": colour, "albedo": albedo, "normal": normal, **more})


# -------------------------------------------------------------------------------- the pixel filter


@pytest.mark.parametrize("spp", [2, 8, 64])
def test_box_filter_is_white(spp: int) -> None:
    noise = noise_of(Frame.from_arrays(colour=scene(1, spp)))
    assert abs(noise.correlation) < 0.08
    assert "splatted pixel filter" not in names(guided(scene(1, spp)))


@pytest.mark.parametrize("spp", [2, 8, 32])
def test_splatted_tent_is_found(spp: int) -> None:
    """The correlation of a tent of radius 1 is (1/6)/(2/3) = 1/4 if samples do not vary in number;
    dividing by the sum of weights raises it a little."""
    noise = noise_of(Frame.from_arrays(colour=scene(2, spp, width=1.0)))
    assert 0.2 < noise.correlation < 0.4
    assert "splatted pixel filter" in names(guided(scene(2, spp, width=1.0)))


@pytest.mark.parametrize("rho", [0.0, 0.1, 0.2, 0.3])
def test_correlation_of_known_noise(rho: float) -> None:
    """Moving averages of white noise with a known neighbour correlation, in both directions."""
    rng = np.random.default_rng(7)
    a = (1 - np.sqrt(1 - 4 * rho**2)) / (2 * rho) if rho else 0.0  # MA(1): rho = a / (1 + a²)
    white = rng.normal(size=(400, 400))
    image = white[1:, :] + a * white[:-1, :]
    image = 0.05 * (image[:, 1:] + a * image[:, :-1])
    noise = noise_in(image.astype(np.float32))
    assert noise.across == pytest.approx(rho, abs=0.03)
    assert noise.down == pytest.approx(rho, abs=0.03)
    assert noise.level == pytest.approx(0.05 * (1 + a**2), rel=0.35)


def test_correlation_of_gaussian_noise() -> None:
    """Neighbours at 1/2, those two apart at 1/16, as under a wide Gaussian filter."""
    rng = np.random.default_rng(8)
    distance = np.minimum(np.arange(512), 512 - np.arange(512)) ** 2
    covariance = 0.5 ** (distance[:, None] + distance[None, :])
    spectrum = np.sqrt(np.maximum(np.fft.fft2(covariance).real, 0))
    image = 0.1 * np.fft.ifft2(np.fft.fft2(rng.normal(size=(512, 512))) * spectrum).real
    noise = noise_in(image.astype(np.float32))
    assert noise.across == pytest.approx(0.5, abs=0.015)
    assert noise.down == pytest.approx(0.5, abs=0.015)


def test_half_buffers_measure_directly() -> None:
    frame = Frame.from_arrays(
        colour=scene(1), colour_half_a=scene(3, 4, 1.0), colour_half_b=scene(4, 4, 1.0)
    )
    noise = noise_of(frame)
    assert noise.source == "half buffers"
    assert 0.15 < noise.correlation < 0.4


def test_clean_and_tiny_images_are_not_judged() -> None:
    y, x = np.mgrid[:200, :200]
    clean = np.repeat((1.0 + 0.5 * (x > y))[:, :, None], 3, 2).astype(np.float32)
    assert noise_of(Frame.from_arrays(colour=clean)).correlation is None
    for shape in ((1, 1, 3), (1, 50, 3), (20, 20, 3)):
        assert noise_of(Frame.from_arrays(colour=np.ones(shape, np.float32))).correlation is None


def test_real_renders(shared_data: Path) -> None:
    """A tent-filtered and a box-filtered render of Mitsuba."""
    tent = inspect_file(shared_data / "exr" / "mitsuba3_aov_cornell.exr")
    assert "splatted pixel filter" in {s.name for s in tent.suspicions}
    for frame in ("00", "05"):
        box = inspect_file(shared_data / "sequence" / "cornell-orbit" / f"noisy_{frame}.exr")
        assert box.suspicions == ()


# --------------------------------------------------------------------------------- other suspicions


def test_a_sound_frame_is_left_in_peace() -> None:
    assert names(guided(scene())) == set()


def test_denoised_already() -> None:
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(scene(), (2, 2, 0))
    assert "smooth" in names(guided(smooth))
    still = np.full((*SIZE, 3), 0.3, np.float32)
    still[:, 100:] = 0.6
    assert "hardly any noise" in names(guided(still).replace(spp=16))
    assert "hardly any noise" not in names(guided(still).replace(spp=4096))


def test_tone_mapped() -> None:
    assert "tone-mapped" in names(guided(np.minimum(scene() * 2, 1.0)))
    eight = np.round(np.clip(scene(), 0, 1) * 255) / 255
    found = {s.name: s for s in suspicions(guided(eight.astype(np.float32)))}
    assert "256 different values" in found["tone-mapped"].explanation
    assert "tone-mapped" not in names(guided(scene() * 0.1))  # a dark render stays below 1


def test_clamped() -> None:
    half = scene()
    half[10, 10:13] = 65504
    assert "clamped half" in names(guided(half))
    assert "clamped" in names(guided(np.minimum(scene(spp=2), 3.0)))
    lamp = scene()
    lamp[:20, :20] = 17.0  # a lamp in view has one radiance
    assert names(guided(lamp)) == set()


def test_all_black() -> None:
    assert names(guided(np.zeros((*SIZE, 3), np.float32))) == {"all black"}


def test_no_colour_lists_what_there_is() -> None:
    frame = Frame.from_layers([Layer(Role.OTHER, np.zeros((9, 9, 3)), name="mystery")])
    found = suspicions(frame)
    assert found[0].name == "no colour"
    assert "mystery" in found[0].remedy


def test_guides() -> None:
    assert "no guides" in names(Frame.from_arrays(colour=scene()))
    bright = np.full((*SIZE, 3), 0.5, np.float32)
    bright[:20] = 3.0
    assert "albedo above 1" in names(guided(scene(), albedo=bright))
    rng = np.random.default_rng(0)
    noisy = (0.5 + 0.05 * rng.normal(size=(*SIZE, 3))).astype(np.float32)
    assert "noisy guides" in names(guided(scene(), albedo=noisy))
    n = rng.normal(size=(*SIZE, 3)).astype(np.float32)
    unit = n / np.linalg.norm(n, axis=2, keepdims=True)
    assert "normals are not unit vectors" in names(guided(scene(), normal=2 * unit))
    assert "encoded normals" in names(guided(scene(), normal=0.5 + 0.5 * unit))


def test_unknown_unit_vectors_are_proposed() -> None:
    n = np.random.default_rng(0).normal(size=(*SIZE, 3))
    unit = n / np.linalg.norm(n, axis=2, keepdims=True)
    frame = Frame.from_layers(
        [Layer(Role.COLOUR, scene()), Layer(Role.OTHER, unit, name="geo.stuff")]
    )
    found = {s.name: s for s in suspicions(frame)}
    assert "--map normal='geo.stuff'" in found["a normal, perhaps"].remedy


def test_constant_alpha() -> None:
    empty = np.zeros((*SIZE, 1), np.float32)
    assert "constant alpha" in names(guided(scene(), alpha=empty))
    assert names(guided(scene(), alpha=empty + 1)) == set()


# -------------------------------------------------------------------------------------------- sums


def test_light_groups_sum() -> None:
    one, two = scene(1), scene(2)
    layers = [
        Layer(Role.COLOUR, one + two),
        Layer(Role.LIGHTING, one, name="RGBA_key"),
        Layer(Role.LIGHTING, two, name="RGBA_fill"),
        Layer(Role.DIRECT, one),
        Layer(Role.INDIRECT, 0.5 * two),
    ]
    first, second = layer_sums(Frame.from_layers(layers))
    assert (first.way, first.sums) == ("light groups", True)
    assert first.residual < 1e-6
    assert (second.way, second.sums) == ("direct and indirect light", False)
    assert second.residual == pytest.approx(0.5 * two.mean() / (one + two).mean(), rel=1e-4)


def test_nothing_to_sum() -> None:
    assert layer_sums(Frame.from_arrays(colour=scene())) == []
    assert layer_sums(Frame.from_arrays(albedo=scene())) == []
    black = Frame.from_arrays(colour=np.zeros((4, 4, 3)), direct=np.zeros((4, 4, 3)))
    assert layer_sums(black) == []


# ------------------------------------------------------------------------------------------- files


def test_cycles_file() -> None:
    """Our own Cycles render: everything the file tells, and passes that sum to the noisy image."""
    found = inspect_file(CYCLES)
    assert (found.format, found.dialect, found.spp) == ("exr", "blender", 8)
    assert (found.width, found.height) == (40, 30)
    assert len(found.parts) == 32
    first = found.parts[0]
    assert (first.name, first.type, first.compression) == (
        "ViewLayer.Combined",
        "scanlineimage",
        "zip",
    )
    assert first.channels[0].type == "half"
    assert found.sums[0].way.startswith("Cycles")
    assert found.sums[0].beauty == "ViewLayer.Noisy Image"
    assert found.sums[0].sums
    depth = next(la for la in found.layers if la.name == "ViewLayer.Depth")
    assert depth.high == 1e10
    assert depth.nan == 0
    text = json.dumps(found.as_dict(), allow_nan=False)
    assert json.loads(text)["sums"][0]["sums"] is True
    assert json.loads(text)["layers"][0]["role"] == "other"


def test_overrides_and_errors(tmp_path: Path) -> None:
    found = inspect_file(CYCLES, {"colour": "ViewLayer.Combined"})
    assert found.sums[0].beauty == "ViewLayer.Combined"
    assert not found.sums[0].sums  # Blender's denoised picture is not the sum of noisy passes
    with pytest.raises(UnknownNameError):
        inspect_file(CYCLES, {"albedo": "nothing like it"})
    with pytest.raises(FileError):
        inspect_file(tmp_path / "missing.exr")


def test_plain_pictures(tmp_path: Path) -> None:
    from PIL import Image

    pixels = (np.clip(scene(), 0, 1) * 255).astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    found = inspect_file(tmp_path / "a.png")
    assert (found.format, found.width, found.height) == ("png", SIZE[1], SIZE[0])
    assert found.layers[0].role is Role.COLOUR
    assert not {"tone-mapped", "no guides"} & {s.name for s in found.suspicions}
    json.dumps(found.as_dict(), allow_nan=False)


def test_lossy_compression(tmp_path: Path) -> None:
    import OpenEXR

    path = tmp_path / "lossy.exr"
    header = {"compression": OpenEXR.DWAA_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": scene().astype(np.float16)}).write(str(path))
    assert "lossy compression" in {s.name for s in inspect_file(path).suspicions}


def test_counts_of_broken_values(tmp_path: Path) -> None:
    import OpenEXR

    image = scene()
    image[0, 0] = np.nan
    image[1, 1, 0] = np.inf
    image[2, 2, 1] = -1
    path = tmp_path / "broken.exr"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": image}).write(str(path))
    colour = inspect_file(path).layers[0]
    assert (colour.nan, colour.infinite, colour.negative) == (3, 1, 1)
    assert colour.low == -1
    assert np.isfinite(colour.mean)
    json.dumps(inspect_file(path).as_dict(), allow_nan=False)


def test_every_shared_file(shared_data: Path) -> None:
    """Every file is reported on, or refused with our errors."""
    for path in sorted((shared_data / "exr").rglob("*.exr")):
        try:
            found = inspect_file(path)
        except (DamagedFileError, DeepFileError, FileError):
            assert path.parent.name == "damaged" or "deep" in path.name
            continue
        assert found.layers
        json.dumps(found.as_dict(), allow_nan=False)
        if "vray" in path.name:
            assert {s.name for s in found.suspicions} == {"all black"}
        if "nan_inf" in path.name:
            assert found.layers[0].nan > 0
            assert found.layers[0].infinite > 0


def test_negatives_of_a_luminance_chroma_picture_are_those_of_its_colour(shared_data: Path) -> None:
    found = inspect_file(shared_data / "exr" / "openexr_luminance_chroma_rec709.exr")
    assert found.layers[0].negative == 954
