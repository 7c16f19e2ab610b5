"""Facts that have one home: nothing but that module computes them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import lambent

ROOT = Path(lambent.__file__).parent

#: The module, what its source must hold, and what no other source may hold.
FACTS = {
    "progress": ("progress.py", r"Callable\[\[float, float, str\]"),
    "device": ("device.py", r'"auto", "cpu", "cuda"'),
    "free memory": ("memory.py", r"MemAvailable"),
    "relMSE": ("metrics/relmse.py", r"\*\* 2 \+ (EPSILON|0\.01)|centre \* centre \+ epsilon"),
    "exposure": ("frame/exposure.py", r"KEY / (math|np)\.exp"),
    "noise level": ("frame/noise_level.py", r"0\.6745\b(?! \()|1\.1503"),
    "σ of features": ("filters/features.py", r"MISS_SIGMA|\"miss\": 0"),
}


@pytest.mark.parametrize("fact", FACTS)
def test_a_fact_is_computed_in_one_module(fact):
    home, pattern = FACTS[fact]
    places = {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if re.search(pattern, _code(path.read_text("utf-8")))
    }
    assert places == {home}


def _code(source: str) -> str:
    """The source without docstrings and comments."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value = ast.Constant("")
    return ast.unparse(tree).replace("'", '"')
