"""Guides in files of their own, CIE XYZ films, and samples per pixel told by the caller."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from lambent.errors import FileError, LayerError, OptionError
from lambent.frame.exr import decode
from lambent.frame.files import read, read_views, write, write_noted
from lambent.frame.guides import file_of, numbered, split
from lambent.frame.inspection import inspect_file
from lambent.frame.role import Role, Stat

HEIGHT, WIDTH = 12, 16


def exr(
    path: Path, names: str, at: tuple[int, int] = (0, 0), size=(HEIGHT, WIDTH), **header
) -> Path:
    """A float EXR with random channels, its data window at ``at``."""
    rng = np.random.default_rng(len(path.name) + sum(map(ord, path.name)))
    height, width = size
    window = (
        np.array(at, np.int32),
        np.array([at[0] + width - 1, at[1] + height - 1], np.int32),
    )
    basic = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": window,
        "displayWindow": window,
    }
    pixels = {n: rng.random(size, np.float32) + 0.1 for n in names.split()}
    OpenEXR.File({**basic, **header}, pixels).write(str(path))
    return path


@pytest.fixture
def beauty(tmp_path: Path) -> Path:
    return exr(tmp_path / "beauty.exr", "R G B")


def channel(path: Path, name: str) -> np.ndarray:
    (part,) = decode(path).parts
    return part.channels[name].data


def test_what_names_a_file() -> None:
    assert file_of("albedo") is None
    assert file_of("ViewLayer.Denoising Albedo") is None
    assert file_of("a:b") is None
    assert file_of("x/albedo.exr") == (Path("x/albedo.exr"), "")
    assert file_of(Path("albedo.PNG")) == (Path("albedo.PNG"), "")
    assert file_of("aovs.exr:base.colour") == (Path("aovs.exr"), "base.colour")
    assert split({"albedo": "tex", "normal": "n.exr"}) == ({"albedo": "tex"}, {"normal": "n.exr"})
    for role in ("colour", "alpha", "lighting", "emission"):
        with pytest.raises(OptionError, match="cannot come from another file"):
            split({role: "other.exr"})
    assert split({"colour.variance": "v.exr"})[1] == {"colour.variance": "v.exr"}


def test_numbers_in_names() -> None:
    roles = {"albedo": "a.####.exr", "normal": "n.%03d.exr:N", "depth": "d.exr", "z": "Z####"}
    assert numbered(roles, 7, "b.0007.exr") == {
        "albedo": "a.0007.exr",
        "normal": "n.007.exr:N",
        "depth": "d.exr",
        "z": "Z####",
    }
    with pytest.raises(OptionError, match=r"has a place for a frame number, and b\.exr has none"):
        numbered(roles, None, "b.exr")


def test_single_pictures_become_guides(tmp_path: Path, beauty: Path) -> None:
    """An albedo in R G B, normals in X Y Z, depth in one channel or three, a variance."""
    names = {"albedo": "R G B A", "normal": "X Y Z", "depth": "Z", "colour.variance": "R G B"}
    files = {role: exr(tmp_path / f"{role}.exr", text) for role, text in names.items()}
    frame = read(beauty, roles={role: str(path) for role, path in files.items()})
    assert np.array_equal(frame[Role.ALBEDO][..., 1], channel(files["albedo"], "G"))
    assert np.array_equal(frame[Role.NORMAL][..., 2], channel(files["normal"], "Z"))
    assert np.array_equal(frame[Role.DEPTH][..., 0], channel(files["depth"], "Z"))
    variance = frame[Role.COLOUR, Stat.VARIANCE]
    assert np.array_equal(variance[..., 0], channel(files["colour.variance"], "R"))
    assert "albedo.exr" in frame.layers[Role.ALBEDO, Stat.MEAN].why
    three = exr(tmp_path / "three.exr", "R G B")
    depth = read(beauty, roles={"depth": str(three)})[Role.DEPTH]
    assert np.array_equal(depth[..., 0], channel(three, "R"))


def test_one_file_of_all_guides(tmp_path: Path, beauty: Path) -> None:
    """Its own roles count; any other layer is named behind a colon."""
    names = "R G B albedo.R albedo.G albedo.B N.X N.Y N.Z tex.R tex.G tex.B"
    aovs = exr(tmp_path / "aovs.exr", names)
    frame = read(beauty, roles={"albedo": str(aovs), "normal": str(aovs)})
    assert np.array_equal(frame[Role.ALBEDO][..., 0], channel(aovs, "albedo.R"))
    assert np.array_equal(frame[Role.NORMAL][..., 0], channel(aovs, "N.X"))
    frame = read(beauty, roles={"albedo": f"{aovs}:tex"})
    assert np.array_equal(frame[Role.ALBEDO][..., 0], channel(aovs, "tex.R"))
    with pytest.raises(LayerError, match=r"no layer for 'depth'(.|\n)*N, RGB, albedo, tex"):
        read(beauty, roles={"depth": str(aovs)})


def test_a_guide_that_does_not_fit(tmp_path: Path, beauty: Path) -> None:
    small = exr(tmp_path / "small.exr", "R G B", size=(HEIGHT // 2, WIDTH))
    with pytest.raises(LayerError, match=r"16x6 at \(0, 0\), are not those of the frame, 16x12"):
        read(beauty, roles={"albedo": str(small)})
    large = exr(tmp_path / "large.exr", "R G B", size=(2 * HEIGHT, 2 * WIDTH))
    with pytest.raises(LayerError, match="are not those"):
        read(beauty, roles={"albedo": str(large)})
    moved = exr(tmp_path / "moved.exr", "R G B", at=(3, 2))
    with pytest.raises(
        LayerError, match=r"16x12 at \(3, 2\), are not those of the frame, .*\(0, 0"
    ):
        read(beauty, roles={"albedo": str(moved)})
    with pytest.raises(FileError, match="there is no such file"):
        read(beauty, roles={"albedo": str(tmp_path / "none.exr")})
    with pytest.raises(LayerError, match="3 channels, this has 1"):
        read(beauty, roles={"normal": str(exr(tmp_path / "z.exr", "Z"))})
    with pytest.raises(LayerError, match="no layer for 'albedo'"):
        read(beauty, roles={"albedo": str(beauty)})


def test_overscan_of_a_guide_is_cut(tmp_path: Path) -> None:
    display = (np.array([0, 0], np.int32), np.array([WIDTH - 1, HEIGHT - 1], np.int32))
    crop = exr(tmp_path / "crop.exr", "R G B", at=(2, 1), size=(8, 9), displayWindow=display)
    wide = exr(
        tmp_path / "wide.exr", "R G B", at=(-2, -3), size=(HEIGHT + 6, WIDTH + 4),
        displayWindow=display,
    )  # fmt: skip
    albedo = read(crop, roles={"albedo": str(wide)})[Role.ALBEDO]
    assert np.array_equal(albedo[..., 0], channel(wide, "R")[4:12, 4:13])


def test_pictures_as_guides(tmp_path: Path, beauty: Path) -> None:
    """An albedo is a colour and becomes linear; normals are stored as they stand."""
    stored = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    Image.fromarray(stored).save(tmp_path / "p.png")
    roles = {"albedo": str(tmp_path / "p.png"), "normal": str(tmp_path / "p.png")}
    frame = read(beauty, roles=roles)
    values = stored / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    assert np.allclose(frame[Role.ALBEDO], linear, atol=1e-5)
    assert np.allclose(frame[Role.NORMAL], values, atol=1e-5)
    assert any("p.png" in note and "linear" in note for note in frame.notes)


def test_guides_by_view(tmp_path: Path) -> None:
    header = {"multiView": ["left", "right"]}
    beauty = exr(tmp_path / "b.exr", "R G B right.R right.G right.B", **header)
    both = exr(tmp_path / "a.exr", "R G B right.R right.G right.B", **header)
    frames = read_views(beauty, roles={"albedo": f"{both}"})
    assert np.array_equal(frames["left"][Role.ALBEDO][..., 0], channel(both, "R"))
    assert np.array_equal(frames["right"][Role.ALBEDO][..., 0], channel(both, "right.R"))
    one = exr(tmp_path / "one.exr", "R G B")
    shared = read_views(beauty, roles={"albedo": str(one)})
    assert np.array_equal(shared["right"][Role.ALBEDO][..., 0], channel(one, "R"))


def test_a_guide_stands_for_the_files_own_which_stays(tmp_path: Path) -> None:
    own = exr(tmp_path / "own.exr", "R G B albedo.R albedo.G albedo.B")
    other = exr(tmp_path / "other.exr", "R G B")
    frame = read(own, roles={"albedo": str(other)})
    assert np.array_equal(frame[Role.ALBEDO][..., 0], channel(other, "R"))
    colour = frame.layers[Role.COLOUR, Stat.MEAN]
    out = write(tmp_path / "out.exr", frame.with_layer(colour.with_data(colour.data * 2)))
    assert np.array_equal(channel(out, "albedo.R"), channel(own, "albedo.R"))
    assert np.array_equal(channel(out, "R"), 2 * channel(own, "R"))


def test_inspection_shows_guides(tmp_path: Path, beauty: Path) -> None:
    albedo = exr(tmp_path / "albedo.exr", "R G B")
    found = inspect_file(beauty, {"albedo": str(albedo)})
    (layer,) = [layer for layer in found.layers if layer.role is Role.ALBEDO]
    assert layer.name == "albedo.exr:RGB"
    assert layer.high == pytest.approx(max(channel(albedo, c).max() for c in "RGB"))


# ------------------------------------------------------------------------- samples per pixel


def test_samples_told_by_the_caller(tmp_path: Path) -> None:
    """RenderMan's variances of samples count once their number is known."""
    names = "R G B mse.R mse.G mse.B sampleCount albedo.R albedo.G albedo.B "
    path = exr(tmp_path / "r.exr", names + "albedo_var.R albedo_var.G albedo_var.B")
    assert not read(path).has(Role.ALBEDO, Stat.VARIANCE)
    frame = read(path, spp=16)
    variance = frame[Role.ALBEDO, Stat.VARIANCE]
    assert np.allclose(variance[..., 0], channel(path, "albedo_var.R") / 16)
    assert frame.spp == 16
    found = inspect_file(path, spp=16)
    assert found.spp == 16
    assert {layer.name for layer in found.layers if layer.stat is Stat.VARIANCE} == {
        "mse", "albedo_var",
    }  # fmt: skip
    for wrong in (0, -3):
        with pytest.raises(OptionError, match="samples per pixel"):
            read(path, spp=wrong)


