"""Frames in and out: the file's own layers get the new pixels, everything else stays."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import exr_samples
import numpy as np
import OpenEXR
import pytest

from lambent.denoise.files import denoise_file
from lambent.errors import FileError, LayerError, OptionError, OutputError
from lambent.frame.exr import decode
from lambent.frame.files import read, read_views, write, write_noted, write_views
from lambent.frame.frame import Frame
from lambent.frame.layer import Layer
from lambent.frame.luma import enlarge, from_rgb, to_rgb, weights
from lambent.frame.role import Role, Stat


def changed(frame: Frame, role: Role, factor: float) -> Frame:
    layer = frame.layer(role)
    assert layer is not None
    return frame.with_layer(layer.with_data(layer.data * np.float32(factor)))


def sample(tmp_path: Path, **options: object) -> Path:
    path = tmp_path / "in.exr"
    path.write_bytes(exr_samples.content(**options))
    return path


@pytest.mark.parametrize("large", [False, True])
def test_layers_are_decoded_when_looked_at(
    large: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading touches no pixel; all roles come in one pass; ids of large files in another."""
    from lambent.frame.exr import file as exrfile

    if large:
        monkeypatch.setattr(exrfile, "KEEP_BYTES", 0)
    calls = []
    for name in ("decode_rows", "read_whole"):
        real = getattr(exrfile, name)
        monkeypatch.setattr(
            exrfile, name, lambda *a, real=real: calls.append(a[0].path) or real(*a)
        )
    frame = read(sample(tmp_path))
    assert frame.layer(Role.COLOUR) is not None
    assert calls == []
    _ = frame.colour, frame[Role.DEPTH], frame[Role.ALPHA]
    assert len(calls) == 1
    (ids,) = [layer for layer in frame.extras.values() if layer.role is Role.ID]
    assert ids.data.shape == (37, 29, 1)
    assert len(calls) == (2 if large else 1)


def test_write_back_changes_the_layer_and_nothing_else(tmp_path: Path) -> None:
    path = sample(tmp_path, origin=(5, -3))
    frame = read(path)
    before = exr_samples.bare(path)[0]
    out = write(tmp_path / "out.exr", changed(frame, Role.COLOUR, 2))
    after = exr_samples.bare(out)[0]
    for name, pixels in before.items():
        expected = pixels * 2 if name in "RGB" else pixels
        assert after[name].dtype == pixels.dtype
        assert after[name].tobytes() == expected.tobytes()
    assert decode(out).container.parts[0].raw == decode(path).container.parts[0].raw


def test_unchanged_frame_is_the_same_file(tmp_path: Path) -> None:
    path = sample(tmp_path)
    frame = read(path)
    _ = frame.colour
    out = write(tmp_path / "out.exr", frame)
    assert out.read_bytes() == path.read_bytes()


def test_halves_are_clamped_with_a_note(tmp_path: Path) -> None:
    frame = changed(read(sample(tmp_path)), Role.COLOUR, 30000)
    written = write_noted(tmp_path / "out.exr", frame)
    after = exr_samples.bare(written.path)[0]["R"]
    assert np.isfinite(after).all()
    assert after.max() == 65504
    assert any("65504" in note for note in written.notes)


def test_layers_in_other_windows(tmp_path: Path) -> None:
    """Cut to the colour's window, and put back into their own; too small ones are left out."""
    rng = np.random.default_rng(0)

    def part(name: str, channels: tuple[str, ...], window: tuple[int, int, int, int]) -> object:
        x0, y0, x1, y1 = window
        shape = (y1 - y0 + 1, x1 - x0 + 1)
        header = {
            "type": OpenEXR.scanlineimage,
            "compression": OpenEXR.ZIP_COMPRESSION,
            "dataWindow": ((x0, y0), (x1, y1)),
            "displayWindow": ((0, 0), (19, 19)),
        }
        pixels = {c: rng.random(shape).astype(np.float16) for c in channels}
        return OpenEXR.Part(header, pixels, name)

    path = tmp_path / "in.exr"
    OpenEXR.File(
        [
            part("rgba", ("R", "G", "B"), (4, 5, 12, 14)),
            part("albedo", ("albedo.R", "albedo.G", "albedo.B"), (2, 5, 15, 19)),
            part("depth", ("depth.Z",), (6, 5, 12, 14)),
        ]
    ).write(str(path))
    before = exr_samples.bare(path)
    frame = read(path)
    assert frame.colour.shape == (10, 9, 3)
    assert not frame.has(Role.DEPTH)
    assert any("depth" in note and "cover" in note for note in frame.notes)
    albedo = np.stack([before[1][f"albedo.{c}"] for c in "RGB"], axis=2)
    np.testing.assert_array_equal(frame[Role.ALBEDO], albedo[0:10, 2:11])
    out = write(tmp_path / "out.exr", changed(frame, Role.ALBEDO, 0.5))
    after = exr_samples.bare(out)
    expected = before[1]["albedo.G"].copy()
    expected[0:10, 2:11] *= np.float16(0.5)
    assert after[1]["albedo.G"].tobytes() == expected.tobytes()
    assert all(after[2][c].tobytes() == before[2][c].tobytes() for c in before[2])
    with pytest.raises(LayerError, match="does not cover"):
        read(path, roles={"depth": "depth"})


