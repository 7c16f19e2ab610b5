"""The records of an EXR file: parts, channels in their own types, header values.

`decode` reads the structure and checks all of it; pixels are decoded when they are asked for.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.frame.exr.header import Container, PartHeader
from lambent.frame.exr.module import enough_memory
from lambent.frame.exr.pixels import Arrays, bands, decode_rows
from lambent.frame.exr.values import COMPRESSIONS
from lambent.frame.exr.whole import read_whole, readable

#: Parts up to so many bytes are decoded once and kept: writing back needs them again.
KEEP_BYTES = 256 << 20
#: Rows that are put into place together: few enough to stay in the processor's cache.
_BLOCK = 32


class ExrChannel:
    """One channel: name, sampling, and pixels in its own type and sampled size ``(h, w)``.

    ``data`` is float16, float32 or uint32, read-only; decoded with its part when first asked for.
    """

    def __init__(
        self,
        name: str,
        data: NDArray[Any] | Callable[[], NDArray[Any]],
        x_sampling: int = 1,
        y_sampling: int = 1,
        dtype: Any = None,
    ) -> None:
        self.name = name
        self.x_sampling = x_sampling
        self.y_sampling = y_sampling
        self.dtype = np.dtype(dtype if dtype is not None else np.asarray(data).dtype)
        self._data = data

    @property
    def data(self) -> NDArray[Any]:
        """The pixels."""
        return self._data() if callable(self._data) else self._data

    def __repr__(self) -> str:
        return f"ExrChannel({self.name!r}, {self.dtype})"


class Pixels:
    """The packed pixels of a part, and once asked for, the decoded ones."""

    def __init__(self, file: Container, packed: PartHeader) -> None:
        self.file, self.packed = file, packed

    @cached_property
    def arrays(self) -> Arrays:
        """Every channel, decoded together and kept."""
        with enough_memory(self.file.path):
            if not self._alone or not readable(self.file):
                return _frozen(decode_rows(self.file, self.packed))
            whole = read_whole(self.file)
            # What failed here is tried again where the reason can be heard.
            return _frozen(whole[0] if whole else decode_rows(self.file, self.packed, apart=True))

    @property
    def _alone(self) -> bool:
        """Whether this is all there is in the file."""
        return len(self.file.parts) == 1

    @property
    def small(self) -> bool:
        """Whether the pixels may be kept for the next who needs them."""
        return self.packed.unpacked <= KEEP_BYTES

    @property
    def kept(self) -> bool:
        """Whether `arrays` has been made."""
        return "arrays" in self.__dict__


def _frozen(arrays: Arrays) -> Arrays:
    for array in arrays.values():
        array.flags.writeable = False
    return arrays


@dataclass(frozen=True, eq=False)
class ExrPart:
    """One part: ``header`` has its attributes as Python values (see `values`).

    ``view`` is the part's stereo view, or "". Windows are ``(x0, y0, x1, y1)``, inclusive.
    """

    index: int
    name: str
    view: str
    header: Mapping[str, Any] = field(repr=False)
    channels: Mapping[str, ExrChannel]
    data_window: tuple[int, int, int, int]
    display_window: tuple[int, int, int, int]
    pixels: Pixels | None = field(default=None, repr=False)

    @property
    def width(self) -> int:
        """Columns of the data window."""
        return self.data_window[2] - self.data_window[0] + 1

    @property
    def height(self) -> int:
        """Rows of the data window."""
        return self.data_window[3] - self.data_window[1] + 1

    @property
    def type(self) -> str:
        """``"scanlineimage"`` or ``"tiledimage"``."""
        return "tiledimage" if self.pixels and self.pixels.packed.tiles else "scanlineimage"

    @property
    def compression(self) -> str:
        """``"zip"``, ``"piz"``, … (`lambent.frame.exr.values.COMPRESSIONS`)."""
        return "zip" if self.pixels is None else COMPRESSIONS[self.pixels.packed.compression]

    def rows(self, top: int, bottom: int) -> Arrays:
        """Rows ``top:bottom`` of every channel without sub-sampling; only these are decoded."""
        if self.pixels is None or self.pixels.kept:
            return {n: c.data[top:bottom] for n, c in self.channels.items() if c.y_sampling == 1}
        packed = self.pixels.packed
        step = packed.lines * max(c.y_sampling for c in packed.channels)
        a, b = top // step * step, min(-(-bottom // step) * step, self.height)
        found = decode_rows(self.pixels.file, packed, (a, b))
        return {
            n: found[n][top - a : bottom - a] for n, c in self.channels.items() if c.y_sampling == 1
        }

    def fill(self, targets: Mapping[str, Iterable[tuple[NDArray[Any], int, int]]]) -> None:
        """Decode straight into other arrays of any type.

        ``targets``: channel name to ``(place, row, column)``: arrays ``(h, w)`` (views of an
        interleaved image, say) and where in the channel their first pixel lies. A small part is
        decoded at once and kept; of a large one, memory beside the targets is one band.
        """
        for a, b, found in self._bands(targets):
            for name, places in targets.items():
                step = self.channels[name].y_sampling
                first, last = a // step, -(-b // step)
                for place, row, column in places:
                    top, bottom = max(first, row), min(last, row + place.shape[0])
                    if top < bottom:
                        piece = found[name][top - first : bottom - first]
                        place[top - row : bottom - row] = piece[:, column : column + place.shape[1]]

    def _bands(self, names: Iterable[str]) -> Iterable[tuple[int, int, Arrays]]:
        if self.pixels is None or self.pixels.kept or self.pixels.small:
            whole = {name: self.channels[name].data for name in names}
            steps = {self.channels[name].y_sampling for name in names}
            block = _BLOCK if steps == {1} else self.height
            for a in range(0, self.height, block):
                b = min(a + block, self.height)
                yield a, b, {n: array[a:b] if steps == {1} else array for n, array in whole.items()}
            return
        for a, b in bands(self.pixels.packed):
            yield a, b, decode_rows(self.pixels.file, self.pixels.packed, (a, b))


@dataclass(frozen=True, eq=False)
class ExrFile:
    """A decoded EXR file."""

    path: Path
    parts: tuple[ExrPart, ...]
    container: Container | None = field(default=None, repr=False)

    def gather(self, wanted: Iterable[int]) -> None:
        """Decode parts of a file together if most of it is wanted anyhow; else do nothing."""
        if self.container is None or len(self.parts) == 1:
            return
        waiting = [p for p in map(self.parts.__getitem__, wanted) if p.pixels and not p.pixels.kept]
        sizes = [p.unpacked for p in self.container.parts]
        share = sum(sizes[p.index] for p in waiting)
        if sum(sizes) > KEEP_BYTES or 2 * share < sum(sizes) or len(waiting) < 2:
            return
        whole = read_whole(self.container)
        for part in waiting if whole else ():
            assert part.pixels is not None
            assert whole is not None
            part.pixels.__dict__["arrays"] = _frozen(whole[part.index])

    @property
    def views(self) -> tuple[str, ...]:
        """The stereo views, the main one first; empty if there is only one picture."""
        for part in self.parts:
            listed = part.header.get("multiView")
            if isinstance(listed, list):
                return tuple(listed)
        return tuple(dict.fromkeys(p.view for p in self.parts if p.view))


def decode(path: str | os.PathLike[str]) -> ExrFile:
    """Read and check the structure of an EXR file; pixels follow when they are asked for.

    Raises `FileError` (missing, no EXR), `DamagedFileError`, `DeepFileError`. Pixels that cannot
    be decoded raise `DamagedFileError` later, where they are asked for.
    """
    container = Container(path)
    return ExrFile(Path(path), tuple(_part(container, p) for p in container.parts), container)


def _part(container: Container, packed: PartHeader) -> ExrPart:
    pixels = Pixels(container, packed)
    return ExrPart(
        index=packed.index,
        name=str(packed.values.get("name", "")),
        view=str(packed.values.get("view", "")),
        header=packed.values,
        channels={
            c.name: ExrChannel(
                c.name, partial(_pixels_of, pixels, c.name), c.x_sampling, c.y_sampling, c.dtype
            )
            for c in packed.channels
        },
        data_window=packed.data_window,
        display_window=packed.display_window,
        pixels=pixels,
    )


def _pixels_of(pixels: Pixels, name: str) -> NDArray[Any]:
    return pixels.arrays[name]
