"""Runs in a Python that has bpy: saves small .blend files for the tests.

``python blend_files.py KIND FILE``, where KIND is ``moving`` (a textured ball that slides by
`STEP` a frame before a textured wall, and a camera that travels), ``still`` (a room corner with a
lamp, a ball of glass, one of metal, a light group; clamping, motion blur and adaptive sampling on),
``region`` (the same with a render region that is cropped to),
``no-camera``, or ``two-cameras`` (neither is active). A name ending in ``.packed.blend`` is packed.
"""

from __future__ import annotations

import sys

STEP = (0.11, 0.0, 0.05)


def _material(bpy, name, colour=(0.6, 0.5, 0.4), texture=0.0, **inputs):
    made = bpy.data.materials.new(name)
    if not made.node_tree:
        made.use_nodes = True
    tree = made.node_tree
    shader = next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ")].default_value = value
    if texture:
        noise = tree.nodes.new("ShaderNodeTexNoise")
        noise.inputs["Scale"].default_value = texture
        place = tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(place.outputs["Object"], noise.inputs["Vector"])
        tree.links.new(noise.outputs["Color"], shader.inputs["Base Color"])
    return made


def main() -> None:
    import bpy

    kind, path = sys.argv[-2:]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 96, 64
    moving = kind == "moving"

    bpy.ops.mesh.primitive_plane_add(size=14, location=(0, 2, 0), rotation=(1.35, 0, 0))
    wall = bpy.context.object
    wall.data.materials.append(_material(bpy, "wall", texture=1.0 if moving else 0.0))
    bpy.ops.mesh.primitive_uv_sphere_add(
        radius=1, location=(-0.6, 0, 0.3), segments=64, ring_count=32
    )
    ball = bpy.context.object
    ball.pass_index = 1
    ball.data.materials.append(
        _material(bpy, "ball", texture=2.0) if moving else
        _material(bpy, "ball", (0.9, 0.7, 0.3), Metallic=1.0, Roughness=0.2)
    )  # fmt: skip
    if not moving:
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.7, location=(1.3, -0.5, 0.1), segments=48)
        bpy.context.object.data.materials.append(
            _material(bpy, "glass", (1, 1, 1), Transmission_Weight=1.0, Roughness=0.0)
        )
    bpy.ops.object.light_add(type="AREA", location=(3, -3, 5), rotation=(0.6, 0.4, 0.5))
    lamp = bpy.context.object
    lamp.data.energy = 500
    scene.view_layers[0].lightgroups.add(name="lamp")
    lamp.lightgroup = "lamp"
    world = bpy.data.worlds.new("sky")
    if not world.node_tree:
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.3, 0.4, 1)
    scene.world = world

    cameras = {"no-camera": 0, "two-cameras": 2}.get(kind, 1)
    for n in range(cameras):
        bpy.ops.object.camera_add(location=(0.5 * n, -7, 1.0), rotation=(1.48, 0, 0))
        camera = bpy.context.object
        camera.name = ("left", "right")[n]
        camera.data.lens = 40
    scene.camera = camera if cameras == 1 else None
    if moving:
        # A pixel filter so narrow that every sample lies in the middle of its pixel: what the
        # first sample alone tells (position) is then where motion says it is.
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        for frame in (1, 5):
            t = frame - 3
            ball.location = (-0.6 + STEP[0] * t, STEP[1] * t, 0.3 + STEP[2] * t)
            ball.keyframe_insert("location", frame=frame)
            camera.location = (0.06 * t, -7 + 0.05 * t, 1.0 + 0.03 * t)
            camera.rotation_euler = (1.48 + 0.004 * t, 0.003 * t, 0.006 * t)
            camera.keyframe_insert("location", frame=frame)
            camera.keyframe_insert("rotation_euler", frame=frame)
        for action in bpy.data.actions:
            curves = getattr(action, "fcurves", None) or [
                c for a in action.layers for s in a.strips for b in s.channelbags for c in b.fcurves
            ]
            for curve in curves:
                for point in curve.keyframe_points:
                    point.interpolation = "LINEAR"
        scene.frame_set(3)
    else:
        scene.cycles.use_adaptive_sampling = True
        scene.cycles.sample_clamp_indirect = 10.0
        scene.render.use_motion_blur = True
    if kind == "region":
        render = scene.render
        render.use_border = render.use_crop_to_border = True
        render.border_min_x, render.border_max_x = 0.25, 0.75  # columns 24 to 71 of 96
        render.border_min_y, render.border_max_y = 0.25, 0.5  # rows 32 to 47 of 64 from above
    bpy.ops.wm.save_as_mainfile(filepath=path, compress=path.endswith(".packed.blend"))


if __name__ == "__main__":
    main()
