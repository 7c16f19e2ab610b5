"""Pictures side by side: pixels are compared that lie at the same place.

An EXR says where its pixels lie (`lambent.frame.windows`). Where all pictures have one data window
they are compared as they are; where they are parts of one display window, on what all of them have,
which a note says. What has no windows (an array, a PNG) lies where a picture of its size lies among
the others, and else is a whole picture. Anything else is refused: pixels of other places say
nothing about each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lambent.errors import LayerError
from lambent.frame.windows import Windows
from lambent.metrics.picture import Picture

#: Rows and columns.
Cut = tuple[slice, slice]


def aligned(pictures: Sequence[Picture]) -> tuple[list[Picture], list[Cut], str]:
    """The pictures cut to what all of them show, where each was cut, and a note (or "").

    The first is the one that others are held against. Raises `LayerError` naming two pictures and
    the offset between them where they show other places.
    """
    placed = [_placed(picture, pictures) for picture in pictures]
    base = placed[0]
    left, top, right, bottom = _box(base)
    for picture, windows in zip(pictures[1:], placed[1:], strict=True):
        if windows.data == base.data or (
            windows.size == base.size == windows.display_size == base.display_size
        ):
            continue  # the same pixels; or whole pictures of one size, wherever they are said to be
        if windows.display_size != base.display_size:
            raise _refused(pictures[0], base, picture, windows)
        x0, y0, x1, y1 = _box(windows)
        left, top, right, bottom = max(left, x0), max(top, y0), min(right, x1), min(bottom, y1)
        if left > right or top > bottom:
            raise _refused(pictures[0], base, picture, windows)
    cut, cuts = [], []
    for picture, windows in zip(pictures, placed, strict=True):
        same = windows.data == base.data
        x, y = base.offset if same else windows.offset
        rows = slice(top - y, bottom - y + 1)
        columns = slice(left - x, right - x + 1)
        cuts.append((rows, columns))
        height, width = picture.image.shape[:2]
        if (right - left + 1, bottom - top + 1) != (width, height):
            picture = replace(picture, image=picture.image[rows, columns])
        cut.append(picture)
    if all(new is old for new, old in zip(cut, pictures, strict=True)):
        return cut, cuts, ""
    size = f"{right - left + 1}x{bottom - top + 1}"
    places = ", ".join(f"{p.name} {w}" for p, w in zip(pictures, placed, strict=True))
    return cut, cuts, f"Compared where all have pixels, {size} at ({left}, {top}): {places}."


# ------------------------------------------------------------------- private


def _placed(picture: Picture, others: Sequence[Picture]) -> Windows:
    """Where a picture's pixels lie."""
    height, width = picture.image.shape[:2]
    if picture.windows is not None and picture.windows.size == (width, height):
        return picture.windows
    for other in others:
        if other.windows is not None and other.windows.size == (width, height):
            return other.windows
    return Windows.of_size(width, height)


def _box(windows: Windows) -> tuple[int, int, int, int]:
    """The data window, counted from the corner of the display window."""
    (x, y), (width, height) = windows.offset, windows.size
    return x, y, x + width - 1, y + height - 1


def _refused(first: Picture, one: Windows, second: Picture, other: Windows) -> LayerError:
    def shown(windows: Windows) -> str:
        width, height = windows.size
        x, y = windows.data[:2]
        whole = "x".join(str(side) for side in windows.display_size)
        part = "" if windows.data == windows.display else f" at ({x}, {y}) of {whole}"
        return f"{width}x{height}{part}"

    if one.size == other.size:
        offset = other.data[0] - one.data[0], other.data[1] - one.data[1]
        return LayerError(
            f"{second.label} is {shown(other)}, {first.label} is {shown(one)}: their pixels lie "
            f"({offset[0]}, {offset[1]}) apart",
            remedy="only the same part of a picture can be compared: render or crop both alike",
        )
    return LayerError(
        f"{second.label} is {shown(other)}, {first.label} is {shown(one)}",
        remedy="only images of one size can be compared: render or crop both alike",
    )
