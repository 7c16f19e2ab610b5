"""Mitsuba scenes from files and dictionaries, with errors that say what to mend.

A scene's own film filter is not used: Lambent's frames are box filtered, each sample counts for its
own pixel only, since splatted noise is correlated and no denoiser removes it well. `load` says so
in a note where the scene asks for another filter.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lambent.errors import DamagedFileError, FileError, OptionError, UnknownNameError
from lambent.frame.windows import Windows
from lambent.render.complaint import explaining
from lambent.render.plugins import check as check_plugins
from lambent.render.plugins import names_in
from lambent.render.variant import mitsuba

#: Integrators whose radiance our own paths compute, or which the plug-in is.
OWN_PATHS = ("PathIntegrator", "PRBIntegrator", "BasicPRBIntegrator", "LambentFrames")
#: Those for scenes with participating media.
VOLUMETRIC = ("VolumetricPathIntegrator", "VolumetricMisPathIntegrator", "PRBVolpathIntegrator")


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A Mitsuba scene with the sensor to render; ``digest`` tells it from other scenes.

    ``depth``, ``rr_depth``: what the scene's own integrator asks for, or None. ``notes``: what a
    person should know, a sentence each.
    """

    scene: Any
    sensor: Any
    digest: str
    path: Path | None = None
    depth: int | None = None
    rr_depth: int | None = None
    notes: tuple[str, ...] = ()


def load(
    source: Any,
    *,
    size: tuple[int, int] | None = None,
    camera: str | int | None = None,
    device: str = "auto",
    parameters: Mapping[str, Any] | None = None,
) -> LoadedScene:
    """A scene from an XML file, a Mitsuba dictionary, or a scene object.

    ``size``: width and height of the whole picture instead of the film's, whose crop window is then
    left out, with a note. ``camera``: number or id of the sensor.
    ``parameters``: values for the scene's ``$names``. Raises `FileError` (missing scene, mesh or
    texture), `DamagedFileError` (no such plug-in, broken XML), `OptionError` (no camera, no light),
    `UnknownNameError` (no such camera).
    """
    mi = mitsuba(device)
    importlib.import_module("lambent.render.integrator")  # a scene may name our plug-in
    path = None
    if isinstance(source, (str, os.PathLike)):
        path = Path(source)
        scene = _from_file(mi, path, parameters or {})
        digest = _digest_of_file(path, parameters or {})
    elif isinstance(source, Mapping):
        with explaining("the scene", "loaded"):
            named = dict.fromkeys(names_in(source), "")
            check_plugins(mi, named, "the scene")
            _check_spectra(mi, named, "the scene")
            scene = mi.load_dict(dict(source))
        digest = hashlib.sha256(repr(sorted(source)).encode() + str(scene).encode()).hexdigest()
    else:
        scene = source
        digest = hashlib.sha256(str(scene).encode()).hexdigest()
    where = path or "the scene"
    if not scene.emitters():
        raise OptionError(
            "the scene has no emitter: every picture of it is black",
            file=where,
            remedy='add a light, for example <emitter type="constant"/>',
        )
    sensor = _chosen_sensor(scene, camera, where)
    notes = _notes(scene, sensor)
    if size is not None:
        windows = film_windows(sensor)
        if windows.data != windows.display:
            notes = (
                *notes,
                f"The film's crop window, {windows}, was left out: the size {size[0]}x{size[1]} "
                "is that of the whole picture (without --size the crop is rendered).",
            )
        with explaining(where, "given that size"):
            _resize(mi, sensor, size)
    return LoadedScene(scene, sensor, digest[:16], path, *_depths(scene), notes)


def build(
    mi: Any,
    path: Path,
    parameters: Mapping[str, Any],
    change: Callable[[Any, Any], None] | None = None,
) -> Any:
    """What a scene file holds, built by Mitsuba; only plug-ins that are loaded already take part.

    As ``mi.load_file`` does it, but that what the parser has read is looked at in between
    (`lambent.render.plugins.check`), and may be changed: ``change(mi, nodes)``; then equal nodes
    stay apart. Raises `DamagedFileError` for a foreign plug-in, and what Mitsuba raises.
    """
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    resolver.prepend(str(path.parent))
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = config.merge_equivalent = change is None
    mi.set_file_resolver(resolver)
    try:
        texts = {k: str(v) for k, v in parameters.items()}
        state = mi.parser.parse_file(config, str(path), **texts)
        mi.parser.transform_all(config, state)
        named: dict[str, str] = {}
        for node in state.nodes:
            where = re.search(r"line \d+, col \d+", mi.parser.file_location(state, node))
            named.setdefault(node.props.plugin_name(), where.group(0) if where else "")
        check_plugins(mi, named, path)
        _check_spectra(mi, named, path)
        if change is not None:
            change(mi, state.nodes)
        built = mi.parser.instantiate(config, state)
    finally:
        mi.set_file_resolver(before)
    return built[0] if isinstance(built, list) else built


def film_windows(sensor: Any) -> Windows:
    """Where the crop window of a sensor's film lies in its picture."""
    film = sensor.film()
    (x, y), (width, height) = film.crop_offset(), film.crop_size()
    box = int(x), int(y), int(x + width) - 1, int(y + height) - 1
    return Windows(box, Windows.of_size(*(int(side) for side in film.size())).display)


