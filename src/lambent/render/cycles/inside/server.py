"""The script that runs in Blender's Python and renders what it is told, until its input ends.

Started as ``python -I server.py SCRATCH`` or ``blender -b --factory-startup --python server.py --
SCRATCH``. Orders come as JSON lines on stdin, answers go as JSON lines to stdout, each with a key
``lambent``: ``ready``, ``progress``, ``done`` or ``error``. Blender's own chatter on stdout is sent
to stderr: the descriptor of stdout is set aside before anything else can print on it.

The input ends when the process on the other side does, even by ``kill -9``; a thread watches for
that, so that no orphan goes on rendering, and removes the scratch folder.
"""

from __future__ import annotations

import json
import os
import queue
import shutil
import sys
import threading
import traceback
from pathlib import Path
from typing import Any, TextIO


class Channel:
    """Orders in, answers out."""

    def __init__(self, scratch: str) -> None:
        self.scratch = scratch
        self._out: TextIO = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)
        self._orders: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, name="orders", daemon=True).start()

    def send(self, answer: str, /, **facts: Any) -> None:
        """One answer."""
        self._out.write(json.dumps({"lambent": answer, **facts}) + "\n")
        self._out.flush()

    def next(self) -> dict[str, Any]:
        """The next order; waits for it."""
        order: dict[str, Any] = json.loads(self._orders.get())
        return order

    def _read(self) -> None:
        for line in sys.stdin:
            if line.strip():
                self._orders.put(line)
        shutil.rmtree(self.scratch, ignore_errors=True)
        os._exit(0)


def main() -> None:
    """Answer orders until the input ends."""
    scratch = sys.argv[-1]
    channel = Channel(scratch)
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    try:
        import bpy
        from inside.orders import Refused, Studio  # type: ignore[import-not-found]
    except Exception as error:
        channel.send("error", kind="engine", message=f"{type(error).__name__}: {error}")
        return
    studio = Studio(channel.send)
    channel.send("ready", version=list(bpy.app.version), text=bpy.app.version_string)
    while True:
        order = channel.next()
        try:
            facts = studio.obey(order)
        except Refused as refused:
            channel.send("error", kind=refused.kind, message=refused.message, **refused.facts)
        except Exception as error:
            traceback.print_exc()
            message = f"{type(error).__name__}: {error}"
            channel.send("error", kind="crash", message=message)
        else:
            channel.send("done", **facts)


if __name__ == "__main__":
    main()
