"""Making denoisers by name: what is refused, and how."""

from __future__ import annotations

import numpy as np
import pytest

import lambent
from lambent.errors import OptionError, UnknownNameError
from lambent.filters.denoiser import DENOISERS, FARTHEST, choose_passes, create
from lambent.frame.frame import Frame
from lambent.frame.role import Role


def test_a_window_that_could_never_be_compiled_is_refused() -> None:
    with pytest.raises(OptionError, match="would look 5000 pixels far"):
        create("box", radius=5000)
    assert create("box", radius=FARTHEST).margin() == FARTHEST


def test_every_model_has_a_reach_within_the_limit() -> None:
    for name in DENOISERS:
        assert 0 <= create(name).margin() <= FARTHEST, name


def test_parameters_are_converted_and_checked() -> None:
    assert create("nlm", radius="7") == create("nlm", radius=7)
    assert create("lambent", views="2") == create("lambent", views=2)
    with pytest.raises(OptionError, match="take one of 1, 2"):
        create("lambent", views="3")
    with pytest.raises(UnknownNameError, match="radius"):
        create("nlm", radus=7)
    with pytest.raises(OptionError, match="needs a value of type int"):
        create("nlm", radius="wide")


@pytest.mark.parametrize(("name", "value"), [("radius", "-3"), ("k", "nan"), ("k", float("inf"))])
def test_numbers_that_mean_nothing_are_refused(name: str, value: object) -> None:
    with pytest.raises(OptionError, match=f"'{name}' of 'nlm' cannot be"):
        create("nlm", **{name: value})


def test_an_array_of_integers_is_no_radiance() -> None:
    with pytest.raises(OptionError, match="uint8 cannot be linear radiance"):
        lambent.denoise(np.zeros((4, 4, 3), np.uint8), model="box")


def test_no_pass_is_not_all_passes():
    frame = Frame.from_arrays(colour=np.ones((4, 4, 3), np.float32))
    with pytest.raises(OptionError, match="no pass"):
        create("box")(frame, passes=" ")
    assert [layer.role for layer in choose_passes(frame, "all")] == [Role.COLOUR]
