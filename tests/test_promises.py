"""Every promise of the docs names tests, and the tests are there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "guides" / "promises.md"
NAMED = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def promises() -> list[tuple[str, str]]:
    """Each promise, and the lines that name its tests."""
    body = PAGE.read_text().split("\n## ", 1)[1]
    blocks = [b for b in body.split("\n\n") if b.startswith("**")]
    return [(text, tests) for text, _, tests in (b.partition("\n: ") for b in blocks)]


def test_every_promise_names_a_test():
    assert len(promises()) > 15
    for text, tests in promises():
        assert NAMED.search(tests), text
        assert not NAMED.sub("", tests).strip(" ,\n"), f"{text}: {tests}"


def test_every_test_that_a_promise_names_is_there():
    for text, tests in promises():
        for file, name in NAMED.findall(tests):
            tree = ast.parse((ROOT / file).read_text())
            functions = {n.name: n for n in tree.body if isinstance(n, ast.FunctionDef)}
            assert name in functions, f"{text}: {file} has no {name}"
            marks = " ".join(ast.unparse(d) for d in functions[name].decorator_list)
            assert "slow" not in marks, f"{text}: {name} does not run with the others"


def test_the_page_is_in_the_table_of_contents():
    assert "\nguides/promises\n" in (ROOT / "docs" / "index.md").read_text()