# ------------------------------------------------------------------------------------ CIE XYZ

#: sRGB's primaries, as IEC 61966-2-1 prints the matrix.
SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def test_xyz_films_are_filtered_as_rgb_and_written_as_xyz(tmp_path: Path) -> None:
    path = exr(tmp_path / "film.exr", "X Y Z A", generatedBy="Mitsuba version 3.9.1")
    frame = read(path)
    xyz = np.stack([channel(path, c) for c in "XYZ"], -1)
    assert np.allclose(frame.colour @ SRGB.T, xyz, atol=2e-3)
    colour = frame.layers[Role.COLOUR, Stat.MEAN]
    written = write_noted(tmp_path / "out.exr", frame.with_layer(colour.with_data(colour.data * 3)))
    for name in "XYZ":
        assert np.allclose(channel(written.path, name), 3 * channel(path, name), rtol=1e-5)
    assert np.array_equal(channel(written.path, "A"), channel(path, "A"))
    assert any("CIE XYZ" in note for note in frame.notes)


def test_grey_in_grey_out(tmp_path: Path) -> None:
    path = exr(tmp_path / "grey.exr", "R")
    frame = read(path, roles={"colour": "R"})
    assert frame[Role.COLOUR].shape == (HEIGHT, WIDTH, 1)
    colour = frame.layers[Role.COLOUR, Stat.MEAN]
    out = write(tmp_path / "out.exr", frame.with_layer(colour.with_data(colour.data * 2)))
    (part,) = decode(out).parts
    assert list(part.channels) == ["R"]
    assert np.array_equal(channel(out, "R"), 2 * channel(path, "R"))


def test_joined_channels_are_written_where_they_were(tmp_path: Path) -> None:
    path = exr(tmp_path / "numbers.exr", "0 1 2 3")
    frame = read(path, roles={"colour": "2,0,1"})
    assert np.array_equal(frame.colour[..., 0], channel(path, "2"))
    colour = frame.layers[Role.COLOUR, Stat.MEAN]
    scaled = colour.with_data(colour.data * np.array([2, 3, 4], np.float32))
    out = write(tmp_path / "out.exr", frame.with_layer(scaled))
    for name, factor in {"2": 2, "0": 3, "1": 4, "3": 1}.items():
        assert np.array_equal(channel(out, name), np.float32(factor) * channel(path, name))