def test_what_is_no_layer_of_the_file_is_noted(tmp_path: Path) -> None:
    frame = read(sample(tmp_path))
    mine = Layer(Role.NORMAL, np.zeros((37, 29, 3), np.float32), name="mine")
    notes = write_noted(tmp_path / "out.exr", frame.with_layer(mine)).notes
    assert any("'mine' is not a layer of the file" in note for note in notes)
    wrong = frame.crop(0, 10, 0, 10)
    with pytest.raises(LayerError, match="origin=None"):
        write(tmp_path / "out2.exr", wrong)
    whole = write(tmp_path / "out3.exr", wrong.replace(origin=None))
    assert read(whole).colour.shape == (10, 10, 3)


def test_new_file_has_names_that_are_found_again(tmp_path: Path) -> None:
    """Every role and statistic, written and read: the same roles with the same values."""
    rng = np.random.default_rng(0)
    shape = (6, 7, 3)
    frame = Frame.from_arrays(
        colour=rng.random(shape, np.float32) * 1e5,
        colour_variance=rng.random(shape, np.float32),
        colour_half_a=rng.random(shape, np.float32),
        colour_half_b=rng.random(shape, np.float32),
        albedo=rng.random(shape, np.float32),
        albedo_variance=rng.random(shape, np.float32),
        normal=rng.random(shape, np.float32),
        normal_variance=rng.random(shape, np.float32),
        position=rng.random(shape, np.float32),
        depth=rng.random((6, 7), np.float32),
        depth_variance=rng.random((6, 7), np.float32),
        motion=rng.random((6, 7, 2), np.float32),
        alpha=rng.random((6, 7), np.float32),
        spp=16,
    )
    back = read(write(tmp_path / "new.exr", frame))
    assert back.spp == 16
    for key, layer in frame.layers.items():
        assert key in back.layers, key
        np.testing.assert_array_equal(back.layers[key].data, layer.data)
    half = write_noted(tmp_path / "half.exr", frame, half=True)
    assert all(p.dtype == np.float16 for p in exr_samples.bare(half.path)[0].values())
    assert any("65504" in note for note in half.notes)


def test_stereo_views(tmp_path: Path) -> None:
    """Both eyes of a new file; then one eye changed in place."""
    eyes = {
        view: Frame.from_arrays(colour=np.full((4, 5, 3), n, np.float32)).replace(view=view)
        for n, view in ((1, "left"), (2, "right"))
    }
    path = write_views(tmp_path / "stereo.exr", eyes)
    frames = read_views(path)
    assert list(frames) == ["left", "right"]
    assert (frames["right"].colour == 2).all()
    assert (read(path).colour == 1).all()
    assert (read(path, view="right").colour == 2).all()
    with pytest.raises(OptionError, match=r"left, right"):
        read(path, view="centre")
    frames["right"] = changed(frames["right"], Role.COLOUR, 5)
    out = write_views(tmp_path / "out.exr", frames)
    channels = exr_samples.bare(out)[0]
    assert {n: float(p.max()) for n, p in channels.items()} == {
        "R": 1, "G": 1, "B": 1, "right.R": 10, "right.G": 10, "right.B": 10,
    }  # fmt: skip


@pytest.mark.parametrize(
    "name", ["openexr_beachball_multipart_stereo", "openexr_beachball_singlepart_stereo"]
)
def test_shared_stereo(name: str, shared_data: Path, tmp_path: Path) -> None:
    """Both views are read; changing the other one leaves the main one bit for bit."""
    path = shared_data / "exr" / f"{name}.exr"
    frames = read_views(path)
    assert list(frames) == ["right", "left"]
    main = frames["right"].colour.copy()
    assert not np.array_equal(main, frames["left"].colour)
    frames["left"] = changed(frames["left"], Role.COLOUR, 2)
    back = read_views(write_views(tmp_path / "out.exr", frames))
    np.testing.assert_array_equal(back["right"].colour, main)
    np.testing.assert_array_equal(back["left"].colour, frames["left"].colour)


