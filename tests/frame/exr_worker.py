"""A process that reads EXR files which may be anything, so that a crash of C code is seen.

Takes lines of JSON ``{"path": …}`` and answers each with ``ok``, ``refused: …`` or ``bug: …``.
"""

import json
import os
import sys
import traceback

from lambent.errors import LambentError
from lambent.frame.exr import decode, encode
from lambent.frame.files import read_views

STDOUT = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what C code prints must not get in between


def answer(path: str) -> str:
    try:
        exr = decode(path)
        replaced = {}
        for part in exr.parts:
            for channel in part.channels.values():
                replaced.setdefault((part.index, channel.name), channel.data)
        encode(path + ".out", exr, dict(list(replaced.items())[:1]), overwrite=True)
        for frame in read_views(path).values():
            for layer in frame.all_layers():
                _ = layer.data
    except LambentError as error:
        # One line, whatever the file's names hold.
        return " ".join(f"refused: {type(error).__name__} {error}".splitlines())
    except BaseException:
        return "bug: " + json.dumps(traceback.format_exc())
    return "ok"


if __name__ == "__main__":
    for line in sys.stdin:
        STDOUT.write(answer(json.loads(line)["path"]) + "\n")
