"""`--model FILE`: the denoiser that a model file is for, and what other files are told."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from lambent.archive import write_archive
from lambent.cli import main
from lambent.denoise.model_file import as_denoiser, read_model, shipped, write_model
from lambent.denoise.pipeline import Settings, denoise
from lambent.errors import FileError, OptionError, UnknownNameError
from lambent.frame.files import write
from lambent.frame.frame import Frame


@pytest.fixture
def noisy() -> Frame:
    colour = np.random.default_rng(0).gamma(2, 0.2, (32, 48, 3)).astype(np.float32)
    return Frame.from_arrays(colour=colour)


@pytest.mark.parametrize("name", ["lambent", "lambent-fast", "kpcn", "dpcn", "modular", "dncnn"])
def test_every_shipped_model_works_by_its_path(name: str, noisy: Frame) -> None:
    path = str(shipped()[name])
    own = "lambent" if name == "lambent-fast" else name  # the same denoiser, other weights
    assert as_denoiser(path, {}) == (own, {"weights": path})
    np.testing.assert_array_equal(denoise(noisy, path).colour, denoise(noisy, name).colour)


def test_a_name_stays_a_name() -> None:
    assert as_denoiser("nlm", {"radius": "3"}) == ("nlm", {"radius": "3"})
    with pytest.raises(UnknownNameError, match="lambent"):
        Settings.checked(model="lambnet")


def test_the_result_names_the_file(tmp_path, noisy: Frame, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped()["lambent-fast"], "mine.lambent")
    write("noisy.exr", noisy)
    assert main(["denoise", "noisy.exr", "-m", "mine.lambent"]) == 0
    assert "with lambent (mine.lambent)" in capsys.readouterr().out


def test_parameters_go_to_the_denoiser_of_the_file() -> None:
    path = str(shipped()["lambent-fast"])
    settings = Settings.checked(model=path, params={"preference": "0.5"})
    assert settings.denoiser().preference == 0.5
    with pytest.raises(OptionError, match="weights another"):
        Settings.checked(model=path, params={"weights": "other.lambent"})


def test_a_solution_is_refused_with_its_command(tmp_path, noisy: Frame, capsys) -> None:
    path, frame = tmp_path / "room.lambent", tmp_path / "noisy.exr"
    write_archive(path, "solution", {"method": "radiosity"}, {})
    write(frame, noisy)
    assert main(["denoise", str(frame), "-m", str(path)]) == FileError.exit_code
    text = " ".join(capsys.readouterr().err.split())
    assert "is a solution, not a model" in text
    assert f"lambent view {path}" in text


def test_a_missing_file_and_a_strange_task_are_named(tmp_path) -> None:
    with pytest.raises(FileError, match="no such file"):
        as_denoiser(str(tmp_path / "none.lambent"), {})
    model = read_model(shipped()["kpcn"])
    card = {k: v for k, v in model.card.items() if k not in ("kind", "format", "sha256")}
    card["recipe"] = {**card["recipe"], "task": "sharpen"}
    write_model(tmp_path / "odd.lambent", card, model.network, model.weights)
    with pytest.raises(FileError, match="sharpen"):
        as_denoiser(str(tmp_path / "odd.lambent"), {})