def film_size(sensor: Any) -> tuple[int, int]:
    """Width and height of what a sensor renders (its crop window)."""
    width, height = sensor.film().crop_size()
    return int(width), int(height)


# ------------------------------------------------------------------- private


def _check_spectra(mi: Any, named: Mapping[str, str], file: object) -> None:
    """Raise `DamagedFileError` for a blackbody in RGB, which Mitsuba refuses only while it renders.

    By then the scene is there, and as long as anything holds it (a traceback does), Dr.Jit calls
    its blackbody for every other scene, too: none could be rendered any more.
    """
    if "blackbody" in named and not mi.is_spectral:
        where = f" ({named['blackbody']})" if named["blackbody"] else ""
        raise DamagedFileError(
            f"has a blackbody{where}, which is not implemented for non-spectral modes",
            file=file,
            remedy="Lambent renders in RGB: give the colour as <rgb value=…>, or as a <spectrum>",
        )


def _from_file(mi: Any, path: Path, parameters: Mapping[str, Any]) -> Any:
    if not path.exists():
        raise FileError("there is no such file", file=path, remedy="check the path")
    if path.is_dir():
        raise FileError("is a folder", file=path, remedy=f"name the scene: {path / 'scene.xml'}")
    try:
        with open(path, "rb") as file:
            start = file.read(4096).lstrip()
    except OSError as error:
        raise FileError(f"cannot be read: {error.strerror}", file=path) from error
    if not start.startswith((b"<", b"\xef\xbb\xbf<")):
        raise FileError(
            "is not a Mitsuba scene (XML)",
            file=path,
            remedy="Lambent renders Mitsuba's .xml and Blender's .blend",
        )
    with explaining(path, "loaded"):
        scene = build(mi, path, parameters)
    if not isinstance(scene, mi.Scene):
        raise DamagedFileError("holds no <scene>", file=path, remedy="its root must be a <scene>")
    return scene


def _chosen_sensor(scene: Any, camera: str | int | None, where: object) -> Any:
    sensors = scene.sensors()
    if not sensors:
        raise OptionError(
            "the scene has no sensor (camera)",
            file=where,
            remedy='add one, for example <sensor type="perspective"> with a to_world transform',
        )
    if camera is None:
        return sensors[0]
    names = [s.id() for s in sensors]
    text = str(camera)
    if text in names:
        return sensors[names.index(text)]
    if text.isdigit() and int(text) < len(sensors):
        return sensors[int(text)]
    known = [f"{n}" + (f" ('{name}')" if name else "") for n, name in enumerate(names)]
    raise UnknownNameError("camera", text, known, file=where)


def _resize(mi: Any, sensor: Any, size: tuple[int, int]) -> None:
    if min(size) < 1 or max(size) > 65536:
        raise OptionError(f"a picture of {size[0]}x{size[1]} pixels cannot be made")
    params = mi.traverse(sensor)
    params["film.size"] = mi.ScalarVector2u(*size)
    params["film.crop_size"] = mi.ScalarVector2u(*size)
    params["film.crop_offset"] = mi.ScalarPoint2u(0, 0)
    params.update()


def _depths(scene: Any) -> tuple[int | None, int | None]:
    """``max_depth`` and ``rr_depth`` as the scene's integrator prints them."""
    text = str(scene.integrator()) if scene.integrator() is not None else ""
    found = []
    for name in ("max_depth", "rr_depth"):
        match = re.search(rf"{name} = (-?\d+)", text)
        value = int(match.group(1)) if match else None
        found.append(-1 if value in (0xFFFFFFFF, 2**31 - 1) else value)
    return found[0], found[1]


def _notes(scene: Any, sensor: Any) -> tuple[str, ...]:
    notes = []
    kind = sensor.film().rfilter().class_name()
    if kind != "BoxFilter":
        notes.append(
            f"The film's {kind.removesuffix('Filter').lower()} filter spreads each sample over "
            "several pixels, so that their noise is correlated; rendered with a box filter."
        )
    integrator = scene.integrator()
    name = integrator_name(integrator)
    if name and name not in (*OWN_PATHS, *VOLUMETRIC):
        notes.append(
            f"The scene asks for the integrator {name}; rendered by path tracing "
            "(--integrator scene takes the scene's own)."
        )
    return tuple(notes)


def _digest_of_file(path: Path, parameters: Mapping[str, Any]) -> str:
    """A hash of the scene's text and of the files it names."""
    text = path.read_bytes()
    digest = hashlib.sha256(text)
    digest.update(repr(sorted(parameters.items())).encode())
    for name in sorted(set(re.findall(rb'"filename"\s+value="([^"]+)"', text))):
        file = path.parent / name.decode("utf-8", "replace")
        if file.is_file():
            digest.update(name + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def integrator_name(integrator: Any) -> str:
    """The class of an integrator; one written in Python is known by its Python class."""
    if integrator is None:
        return ""
    name = type(integrator).__name__
    return str(integrator.class_name()) if hasattr(sys.modules["mitsuba"], name) else name
