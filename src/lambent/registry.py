"""The one mechanism by which things have names: models, dialects, metrics, losses, encodings.

An entry is a string ``"package.module:attribute"`` that is imported when it is first asked for, so
that listing names costs nothing. Other people's packages join through an entry-point group of the
same form (see ``docs/guides/plugins.md``).
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

from lambent.errors import LambentError, UnknownNameError, stop_by_interrupt


class Registry(Mapping[str, Any]):
    """Names to objects, imported lazily.

    Parameters: ``kind`` is the word used in messages ("model"), ``entries`` maps a name to
    ``"module:attribute"``, ``group`` names the entry-point group that plug-ins use, or None.
    """

    def __init__(self, kind: str, entries: Mapping[str, str], group: str | None = None) -> None:
        self.kind = kind
        self.group = group
        self._own = dict(entries)
        self._loaded: dict[str, Any] = {}

    @cached_property
    def _plugins(self) -> dict[str, str]:
        if self.group is None:
            return {}
        from importlib.metadata import entry_points  # slow to import; only when needed

        return {e.name: e.value for e in entry_points(group=self.group)}

    def register(self, name: str, thing: Any) -> Any:
        """Add an object under a name for this process (in a notebook, in a test)."""
        self._own[name] = ""
        self._loaded[name] = thing
        return thing

    def where(self, name: str) -> str:
        """The ``module:attribute`` an entry comes from."""
        return self._own.get(name) or self._plugins.get(name, "")

    def __getitem__(self, name: str) -> Any:
        if name in self._loaded:
            return self._loaded[name]
        target = self._own.get(name) or self._plugins.get(name)
        if target is None:
            raise UnknownNameError(self.kind, name, self)
        module, _, attribute = target.partition(":")
        try:
            thing = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            stop_by_interrupt(error)
            if name in self._own:
                raise
            raise LambentError(
                f"the plug-in for {self.kind} '{name}' ({target}) cannot be loaded: {error}",
                remedy="update or uninstall the package that brings it",
            ) from error
        self._loaded[name] = thing
        return thing

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._plugins

    def __iter__(self) -> Iterator[str]:
        yield from self._own
        yield from (n for n in self._plugins if n not in self._own)

    def __repr__(self) -> str:
        return f"<Registry of {self.kind}s: {', '.join(self)}>"

    def __len__(self) -> int:
        return sum(1 for _ in self)
