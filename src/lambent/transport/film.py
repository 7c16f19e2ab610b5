"""Frames to a film: H.264 in MP4, through PyAV."""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from lambent.errors import EngineError, OutputError
from lambent.frame.atomic import check_target
from lambent.frame.exposure import auto_exposure
from lambent.frame.frame import Frame
from lambent.frame.tonemap import to_uint8


def write_film(
    path: str | os.PathLike[str],
    frames: Iterable[Frame],
    fps: float = 24.0,
    exposure: float | None = None,
    overwrite: bool = False,
) -> int:
    """Write frames as they come; returns how many. One exposure for all (None: the first's).

    The file appears when it is whole. Raises `OutputError`, `EngineError`.
    """
    try:
        import av
    except ImportError as error:
        raise EngineError(
            "films need PyAV, which is not installed", remedy="pip install 'lambent[transport]'"
        ) from error
    target = check_target(path, overwrite)
    partial = target.with_name(f".{target.stem}.part.mp4")
    count = 0
    try:
        with av.open(str(partial), "w", format="mp4") as container:
            stream: Any = None
            for frame in frames:
                if exposure is None:
                    exposure = auto_exposure(frame.colour)
                pixels = to_uint8(frame.colour, exposure)
                # the encoder halves colour: sides must be even
                pixels = np.pad(
                    pixels, ((0, pixels.shape[0] % 2), (0, pixels.shape[1] % 2), (0, 0)), "edge"
                )
                if stream is None:
                    stream = container.add_stream(
                        "libx264", rate=Fraction(fps).limit_denominator(1001)
                    )
                    stream.height, stream.width = pixels.shape[:2]
                    stream.pix_fmt = "yuv420p"
                    stream.options = {"crf": "16"}
                picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
                for packet in stream.encode(picture):
                    container.mux(packet)
                count += 1
            if stream is not None:
                for packet in stream.encode():
                    container.mux(packet)
        os.replace(partial, target)
    except OSError as error:
        raise OutputError(f"cannot be written: {error}", file=target) from error
    finally:
        Path(partial).unlink(missing_ok=True)
    return count
