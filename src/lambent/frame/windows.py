"""Where a frame's pixels lie in its picture: data window and display window.

Both are boxes ``(x0, y0, x1, y1)``, last column and row included, as OpenEXR counts: x to the
right, y down. The display window is the picture, the data window the pixels that there are: fewer
where a crop was rendered, more with overscan.
"""

from __future__ import annotations

from dataclasses import dataclass

Window = tuple[int, int, int, int]


@dataclass(frozen=True)
class Windows:
    """The boxes of a frame's pixels (``data``) and of the whole picture (``display``)."""

    data: Window
    display: Window

    @classmethod
    def of_size(cls, width: int, height: int) -> Windows:
        """Of a whole picture."""
        box = (0, 0, width - 1, height - 1)
        return cls(box, box)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the data window."""
        return size_of(self.data)

    @property
    def display_size(self) -> tuple[int, int]:
        """Width and height of the display window."""
        return size_of(self.display)

    @property
    def offset(self) -> tuple[int, int]:
        """Column and row of the display window where the data window begins."""
        return self.data[0] - self.display[0], self.data[1] - self.display[1]

    def cropped(self, top: int, bottom: int, left: int, right: int) -> Windows:
        """Those of rows ``top:bottom`` and columns ``left:right`` of the pixels."""
        width, height = self.size
        x, y, _, _ = self.data
        right, bottom = min(right, width), min(bottom, height)
        return Windows((x + left, y + top, x + right - 1, y + bottom - 1), self.display)

    def __str__(self) -> str:
        width, height = self.size
        whole = self.display_size
        return f"{width}x{height} at {self.offset} of {whole[0]}x{whole[1]}"


def size_of(window: Window) -> tuple[int, int]:
    """Width and height of a box."""
    return window[2] - window[0] + 1, window[3] - window[1] + 1
