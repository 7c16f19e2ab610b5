"""Blender's Cycles: frames of .blend files, and random scenes of its own to learn from.

Reading order: `find` (which Blender), `process` (talking to it), `blend` (a file to a frame),
`worker` (random scenes), `frames` (what Cycles wrote, as frames); `inside` holds what runs in
Blender's Python.

Example: ``render_blend("kitchen.blend", spp=32)`` is a frame for ``lambent.denoise``.
"""

from __future__ import annotations

from lambent.render.cycles.blend import render_blend, render_blend_frames
from lambent.render.cycles.find import cycles_available, find_blender
from lambent.render.cycles.worker import CyclesWorker, RandomView, render_random

__all__ = [
    "CyclesWorker",
    "RandomView",
    "cycles_available",
    "find_blender",
    "render_blend",
    "render_blend_frames",
    "render_random",
]
