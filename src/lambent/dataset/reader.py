"""Reading a data set: items by number, decoded when they are looked at."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from lambent.dataset.folder import ItemKey, Line, file_of, read_lines, read_manifest, recipe_of
from lambent.dataset.item import Item
from lambent.dataset.pack import REMAKE, unpacked
from lambent.dataset.plan import CLIP, STILL
from lambent.dataset.recipe import Recipe
from lambent.errors import FileError, OptionError


class Dataset(Sequence[Item]):
    """The crops of a set, then its clips, each in the order of their numbers.

    ``len(dataset)``, ``dataset[i]``; ``dataset.line(i)`` is what the list says of an item without
    opening its file; ``dataset.crops`` and ``dataset.clips`` are the places of either kind.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest: dict[str, Any] = read_manifest(folder)
        self.recipe: Recipe = recipe_of(folder)
        self._lines: list[Line] = [
            line for _, line in sorted(read_lines(folder).items(), key=_order)
        ]

    def __len__(self) -> int:
        return len(self._lines)

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return [self.item(k) for k in range(*i.indices(len(self)))]
        return self.item(i)

    def __iter__(self) -> Iterator[Item]:
        return (self.item(i) for i in range(len(self)))

    def line(self, i: int) -> Line:
        """What the list of items says of item ``i``. Raises `IndexError`."""
        return self._lines[i]

    def item(self, i: int) -> Item:
        """Item ``i``. Raises `IndexError`; `FileError` and `DamagedFileError` with a remedy."""
        path = self.folder / self._lines[i]["file"]
        if not path.exists():
            raise FileError("an item of the data set is missing", file=path, remedy=REMAKE)
        return unpacked(path)

    @property
    def crops(self) -> range:
        """The places of the crops."""
        return range(sum(line["what"] == STILL for line in self._lines))

    @property
    def clips(self) -> range:
        """The places of the clips."""
        return range(len(self.crops), len(self))

    def find(self, what: str, index: int) -> Item:
        """The crop or clip of a number. Raises `OptionError` if there is none."""
        for i, line in enumerate(self._lines):
            if (line["what"], line["index"]) == (what, index):
                return self.item(i)
        raise OptionError(f"the set has no {what} {index} ({file_of(what, index)})", remedy=REMAKE)

    def __repr__(self) -> str:
        return f"<Dataset {self.recipe.name}: {len(self.crops)} crops, {len(self.clips)} clips>"


def open_dataset(folder: str | os.PathLike[str]) -> Dataset:
    """The data set in a folder. Raises `FileError` if there is none."""
    return Dataset(Path(folder))


def _order(entry: tuple[ItemKey, Line]) -> tuple[bool, int]:
    (what, index), _ = entry
    return what == CLIP, index
