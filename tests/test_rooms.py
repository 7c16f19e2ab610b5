"""The rooms: CONTRIBUTING names them all, in the order of the import contract, and no module goes
round the contract by naming another one in a string.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from lambent.settings import read_toml

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "lambent"
#: Registries that list what rooms above them bring; everything else joins by an entry point.
ALLOWED = {("lambent.filters.denoiser", "lambent.denoise")}


def layers() -> dict[str, int]:
    """Module of the contract -> its row, 0 for the uppermost."""
    (contract,) = (
        one
        for one in read_toml(ROOT / "pyproject.toml")["tool"]["importlinter"]["contracts"]
        if one["name"] == "Imports point one way only"
    )
    return {
        name.strip(): row
        for row, names in enumerate(contract["layers"])
        for name in names.split("|")
    }


def table() -> list[str]:
    """The rooms of CONTRIBUTING's table, from above."""
    return re.findall(r"^\| `src/lambent/(\w+)` \|", (ROOT / "CONTRIBUTING.md").read_text(), re.M)


def test_contributing_names_every_room() -> None:
    rooms = {path.parent.name for path in SOURCE.glob("*/__init__.py")} | {"models"}
    assert set(table()) == rooms
    assert len(table()) == len(rooms)


def test_the_table_has_the_order_of_the_contract() -> None:
    rows = [layers()[f"lambent.{room}"] for room in table() if room != "models"]
    assert rows == sorted(rows)


def test_every_room_and_module_is_in_the_contract() -> None:
    modules = {f"lambent.{p.stem}" for p in SOURCE.glob("*.py") if not p.stem.startswith("_")}
    packages = {f"lambent.{p.parent.name}" for p in SOURCE.glob("*/__init__.py")}
    assert set(layers()) == modules | packages


def named_in_strings(path: Path) -> list[str]:
    """Modules of Lambent that a file names in a string: ``"lambent.x.y"``, ``"lambent.x.y:Z"``."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            match = re.fullmatch(r"(lambent(?:\.\w+)+)(?::\w+)?", node.value)
            file = SOURCE.parent / match[1].replace(".", "/") if match else None
            if file is not None and (file.with_suffix(".py").exists() or file.is_dir()):
                found.append(match[1])
    return found


@pytest.mark.parametrize("room", sorted({name.split(".")[1] for name in layers()}))
def test_no_string_goes_round_the_contract(room: str) -> None:
    rows = layers()
    files = [SOURCE / f"{room}.py", *(SOURCE / room).rglob("*.py")]
    for path in filter(Path.exists, files):
        here = ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts)
        for there in named_in_strings(path):
            target = ".".join(there.split(".")[:2])
            if (here, target) in ALLOWED or target == f"lambent.{room}":
                continue
            assert rows[target] > rows[f"lambent.{room}"], f"{here} names {there} in a string"
