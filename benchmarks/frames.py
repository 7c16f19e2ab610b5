"""Renders the frames that the quality tables are measured on.

    python benchmarks/frames.py SCENES_DIR [--spp 4,16,64] [--reference-spp 2048] [--cache DIR]

SCENES_DIR holds ``<name>/scene.xml`` for the scenes of `SIZES` (Benedikt Bitterli's rendering
resources). For every scene and spp the cache gets ``<name>-<spp>spp.exr`` with colour, albedo,
world-space normal, depth and position, the variance of the mean of each, two half buffers, and the
moments that the statistical filter reads; ``<name>-reference.exr`` holds colour and its variance.
Everything is box filtered. A reference grows in passes whose sums are kept beside it, so that a
stopped run goes on where it was and a larger ``--reference-spp`` adds to what there is.
``--tent NAME`` adds a frame of Mitsuba's own film with a splatted tent filter, 16 spp.
Existing files are kept. ``benchmarks/scenes`` has two scenes of our own
(``--scenes desk,arcade``). Needs ``mitsuba`` (``pip install lambent[bench]``).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent.startup import find_llvm

#: Scene -> width, height.
SIZES = {
    "cornell-box": (448, 448),
    "veach-bidir": (448, 448),
    "living-room": (640, 360),
    "dining-room": (640, 360),
    "veach-mis": (640, 360),
}
REFERENCE_PASS = 64
#: Noisy frames and references draw from far apart seeds.
NOISY_SEED, REFERENCE_SEED = 1, 1_000_000


def default_cache() -> Path:
    """``$LAMBENT_CACHE`` or ``~/.cache/lambent``, and in it ``frames``."""
    base = os.environ.get("LAMBENT_CACHE")
    return (Path(base) if base else Path.home() / ".cache" / "lambent") / "frames"


def start_mitsuba() -> Any:
    """Mitsuba with its LLVM variant chosen."""
    llvm = find_llvm()
    if llvm:
        os.environ["DRJIT_LIBLLVM_PATH"] = llvm
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    return mi


def write_exr(
    path: Path,
    layers: dict[str, tuple[str, NDArray[Any]]],
    half: tuple[str, ...] = (),
    compression: str = "ZIP_COMPRESSION",
    **header: Any,
) -> None:
    """Write layers ``name -> (channel letters, (H, W, C))``; those in ``half`` as half floats.

    The layer "" is the beauty. The file appears at once and whole, or not at all.
    """
    import OpenEXR

    channels = {}
    for name, (letters, image) in layers.items():
        for i, letter in enumerate(letters):
            kind = np.float16 if name in half else np.float32
            plane = np.ascontiguousarray(image[..., i], dtype=kind)
            channels[f"{name}.{letter}" if name else letter] = plane
    header = {
        "compression": getattr(OpenEXR, compression),
        "type": OpenEXR.scanlineimage,
        **header,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem}.tmp.exr")
    OpenEXR.File(header, channels).write(str(beside))
    os.replace(beside, path)


def noisy_layers(moments: Any) -> dict[str, tuple[str, NDArray[Any]]]:
    """The layers of a noisy frame under the names that Lambent reads."""
    from sampling import FEATURES

    layers, channel = {}, 0
    for name, letters in FEATURES:
        cut = slice(channel, channel + len(letters))
        base = "" if name == "colour" else name
        layers[base] = letters, moments.mean[..., cut]
        layers[f"{base}_variance".lstrip("_")] = letters, moments.variance[..., cut]
        if name == "boxcox":
            layers["boxcox_skew"] = letters, moments.skew[..., cut]
        channel += len(letters)
    layers["half_a"] = "RGB", moments.half_a
    layers["half_b"] = "RGB", moments.half_b
    return layers


def noisy(scene: Any, spp: int) -> Any:
    """Moments of a noisy frame; each spp has samples of its own."""
    from sampling import sample

    return sample(scene, spp, NOISY_SEED + spp)


def reference(scene: Any, spp: int, checkpoint: Path, beat: Any = None) -> Any:
    """Moments of at least ``spp`` samples, going on from ``checkpoint`` and saved to it.

    ``beat(moments)`` is called after every pass.
    """
    from sampling import Moments, sample

    total = None
    if checkpoint.exists():
        with np.load(checkpoint) as saved:
            total = Moments(**{k: v if v.ndim else int(v) for k, v in saved.items()})
        width, height = scene.sensors()[0].film().size()
        if total.mean.shape[:2] != (height, width):
            sys.exit(f"{checkpoint} is of another size: delete it to begin again")
    done = total.count if total else 0
    while done < spp:
        more = sample(scene, REFERENCE_PASS, REFERENCE_SEED + done, features=False)
        total = more if total is None else total + more
        done = total.count
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        beside = checkpoint.with_name(f".{checkpoint.stem}.tmp.npz")
        np.savez(beside, **vars(total))
        os.replace(beside, checkpoint)
        if beat:
            beat(total)
    return total


def write_reference(path: Path, moments: Any, **options: Any) -> None:
    """Colour and the variance of its mean, with the spp in the header."""
    colour, variance = moments.mean[..., :3], moments.variance[..., :3]
    layers = {"": ("RGB", colour), "variance": ("RGB", variance)}
    write_exr(path, layers, spp=moments.count, **options)


def tent(mi: Any, folder: Path, size: tuple[int, int], path: Path, spp: int = 16) -> None:
    """The scene through Mitsuba's film as published, with its splatted tent filter."""
    scene = mi.load_file(str(folder / "scene.xml"), resx=size[0], resy=size[1])
    aovs = "albedo:albedo,normal:sh_normal,depth:depth"
    integrator = mi.load_dict({"type": "aov", "aovs": aovs, "path": scene.integrator()})
    image = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=NOISY_SEED))
    layers = {
        "": ("RGB", image[..., :3]),
        "albedo": ("RGB", image[..., -7:-4]),
        "normal": ("XYZ", image[..., -4:-1]),
        "depth": ("Z", image[..., -1:]),
    }
    write_exr(path, layers, spp=spp)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes_dir", type=Path)
    parser.add_argument("--scenes", default=",".join(SIZES), help="names, in order of rendering")
    parser.add_argument("--spp", default="4,16,64", help="of the noisy frames; empty for none")
    parser.add_argument("--size", help="WIDTHxHEIGHT instead of each scene's own")
    parser.add_argument("--reference-spp", type=int, default=2048, help="0 for none")
    parser.add_argument("--cache", type=Path, default=default_cache())
    parser.add_argument("--tent", default="", help="a scene to render with a tent filter, too")
    arguments = parser.parse_args()
    mi = start_mitsuba()
    began = time.time()

    def say(text: str) -> None:
        print(f"{time.time() - began:7.0f} s  {text}", flush=True)

    for name in filter(None, arguments.scenes.split(",")):
        width, height = SIZES.get(name, (640, 360))
        if arguments.size:
            width, height = (int(v) for v in arguments.size.split("x"))
        folder, cache = arguments.scenes_dir / name, arguments.cache
        scene = mi.load_file(str(folder / "scene.xml"), resx=width, resy=height)
        for spp in (int(v) for v in arguments.spp.split(",") if v):
            path = cache / f"{name}-{spp}spp.exr"
            if not path.exists():
                write_exr(path, noisy_layers(noisy(scene, spp)), spp=spp)
                say(str(path))
        if name == arguments.tent:
            path = cache / f"{name}-tent-16spp.exr"
            if not path.exists():
                tent(mi, folder, (width, height), path)
                say(str(path))
        if arguments.reference_spp:
            path = cache / f"{name}-reference.exr"
            found = reference(
                scene,
                arguments.reference_spp,
                cache / f"{name}-reference.npz",
                lambda m, name=name: say(f"{name} reference: {m.count} spp"),
            )
            write_reference(path, found)


if __name__ == "__main__":
    main()
