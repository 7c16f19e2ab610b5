"""Fine-tuning to an odd renderer set-up: error before and after, on frames never tuned on.

    LAMBENT_BLENDER=... python benchmarks/finetune.py [--minutes 15] [--cache DIR] [--model lambent]
                                                      [--render-only]

A Cycles scene that no random scene resembles (CC0, made here): fluorescent paint and anisotropic
metal, lit by many small coloured lamps and a laser-like spot, in thin fog, seen by a moving camera.
Twelve frames are rendered with 8 spp and with 256 spp. Eight are tuned on, once as pairs and once
from their half buffers alone; the error is measured on the other four. Prints a table.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from filters import geometric_mean, markdown_table, measured
from frames import default_cache

FRAMES, TUNED, SIZE = range(1, 13), 8, (320, 180)
NOISY_SPP, REFERENCE_SPP = 8, 256

ERRORS = ("relmse_trimmed", "relmse", "dssim", "flip")

#: Runs inside Blender's Python.
SCENE = """
import math, random, sys
import bpy

random.seed(5)
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"


def material(name, **values):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    node = made.node_tree.nodes["Principled BSDF"]
    for key, value in values.items():
        if key in node.inputs:
            node.inputs[key].default_value = value
    return made


paints = [
    material("paint", **{"Base Color": (0.95, 0.05, 0.6, 1), "Emission Color": (1, 0.1, 0.7, 1),
                         "Emission Strength": 0.15, "Roughness": 0.3}),
    material("metal", **{"Base Color": (0.6, 0.9, 1, 1), "Metallic": 1.0, "Roughness": 0.25,
                         "Anisotropic": 0.9}),
    material("glass", **{"Base Color": (0.4, 1, 0.5, 1), "Transmission Weight": 1.0,
                         "Roughness": 0.12}),
    material("velvet", **{"Base Color": (0.02, 0.02, 0.1, 1), "Sheen Weight": 1.0,
                          "Sheen Roughness": 0.4}),
]
dark = {"Base Color": (0.03, 0.03, 0.03, 1), "Metallic": 0.7, "Roughness": 0.2}
floor = material("floor", **dark)
bpy.ops.mesh.primitive_plane_add(size=40)
bpy.context.object.data.materials.append(floor)
for n in range(60):
    place = (random.uniform(-6, 6), random.uniform(-6, 6), random.uniform(0.2, 2.5))
    make = random.choice([bpy.ops.mesh.primitive_torus_add, bpy.ops.mesh.primitive_ico_sphere_add,
                          bpy.ops.mesh.primitive_cone_add, bpy.ops.mesh.primitive_monkey_add])
    make(location=place, rotation=[random.uniform(0, 6) for _ in range(3)])
    thing = bpy.context.object
    thing.scale = [random.uniform(0.2, 0.6)] * 3
    thing.data.materials.append(random.choice(paints))
for n in range(24):
    place = (random.uniform(-7, 7), random.uniform(-7, 7), random.uniform(0.5, 4))
    bpy.ops.object.light_add(type="POINT", location=place)
    lamp = bpy.context.object.data
    lamp.energy, lamp.shadow_soft_size = random.uniform(10, 60), 0.02
    lamp.color = random.choice([(1, 0, 0.2), (0, 0.4, 1), (0.1, 1, 0.2), (1, 0.6, 0)])
