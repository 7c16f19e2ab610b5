"""Random Cycles scenes to learn from, built and rendered in a Blender.

`worker` keeps a Blender alive over many scenes and makes frames of what it renders; `inside` is the
package that builds the scenes, in Blender's Python (`lambent.render.cycles` sends it there).

Example: ``render_random(7)[0].target`` is a frame with many samples.
"""

from __future__ import annotations

from lambent.scenes.cycles.worker import CyclesWorker, RandomView, render_random

__all__ = ["CyclesWorker", "RandomView", "render_random"]
