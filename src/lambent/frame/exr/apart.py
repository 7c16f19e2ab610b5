"""Decoding in a process of its own: for what prints, and to learn why pixels cannot be decoded.

OpenEXR's C code writes its remarks to the standard output and error of the process, which belong
to whoever uses Lambent: a result in JSON must stay JSON. Two things are therefore done in another
process, whose output can be collected without touching our own:

- pixels packed with JPEG 2000, whose library (OpenJPH) prints to standard output;
- pixels that could not be decoded here, once more, for the reason.

`decode_apart` starts the process, `serve` is what it does.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys

import numpy as np

from lambent.frame.exr.module import (
    memory_file,
    name_of,
    no_memory,
    out_of_memory,
    parts_of,
    plain,
)

_START = (
    "import sys; sys.path[:] = sys.argv[1:]; from lambent.frame.exr.apart import serve; serve()"
)
#: Remarks that reach a message: the first say what the matter is.
_MOST = 2


def decode_apart(content: bytes, file: object) -> tuple[bytes | None, str]:
    """Decode a single-part EXR: the channels' bytes one after the other, or None and the reason.

    Raises `FileError`, which names ``file``, where memory runs out.
    """
    if not sys.executable or getattr(sys, "frozen", False):
        return None, ""  # there is no Python to start
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-c", _START, *sys.path],
            input=content,
            capture_output=True,
            check=False,
        )
    except OSError as error:
        return None, f"no process could be started to decode it: {error.strerror}"
    if done.returncode == 0:
        return done.stdout, ""
    lines = [plain(line) for line in done.stderr.decode("utf-8", "replace").splitlines()]
    if lines and out_of_memory(lines[-1]):
        raise no_memory(file)
    said = [line for line in lines if "EXR_ERR" in line or line.startswith("ojph error")]
    if done.returncode < 0:
        said.append(f"the decoder died of signal {-done.returncode}")
    return None, "; ".join(list(dict.fromkeys(said or lines[-1:]))[:_MOST])


def serve() -> None:
    """Decode the EXR on standard input to standard output; what C code prints goes to error."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    content = sys.stdin.buffer.read()
    descriptor = memory_file()
    if descriptor is None:
        parts, reason = parts_of(io.BytesIO(content), 0, "")
    else:
        with os.fdopen(descriptor, "wb") as kept:
            kept.write(content)
            kept.flush()
            parts, reason = parts_of(name_of(descriptor), os.cpu_count() or 1, "")
    if not parts:
        sys.exit(reason or "OpenEXR gave no reason")
    with out:
        for channel in parts[0].channels.values():
            out.write(np.ascontiguousarray(channel.pixels).data)
