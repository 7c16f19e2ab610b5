"""How Cycles is set for a noisy frame with every feature.

All passes on; the denoiser and adaptive sampling off, so that every pixel has the same number of
samples and nothing has touched them; motion blur off, since Blender writes motion vectors only
then; compositor and sequencer off. Clamping, bounces and light-path tricks stay as the artist set
them and are told, not changed.
"""

from __future__ import annotations

from typing import Any

import bpy

PASSES = (
    "z",
    "position",
    "normal",
    "vector",
    "diffuse_direct",
    "diffuse_indirect",
    "diffuse_color",
    "glossy_direct",
    "glossy_indirect",
    "glossy_color",
    "transmission_direct",
    "transmission_indirect",
    "transmission_color",
    "emit",
    "environment",
)
#: Cheap ones that say more about a file's things; occlusion and shadow cost rays and stay as set.
EXTRA_PASSES = ("uv", "mist", "object_index", "material_index")
CRYPTOMATTES = ("cryptomatte_object", "cryptomatte_material")


class Refused(Exception):  # noqa: N818  (it is an answer, not a failure of the program)
    """An order that cannot be carried out. ``kind`` tells the other side which error it is."""

    def __init__(self, kind: str, message: str, **facts: Any) -> None:
        super().__init__(message)
        self.kind, self.message, self.facts = kind, message, facts


def choose_device(scene: Any, wish: str) -> str:
    """Set the device (``auto``, ``cpu``, ``cuda``); which one it became. Raises `Refused`."""
    scene.cycles.device = "CPU"
    if wish == "cpu":
        return "CPU"
    preferences = bpy.context.preferences.addons["cycles"].preferences
    for kind in ("OPTIX", "CUDA"):
        try:
            preferences.compute_device_type = kind
        except TypeError:
            continue
        preferences.get_devices()
        chosen = [d for d in preferences.devices if d.type == kind]
        if chosen:
            for device in preferences.devices:
                device.use = device.type == kind
            scene.cycles.device = "GPU"
            return f"{chosen[0].name} ({kind})"
    if wish == "cuda":
        raise Refused("device", "Cycles finds no CUDA device")
    return "CPU"


def apply_settings(scene: Any, order: dict[str, Any]) -> dict[str, Any]:
    """Everything but samples and seed, from the order's keys. Notes in sentences, and the region.

    Keys: ``camera`` (name), ``size`` ``[width, height]``, ``window`` ``[left, top, right, bottom]``
    in shares of the picture, ``depth``, ``time`` (seconds a picture), ``passes`` (``all``,
    ``light``), ``cryptomatte``, ``layer``, ``codec``. Raises `Refused`.
    """
    notes: list[str] = []
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    _camera(scene, order.get("camera"))
    notes += _size(render, order)
    cycles.use_denoising = False
    if cycles.use_adaptive_sampling:
        cycles.use_adaptive_sampling = False
        notes.append("Adaptive sampling is off: every pixel gets the same number of samples.")
    if render.use_motion_blur:
        render.use_motion_blur = False
        notes.append(
            "Motion blur is off: Blender writes motion vectors only without it. What moves is "
            "sharp in this render."
        )
    if hasattr(cycles, "use_sample_subset"):
        cycles.use_sample_subset = False
    cycles.use_layer_samples = "IGNORE"
    cycles.time_limit = float(order.get("time") or 0.0)
    if order.get("depth") is not None:
        cycles.max_bounces = int(order["depth"])
    for name, words in (("direct", "direct"), ("indirect", "indirect")):
        clamp = getattr(cycles, f"sample_clamp_{name}")
        if clamp > 0:
            notes.append(f"The file clamps {words} light at {clamp:g} per sample; that was kept.")
    render.use_compositing = render.use_sequencer = False
    render.use_persistent_data = True
    render.use_stamp = False
    render.use_file_extension = False
    notes += _layers(scene, order)
    _output(render, order.get("codec", "NONE"))
    return {"notes": notes, "region": _region(render)}


def _camera(scene: Any, name: str | None) -> None:
    cameras = {o.name: o for o in scene.objects if o.type == "CAMERA"}
    if name is not None:
        if name not in cameras:
            raise Refused("camera", name, known=sorted(cameras))
        scene.camera = cameras[name]
    if scene.camera is None:
        if len(cameras) == 1:
            scene.camera = next(iter(cameras.values()))
        else:
            raise Refused(
                "which camera", "no camera of the scene is the active one", known=sorted(cameras)
            )


def _size(render: Any, order: dict[str, Any]) -> list[str]:
    """The picture's size; with a window, the size of what is cut out of it. Notes."""
    notes = []
    if order.get("size"):
        if render.use_border and not order.get("window"):
            notes.append(
                "The file's render region was left out: the size is that of the whole picture "
                "(without --size the region is rendered)."
            )
        width, height = order["size"]
        window = order.get("window")
        if window:
            left, top, right, bottom = window
            whole_x, whole_y = round(width / (right - left)), round(height / (bottom - top))
            x, y = round(left * whole_x), round(top * whole_y)
            low = whole_y - y - height  # rows count from below
            # The border is given in shares of the whole, float32, and Blender cuts off what is
            # behind the comma: 56 / 213 of 213 would be 55. A quarter of a pixel further is safe.
            render.border_min_x, render.border_max_x = (
                (edge + 0.25) / whole_x for edge in (x, x + width)
            )
            render.border_min_y, render.border_max_y = (
                (edge + 0.25) / whole_y for edge in (low, low + height)
            )
            width, height = whole_x, whole_y
        render.use_border = render.use_crop_to_border = bool(window)
        render.resolution_x, render.resolution_y = int(width), int(height)
        render.resolution_percentage = 100
    return notes


def _region(render: Any) -> list[int] | None:
    """Of a render region that is cropped to: its first column and its first row from below, and
    the size of the whole picture; else None."""
    if not (render.use_border and render.use_crop_to_border):
        return None
    share = render.resolution_percentage / 100
    width, height = int(render.resolution_x * share), int(render.resolution_y * share)
    return [int(render.border_min_x * width), int(render.border_min_y * height), width, height]


def _layers(scene: Any, order: dict[str, Any]) -> list[str]:
    """Passes of every view layer that is rendered, and notes."""
    notes = []
    on = [layer for layer in scene.view_layers if layer.use]
    if not on:
        raise Refused("layers", "no view layer is switched on for rendering")
    for layer in on:
        layer.cycles.use_denoising = False
        layer.cycles.denoising_store_passes = True
        layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = True
        for name in PASSES:
            setattr(layer, f"use_pass_{name}", True)
        for name in CRYPTOMATTES:
            setattr(layer, f"use_pass_{name}", bool(order.get("cryptomatte")))
        for name in EXTRA_PASSES:
            setattr(layer, f"use_pass_{name}", order.get("passes") != "light")
        if order.get("passes") == "light":
            layer.use_pass_ambient_occlusion = layer.use_pass_shadow = False
    if len(on) > 1:
        names = ", ".join(f"'{layer.name}'" for layer in on)
        notes.append(f"The scene has several view layers, all rendered: {names}.")
    return notes


def _output(render: Any, codec: str) -> None:
    settings = render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = codec
    if hasattr(settings, "color_management"):
        settings.color_management = "FOLLOW_SCENE"


def camera_facts(scene: Any) -> dict[str, Any]:
    """The camera that rendered: its name and its matrix from camera to world, row by row."""
    matrix = scene.camera.matrix_world
    return {"camera": scene.camera.name, "to_world": [list(row) for row in matrix]}
