"""Training data: crops and clips with several noise levels, every feature, and a clean target.

``lambent.dataset.open(folder)`` reads a set, `make` makes one from a `Recipe`.

Reading order: `recipe`, `plan` (what an item is, by its number), `source` (what a renderer must
offer), `windows` (where to crop), `produce` (a scene's items), `pack` (an item as one EXR),
`folder` (files, list and lock), `check`, `make` with `workers` and `cluster`, `reader`, `preview`,
`summary`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_PUBLIC = {
    "open": "lambent.dataset.reader:open_dataset",
    "Dataset": "lambent.dataset.reader:Dataset",
    "Item": "lambent.dataset.item:Item",
    "Still": "lambent.dataset.item:Still",
    "Recipe": "lambent.dataset.recipe:Recipe",
    "load_recipe": "lambent.dataset.recipe:load_recipe",
    "verify": "lambent.dataset.check:verify",
    "SOURCES": "lambent.dataset.source:SOURCES",
}
# Not here: `make`, whose module has its name. Write ``from lambent.dataset.make import make``.

__all__ = ["SOURCES", "Dataset", "Item", "Recipe", "Still", "load_recipe", "open", "verify"]

if TYPE_CHECKING:
    from lambent.dataset.check import verify
    from lambent.dataset.item import Item, Still
    from lambent.dataset.reader import Dataset
    from lambent.dataset.reader import open_dataset as open
    from lambent.dataset.recipe import Recipe, load_recipe
    from lambent.dataset.source import SOURCES


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'lambent.dataset' has no attribute {name!r}")
    module, _, attribute = _PUBLIC[name].partition(":")
    value = getattr(importlib.import_module(module), attribute)
    globals()[name] = value
    return value
