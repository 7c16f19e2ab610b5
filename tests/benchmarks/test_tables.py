"""The tables of README and docs say what the JSON beside them says."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
sys.path.insert(0, str(ROOT / "benchmarks"))

import ablations
import denoise
import filters
import papers
import photo_models

#: What the tables of the scenes that were kept back call each kind of file.
KINDS = {
    "all layers, variances": "full",
    "colour, albedo, normal, depth": "plain",
    "splatted pixel filter": "splat",
}


def figures(name: str) -> Any:
    return json.loads((RESULTS / f"{name}.json").read_text())


def text(name: str) -> str:
    return (RESULTS / f"{name}.md").read_text()


def test_our_denoiser() -> None:
    assert text("denoise") == denoise.text_of(figures("denoise"))


def test_columns_count_their_scenes_and_failures_are_marked() -> None:
    row = {"kind": "full", "relmse_trimmed": 1.0, "flip": 1.0, "dssim": 1.0}
    rows = [{**row, "model": "oidn", "scene": s, "spp": 4} for s in "abc"]
    rows += [{**row, "model": "lambent", "scene": s, "spp": 4} for s in "ab"]
    rows += [{"kind": "full", "model": m, "scene": "c", "spp": 4, "failed": "why"}
             for m in ("lambent", "nfor-tuned")]  # fmt: skip
    table = denoise.quality_tables(rows)
    assert "| model | 4 spp, 3 scenes |" in table
    assert "| lambent | 1.00 / 1.00 / 1.00 (2 scenes) |" in table
    assert "| nfor-tuned | failed |" in table


def test_filters() -> None:
    found = figures("filters")
    assert text("filters") == filters.markdown(found["rows"], found)


def test_learned_denoisers() -> None:
    assert text("learned") == papers.tables(figures("learned"))


def test_photographs() -> None:
    assert text("photo_models") == photo_models.table(figures("photo_models")) + "\n"


@pytest.mark.parametrize(
    ("name", "what"), [("blocks", "blocks"), ("source", "source"), ("dncnn_ablation", "dncnn")]
)
def test_ablations(name: str, what: str) -> None:
    assert text(name).partition("\n\n")[2] == ablations.table(figures(name), what) + "\n"


@pytest.mark.parametrize("path", [RESULTS / "kept_back.md", ROOT / "README.md"])
def test_scenes_kept_back(path: Path) -> None:
    found = figures("kept_back")
    by = {(row["model"], row["kind"]): row for row in found["rows"]}
    lines = re.findall(
        r"^\| `([a-z-]+)` \| ([a-z, ]+) \| (\d+) \| (.+) \|$", path.read_text(), re.M
    )
    assert len(lines) >= 7
    for model, kind, scenes, cells in lines:
        row = by[model, KINDS[kind]]
        assert int(scenes) == row["scenes"]
        for index, cell in enumerate(cells.split(" | ")):
            error, _, dssim = cell.partition(" / ")
            assert error == f"{row['relmse_trimmed'][index]:.2f}"
            assert not dssim or dssim == f"{row['dssim'][index]:.2f}"


def test_readme_speaks_of_time_as_measured() -> None:
    speed = {row["model"]: row for row in figures("denoise")["speed"] if "seconds_0" in row}
    high = speed["oidn"]["seconds_0"]
    ours = speed["lambent"]
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"`lambent` takes {ours['seconds_0'] / high:.1f} of OIDN High's time" in readme
    more = (ours["seconds_4"] - ours["seconds_0"]) / 4 / high
    assert f"and {more:.2f} more for each further layer" in readme
    assert round(speed["oidn-best"]["seconds_0"] / high) == 7
    assert "seven times the time" in readme
