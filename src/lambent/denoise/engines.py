"""What computes our own network and applies its kernels: one engine a device, by name.

OpenVINO computes on the processor (`denoise.processor`). Engines of rooms above this one, and of
other people's packages, join through the entry-point group ``lambent.engines``: PyTorch on CUDA is
`lambent.learn.inference`, and this room knows it by its device alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lambent.denoise.model_file import ModelFile
from lambent.denoise.prepare import Given, Whole
from lambent.device import choose_device
from lambent.errors import EngineError, LambentError
from lambent.frame.layer import FloatImage
from lambent.registry import Registry
from lambent.startup import has_cuda


@dataclass(frozen=True, eq=False)
class Work:
    """Images of a frame to be filtered by a model's kernels.

    ``images`` ``(H, W, C)`` float32, C 1 to 3; ``divided``: which of them the albedo divides.
    ``given``: what the network reads; ``whole``: measured over the whole frame. The others are
    the parameters of `denoise.learned.Lambent`.
    """

    model: ModelFile
    given: Given
    whole: Whole
    images: Sequence[FloatImage]
    divided: Sequence[bool]
    preference: float = 0.0
    views: int = 1
    precision: str = "auto"
    threads: int | None = None


#: Returns the filtered images, each of the shape that it had.
Engine = Callable[[Work], list[FloatImage]]

ENGINES = Registry("engine", {"cpu": "lambent.denoise.processor:filtered"}, group="lambent.engines")


def engine(device: str) -> Engine:
    """The engine of a device, ``"auto"`` being the processor. Raises `EngineError`."""
    name = "cpu" if device == "auto" else device
    try:
        found: Engine = ENGINES[name]
    except LambentError as error:  # not there, or what it needs is not
        if name == "cuda":
            choose_device(name, has_cuda)  # without a GPU, no package would help
        raise EngineError(
            f"no engine for --device {device} can be loaded: {error.__cause__ or error.message}",
            remedy="pip install 'lambent[train]', or --device cpu",
        ) from error
    return found
