"""Images as planes that Dr.Jit kernels read at offsets with plain loads.

The package docstring says how kernels use them.

Memory of one plane, ``b`` = border::

    b + 1 empty rows
    image row 0   | W pixels | at least b empty entries |   = stride entries, a multiple of 16
    ...
    b + 1 empty rows

A step to the left of the first column lands in the empty entries of the row above. Hence a shift
by (dx, dy) with |dx|, |dy| <= b is one flat offset, and what it finds outside the image is empty.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.startup import engine

FloatImage = NDArray[np.float32]

#: Entries that rows are rounded up to: 64 bytes, the widest vector there is.
_LANES = 16


def backend(device: str = "auto") -> ModuleType:
    """The Dr.Jit module (``drjit.llvm`` or ``drjit.cuda``) for a device. Raises `EngineError`."""
    return importlib.import_module(f"drjit.{engine(device)}")


@dataclass(frozen=True)
class Layout:
    """How an image of ``height`` x ``width`` lies in a plane with a border of ``border``."""

    height: int
    width: int
    border: int

    @property
    def stride(self) -> int:
        """Floats from one row to the next."""
        return -(-(self.width + self.border) // _LANES) * _LANES

    @property
    def size(self) -> int:
        """Entries of a view: the image's rows, with the empty ends of the rows."""
        return self.height * self.stride

    @property
    def margin_rows(self) -> int:
        """Empty rows above, and below."""
        return self.border + 1

    @property
    def rows(self) -> int:
        """All rows of a plane."""
        return self.height + 2 * self.margin_rows

    def offset(self, dx: int, dy: int) -> int:
        """The flat distance to the neighbour at (dx, dy)."""
        return dy * self.stride + dx


def aligned(shape: tuple[int, ...]) -> FloatImage:
    """A float32 array of zeros whose first entry lies on a 64-byte boundary."""
    count = int(np.prod(shape))
    raw = np.zeros(count + _LANES, np.float32)
    skip = (-(raw.ctypes.data // 4)) % _LANES
    return raw[skip : skip + count].reshape(shape)


class Plane:
    """One plane that can be viewed at offsets.

    ``values``: flat, rows ``-extent`` to ``height + extent`` of the layout; a NumPy array, or an
    evaluated Dr.Jit array (a kernel's result). ``module``: from `backend`.
    """

    def __init__(self, layout: Layout, extent: int, values: Any, module: ModuleType) -> None:
        self.layout = layout
        self.extent = extent
        self.module = module
        self._mapped = module.__name__.endswith("llvm")
        if self._mapped:
            # no copy in either direction; NumPy keeps the memory alive
            self.flat = values if isinstance(values, np.ndarray) else values.numpy()
        else:
            self.flat = module.Float(values)

    def view(self, dx: int = 0, dy: int = 0, extend: int = 0) -> Any:
        """The plane shifted: entry (x, y) is the plane at (x + dx, y + dy).

        ``extend``: rows above and below the image that the view covers as well.
        Returns a ``Float`` of ``(height + 2·extend)·stride`` entries.
        """
        stride = self.layout.stride
        start = (self.extent - extend + dy) * stride + dx
        count = (self.layout.height + 2 * extend) * stride
        if start < 0 or start + count > self.flat_size:
            raise IndexError(f"a view at ({dx}, {dy}), extended by {extend}, leaves the plane")
        if self._mapped:
            return self.module.Float(self.flat[start : start + count])
        import drjit as dr

        index = dr.arange(self.module.UInt32, count) + dr.opaque(self.module.UInt32, start)
        return dr.gather(self.module.Float, self.flat, index)

    @property
    def flat_size(self) -> int:
        """Entries of the plane."""
        return (self.layout.height + 2 * self.extent) * self.layout.stride


class Planes:
    """An image ``(H, W, C)`` as planes; channel c at offset (dx, dy) is ``view(c, dx, dy)``."""

    def __init__(self, layout: Layout, memory: FloatImage, module: ModuleType) -> None:
        self.layout = layout
        self.memory = memory
        self.planes = [Plane(layout, layout.margin_rows, m.reshape(-1), module) for m in memory]

    @classmethod
    def of(cls, image: NDArray[Any], layout: Layout, module: ModuleType) -> Planes:
        """Planes of ``(H, W, C)`` or ``(H, W)``. What is not finite becomes 0."""
        return cls.stacked([image if image.ndim == 3 else image[:, :, None]], layout, module)

    @classmethod
    def stacked(cls, images: Sequence[NDArray[Any]], layout: Layout, module: ModuleType) -> Planes:
        """Planes of the channels of several images ``(H, W, C)``, one after the other."""
        memory = aligned((sum(i.shape[2] for i in images), layout.rows, layout.stride))
        inside = memory[:, layout.margin_rows : layout.margin_rows + layout.height, : layout.width]
        first = 0
        for image in images:
            for channel in range(image.shape[2]):
                inside[first + channel] = image[:, :, channel]
            first += image.shape[2]
        if not all_finite(memory):
            memory[~np.isfinite(memory)] = 0.0
        return cls(layout, memory, module)

    def __len__(self) -> int:
        return len(self.planes)

    def refilled(self, values: Sequence[Any]) -> Planes:
        """These planes with other contents: Dr.Jit arrays of ``layout.size``, one a channel.

        Waits for the values and then uses this object's memory again: do not keep it.
        """
        layout = self.layout
        for plane, value in zip(self.memory, values, strict=True):
            rows = slice(layout.margin_rows, layout.margin_rows + layout.height)
            plane[rows] = value.numpy().reshape(layout.height, layout.stride)
        return Planes(layout, self.memory, self.planes[0].module)

    def view(self, channel: int, dx: int = 0, dy: int = 0, extend: int = 0) -> Any:
        """Channel ``channel`` shifted by (dx, dy): see `Plane.view`."""
        return self.planes[channel].view(dx, dy, extend)

    def views(self, dx: int = 0, dy: int = 0, extend: int = 0) -> list[Any]:
        """All channels shifted by (dx, dy)."""
        return [plane.view(dx, dy, extend) for plane in self.planes]


def valid_pixels(*images: NDArray[Any] | None) -> FloatImage:
    """``(H, W)``: 1 where every channel of every image ``(H, W, C)`` is finite, else 0.

    This is the mask plane (see the package docstring). None counts as finite.
    """
    given = [image for image in images if image is not None]
    mask = np.ones(given[0].shape[:2], bool)
    for image in given:
        if not all_finite(image):
            finite = np.isfinite(image)
            mask &= finite if image.ndim == 2 else finite.all(axis=2)
    return mask.astype(np.float32)


def all_finite(image: NDArray[Any]) -> bool:
    """Whether a sum proves that all is finite (False also where finite values overflow it)."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(image.sum()))  # inf - inf is NaN: nothing hides


def to_image(values: Sequence[Any], layout: Layout) -> FloatImage:
    """Dr.Jit arrays of ``layout.size`` entries, one a channel, to an image ``(H, W, C)``."""
    import drjit as dr

    dr.eval(*values)
    image = np.empty((layout.height, layout.width, len(values)), np.float32)
    for channel, value in enumerate(values):
        plane = value.numpy().reshape(layout.height, layout.stride)
        image[:, :, channel] = plane[:, : layout.width]
    return image


def constants(values: Iterable[float], module: ModuleType) -> list[Any]:
    """Numbers as one-entry arrays that are read at run time: other values, same kernel."""
    import drjit as dr

    return [dr.opaque(module.Float, float(value)) for value in values]
