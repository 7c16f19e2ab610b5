"""Where the chunks of an EXR lie, found without the offset table.

Some programs leave the table empty, or it is damaged, while the chunks behind it are complete.
Each chunk begins with a leader (part number in files of several parts, its place, its size), so
that one leads to the next.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray


def walk(
    read: Callable[[int, int], bytes],
    first: int,
    size: int,
    places: Sequence[NDArray[np.int32]],
    multipart: bool,
) -> list[NDArray[np.uint64]]:
    """The offset of every chunk, in table order, a table a part; 0 where none is met.

    ``read``: bytes of the file by place and count. ``first``: where the chunks begin; ``size``: the
    length of the file. ``places``: what the leaders of each part's chunks must say, ``(n, k)``.
    The walk ends at the first leader that no chunk of the file can have, or that was met before.
    """
    tables = [np.zeros(len(place), np.uint64) for place in places]
    numbers = [{one.tobytes(): n for n, one in enumerate(place.astype("<i4"))} for place in places]
    at, prefix, left = first, 4 if multipart else 0, sum(map(len, places))
    while left and at + prefix <= size:
        part = struct.unpack("<i", read(at, 4))[0] if multipart else 0
        if not 0 <= part < len(places):
            break
        place = 4 * places[part].shape[1]
        lead = prefix + place + 4
        if at + lead > size:
            break
        leader = read(at, lead)
        number = numbers[part].get(leader[prefix : prefix + place])
        (packed,) = struct.unpack("<i", leader[-4:])
        if number is None or tables[part][number] or packed < 0 or at + lead + packed > size:
            break
        tables[part][number] = at
        at += lead + packed
        left -= 1
    return tables
