"""Engines: the processor's is here, others join by an entry point."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from lambent.denoise.engines import ENGINES, Work, engine
from lambent.denoise.learned import LambentFast
from lambent.errors import EngineError
from lambent.frame.frame import Frame
from lambent.settings import read_toml

ROOT = Path(__file__).resolve().parents[2]


def test_auto_is_the_processor() -> None:
    assert engine("auto") is engine("cpu")


def test_an_engine_gets_the_work_and_its_result_is_the_frame(monkeypatch) -> None:
    """Any function of this form serves: the same as on the processor, and then half as bright."""
    seen: list[Work] = []

    def half(work: Work) -> list[np.ndarray]:
        seen.append(work)
        return [image / 2 for image in engine("cpu")(work)]

    monkeypatch.setitem(ENGINES._own, "cuda", "")
    monkeypatch.setitem(ENGINES._loaded, "cuda", half)
    colour = np.random.default_rng(0).gamma(2, 0.2, (32, 32, 3)).astype(np.float32)
    frame = Frame.from_arrays(colour=colour, diffuse=colour / 3)
    ours, theirs = LambentFast()(frame, "all"), LambentFast(device="cuda", views=2)(frame, "all")
    assert (seen[0].views, len(seen[0].images)) == (2, 2)
    again = LambentFast(views=2)(frame, "all")
    np.testing.assert_allclose(theirs.colour, again.colour / 2, rtol=1e-6)
    assert not np.array_equal(ours.colour, again.colour)


def test_an_engine_that_is_not_there_is_named_with_a_remedy() -> None:
    with pytest.raises(EngineError, match="--device abacus") as raised:
        engine("abacus")
    assert "--device cpu" in str(raised.value)


def test_the_entry_point_of_the_package_is_an_engine() -> None:
    pytest.importorskip("torch")
    target = read_toml(ROOT / "pyproject.toml")["project"]["entry-points"]["lambent.engines"][
        "cuda"
    ]
    module, _, attribute = target.partition(":")
    assert callable(getattr(importlib.import_module(module), attribute))


def test_without_a_gpu_the_want_of_a_package_is_not_what_is_told(monkeypatch) -> None:
    here = importlib.import_module("lambent.denoise.engines")
    monkeypatch.setattr(here, "has_cuda", lambda: False)
    monkeypatch.setitem(ENGINES._plugins, "cuda", "lambent.no_such_module:filtered")
    monkeypatch.delitem(ENGINES._loaded, "cuda", raising=False)
    with pytest.raises(EngineError, match="no CUDA device"):
        engine("cuda")
