"""What OpenVINO has compiled for this machine, kept on disk, and never believed without a checksum.

OpenVINO has a cache of its own, but takes from it whatever lies there: a blob with one damaged
byte gave another picture without an error. Here a file is the SHA-256 of a blob and the blob; what
does not fit is compiled anew and replaced.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from lambent.errors import OutputError
from lambent.frame.atomic import atomic
from lambent.startup import cache_folder

_DIGEST = hashlib.sha256().digest_size


def compiled(core: Any, graph: Any, options: Mapping[str, Any], identity: str, version: str) -> Any:
    """The graph compiled for the processor, from the cache if it is there and sound.

    ``identity``: a text that differs wherever the graph differs; ``version``: OpenVINO's. Raises
    `RuntimeError` where OpenVINO does not take the graph.
    """
    path = _place(core, options, identity, version)
    with suppress(OSError, RuntimeError):  # not there, or of an OpenVINO that reads it no longer
        content = path.read_bytes()
        digest, blob = content[:_DIGEST], content[_DIGEST:]
        if hashlib.sha256(blob).digest() == digest:
            return core.import_model(io.BytesIO(blob), "CPU", dict(options))
    made = core.compile_model(graph, "CPU", dict(options))
    with suppress(OSError, OutputError):  # a home that cannot be written: compile each time
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = io.BytesIO()
        made.export_model(stream)
        blob = stream.getvalue()
        with atomic(path, overwrite=True) as file:
            file.write(hashlib.sha256(blob).digest() + blob)
    return made


def _place(core: Any, options: Mapping[str, Any], identity: str, version: str) -> Path:
    """A file for this graph, these options, this OpenVINO and this processor."""
    processor = [
        str(core.get_property("CPU", name))
        for name in ("FULL_DEVICE_NAME", "OPTIMIZATION_CAPABILITIES")
    ]
    text = json.dumps([identity, version, processor, sorted(options.items())])
    return cache_folder() / "compiled" / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.bin"
