"""Shared fixtures: where the project's test data is, and small frames with known content."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from lambent.render.cycles.find import Blender


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of test renders beside the checkout; tests that need it are skipped without."""
    chosen = os.environ.get("LAMBENT_SHARED_DATA")
    here = Path(__file__).resolve().parent.parent
    for folder in (Path(chosen) if chosen else None, here.parent / "shared" / "data"):
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
