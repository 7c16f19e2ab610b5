"""Small Cycles renders with every pass, for the tests of the Blender dialect.

Runs under a Python that has ``bpy`` (extra ``blender``)::

    python benchmarks/cycles_frames.py OUTPUT_FOLDER [WIDTH HEIGHT SPP]

A scene of primitives made here (CC0): a diffuse floor, a glossy and a glass ball, an emitting
cube, an area lamp and a sun-less sky colour; two light groups; camera and one ball move, so that
the motion pass holds something. Written are

``cycles_multilayer.exr``    what ``Render > Multilayer EXR`` writes, half float, small
``cycles_interleaved.exr``   the same with "Interleave" on (one part), where Blender has the switch
``cycles_denoised.exr``      the same, denoised by Blender, with ``Noisy Image``
``cycles_pass_*.exr``        one file a pass, as the File Output node writes them

``tests/data/cycles_50_multilayer.exr`` is ``cycles_denoised.exr`` of Blender 5.0.1 at 40x30 pixels
and 8 spp (CC0, like the scene).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import bpy

WIDTH, HEIGHT, SPP = 64, 48, 8

PASSES = (
    "use_pass_z",
    "use_pass_mist",
    "use_pass_position",
    "use_pass_normal",
    "use_pass_vector",
    "use_pass_uv",
    "use_pass_object_index",
    "use_pass_material_index",
    "use_pass_diffuse_direct",
    "use_pass_diffuse_indirect",
    "use_pass_diffuse_color",
    "use_pass_glossy_direct",
    "use_pass_glossy_indirect",
    "use_pass_glossy_color",
    "use_pass_transmission_direct",
    "use_pass_transmission_indirect",
    "use_pass_transmission_color",
    "use_pass_emit",
    "use_pass_environment",
    "use_pass_ambient_occlusion",
    "use_pass_shadow",
    "use_pass_cryptomatte_object",
    "use_pass_cryptomatte_material",
)


def material(name: str, **inputs: Any) -> Any:
    """A material of one Principled shader."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = next(n for n in made.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    return made


def build_scene() -> Any:
    """The scene, with motion in frame 2."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene

    bpy.ops.mesh.primitive_plane_add(size=12)
    bpy.context.object.data.materials.append(
        material("floor", Base_Color=(0.6, 0.5, 0.4, 1.0), Roughness=0.9)
    )
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1, location=(-1.2, 0, 1), segments=24)
    ball = bpy.context.object
    ball.pass_index = 3
    ball.data.materials.append(
        material("gloss", Base_Color=(0.8, 0.2, 0.1, 1.0), Roughness=0.2, Metallic=1.0)
    )
    ball.keyframe_insert("location", frame=1)
    ball.location.x += 0.5
    ball.keyframe_insert("location", frame=3)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, location=(1.2, -0.4, 0.8))
    bpy.context.object.data.materials.append(
        material("glass", Transmission_Weight=1.0, Roughness=0.05)
    )
    bpy.ops.mesh.primitive_cube_add(size=0.7, location=(0.2, 1.6, 0.35))
    cube = bpy.context.object
    cube.data.materials.append(
        material("glow", Emission_Color=(0.2, 0.5, 1.0, 1.0), Emission_Strength=3.0)
    )
    cube.lightgroup = "cube"

    bpy.ops.object.light_add(type="AREA", location=(2.5, -2.5, 4), rotation=(0.6, 0.4, 0.5))
    bpy.context.object.data.energy = 300
    bpy.context.object.lightgroup = "lamp"
    bpy.ops.object.camera_add(location=(0, -6, 2.4), rotation=(1.3, 0, 0))
    scene.camera = bpy.context.object

    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.4, 0.6, 1.0)
    scene.world = world
    return scene


def set_passes(scene: Any) -> None:
    """Cycles, all passes, two light groups (and the world's light outside both)."""
    scene.frame_set(2)
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.cycles.device = "CPU"
    scene.cycles.samples = SPP
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.seed = 1
    layer = scene.view_layers[0]
    for name in PASSES:
        setattr(layer, name, True)
    layer.pass_cryptomatte_depth = 2
    layer.cycles.denoising_store_passes = True
    layer.cycles.use_pass_volume_direct = True
    layer.cycles.use_pass_volume_indirect = True
    layer.cycles.pass_debug_sample_count = True
    for name in ("lamp", "cube"):
        layer.lightgroups.add(name=name)


def render_to(scene: Any, path: Path, interleave: bool, denoise: bool) -> None:
    """One multi-layer file."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "16"
    settings.exr_codec = "ZIP"
    if hasattr(settings, "use_exr_interleave"):
        settings.use_exr_interleave = interleave
    scene.cycles.use_denoising = denoise
    scene.view_layers[0].cycles.use_denoising = denoise
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    print("wrote", path)


def single_files(scene: Any, folder: Path) -> None:
    """One file a pass through the compositor's File Output node."""
    if hasattr(scene, "compositing_node_group"):  # Blender 5
        tree = bpy.data.node_groups.new("passes", "CompositorNodeTree")
        scene.compositing_node_group = tree
    else:
        scene.use_nodes = True
        tree = scene.node_tree
    source = tree.nodes.new("CompositorNodeRLayers")
    writer = tree.nodes.new("CompositorNodeOutputFile")
    if hasattr(writer, "directory"):
        writer.directory = str(folder)
        writer.file_name = "cycles_pass_"
        writer.format.media_type = "IMAGE"
    else:
        writer.base_path = str(folder)
    writer.format.file_format = "OPEN_EXR"
    writer.format.color_depth = "16"
    for name in ("Image", "Denoising Albedo", "Denoising Normal", "Depth", "Vector"):
        socket = source.outputs[name]
        if hasattr(writer, "file_output_items"):
            kind = {"VALUE": "FLOAT"}.get(socket.type, socket.type)
            writer.file_output_items.new(kind, name)
        else:
            writer.file_slots.new(f"cycles_pass_{name}")
        tree.links.new(socket, writer.inputs[name if hasattr(writer, "directory") else -1])
    scene.cycles.use_denoising = False
    scene.render.filepath = str(folder / "unused")
    bpy.ops.render.render()
    print("wrote one file a pass to", folder)


def main() -> None:
    global WIDTH, HEIGHT, SPP
    if len(sys.argv) > 4:
        WIDTH, HEIGHT, SPP = map(int, sys.argv[2:5])
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    scene = build_scene()
    set_passes(scene)
    render_to(scene, folder / "cycles_multilayer.exr", interleave=False, denoise=False)
    render_to(scene, folder / "cycles_interleaved.exr", interleave=True, denoise=False)
    render_to(scene, folder / "cycles_denoised.exr", interleave=False, denoise=True)
    single_files(scene, folder)


if __name__ == "__main__":
    main()
