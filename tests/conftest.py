"""Where the project's test data is, and which tests need more than `make test` installs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from lambent.render.cycles.find import Blender
HERE = Path(__file__).resolve().parent

#: Folders and files whose tests import PyTorch, Ray, Playwright or OpenCV. All their tests get the
#: mark `heavy`; a single test elsewhere that needs one of these is marked where it stands.
HEAVY = (
    "learn",
    "training",
    "cli/test_train.py",
    "dataset/test_cluster.py",
    "report/test_browser.py",
)


def _heavy(path: Path) -> bool:
    return any(path.is_relative_to(HERE / name) for name in HEAVY)


def pytest_configure() -> None:
    for name in HEAVY:
        if not (HERE / name).exists():
            raise pytest.UsageError(f"HEAVY in tests/conftest.py: tests/{name} does not exist")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Without the heavy packages, files that import them cannot even be collected."""
    light = "not heavy" in config.getoption("markexpr")
    return True if light and _heavy(collection_path) else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Before pytest selects by marks."""
    for item in items:
        if _heavy(item.path):
            item.add_marker(pytest.mark.heavy)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of test renders beside the checkout; tests that need it are skipped without."""
    chosen = os.environ.get("LAMBENT_SHARED_DATA")
    for folder in (Path(chosen) if chosen else None, HERE.parents[1] / "shared" / "data"):
        if folder is not None and folder.is_dir():
            return folder
    pytest.skip("the folder of shared test data is not there (LAMBENT_SHARED_DATA)")


@pytest.fixture(scope="session")
def blender() -> Blender:
    """The Blender of this machine; tests are skipped where there is none."""
    from lambent.errors import EngineError
    from lambent.render.cycles.find import find_blender

    try:
        return find_blender()
    except EngineError as error:
        pytest.skip(f"no Blender here: {error.remedy}")
