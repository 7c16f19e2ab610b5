"""Opening a .blend file, and saying what is wrong with one that cannot be rendered."""

from __future__ import annotations

import os
from typing import Any

import bpy

from .settings import Refused


def open_blend(path: str) -> dict[str, Any]:
    """Open a file without its scripts; facts about it. Raises `Refused`.

    The file's own scripts are never run: a render of a file from a stranger must be no risk.
    """
    try:
        bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise Refused("blend", str(error).strip()) from error
    written = tuple(bpy.data.version)
    if written[:2] > bpy.app.version[:2]:
        raise Refused(
            "newer",
            f"was saved by Blender {written[0]}.{written[1]}, newer than this one "
            f"({bpy.app.version[0]}.{bpy.app.version[1]})",
        )
    scene = bpy.context.scene
    cameras = sorted(o.name for o in scene.objects if o.type == "CAMERA")
    if not cameras:
        raise Refused("no camera", f"the scene '{scene.name}' has no camera")
    notes = []
    lost = missing_files()
    if lost:
        shown = ", ".join(f"'{name}'" for name in lost[:5])
        more = f" and {len(lost) - 5} more" if len(lost) > 5 else ""
        notes.append(
            f"Files that the scene names are missing (Blender draws magenta): {shown}{more}."
        )
    if scene.render.engine != "CYCLES":
        notes.append(f"The file is made for {scene.render.engine}; it is rendered with Cycles.")
    return {"cameras": cameras, "scene": scene.name, "version": list(written), "notes": notes}


def missing_files() -> list[str]:
    """Images and libraries that the file names and that are not there."""
    found = []
    for image in bpy.data.images:
        if image.source in ("FILE", "SEQUENCE", "MOVIE") and not image.packed_file:
            name = bpy.path.abspath(image.filepath, library=image.library)
            if (
                image.source == "FILE"
                and "<UDIM>" not in name
                and name
                and not os.path.exists(name)
            ):
                found.append(image.filepath)
    for library in bpy.data.libraries:
        if not os.path.exists(bpy.path.abspath(library.filepath)):
            found.append(library.filepath)
    return sorted(set(found))
