"""Random scenes built with Blender's own means. Reading order: `dice`, `nodes`, `textures`,
`materials`, `shapes`, `lights`, then a layout (`still_lifes`, `rooms`, `open_air`, `tangles`),
`cameras`, `motion`.
"""

from __future__ import annotations

from typing import Any

import bpy

from .cameras import add_cameras, best_window
from .dice import Dice
from .motion import animate
from .open_air import court, land
from .rooms import room
from .still_lifes import still_life
from .tangles import stage, tangle

KINDS = {
    "room": (room, 3.5), "still life": (still_life, 3.0), "court": (court, 2.0),
    "land": (land, 1.5), "tangle": (tangle, 1.2), "stage": (stage, 1.5),
}  # fmt: skip


def build(
    seed: int,
    kind: str | None = None,
    cameras: int = 1,
    frames: int = 1,
    crops: float | None = None,
) -> dict[str, Any]:
    """Build the scene of a seed in place of what is open; facts about it.

    ``cameras``: how many viewpoints. ``frames``: more than one makes things move. ``crops``: what
    share of a picture a crop is; None draws one for each camera. Facts: ``kind``, ``cameras``
    (names), ``windows`` (for each camera the crop that shows most).
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    dice = Dice("scene", seed)
    if kind is None:
        kind = dice.weighted(**{name: weight for name, (_, weight) in KINDS.items()})
    layout = KINDS[kind][0](dice.child(kind))
    scene = bpy.context.scene
    names = add_cameras(dice.child("cameras"), layout, cameras)
    if frames > 1:
        animate(dice.child("motion"), layout, names, frames)
        scene.frame_set(1)
    _look(dice.child("look"), scene)
    windows = []
    for name in names:
        part = dice.child("window", name)
        share = crops if crops is not None else part.pick((1.0, 0.6, 0.4, 0.25))
        windows.append(best_window(part, scene.objects[name], share, 1.0))
    return {"kind": kind, "cameras": names, "windows": windows}


def _look(dice: Dice, scene: Any) -> None:
    """Settings that differ from artist to artist: filter, bounces, caustics."""
    cycles = scene.cycles
    cycles.pixel_filter_type = dice.pick(("BLACKMAN_HARRIS", "BLACKMAN_HARRIS", "BOX"))
    cycles.filter_width = dice.uniform(1.0, 1.8) if dice.chance(0.3) else 1.5
    cycles.max_bounces = dice.pick((4, 6, 8, 12))
    cycles.diffuse_bounces = cycles.glossy_bounces = cycles.max_bounces
    cycles.transmission_bounces = cycles.transparent_max_bounces = 12
    cycles.volume_bounces = dice.pick((0, 1, 2))
    if hasattr(cycles, "volume_biased"):
        # Blender 5 samples clouds without bias by an octree, which it makes again for each picture:
        # 4 s where the samples take 0.2 s
        cycles.volume_biased = True
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = dice.chance(0.75)
    cycles.blur_glossy = dice.pick((0.0, 0.0, 1.0))
    cycles.light_sampling_threshold = 0.0
    # Blender's default picks lights by a tree. With the few lights of these scenes that takes a
    # third more time for no less noise, so most do without
    cycles.use_light_tree = dice.chance(0.25)
