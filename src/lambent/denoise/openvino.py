"""The one place where OpenVINO is imported: without its telemetry.

OpenVINO's Python package reports every import to an analytics service, through the package
``openvino-telemetry``: from a process of its own, with an id that it writes to the home folder. No
setting turns that off beforehand. But where that package is not installed OpenVINO works as well,
with a stand-in that sends nothing; `silent` makes it seem so while something of OpenVINO's is
imported. NNCF does the same.
"""

from __future__ import annotations

import importlib
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_TELEMETRY = "openvino_telemetry"
_lock = threading.RLock()


def openvino() -> Any:
    """The module ``openvino``. Raises `ImportError`."""
    with silent():
        return importlib.import_module("openvino")


@contextmanager
def silent() -> Iterator[None]:
    """While this lasts, nothing can import OpenVINO's telemetry."""
    with _lock:
        before = {_TELEMETRY: sys.modules[_TELEMETRY]} if _TELEMETRY in sys.modules else {}
        sys.modules[_TELEMETRY] = None  # type: ignore[assignment]
        try:
            yield
        finally:
            del sys.modules[_TELEMETRY]
            sys.modules.update(before)
