"""Denoising at run time: the pipeline from file to file, tiles, sequences.

Reading order: `pipeline` (one frame), `tiles`, `files` (one file), `sequence` (many), `runtime`.

The package is also the verb: ``lambent.denoise(frame)`` calls `lambent.denoise.pipeline.denoise`.
Python binds a package to its name in the parent as soon as anything in it is imported, so a
function of the same name would be hidden by then; hence the module itself can be called.
"""

from __future__ import annotations

import sys
import types
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import inspect

    from lambent.frame.frame import Frame


class _Verb(types.ModuleType):
    """A module that can be called."""

    def __call__(self, *args: Any, **options: Any) -> Frame:
        from lambent.denoise.pipeline import denoise

        return denoise(*args, **options)

    @property
    def __signature__(self) -> inspect.Signature:
        """For ``help`` and notebooks."""
        import inspect

        from lambent.denoise.pipeline import denoise

        return inspect.signature(denoise)


sys.modules[__name__].__class__ = _Verb
