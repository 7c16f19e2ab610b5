"""The orders that the server knows: open a scene, look through a camera, render pictures of it.

One order renders many pictures of one scene, ``{"samples": …, "seed": …, "path": …}`` each; a scene
stays open until another is asked for, and Cycles keeps what it built of it (persistent data), so
that a small picture costs little more than its samples.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
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
        if order["do"] == "random":
            return self._random(order)
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

    def _random(self, order: dict[str, Any]) -> dict[str, Any]:
        from .scenes import build

        key = ("random", order["scene"])
        if self._open != key:
            self._open = None
            start = time.perf_counter()
            self._facts = build(**order["scene"])
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