bpy.ops.object.light_add(type="SPOT", location=(0, -6, 7), rotation=(0.7, 0, 0))
laser = bpy.context.object.data
laser.energy, laser.spot_size, laser.shadow_soft_size = 6000, 0.15, 0.01
bpy.ops.mesh.primitive_cube_add(size=30, location=(0, 0, 10))
fog = bpy.data.materials.new("fog")
fog.use_nodes = True
nodes = fog.node_tree.nodes
nodes.clear()
scatter, out = nodes.new("ShaderNodeVolumeScatter"), nodes.new("ShaderNodeOutputMaterial")
scatter.inputs["Density"].default_value = 0.015
fog.node_tree.links.new(scatter.outputs[0], out.inputs["Volume"])
bpy.context.object.data.materials.append(fog)
bpy.ops.object.camera_add()
camera = bpy.context.object
scene.camera = camera
goal = bpy.data.objects.new("goal", None)
goal.location = (0, 0, 1)
scene.collection.objects.link(goal)
watch = camera.constraints.new("TRACK_TO")
watch.target = goal
for frame in range(1, 13):
    angle = frame * 0.5
    camera.location = (8 * math.cos(angle), 8 * math.sin(angle), 2 + 0.2 * frame)
    camera.keyframe_insert("location", frame=frame)
scene.frame_start, scene.frame_end = 1, 12
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[-1])
"""


def rendered(cache: Path) -> list[tuple[Path, Path]]:
    """Noisy frame and reference of every frame."""
    import lambent

    cache.mkdir(parents=True, exist_ok=True)
    blend = cache / "odd.blend"
    if not blend.exists():
        blender = os.environ.get("LAMBENT_BLENDER", sys.executable)
        subprocess.run([blender, "-c", SCENE, str(blend)], check=True, stdout=subprocess.DEVNULL)
    pairs = []
    for number in FRAMES:
        noisy = cache / f"odd.{number:04d}.exr"
        reference = cache / f"odd.{number:04d}.reference.exr"
        for path, spp in ((noisy, NOISY_SPP), (reference, REFERENCE_SPP)):
            if not path.exists():
                frame = lambent.render(blend, spp=spp, size=SIZE, frames=[number], seed=spp)[0]
                lambent.write(path, frame)
                print(path.name, file=sys.stderr, flush=True)
        pairs.append((noisy, reference))
    return pairs


def errors(weights: str | None, pairs: list[tuple[Path, Path]]) -> dict[str, float]:
    """Geometric means over frames."""
    import lambent

    options: dict[str, Any] = {} if weights is None else {"weights": weights}
    rows = [
        measured(lambent.denoise(noisy, model="lambent", passes="beauty", **options).colour, truth)
        for noisy, truth in pairs
    ]
    return {what: geometric_mean(row[what] for row in rows) for what in ERRORS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--model", default="lambent")
    parser.add_argument("--cache", type=Path, default=default_cache().with_name("odd"))
    parser.add_argument("--render-only", action="store_true", help="make the frames, no more")
    arguments = parser.parse_args()
    from lambent.learn.finetune import finetune

    pairs = rendered(arguments.cache)
    if arguments.render_only:
        return
    tuned, held = pairs[:TUNED], pairs[TUNED:]
    table = []
    start = errors(None, held)
    table.append(["as shipped", *(f"{v:.5f}" for v in start.values()), "1.00"])
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder) / "alone"
        alone.mkdir()
        for noisy, _ in tuned:
            (alone / noisy.name).symlink_to(noisy)
        ways = {
            "8 pairs": [noisy for noisy, _ in tuned],
            "8 frames' half buffers": [alone / noisy.name for noisy, _ in tuned],
        }
        for name, paths in ways.items():
            model = Path(folder) / "tuned.lambent"
            seconds = arguments.minutes * 60
            done = finetune(paths, arguments.model, model, seconds, overwrite=True)
            found = errors(str(model), held)
            ratio = f"{found[ERRORS[0]] / start[ERRORS[0]]:.2f}"
            table.append([name, *(f"{v:.5f}" for v in found.values()), ratio])
            print(" ".join(table[-1]), f"{done['steps']:.0f} steps", file=sys.stderr, flush=True)
    head = ["tuned on", "trimmed relMSE", "relMSE", "DSSIM", "HDR-FLIP", "÷ shipped"]
    print(f"{arguments.minutes:g} minutes each, four frames held out\n")
    print(markdown_table(head, table))


if __name__ == "__main__":
    main()
