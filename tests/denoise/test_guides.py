"""Guides in files of their own, from Python and from the command: one file, sequences, errors."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

import lambent
from lambent.cli import main
from lambent.denoise.files import denoise_file
from lambent.denoise.pipeline import Settings
from lambent.denoise.sequence import denoise_sequence, find_jobs, sort_out
from lambent.errors import FileError, OutputError

MODEL = "cross-bilateral"
FRAMES = (1, 2, 3)


def checks() -> np.ndarray:
    squares = (np.indices((40, 48)).sum(axis=0) // 6 % 2)[..., None] > 0
    return np.where(squares, [0.8, 0.2, 0.1], [0.1, 0.5, 0.7]).astype(np.float32)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Beauties, an albedo of each, one of normals, and all of it in one file (``all.####``)."""
    rng = np.random.default_rng(4)
    normal = np.zeros((40, 48, 3), np.float32)
    normal[..., 2] = 1

    def write(name: str, **arrays: np.ndarray) -> None:
        lambent.write(tmp_path / name, lambent.Frame.from_arrays(**arrays))

    write("normal.exr", normal=normal)
    for n in FRAMES:
        albedo = np.roll(checks(), 5 * n, axis=1)
        colour = (albedo * rng.gamma(2.0, 0.5, albedo.shape)).astype(np.float32)
        write(f"beauty.{n:04d}.exr", colour=colour)
        write(f"albedo.{n:04d}.exr", colour=albedo)
        write(f"all.{n:04d}.exr", colour=colour, albedo=albedo, normal=normal)
    return tmp_path


def colour(path: Path) -> np.ndarray:
    return lambent.read(path).colour


def expected(folder: Path, n: int = 1) -> np.ndarray:
    return lambent.denoise(folder / f"all.{n:04d}.exr", model=MODEL).colour


def test_from_a_file_a_frame_and_an_array(folder: Path) -> None:
    """The same pixels as with the guides in the file itself."""
    beauty, albedo = folder / "beauty.0001.exr", folder / "albedo.0001.exr"
    guides = {"albedo": albedo, "normal": str(folder / "normal.exr")}
    frame = lambent.read(beauty)
    for thing in (beauty, frame, frame.colour):
        clean = lambent.denoise(thing, model=MODEL, **guides).colour
        assert np.array_equal(clean, expected(folder)), type(thing)
    arrays = lambent.denoise(beauty, model=MODEL, albedo=colour(albedo), normal=guides["normal"])
    assert np.array_equal(arrays.colour, expected(folder))
    alone = lambent.denoise(beauty, model=MODEL, normal=guides["normal"]).colour
    assert not np.array_equal(alone, expected(folder))
    by_number = lambent.denoise(
        beauty, model=MODEL, albedo=folder / "albedo.####.exr", normal=guides["normal"]
    )
    assert np.array_equal(by_number.colour, expected(folder))


def test_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The guides are looked at, not written, and no note says that they were not."""
    beauty, out = folder / "beauty.0001.exr", folder / "out.exr"
    options = ["--albedo", folder / "albedo.0001.exr", "--map", f"normal={folder / 'normal.exr'}"]
    call = ["denoise", beauty, "-m", MODEL, "-o", out, *options, "--json"]
    assert main([str(a) for a in call]) == 0
    found = json.loads(capsys.readouterr().out)
    assert not any("not written" in note for note in found["notes"])
    assert np.array_equal(colour(out), expected(folder))
    (part,) = lambent.read(out).origin.payload.exr.parts
    assert list(part.channels) == ["B", "G", "R"]


@pytest.mark.parametrize("source", ["beauty.####.exr", "beauty.*.exr"])
def test_sequence(folder: Path, source: str) -> None:
    options = {"albedo": str(folder / "albedo.####.exr"), "normal": str(folder / "normal.exr")}
    out = folder / "out"
    made = denoise_sequence(folder / source, out, model=MODEL, **options)
    assert len(made.done) == 3
    for n in FRAMES:
        assert np.array_equal(colour(out / f"beauty.{n:04d}.exr"), expected(folder, n))
    again = denoise_sequence(folder / source, out, model=MODEL, **options)
    assert (len(again.done), len(again.skipped)) == (0, 3)
    # A guide rendered anew makes its frame outdated; another missing one fails its frame alone.
    later = os.stat(out / "beauty.0003.exr").st_mtime + 10
    os.utime(folder / "albedo.0002.exr", (later, later))
    again = denoise_sequence(folder / source, out, model=MODEL, **options)
    assert [result.source.name for result in again.done] == ["beauty.0002.exr"]
    (folder / "albedo.0003.exr").unlink()
    third = denoise_sequence(folder / source, out, model=MODEL, overwrite=True, **options)
    assert len(third.done) == 2
    ((job, error),) = third.failed
    assert job.number == 3
    assert "albedo.0003.exr" in str(error)


def test_guides_among_the_frames_are_not_cleaned(folder: Path) -> None:
    for path in folder.glob("all.*"):
        path.unlink()
    settings = Settings.checked(
        model=MODEL,
        albedo=str(folder / "albedo.####.exr"),
        normal=str(folder / "normal.exr"),
    )
    jobs = find_jobs(folder, None, folder / "out").jobs
    (folder / "albedo.0000.exr").write_bytes((folder / "albedo.0001.exr").read_bytes())
    todo, _ = sort_out([job for job in jobs if job.number], settings, False)
    assert [job.source.name for job in todo] == [f"beauty.{n:04d}.exr" for n in FRAMES]


def test_refused_before_any_work(folder: Path) -> None:
    beauty, albedo = folder / "beauty.0001.exr", folder / "albedo.0001.exr"
    before = albedo.read_bytes()
    with pytest.raises(OutputError, match="is the file of a guide"):
        denoise_file(beauty, albedo, model=MODEL, albedo=str(albedo), overwrite=True)
    with pytest.raises(OutputError, match="is the file of a guide"):
        denoise_sequence(
            folder / "beauty.####.exr",
            folder / "albedo.####.exr",
            model=MODEL,
            albedo=str(folder / "albedo.####.exr"),
            overwrite=True,
        )
    assert albedo.read_bytes() == before
    with pytest.raises(FileError, match="there is no such file"):
        denoise_file(beauty, folder / "o.exr", model=MODEL, albedo=str(folder / "nothing.exr"))


def test_samples_per_pixel(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``--spp`` reaches the frame that a model sees, and is one of the settings of a result."""
    beauty, out = folder / "all.0001.exr", folder / "out.exr"
    assert main(["denoise", str(beauty), "-o", str(out), "--spp", "64", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["spp"] == 64
    with_spp = colour(out)
    assert not np.array_equal(with_spp, lambent.denoise(beauty).colour)
    for thing in (beauty, lambent.read(beauty)):
        assert np.array_equal(with_spp, lambent.denoise(thing, spp=64).colour)
    keys = [Settings.checked(spp=spp).key() for spp in (None, 16, 64)]
    assert keys[0] != keys[1] != keys[2]
    assert main(["denoise", str(beauty), "--spp", "0", "-o", str(folder / "no.exr")]) == 4
    assert main(["inspect", str(beauty), "--spp", "64", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["spp"] == 64
