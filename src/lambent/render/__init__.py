"""Frames with every feature, from Mitsuba scenes and from Blender's Cycles.

Reading order: `path` (one sample, and the books it keeps), `surface` (what is seen), `sampling`
(all samples of a picture in one kernel), `moments` (what is known of every pixel), `accumulate` (a
picture that grows and resumes), `animation` and `motion`, `scene` (files), `job` (the verb);
`integrator` is the same as a Mitsuba plug-in. `procedural` makes random scenes, `cycles` talks to
Blender.

The package is also the verb: ``lambent.render("scene.xml", spp=64)`` is a `Frame` (see
`lambent.denoise` for why the module itself can be called).
"""

from __future__ import annotations

import sys
import types
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import inspect


class _Verb(types.ModuleType):
    """A module that can be called."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        from lambent.render.job import render

        return render(*args, **options)

    @property
    def __signature__(self) -> inspect.Signature:
        """For ``help`` and notebooks."""
        import inspect

        from lambent.render.job import render_all

        return inspect.signature(render_all)


sys.modules[__name__].__class__ = _Verb
