"""`lambent models`: complete, and the same in JSON."""

from __future__ import annotations

import json
import shutil

import pytest

from lambent.archive import write_archive
from lambent.cli import main
from lambent.denoise.model_file import shipped
from lambent.errors import FileError
from lambent.filters.denoiser import DENOISERS, parameters


def test_every_model_is_listed_with_its_paper(capsys):
    assert main(["models", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [card["name"] for card in found["models"]] == list(DENOISERS)
    assert all(card["title"] and card["needs"] for card in found["models"])
    assert all(card["paper"] or card["group"] == "work" for card in found["models"])
    assert found["default"] in DENOISERS


def test_one_model_shows_its_parameters_with_defaults(capsys):
    assert main(["models", "oidn"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in parameters("oidn"))


@pytest.mark.parametrize("name", list(DENOISERS))
def test_every_model_has_a_card_to_read(name, capsys):
    assert main(["models", name]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"{name}: ")
    learned = bool(DENOISERS[name]().card())
    assert ("trained" in text) == learned


def test_the_table_fits_the_terminal(capsys, monkeypatch):
    for columns in (80, 120):
        monkeypatch.setenv("COLUMNS", str(columns))
        assert main(["models"]) == 0
        assert max(map(len, capsys.readouterr().out.splitlines())) <= columns


def test_the_table_has_three_groups_with_a_line_for_each_model(capsys):
    assert main(["models"]) == 0
    lines = capsys.readouterr().out.splitlines()
    headings = [line for line in lines if line and not line.startswith(" ")]
    assert [h.split()[0] for h in headings] == ["For", "From", "Floors:", "What"]
    work, papers, floors = (lines.index(h) for h in headings[:3])
    where = {line.split()[0]: n for n, line in enumerate(lines) if line.startswith("  ")}
    assert list(sorted(where)) == sorted(DENOISERS)
    assert sum(line.startswith("  ") for line in lines) == len(DENOISERS)
    assert work < where["lambent"] < papers
    assert work < where["nfor-tuned"] < papers
    assert papers < where["nfor"] < floors < where["box"]


def test_an_unknown_model_is_answered_with_the_nearest(capsys):
    assert main(["models", "oidm"]) == 4
    assert "did you mean oidn" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["oidn", "oidn-best"])
def test_json_of_one_model_has_types(capsys, name):
    assert main(["models", name, "--json"]) == 0
    card = json.loads(capsys.readouterr().out)
    assert {p["name"] for p in card["parameters"]} == set(parameters(name))


@pytest.mark.parametrize("name", ["lambent-fast", "kpcn", "dncnn"])
def test_a_model_file_is_described_as_a_shipped_one(name, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    shutil.copy(shipped()[name], "mine.lambent")
    assert main(["models", name, "--json"]) == 0
    own = json.loads(capsys.readouterr().out)
    assert main(["models", "mine.lambent", "--json"]) == 0
    mine = json.loads(capsys.readouterr().out)
    assert mine["training"] == own["training"]
    assert mine["needs"] == own["needs"]
    assert "weights" not in {p["name"] for p in mine["parameters"]}
    assert main(["models", "mine.lambent"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("mine.lambent: ")
    assert main(["models", name]) == 0
    for line in capsys.readouterr().out.splitlines():
        if line.startswith(("  data", "  trained", "  score")):
            assert line in lines
    assert lines[-1] == "Use it: lambent denoise noisy.exr --model mine.lambent"


def test_a_file_that_is_no_model_is_refused_with_its_kind(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_archive("room.lambent", "solution", {"method": "radiosity"}, {})
    assert main(["models", "room.lambent"]) == FileError.exit_code
    text = " ".join(capsys.readouterr().err.split())
    assert "is a solution, not a model" in text
    assert "lambent view room.lambent" in text
    assert main(["models", "none.lambent"]) == FileError.exit_code
    assert "there is no such file" in capsys.readouterr().err
