"""Which device is taken for a name, with and without a GPU."""

from __future__ import annotations

import pytest

from lambent.device import choose_device
from lambent.errors import EngineError, OptionError


@pytest.mark.parametrize(
    ("name", "gpu", "chosen"),
    [("auto", True, "cuda"), ("auto", False, "cpu"), ("cuda", True, "cuda"), ("cpu", True, "cpu")],
)
def test_a_name_is_the_device_that_is_there(name, gpu, chosen):
    assert choose_device(name, lambda: gpu) == chosen


def test_what_is_not_there_is_refused():
    with pytest.raises(EngineError, match="no CUDA device"):
        choose_device("cuda", lambda: False)
    with pytest.raises(OptionError, match="no device 'tpu'"):
        choose_device("tpu", lambda: True)
