"""Where work is done: on the processor, or on an NVIDIA GPU. The one place that decides."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

from lambent.errors import EngineError, OptionError

Device = Literal["auto", "cpu", "cuda"]
DEVICES: tuple[str, ...] = get_args(Device)


def check_device(name: str) -> None:
    """Raise `OptionError` for what is none of `DEVICES`."""
    if name not in DEVICES:
        raise OptionError(f"there is no device '{name}'", remedy="take auto, cpu or cuda")


def choose_device(name: str, has_cuda: Callable[[], bool]) -> Literal["cpu", "cuda"]:
    """The device for a name of `DEVICES`; auto: CUDA where there is one.

    ``has_cuda``: whether the library that does the work finds a GPU; asked only if it matters.
    Raises `OptionError` for an unknown name, `EngineError` for CUDA where there is none.
    """
    check_device(name)
    if name == "cpu":
        return "cpu"
    if has_cuda():
        return "cuda"
    if name == "cuda":
        raise EngineError(
            "no CUDA device was found", remedy="use --device cpu, or check the NVIDIA driver"
        )
    return "cpu"
