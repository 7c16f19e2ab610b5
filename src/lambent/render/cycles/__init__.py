"""Blender's Cycles: frames of .blend files, and of scenes that are built in Blender.

Reading order: `find` (which Blender), `process` (talking to it), `blend` (a file to a frame),
`frames` (what Cycles wrote, as frames); `inside` holds what runs in Blender's Python. Random scenes
are in `lambent.scenes.cycles`.

Example: ``render_blend("kitchen.blend", spp=32)`` is a frame for ``lambent.denoise``.
"""

from __future__ import annotations

from lambent.render.cycles.blend import render_blend, render_blend_frames
from lambent.render.cycles.find import cycles_available, find_blender

__all__ = [
    "cycles_available",
    "find_blender",
    "render_blend",
    "render_blend_frames",
]