def test_luminance_chroma(shared_data: Path, tmp_path: Path) -> None:
    """Read as RGB; written back unchanged in look, and twice as bright if doubled."""
    frame = read(shared_data / "exr" / "openexr_luminance_chroma_rec709.exr")
    assert frame.colour.shape == (406, 610, 3)
    out = write(tmp_path / "out.exr", changed(frame, Role.COLOUR, 2))
    assert [c.x_sampling for c in decode(out).parts[0].channels.values()] == [2, 2, 1]
    np.testing.assert_allclose(read(out).colour, 2 * frame.colour, rtol=2e-3, atol=2e-3)
    exr_samples.bare(out)


def test_luminance_weights_and_round_trip() -> None:
    """Rec. 709 weights from its chromaticities; RGB to Y, RY, BY and back is the identity."""
    w = weights({})
    np.testing.assert_allclose(w, [0.2126, 0.7152, 0.0722], atol=1e-4)
    rgb = np.random.default_rng(0).random((5, 6, 3), np.float32)
    rgb[0, 0] = 0
    np.testing.assert_allclose(to_rgb(*from_rgb(rgb, w), w), rgb, atol=1e-5)
    small = np.arange(6, dtype=np.float32).reshape(2, 3)
    np.testing.assert_array_equal(enlarge(small, 4, 6)[::2, ::2], small)
    np.testing.assert_array_equal(enlarge(small, 4, 6)[0], [0, 0.5, 1, 1.5, 2, 2])


def test_variance_scale_is_applied(tmp_path: Path) -> None:
    """pbrt's `Variance` is that of the samples: with 4 spp the mean's is a quarter."""
    planes = {c: np.full((3, 4), 2.0, np.float32) for c in ("R", "G", "B")}
    planes |= {f"Variance.{c}": np.full((3, 4), 8.0, np.float32) for c in "RGB"}
    planes |= {f"{n}.{c}": np.ones((3, 4), np.float32) for n in ("P", "N", "Ns") for c in "XYZ"}
    planes |= {f"Albedo.{c}": np.ones((3, 4), np.float32) for c in "RGB"}
    (tmp_path / "in.exr").write_bytes(exr_samples.content(channels=planes))
    frame = read(tmp_path / "in.exr", spp=4)
    if frame.dialect == "pbrt":
        np.testing.assert_array_equal(frame[Role.COLOUR, Stat.VARIANCE], 2.0)
    assert frame.spp == 4


