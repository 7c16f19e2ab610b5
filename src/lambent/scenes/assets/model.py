"""A model: meshes with surfaces, standing upright (z up), from whatever file it came in.

Formats: glTF (`gltf`); a folder with ``model.json``, which names PLY meshes, their materials, what
is up and whether units are metres; and single PLY and OBJ files, read by Mitsuba, without material.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError
from lambent.scenes.assets.gltf import read_gltf
from lambent.scenes.assets.surface import Surface, glass, pbr, swatches
from lambent.scenes.mitsuba.geometry import Array, Geometry, merge, rotate, smooth_normals, unit

MODEL = "model.json"


@dataclass(frozen=True, eq=False)
class Model:
    """Parts of a thing. ``metric``: its units are metres; else its size means nothing.

    ``plain`` says that it has no surface of its own.
    """

    name: str
    parts: tuple[tuple[Geometry, Surface], ...]
    metric: bool = False
    plain: bool = False

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The least and the greatest corner."""
        corners = [g.bounds for g, _ in self.parts]
        return np.min([low for low, _ in corners], 0), np.max([high for _, high in corners], 0)

    @property
    def size(self) -> float:
        """The longest side of the bounding box."""
        low, high = self.bounds
        return float((high - low).max())


def load_model(path: Path, mi: Any) -> Model:
    """The model of a file. Raises `DamagedFileError`, `FileError`.

    Constant surfaces are joined to one (`swatches`), so that a model needs few materials.
    """
    name = path.parent.name if path.name == MODEL else path.stem
    metric = plain = False
    turn = rotate("x", np.pi / 2)  # y up to z up
    if path.name == MODEL:
        about = _json(path)
        parts = [_part(path.parent, entry, mi) for entry in about["parts"]]
        metric = bool(about.get("metric"))
        turn = turn if about.get("up", "y") == "y" else np.eye(4)
    elif path.suffix.lower() in (".glb", ".gltf"):
        parts, metric = read_gltf(path), True
    else:
        plain = True
        parts = [(read_mesh(path, mi), pbr(name, (0.5, 0.5, 0.5)))]
        turn = turn if path.suffix.lower() == ".obj" else np.eye(4)
    parts = [(geometry.moved(turn), surface) for geometry, surface in _joined(parts)]
    model = Model(name, tuple(parts), metric, plain)
    if not np.isfinite(model.size) or model.size <= 0:
        raise DamagedFileError("the model has no size", file=path)
    return model


def read_mesh(path: Path, mi: Any) -> Geometry:
    """A PLY or OBJ mesh by Mitsuba's own plug-in. Raises `DamagedFileError`."""
    try:
        description = {"type": path.suffix.lower()[1:], "filename": str(path)}
        mesh = mi.load_dict(description, parallel=False)  # one thread may be all there are
    except RuntimeError as error:
        raise DamagedFileError(f"the mesh cannot be read: {error}", file=path) from error
    params = mi.traverse(mesh)
    positions = np.array(params["vertex_positions"], np.float64).reshape(-1, 3)
    faces = np.array(params["faces"], np.int64).reshape(-1, 3)
    normals = np.array(params["vertex_normals"], np.float64).reshape(-1, 3)
    uv = np.array(params["vertex_texcoords"], np.float64).reshape(-1, 2)
    if not len(faces) or not np.isfinite(positions).all():
        raise DamagedFileError("the mesh has no sound triangles", file=path)
    normals = unit(normals) if len(normals) else smooth_normals(positions, faces)
    return Geometry(positions, normals, uv if len(uv) else np.zeros((len(positions), 2)), faces)


def read_picture(path: Path, channels: int) -> NDArray[np.uint8]:
    """A picture ``(H, W, channels)``, at most 1024 pixels wide and high."""
    from PIL import Image

    try:
        picture = Image.open(path).convert("L" if channels == 1 else "RGB")
    except OSError as error:
        raise DamagedFileError(f"the picture cannot be read: {error}", file=path) from error
    picture.thumbnail((1024, 1024))
    return np.array(picture).reshape(picture.height, picture.width, channels)


def boxed(geometry: Geometry) -> Geometry:
    """The mesh with texture coordinates in metres, from the side that each vertex looks to most."""
    p = geometry.positions
    side = np.abs(geometry.normals).argmax(1)[:, None]
    uv = np.where(side == 0, p[:, [1, 2]], np.where(side == 1, p[:, [0, 2]], p[:, :2]))
    return Geometry(p, geometry.normals, uv, geometry.faces)


# ------------------------------------------------------------------- private


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_bytes())
        if not found["parts"]:
            raise ValueError("it has no parts")
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedFileError(
            f"the model's description cannot be read: {error}", file=path
        ) from error
    return dict(found)


def _part(folder: Path, entry: dict[str, Any], mi: Any) -> tuple[Geometry, Surface]:
    material = entry.get("material", {})
    name = str(material.get("name", "surface"))
    geometry = read_mesh(folder / entry["mesh"], mi)

    def value(key: str, default: Any, channels: int) -> Any:
        found = material.get(key, default)
        return read_picture(folder / found, channels) if isinstance(found, str) else found

    rough = value("roughness", 0.5, 1)
    kind = material.get("type", "principled")
    if kind.endswith("dielectric"):
        tint = material.get("specular_transmittance", (1, 1, 1))
        alpha = float(material.get("alpha", 0.0 if kind == "dielectric" else 0.1))
        return geometry, glass(name, tint, alpha**0.5, thin=kind == "thindielectric")
    surface = pbr(
        name,
        value("base_color", (0.5, 0.5, 0.5), 3),
        rough,
        value("metallic", 0.0, 1),
        normals=value("normal_map", None, 3),
        opacity=value("opacity", None, 1),
        clearcoat=float(material.get("clearcoat", 0.0)),
    )
    return geometry, surface


def _joined(parts: list[tuple[Geometry, Surface]]) -> list[tuple[Geometry, Surface]]:
    """One part a surface, and one for all that are constant."""
    by_surface: dict[int, list[Geometry]] = {}
    surfaces = {id(s): s for _, s in parts}
    for geometry, surface in parts:
        by_surface.setdefault(id(surface), []).append(geometry)
    constant = [s for s in surfaces.values() if s.constant]
    result = [(merge(by_surface[k]), s) for k, s in surfaces.items() if not s.constant]
    if constant:
        joined, places = swatches(constant)
        meshes = [
            Geometry(g.positions, g.normals, np.tile(place, (len(g.positions), 1)), g.faces)
            for s, place in zip(constant, places, strict=True)
            for g in by_surface[id(s)]
        ]
        result.append((merge(meshes), joined))
    return result
