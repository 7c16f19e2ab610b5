"""The orders that the server knows: open a file or build a scene, and render pictures of it.

One order renders many pictures of one scene, ``{"samples": …, "seed": …, "path": …}`` each; a scene
stays open until another is asked for, and Cycles keeps what it built of it (persistent data), so
that a small picture costs little more than its samples.

The builder of a scene is not part of this folder: the order names a package that stands elsewhere.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy

from .settings import Refused, apply_settings, camera_facts, choose_device
from .source import open_blend

__all__ = ["Refused", "Studio"]

_SAMPLE = re.compile(r"Sample (\d+)/(\d+)")


class Studio:
    """The scene that is open, and how it is rendered. ``send`` is the channel's."""

    def __init__(self, send: Callable[..., None]) -> None:
        self._send = send
        self._open: Any = None
        self._facts: dict[str, Any] = {}
        self._device: tuple[str, str] | None = None
        self._before = 0
        self._now = 0
        self._total = 1

    def obey(self, order: dict[str, Any]) -> dict[str, Any]:
        """Do what is asked for; the facts to answer with. Raises `Refused`."""
        if order["do"] == "build":
            return self._build(order)
        if order["do"] == "blend":
            return self._blend(order)
        raise Refused("order", f"there is no order '{order['do']}'")

    # ---------------------------------------------------------------- orders

    def _blend(self, order: dict[str, Any]) -> dict[str, Any]:
        key = ("blend", order["blend"])
        if self._open != key:
            self._open = None
            self._facts = open_blend(order["blend"])
            self._open, self._device = key, None
        return self._render(order)

    def _build(self, order: dict[str, Any]) -> dict[str, Any]:
        """``builder``: the folder of a package whose ``build(**scene)`` builds a scene in Blender.

        It returns facts, among them a list of ``cameras`` and their ``windows``.
        """
        key = (order["builder"], order["scene"])
        if self._open != key:
            self._open = None
            start = time.perf_counter()
            self._facts = _package(order["builder"]).build(**order["scene"])
            self._facts["built_in"] = time.perf_counter() - start
            self._open, self._device = key, None
        n = order["view"]
        view = {"camera": self._facts["cameras"][n], "window": self._facts["windows"][n]}
        return self._render({**order, **view})

    def _render(self, order: dict[str, Any]) -> dict[str, Any]:
        scene = bpy.context.scene
        wish = order.get("device", "cpu")
        if self._device is None or self._device[0] != wish:
            self._device = (wish, choose_device(scene, wish))
        facts = {**self._facts, "device": self._device[1], **apply_settings(scene, order)}
        facts["notes"] = [*self._facts.get("notes", ()), *facts["notes"]]
        if self._watch not in bpy.app.handlers.render_stats:  # opening a scene drops it
            bpy.app.handlers.render_stats.append(self._watch)
        pictures = order["pictures"]
        self._before, self._now = 0, 0
        self._total = sum(picture["samples"] for picture in pictures)
        seconds: list[float] = []
        reached: list[int] = []
        for picture in pictures:
            if "frame" in picture and scene.frame_current != picture["frame"]:
                scene.frame_set(picture["frame"])
            scene.cycles.samples = picture["samples"]
            scene.cycles.seed = picture["seed"]
            scene.render.filepath = picture["path"]
            start = time.perf_counter()
            bpy.ops.render.render(write_still=True)
            seconds.append(time.perf_counter() - start)
            # With a time limit Cycles may stop early; its status line tells how far it came.
            reached.append(self._now if order.get("time") and self._now else picture["samples"])
            self._before, self._now = self._before + picture["samples"], 0
        return {
            **facts,
            **camera_facts(scene),
            "frame": scene.frame_current,
            "samples": reached,
            "seconds": seconds,
        }

    # -------------------------------------------------------------- progress

    def _watch(self, text: str, *_: Any) -> None:
        """Called by Blender with its status line."""
        match = _SAMPLE.search(text)
        if match and int(match.group(1)) > self._now:  # it ends with a 0 again
            self._now = int(match.group(1))
            self._send("progress", done=self._before + self._now, total=self._total, text=text)


def _package(folder: str) -> Any:
    """The package in a folder, imported once; its own modules import each other relatively."""
    name = "scenes_" + "".join(c if c.isalnum() else "_" for c in folder)
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(
            name, Path(folder) / "__init__.py", submodule_search_locations=[folder]
        )
        assert spec is not None
        assert spec.loader is not None
        package = sys.modules[name] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(package)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