@pytest.mark.parametrize("ending", ["exr", "png", "hdr", "tif"])
def test_disk_full_leaves_the_old_file(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ENOSPC at the flush to the disk: the old file stays, nothing else lies there."""
    frame = Frame.from_arrays(colour=np.ones((4, 5, 3), np.float32))
    path = write(tmp_path / f"a.{ending}", frame)
    old = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="make room"):
        write(path, frame, overwrite=True)
    assert path.read_bytes() == old
    assert os.listdir(tmp_path) == [path.name]


def test_write_onto_itself(tmp_path: Path) -> None:
    """Output equals input: refused, or with `overwrite` sound, though pixels are still unread."""
    path = sample(tmp_path)
    before = exr_samples.bare(path)[0]
    frame = read(path)
    with pytest.raises(OutputError, match="--overwrite"):
        write(path, frame)
    write(path, changed(frame, Role.COLOUR, 2), overwrite=True)
    np.testing.assert_array_equal(frame[Role.DEPTH][..., 0], before["depth.Z"])
    np.testing.assert_array_equal(exr_samples.bare(path)[0]["R"], before["R"] * 2)


def test_one_row_and_one_pixel(tmp_path: Path) -> None:
    for height, width in ((1, 1), (1, 40), (40, 1)):
        path = sample(tmp_path, channels=exr_samples.arrays(0, height, width))
        frame = read(path)
        assert frame.colour.shape == (height, width, 3)
        out = write(tmp_path / "out.exr", changed(frame, Role.COLOUR, 2), overwrite=True)
        np.testing.assert_array_equal(read(out).colour, frame.colour * 2)


def test_errors_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"missing\.exr"):
        read(tmp_path / "missing.exr")
    (tmp_path / "a.gif").write_bytes(b"GIF89a" + bytes(20))
    with pytest.raises(FileError, match="reads EXR"):
        read(tmp_path / "a.gif")
    with pytest.raises(OutputError, match="stereo"):
        write_views(tmp_path / "a.png", {"": Frame.from_arrays(colour=np.ones((1, 1, 3)))})


LIMITED = """
import resource, sys
from lambent.errors import LambentError
from lambent.frame.files import read, write
frame = read(sys.argv[1])
layer = next(iter(frame.all_layers()))
import OpenEXR  # its library takes room too
OpenEXR.set_global_thread_count(1)
kind, size = getattr(resource, sys.argv[3]), int(sys.argv[4])
if sys.argv[3] == "RLIMIT_AS":
    size += int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(kind, (size, resource.getrlimit(kind)[1]))
try:
    changed = frame.with_layer(layer.with_data(layer.data * 2))
    print("read", flush=True)
    write(sys.argv[2], changed)
except LambentError as error:
    print(type(error).__name__, error, error.remedy is not None)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits work so on Linux")
@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("compression", ["ZIP", "ZSTD"])
def test_limits_of_the_system(compression: str, parts: int, tmp_path: Path) -> None:
    """A limit on file sizes (files in memory count) or on memory: our errors, with a remedy."""
    pixels = {c: np.random.default_rng(1).random((700, 700), np.float32) for c in "RGB"}
    if f"{compression}_COMPRESSION" not in exr_samples.COMPRESSIONS:
        compression = "PIZ"
    content = exr_samples.content(f"{compression}_COMPRESSION", parts=parts, channels=pixels)
    (tmp_path / "in.exr").write_bytes(content)

    def limited(kind: str, size: int) -> str:
        command = [sys.executable, "-c", LIMITED, str(tmp_path / "in.exr"), str(tmp_path / "o.exr")]
        done = subprocess.run(
            [*command, kind, str(size)], capture_output=True, text=True, check=False
        )
        assert done.stderr == ""
        return done.stdout

    # Reading needs no file; writing meets the limit where it is met.
    said = limited("RLIMIT_FSIZE", 1 << 20)
    assert said.startswith("read\nOutputError"), said
    assert "no files of that size" in said
    said = limited("RLIMIT_AS", 8 << 20)
    assert said.startswith("FileError"), said
    assert "not enough memory" in said
    assert said.endswith("True\n")
    assert os.listdir(tmp_path) == ["in.exr"]


def test_nan_outside_what_was_filtered_stays(tmp_path: Path) -> None:
    """Repaired, denoised and written: every channel but the filtered ones has its old bits.

    NaNs of several kinds among them, ids beyond 2**24, and the negative zero.
    """
    rng = np.random.default_rng(4)
    kinds = np.array([0x7FC00000, 0x7FC12345, 0xFFC00001, 0x7F800000, 0x80000000], np.uint32)
    planes: dict[str, np.ndarray] = {
        name: rng.random((24, 30), np.float32)
        for name in (
            *("R", "G", "B", "A", "depth.Z", "odd.thing"),
            *(f"{layer}.{c}" for layer in ("albedo", "emission") for c in "RGB"),
            *(f"normal.{c}" for c in "XYZ"),
        )
    }
    for plane in planes.values():
        plane.flat[rng.integers(0, plane.size, 5)] = kinds.view(np.float32)
    planes["id"] = rng.integers(2**25, 2**32, (24, 30), dtype=np.uint32)
    planes["half.Z"] = np.array([0x7E00, 0x7E01, 0xFE55, 0x7C00], np.uint16).view(np.float16)[
        rng.integers(0, 4, (24, 30))
    ]
    (tmp_path / "in.exr").write_bytes(exr_samples.content(channels=planes))
    result = denoise_file(
        tmp_path / "in.exr", tmp_path / "out.exr", model="box", passes="beauty", alpha=False
    )
    assert result.repairs
    after = exr_samples.bare(tmp_path / "out.exr")[0]
    assert list(after) == sorted(planes)
    for name, plane in planes.items():
        same = after[name].tobytes() == plane.tobytes()
        assert same == (name not in ("R", "G", "B")), name
    assert np.isfinite(after["R"]).all()


def test_swapped_arguments_of_write_are_told(tmp_path):
    frame = Frame.from_arrays(colour=np.ones((4, 4, 3), np.float32))
    with pytest.raises(OptionError, match="path and then a frame"):
        write(frame, tmp_path / "a.exr")
