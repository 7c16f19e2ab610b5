"""Files of one command that would overwrite each other are refused beforehand, by both names."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from lambent.cli import main
from lambent.denoise.collisions import check_collisions
from lambent.denoise.pipeline import Settings
from lambent.denoise.sequence import denoise_sequence, listed_jobs, sort_out
from lambent.errors import OutputError
from lambent.frame.files import write
from lambent.frame.frame import Frame


@pytest.fixture
def renders(tmp_path: Path) -> Path:
    """Two folders with a file of one name each, and a second name beside the first."""
    rng = np.random.default_rng(0)
    for name in ("a/x.exr", "b/x.exr", "a/y.exr"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        image = rng.gamma(2.0, 0.5, (8, 8, 3)).astype(np.float32)
        write(tmp_path / name, Frame.from_arrays(colour=image))
    return tmp_path


def refused(renders: Path, capsys, *args: object) -> str:
    """What the command says; it writes nothing, with --overwrite either."""
    before = {p: p.read_bytes() for p in renders.rglob("*") if p.is_file()}
    for more in ([], ["--overwrite"]):
        capsys.readouterr()
        assert main(["denoise", *map(str, args), "--model", "oidn-fast", *more]) == 2
        assert {p: p.read_bytes() for p in renders.rglob("*") if p.is_file()} == before
    return capsys.readouterr().err


def test_two_folders_with_one_name(renders, capsys):
    text = refused(renders, capsys, renders / "a/x.exr", renders / "b/x.exr", "-o", renders / "out")
    assert str(renders / "a/x.exr") in text
    assert str(renders / "b/x.exr") in text
    assert not (renders / "out").exists()


def test_a_finished_result_is_not_taken_for_that_of_another_input(renders, capsys):
    assert (
        main(["denoise", str(renders / "a/x.exr"), "-o", f"{renders}/out/", "--model", "oidn-fast"])
        == 0
    )
    refused(renders, capsys, renders / "a/x.exr", renders / "b/x.exr", "-o", renders / "out")


def test_one_file_named_twice(renders, capsys, monkeypatch):
    monkeypatch.chdir(renders)
    assert "twice" in refused(renders, capsys, "a/x.exr", "a/../a/x.exr")
    (renders / "link").symlink_to("a")
    text = refused(renders, capsys, "a/x.exr", "link/x.exr")
    assert "a/x.exr" in text
    assert "link/x.exr" in text


def test_a_result_that_is_the_input_of_another(renders, capsys):
    """In the place itself, and where a link leads to it."""
    write(renders / "out.exr", Frame.from_arrays(colour=np.ones((8, 8, 3), np.float32)))
    (renders / "o").mkdir()
    (renders / "o" / "x.exr").symlink_to(renders / "a" / "y.exr")
    text = refused(renders, capsys, renders / "a/x.exr", renders / "a/y.exr", "-o", renders / "o")
    assert str(renders / "a/x.exr") in text
    assert str(renders / "a/y.exr") in text


def test_results_that_links_lead_to_one_file(renders, capsys):
    (renders / "o").mkdir()
    (renders / "o" / "x.exr").symlink_to("y.exr")
    text = refused(renders, capsys, renders / "a/x.exr", renders / "a/y.exr", "-o", renders / "o")
    assert "would both be written" in text


def test_previews_and_reports_beside(renders, capsys):
    frame = Frame.from_arrays(colour=np.full((8, 8, 3), 0.5, np.float32))
    write(renders / "a" / "x.png", frame)
    text = refused(renders, capsys, renders / "a/x.exr", renders / "a/x.png", "--report")
    assert "the report of" in text
    write(renders / "a" / "x_preview.png", frame)
    alone = (renders / "a/x_preview.png", "-o", renders / "a" / "x.png", "--preview")
    capsys.readouterr()
    assert main(["denoise", *map(str, alone), "--overwrite", "--model", "oidn-fast"]) == 2
    assert "is an input" in capsys.readouterr().err


def test_a_preview_that_is_not_ours_stops_a_sequence(renders, capsys):
    precious = renders / "a_clean" / "x_preview.png"
    precious.parent.mkdir()
    precious.write_text("precious")
    assert main(["denoise", str(renders / "a"), "--preview", "--model", "oidn-fast"]) == 2
    assert "the preview exists already" in capsys.readouterr().err
    assert precious.read_text() == "precious"


def test_the_library_refuses_too(renders):
    (renders / "a" / "x_clean.exr").write_bytes((renders / "a" / "y.exr").read_bytes())
    with pytest.raises(OutputError, match="is an input"):
        sort_out(
            listed_jobs([renders / "a/x.exr", renders / "a/x_clean.exr"]).jobs,
            Settings.checked(model="oidn-fast"),
            overwrite=True,
        )


def test_a_sequence_may_replace_itself(renders):
    """That is what --overwrite allows; hard links are names of their own, and stay whole."""
    os.link(renders / "b" / "x.exr", renders / "b" / "z.exr")
    before = (renders / "a" / "y.exr").read_bytes()
    done = denoise_sequence(renders / "a", renders / "a", overwrite=True, model="oidn-fast")
    assert len(done.done) == 2
    assert (renders / "a" / "y.exr").read_bytes() != before
    kept = (renders / "b" / "x.exr").read_bytes()
    done = denoise_sequence(renders / "b", renders / "b", overwrite=True, model="oidn-fast")
    assert len(done.done) == 2
    assert (renders / "b" / "x.exr").read_bytes() != kept


def test_case_counts_where_the_folder_says_so(tmp_path, monkeypatch):
    """This system tells `A` from `a`; one that does not is put in its place for the second half."""
    pairs = [
        (tmp_path / "in1", tmp_path / "o" / "A.exr"),
        (tmp_path / "in2", tmp_path / "o" / "a.exr"),
    ]
    check_collisions(pairs)
    real = Path.samefile
    monkeypatch.setattr(
        Path, "samefile", lambda a, b: str(a).lower() == str(b).lower() or real(a, b)
    )
    with pytest.raises(OutputError, match="both be written"):
        check_collisions(pairs)


def test_what_is_left_out_is_said(renders, capsys):
    (renders / "a" / "paint.tif").touch()
    assert main(["denoise", str(renders / "a" / "x.exr"), "--model", "oidn-fast"]) == 0
    capsys.readouterr()
    assert main(["denoise", str(renders / "a"), "--model", "oidn-fast"]) == 0
    text = capsys.readouterr().err
    assert "left out: x_clean.exr (made by an earlier command)" in text
    assert "left out: paint.tif (no EXR)" in text
    assert "2 frames cleaned" in text
