"""Renders the frames that the denoisers are compared on.

    python benchmarks/denoise_frames.py SCENES_DIR [--spp 1,4,16,64,256,1024] [--cache DIR]
        [--reference-spp 4096] [--share 1] [--scenes a,b] [--cycles 900001,...] [--no-splat]

SCENES_DIR holds the validation scenes (``<name>/scene.xml``). Into the cache go, for each scene and
spp, ``NAME-SPPspp.exr`` by `lambent.render` with every feature and variance, box filtered;
``NAME-splat-SPPspp.exr`` by Mitsuba's own film and the scene's own splatted filter with albedo,
normal and depth; a reference of each kind. ``--cycles`` renders random Cycles scenes from seeds
that no training set may hold (needs ``LAMBENT_BLENDER``). ``--share`` shrinks the pictures.
What is there is kept; a stopped run goes on.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from frames import SIZES, default_cache, write_exr
from lambent.dataset.validation import CYCLES_SEEDS, SCENES

#: Noisy frames and references draw from far apart seeds.
NOISY_SEED, REFERENCE_SEED = 11, 2_000_000
CYCLES_SIZE = (480, 270)
#: Samples of a splatted reference are added up in passes of so many.
PASS = 128


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes_dir", type=Path)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--spp", default="1,4,16,64,256,1024")
    parser.add_argument("--reference-spp", type=int, default=4096)
    parser.add_argument("--cycles", default=",".join(map(str, CYCLES_SEEDS)), help="empty for none")
    parser.add_argument("--share", type=float, default=1.0, help="of each side of the pictures")
    parser.add_argument("--no-splat", action="store_true")
    parser.add_argument("--cache", type=Path, default=default_cache().with_name("validation"))
    arguments = parser.parse_args()
    arguments.cache.mkdir(parents=True, exist_ok=True)
    levels = [int(v) for v in arguments.spp.split(",")]
    began = time.time()

    def say(path: Path) -> None:
        print(f"{time.time() - began:7.0f} s  {path.name}", flush=True)

    for name in filter(None, arguments.scenes.split(",")):
        size = tuple(round(v * arguments.share / 2) * 2 for v in SIZES[name])
        ours(arguments, name, size, levels, say)
        if not arguments.no_splat:
            splatted(arguments, name, size, levels, say)
    for seed in filter(None, arguments.cycles.split(",")):
        size = tuple(round(v * arguments.share / 2) * 2 for v in CYCLES_SIZE)
        cycles(arguments, int(seed), size, levels, say)


def ours(arguments: Any, name: str, size: Any, levels: list[int], say: Any) -> None:
    """Every feature, by our renderer."""
    import lambent

    scene = arguments.scenes_dir / name / "scene.xml"
    for spp in levels:
        path = arguments.cache / f"{name}-{spp}spp.exr"
        if not path.exists():
            lambent.render(scene, path, spp=spp, size=size, seed=NOISY_SEED + spp)
            say(path)
    path = arguments.cache / f"{name}-reference.exr"
    if not path.exists():
        spp = arguments.reference_spp
        lambent.render(scene, path, spp=spp, size=size, seed=REFERENCE_SEED, features="none")
        say(path)


def splatted(arguments: Any, name: str, size: Any, levels: list[int], say: Any) -> None:
    """By Mitsuba's film with the scene's own filter, unless that is a box."""
    from lambent.render.variant import mitsuba

    mi = mitsuba()
    source = arguments.scenes_dir / name / "scene.xml"
    todo = [arguments.cache / f"{name}-splat-{spp}spp.exr" for spp in levels]
    last = arguments.cache / f"{name}-splat-reference.exr"
    if all(path.exists() for path in (*todo, last)):
        return
    scene = mi.load_file(str(source), resx=size[0], resy=size[1])
    if "Box" in str(scene.sensors()[0].film().rfilter()):
        return
    aovs = "albedo:albedo,normal:sh_normal,depth:depth"
    integrator = mi.load_dict({"type": "aov", "aovs": aovs, "path": scene.integrator()})
    for spp, path in zip(levels, todo, strict=True):
        if path.exists():
            continue
        image = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=NOISY_SEED + spp))
        layers = {
            "": ("RGB", image[..., :3]),
            "albedo": ("RGB", image[..., -7:-4]),
            "normal": ("XYZ", image[..., -4:-1]),
            "depth": ("Z", image[..., -1:]),
        }
        write_exr(path, layers, spp=spp)
        say(path)
    if not last.exists():
        total = np.zeros((size[1], size[0], 3), np.float64)
        count = max(1, arguments.reference_spp // PASS)
        squares = np.zeros_like(total)
        for k in range(count):
            image = np.array(mi.render(scene, spp=PASS, seed=REFERENCE_SEED + k))[..., :3]
            total += image
            squares += image.astype(np.float64) ** 2
        mean = total / count
        variance = np.maximum(squares / count - mean**2, 0) / max(count - 1, 1)
        layers = {"": ("RGB", mean), "variance": ("RGB", variance)}
        layers = {k: (c, v.astype(np.float32)) for k, (c, v) in layers.items()}
        write_exr(last, layers, spp=count * PASS)
        say(last)


def cycles(arguments: Any, seed: int, size: Any, levels: list[int], say: Any) -> None:
    """A random Cycles scene, whole pictures."""
    from lambent.frame.files import write
    from lambent.scenes.cycles import CyclesWorker

    names = [arguments.cache / f"cycles-{seed}-{spp}spp.exr" for spp in levels]
    last = arguments.cache / f"cycles-{seed}-reference.exr"
    if all(path.exists() for path in (*names, last)):
        return
    with CyclesWorker() as worker:
        (view,) = worker.render_random(
            seed,
            spp_list=levels,
            size=size,
            reference_spp=max(16, arguments.reference_spp // 4),
            reference_blocks=8,
            crop=1.0,
        )
    for path, frame in zip([*names, last], [*view.noisy, view.target], strict=True):
        write(path, frame, overwrite=True)
        say(path)


if __name__ == "__main__":
    main()
