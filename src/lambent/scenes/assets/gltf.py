"""glTF 2.0 (.glb, .gltf) as meshes with surfaces: what a still picture needs, and no more.

Khronos Group, "glTF 2.0 Specification", 2021 (ISO/IEC 12113). Read are triangles with normals and
the first texture coordinates, the transforms of nodes, and metallic-roughness materials with their
textures, alpha, and transmission (KHR_materials_transmission). Skins, animations and morph targets
are left out: a model stands as its nodes have it. Compressed meshes are refused.
"""

from __future__ import annotations

import base64
import io
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from lambent.errors import DamagedFileError, FileError
from lambent.scenes.assets.surface import Surface, glass, pbr
from lambent.scenes.mitsuba.geometry import Array, Geometry, smooth_normals, unit

_TYPES: dict[int, Any] = {
    5120: np.int8,
    5121: np.uint8,
    5122: np.int16,
    5123: np.uint16,
    5125: np.uint32,
    5126: np.float32,
}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLES = 4
#: Extensions without which a model can still be shown as it is meant to be, or nearly.
_HARMLESS = ("KHR_materials_", "KHR_texture_transform", "KHR_mesh_quantization", "KHR_lights_")


@dataclass
class Gltf:
    """An open file: its JSON, and its buffers as they are asked for."""

    path: Path
    json: Mapping[str, Any]
    blob: bytes | None
    _buffers: dict[int, bytes] = field(default_factory=dict)
    _images: dict[int, NDArray[np.uint8]] = field(default_factory=dict)

    def array(self, number: int) -> NDArray[Any]:
        """The values of an accessor ``(N, width)``; normalised integers as floats."""
        entry = self.json["accessors"][number]
        kind = np.dtype(_TYPES[entry["componentType"]]).newbyteorder("<")
        width, count = _WIDTHS[entry["type"]], entry["count"]
        if "sparse" in entry or "bufferView" not in entry:
            raise self.damaged(f"accessor {number} is sparse or empty")
        view = self.json["bufferViews"][entry["bufferView"]]
        stride = view.get("byteStride") or kind.itemsize * width
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        data = self.buffer(view["buffer"])
        if start + stride * (count - 1) + kind.itemsize * width > len(data):
            raise self.damaged(f"accessor {number} reaches beyond its buffer")
        values = np.ndarray((count, width), kind, data, start, (stride, kind.itemsize))
        if entry.get("normalized"):
            return np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def buffer(self, number: int) -> bytes:
        """A buffer's bytes. Raises `DamagedFileError` if they are too few."""
        if number not in self._buffers:
            entry = self.json["buffers"][number]
            uri = entry.get("uri")
            data = self.blob if uri is None else self._fetched(uri)
            if data is None or len(data) < entry["byteLength"]:
                raise self.damaged(f"buffer {number} is cut short")
            self._buffers[number] = data
        return self._buffers[number]

    def image(self, reference: Mapping[str, Any] | None) -> NDArray[np.uint8] | None:
        """The picture ``(H, W, 4)`` of a texture reference, at most 1024 pixels wide and high."""
        from PIL import Image

        if reference is None:
            return None
        texture = self.json["textures"][reference["index"]]
        if "source" not in texture:
            raise self.damaged("a texture is in a format of an extension")
        number = texture["source"]
        if number not in self._images:
            entry = self.json["images"][number]
            if "uri" in entry:
                data = self._fetched(entry["uri"])
            else:
                view = self.json["bufferViews"][entry["bufferView"]]
                start = view.get("byteOffset", 0)
                data = self.buffer(view["buffer"])[start : start + view["byteLength"]]
            picture = Image.open(io.BytesIO(data)).convert("RGBA")
            picture.thumbnail((1024, 1024))
            self._images[number] = np.array(picture)  # Mitsuba takes no read-only array
        return self._images[number]

    def damaged(self, why: str) -> DamagedFileError:
        """The error for this file."""
        return DamagedFileError(f"the glTF model cannot be read: {why}", file=self.path)

    def _fetched(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        place = self.path.parent / unquote(uri)
        if not place.is_file():
            raise FileError(f"the model '{self.path}' names a file that is not there", file=place)
        return place.read_bytes()


def open_gltf(path: Path) -> Gltf:
    """A .glb or .gltf, whose structure is whole. Raises `DamagedFileError`, `FileError`."""
    content = path.read_bytes()
    blob: bytes | None = None
    try:
        if content[:4] == b"glTF":
            version, length = struct.unpack_from("<II", content, 4)
            if version != 2 or length > len(content):
                raise ValueError("not version 2, or cut short")
            size = struct.unpack_from("<I", content, 12)[0]
            text = content[20 : 20 + size]
            blob = content[28 + size :] if len(content) > 28 + size else None
        else:
            text = content
        found = json.loads(text)
        if not isinstance(found, dict) or not found.get("meshes"):
            raise ValueError("it holds no mesh")
    except (ValueError, struct.error) as error:
        raise DamagedFileError(f"the glTF model cannot be read: {error}", file=path) from error
    gltf = Gltf(path, found, blob)
    for name in found.get("extensionsRequired", ()):
        if not name.startswith(_HARMLESS):
            raise gltf.damaged(f"it needs the extension {name}")
    for number in range(len(found.get("buffers", ()))):
        gltf.buffer(number)
    return gltf


def read_gltf(path: Path) -> list[tuple[Geometry, Surface]]:
    """Meshes (y up, in metres) with their surfaces. Raises `DamagedFileError`, `FileError`."""
    gltf = open_gltf(path)
    surfaces: dict[int | None, Surface] = {}
    parts: list[tuple[Geometry, Surface]] = []
    try:
        for mesh, matrix in _placed(gltf):
            for primitive in gltf.json["meshes"][mesh]["primitives"]:
                geometry = _geometry(gltf, primitive)
                if geometry is None:
                    continue
                number = primitive.get("material")
                if number not in surfaces:
                    surfaces[number] = _surface(gltf, number)
                parts.append((geometry.moved(matrix), surfaces[number]))
    except (KeyError, IndexError, TypeError, ValueError, OSError) as error:
        raise gltf.damaged(f"{type(error).__name__}: {error}") from error
    if not parts:
        raise gltf.damaged("it has no triangles")
    return parts


# ------------------------------------------------------------------- private


def _placed(gltf: Gltf) -> list[tuple[int, Array]]:
    """Every use of a mesh, with its place ``(4, 4)`` in the scene."""
    nodes = gltf.json.get("nodes", [])
    scenes = gltf.json.get("scenes")
    roots = scenes[gltf.json.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    found: list[tuple[int, Array]] = []
    todo = [(number, np.eye(4), 0) for number in roots]
    while todo:
        number, above, depth = todo.pop()
        if depth > 64:
            raise gltf.damaged("its nodes go round in a circle")
        node = nodes[number]
        place = above @ _matrix(node)
        if "mesh" in node:
            found.append((node["mesh"], place))
        todo += [(child, place, depth + 1) for child in node.get("children", ())]
    return found


def _matrix(node: Mapping[str, Any]) -> Array:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.asarray(node.get("scale", (1, 1, 1)), float)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _geometry(gltf: Gltf, primitive: Mapping[str, Any]) -> Geometry | None:
    if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
        return None
    attributes = primitive["attributes"]
    positions = gltf.array(attributes["POSITION"]).astype(np.float64)
    if "indices" in primitive:
        faces = gltf.array(primitive["indices"]).astype(np.int64).reshape(-1, 3)
    else:
        faces = np.arange(len(positions) // 3 * 3).reshape(-1, 3)
    if faces.size and faces.max() >= len(positions):
        raise gltf.damaged("a triangle names a vertex that is not there")
    if "NORMAL" in attributes:
        normals = unit(gltf.array(attributes["NORMAL"]).astype(np.float64))
    else:
        normals = smooth_normals(positions, faces)
    uv = np.zeros((len(positions), 2))
    if "TEXCOORD_0" in attributes:
        uv = gltf.array(attributes["TEXCOORD_0"]).astype(np.float64)
    return Geometry(positions, normals, uv, faces) if len(faces) else None


def _surface(gltf: Gltf, number: int | None) -> Surface:
    entry = gltf.json["materials"][number] if number is not None else {}
    name = str(entry.get("name") or f"material {number}")
    model = entry.get("pbrMetallicRoughness", {})
    factor = np.array(model.get("baseColorFactor", (1, 1, 1, 1)), float)
    extensions = entry.get("extensions", {})
    rough = float(model.get("roughnessFactor", 1))
    transmission = extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0)
    if transmission > 0.5:
        thin = "KHR_materials_volume" not in extensions
        return glass(name, factor[:3], rough, thin=thin)
    picture = gltf.image(model.get("baseColorTexture"))
    both = gltf.image(model.get("metallicRoughnessTexture"))
    normals = gltf.image(entry.get("normalTexture"))
    opacity: Any = None
    if entry.get("alphaMode", "OPAQUE") != "OPAQUE":
        opacity = factor[3] if picture is None else picture[..., 3:] * factor[3]
    metal = float(model.get("metallicFactor", 1))
    return pbr(
        name,
        factor[:3] if picture is None else picture[..., :3],
        rough if both is None else both[..., 1:2] * rough,
        metal if both is None else both[..., 2:3] * metal,
        normals=None if normals is None else normals[..., :3],
        opacity=opacity,
        tint=factor[:3] if picture is not None else None,
    )
