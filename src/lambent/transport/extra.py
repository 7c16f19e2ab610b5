"""The packages that solving light needs beside the base product: those of the extra `transport`."""

from __future__ import annotations

import importlib.util

from lambent.errors import EngineError


def check_extra() -> None:
    """Raises `EngineError` where a package is missing, before a module fails to import it."""
    for name, module in (("Mitsuba", "mitsuba"), ("SciPy", "scipy")):
        if importlib.util.find_spec(module) is None:
            raise EngineError(
                f"solving light needs {name}, which is not installed",
                remedy="pip install 'lambent[transport]'",
            )
