"""What a folder of assets holds, found by file ending: models, textures, maps, whole scenes.

- models: ``.glb``, ``.gltf``, ``.ply``, ``.obj``, and folders with ``model.json`` (`model`)
- textures: folders with a picture ``albedo``, ``base_color``, ``basecolor``, ``color`` or
  ``diffuse``; beside it ``roughness``, ``metallic`` and ``normal`` (y up) where there are any
- environment maps: ``.hdr`` and ``.exr`` twice as wide as high
- whole scenes: Mitsuba's ``.xml``; what lies below such a file's folder belongs to the scene

Nothing is rendered for it. Files that are damaged, and scenes that no training may see, are left
out, and `Library.notes` says so.
"""

from __future__ import annotations

import hashlib
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lambent.errors import FileError, LambentError
from lambent.scenes.assets.gltf import open_gltf
from lambent.scenes.assets.model import MODEL

_ALBEDO = ("albedo", "base_color", "basecolor", "color", "diffuse")
_PICTURES = (".jpg", ".jpeg", ".png")
_MESHES = (".ply", ".obj")
#: A line of a SOURCES.md: "- `models/cup` — Cup, Somebody, CC0-1.0, …".
_SOURCE = re.compile(r"^[-*]\s*`([^`]+)`\s*(?:—|–|-|:)\s*(.+)$")

#: Raises `OptionError` for a file that no training set may hold.
Refuse = Callable[[Path], None]


@dataclass(frozen=True)
class Library:
    """The files of a folder, in the order of their names.

    ``textures`` are the pictures of base colour. ``licences``: a line for each, from the folder's
    SOURCES.md, or "unknown: FILE"; ``digest`` tells the folder from others by names and sizes.
    """

    folder: Path
    models: tuple[Path, ...]
    textures: tuple[Path, ...]
    environments: tuple[Path, ...]
    scenes: tuple[Path, ...]
    notes: tuple[str, ...]
    licences: tuple[str, ...]
    digest: str


def open_library(folder: Path, refuse: Refuse) -> Library:
    """What a folder holds. Raises `FileError` if it is not there or holds no model and no scene."""
    if not folder.is_dir():
        raise FileError(
            "there is no such folder of assets",
            file=folder,
            remedy="give --assets DIR, assets = in the recipe, or set LAMBENT_ASSETS",
        )
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    scenes = [p for p in files if p.suffix.lower() == ".xml" and _is_scene(p)]
    inside = {p.parent for p in scenes if p.parent != folder}
    described = {p.parent for p in files if p.name == MODEL}
    free = [p for p in files if not inside.intersection(p.parents)]
    loose = [p for p in free if not described.intersection(p.parents)]
    sorts = {
        "models": [
            *(p for p in free if p.name == MODEL),
            *(p for p in loose if p.suffix.lower() in (".glb", ".gltf", *_MESHES)),
        ],
        "textures": [p for p in loose if _is_albedo(p)],
        "environments": [p for p in loose if p.suffix.lower() in (".hdr", ".exr")],
        "scenes": scenes,
    }
    notes: list[str] = []
    sound: dict[str, tuple[Path, ...]] = {}
    for sort, paths in sorts.items():
        kept = []
        for path in sorted(paths):
            try:
                _check(path, folder, refuse)
            except LambentError as error:
                notes.append(f"left out: {path.relative_to(folder).as_posix()}: {error.message}")
                continue
            kept.append(path)
        sound[sort] = tuple(kept)
    if not sound["models"] and not sound["scenes"]:
        raise FileError(
            "the folder of assets holds no model and no scene" + "".join(f"; {n}" for n in notes),
            file=folder,
            remedy="models are .glb, .gltf, .ply and .obj, scenes are Mitsuba's .xml",
        )
    used = [p for kept in sound.values() for p in kept]
    listed = "\n".join(f"{p.relative_to(folder).as_posix()} {p.stat().st_size}" for p in used)
    digest = hashlib.sha256(listed.encode()).hexdigest()[:16]
    return Library(
        folder, notes=tuple(notes), licences=_licences(folder, used), digest=digest, **sound
    )


def beside(albedo: Path, what: str) -> Path | None:
    """The picture of another property of a texture, if there is one."""
    for ending in _PICTURES:
        for path in (
            albedo.with_name(what + ending),
            albedo.with_name(re.sub("|".join(_ALBEDO), what, albedo.stem.lower()) + ending),
        ):
            if path.is_file() and path != albedo:
                return path
    return None


# ------------------------------------------------------------------- private


def _is_scene(path: Path) -> bool:
    with path.open("rb") as file:
        return b"<scene" in file.read(2000)


def _is_albedo(path: Path) -> bool:
    stem = path.stem.lower()
    return path.suffix.lower() in _PICTURES and stem.endswith(_ALBEDO)


def _check(path: Path, folder: Path, refuse: Refuse) -> None:
    """Raise a `LambentError` for what cannot or may not be used."""
    refuse(path)
    ending = path.suffix.lower()
    if path.name == MODEL:
        for mesh in sorted(path.parent.glob("*.ply")):
            refuse(mesh)
    elif ending in (".glb", ".gltf"):
        open_gltf(path)
    elif ending == ".ply" and path.open("rb").read(4) not in (b"ply\n", b"ply\r"):
        raise FileError("it is no PLY file", file=path)
    elif ending in (".hdr", ".exr"):
        width, height = _size_of_map(path)
        if width != 2 * height:
            raise FileError(f"{width}x{height} is no environment map, 2:1", file=path)


def _size_of_map(path: Path) -> tuple[int, int]:
    if path.suffix.lower() == ".hdr":
        found = re.search(rb"\n[-+]Y (\d+) [-+]X (\d+)\n", path.open("rb").read(4096))
        if found is None:
            raise FileError("its header cannot be read", file=path)
        return int(found[2]), int(found[1])
    head = path.open("rb").read(65536)
    at = head.find(b"dataWindow\0box2i\0")
    if head[:4] != b"v/1\x01" or at < 0:
        raise FileError("its header cannot be read", file=path)
    left, top, right, bottom = struct.unpack_from("<4i", head, at + 21)
    return right - left + 1, bottom - top + 1


def _licences(folder: Path, used: list[Path]) -> tuple[str, ...]:
    told: dict[str, str] = {}
    sources = folder / "SOURCES.md"
    if sources.is_file():
        for line in sources.read_text(encoding="utf-8", errors="replace").splitlines():
            match = _SOURCE.match(line)
            if match:
                told[match[1].rstrip("/")] = match[2].strip()
    found = []
    for path in used:
        relative = path.relative_to(folder)
        names = [relative.as_posix(), *(p.as_posix() for p in relative.parents)]
        names.append(relative.with_suffix("").as_posix())
        licence = next((f"{n}: {told[n]}" for n in names if n in told), None)
        found.append(licence or f"unknown: {folder.name}/{relative.as_posix()}")
    return tuple(dict.fromkeys(found))
