"""Real files in other renderers' naming: read with roles, written back with all else as it was.

Blender 4's file is our Cycles 5.0 render with the old pass names in one part; pbrt's holds the same
pixels under the names of its gbuffer film.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from test_dialects_shared import CYCLES, OLD

from lambent.frame.exr import decode
from lambent.frame.files import read, write
from lambent.frame.frame import Frame
from lambent.frame.inspection import inspect_file
from lambent.frame.role import Role, Stat


def cycles_channels() -> dict[str, np.ndarray]:
    return {n: c.data for p in decode(CYCLES).parts for n, c in p.channels.items()}


def write_exr(path: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    basic = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    made = {name: OpenEXR.Channel(name, data.copy(), 1, 1) for name, data in channels.items()}
    OpenEXR.File({**basic, **header}, made).write(str(path))
    return path


@pytest.fixture
def blender_4(tmp_path: Path) -> Path:
    """One part, ``RenderLayer.DiffDir.R``…, without Blender's own denoising."""
    channels = {}
    for name, data in cycles_channels().items():
        _, pass_name, component = name.split(".")
        if pass_name != "Noisy Image":
            channels[f"RenderLayer.{OLD.get(pass_name, pass_name)}.{component}"] = data
    for component in "RGBA":
        noisy = cycles_channels()[f"ViewLayer.Noisy Image.{component}"]
        channels[f"RenderLayer.Combined.{component}"] = noisy
    return write_exr(
        tmp_path / "blender4.exr",
        channels,
        BlenderMultiChannel="Blender V2.55.1 and newer",
        **{"cycles.RenderLayer.samples": "8"},
    )


@pytest.fixture
def pbrt(tmp_path: Path) -> Path:
    """The gbuffer film's names, half floats as it writes them."""
    source = cycles_channels()
    names = {"": "Noisy Image", "Albedo.": "Denoising Albedo"}
    channels = {f"{new}{c}": source[f"ViewLayer.{old}.{c}"] for new, old in names.items()
                for c in "RGB"}  # fmt: skip
    for new, old in {"P": "Position", "N": "Normal", "Ns": "Denoising Normal"}.items():
        for c in "XYZ":
            channels[f"{new}.{c}"] = source[f"ViewLayer.{old}.{c}"].astype(np.float16)
    for c in "RGB":
        noisy = source[f"ViewLayer.Noisy Image.{c}"].astype(np.float32)
        channels[f"Variance.{c}"] = (0.5 * noisy**2).astype(np.float16)
        channels[f"RelativeVariance.{c}"] = np.full_like(channels[f"Variance.{c}"], 0.5)
    for name in ("dzdx", "dzdy", "u", "v"):
        channels[name] = np.zeros_like(channels["Variance.R"])
    return write_exr(tmp_path / "pbrt.exr", channels, samplesPerPixel=16)


def brightened(frame: Frame) -> Frame:
    colour = frame.layers[Role.COLOUR, Stat.MEAN]
    return frame.with_layer(colour.with_data(colour.data * 2))


def changed(before: Path, after: Path) -> set[str]:
    """Channels whose pixels differ; every other one, and the order of all, is the same."""
    one, two = decode(before).parts, decode(after).parts
    assert [(p.name, list(p.channels)) for p in one] == [(p.name, list(p.channels)) for p in two]
    return {
        name
        for p, q in zip(one, two, strict=True)
        for name in p.channels
        if p.channels[name].data.tobytes() != q.channels[name].data.tobytes()
    }


def test_blender_4(blender_4: Path, tmp_path: Path) -> None:
    frame = read(blender_4)
    assert (frame.dialect, frame.spp) == ("blender", 8)
    assert {"colour", "alpha", "albedo", "normal", "depth", "motion"} <= {
        role.value for role, stat in frame.layers
    }
    assert "RenderLayer.DiffDir" in frame.lighting()
    assert "RenderLayer.Combined_lamp" in frame.lighting()
    sums = inspect_file(blender_4).sums
    assert sums[0].way.startswith("Cycles")
    assert sums[0].sums
    out = write(tmp_path / "out.exr", brightened(frame))
    assert changed(blender_4, out) == {f"RenderLayer.Combined.{c}" for c in "RGB"}


def test_pbrt(pbrt: Path, tmp_path: Path) -> None:
    frame = read(pbrt)
    assert (frame.dialect, frame.spp) == ("pbrt", 16)
    assert frame.has(Role.NORMAL)
    assert frame.layers[Role.NORMAL, Stat.MEAN].name == "Ns"
    # Variance of the samples in the file, of the mean in the frame.
    raw = decode(pbrt).parts[0].channels["Variance.R"].data.astype(np.float32)
    assert np.allclose(frame[Role.COLOUR, Stat.VARIANCE][:, :, 0], raw / 16)
    assert np.allclose(read(pbrt, spp=4)[Role.COLOUR, Stat.VARIANCE][:, :, 0], raw / 4)
    out = write(tmp_path / "out.exr", brightened(frame))
    assert changed(pbrt, out) == {"R", "G", "B"}


def test_cycles_50_parts(tmp_path: Path) -> None:
    """A part for each pass: only the noisy image's part gets new pixels."""
    out = write(tmp_path / "out.exr", brightened(read(CYCLES)))
    assert changed(CYCLES, out) == {f"ViewLayer.Noisy Image.{c}" for c in "RGB"}


def test_map_by_hand(pbrt: Path) -> None:
    """The layer that the table passes over, named by the user."""
    frame = read(pbrt, roles={"normal": "N"})
    assert frame.layers[Role.NORMAL, Stat.MEAN].name == "N"
    assert frame.layers[Role.NORMAL, Stat.MEAN].why == "--map normal"
