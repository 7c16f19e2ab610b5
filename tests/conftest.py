"""Shared fixtures: where the project's test data is, and small frames with known content."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of test renders beside the checkout; tests that need it are skipped without."""
    chosen = os.environ.get("LAMBENT_SHARED_DATA")
    here = Path(__file__).resolve().parent.parent
    for folder in (Path(chosen) if chosen else None, here.parent / "shared" / "data"):
        if folder is not None and folder.is_dir():
            return folder
    pytest.skip("the folder of shared test data is not there (LAMBENT_SHARED_DATA)")
