"""The process in which `attack.py` tries its files, so that a crash of C code is seen.

Takes the number of a try on each line and answers with a line of JSON: ``end`` (``clean``: an error
of ours, ``accepted``, ``bug``: any other exception), ``lost``: bytes that differ though they had to
stay, ``words`` about it, ``peak``: the most memory of this process so far, in bytes. A try is made
of the seed, its kind and its number alone. The file lies in the folder until the next try.

Usage: python benchmarks/attack_tries.py KIND SEED FOLDER MEMORY
"""

from __future__ import annotations

import json
import os
import resource
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import attack_files as files
from lambent.errors import LambentError

#: (what differs in bytes, what differs in words)
Lost = tuple[int, str]
KINDS = ("exr", "roundtrips", "pictures", "models", "solutions")


def generator(seed: int, kind: str, number: int) -> np.random.Generator:
    return np.random.default_rng([seed, KINDS.index(kind), number])


def differing(one: np.ndarray, other: np.ndarray) -> int:
    """Bytes that differ."""
    if one.dtype != other.dtype or one.shape != other.shape:
        return max(one.nbytes, other.nbytes)
    pairs = (np.frombuffer(a.tobytes(), np.uint8) for a in (one, other))
    return int(np.count_nonzero(np.not_equal(*pairs)))


# ------------------------------------------------------------------- EXR


def levels(exr: object) -> dict[tuple[int, int, int, str], np.ndarray]:
    """Every channel of every level of every part of what `decode` returns."""
    from lambent.frame.exr.pixels import decode_rows

    return {
        (part.index, level.lx, level.ly, name): array
        for part in exr.container.parts
        for level in part.levels
        for name, array in decode_rows(exr.container, part, None, level).items()
    }


def lost_between(source: Path, target: Path, changed: set[tuple[int, str]]) -> Lost:
    """What of ``source`` is not in ``target``, but for the channels that were changed."""
    from lambent.frame.exr import decode

    exrs = decode(source), decode(target)
    before, after = (levels(exr) for exr in exrs)
    lost, words = 0, []
    for key, array in before.items():
        if (key[0], key[3]) in changed and key in after:
            continue
        count = differing(array, after[key]) if key in after else array.nbytes
        if count:
            lost += count
            words.append(f"channel {key}")
    for old, new in zip(exrs[0].container.parts, exrs[1].container.parts, strict=True):
        kept = {a.name: a.raw for a in new.attributes}
        for attribute in old.attributes:
            free = ("compression", "chunkCount", "lambent", "software")
            if attribute.name not in free and kept.get(attribute.name) != attribute.raw:
                lost += max(1, len(attribute.raw))
                words.append(f"attribute {attribute.name}")
    return lost, ", ".join(words[:4])


def try_exr(rng: np.random.Generator, folder: Path) -> Lost:
    """A mutant is read, all of it, and written with one channel replaced; the rest must stay."""
    from lambent.frame.exr import decode, encode
    from lambent.frame.files import read_views

    path, out = folder / "mutant.exr", folder / "out.exr"
    path.write_bytes(files.exr_mutant(rng))
    exr = decode(path)
    channels = [(part.index, c) for part in exr.parts for c in part.channels.values()]
    for _, channel in channels:
        _ = channel.data
    index, first = channels[0]
    encode(out, exr, {(index, first.name): first.data.copy()}, overwrite=True)
    lost = lost_between(path, out, {(index, first.name)})
    for frame in read_views(path).values():
        for layer in frame.all_layers():
            _ = layer.data
    return lost


def try_roundtrip(rng: np.random.Generator, folder: Path) -> Lost:
    """Denoised and written: what is not the beauty has the same bits, in all levels.

    The OpenEXR module itself is the second witness for the finest level.
    """
    import OpenEXR

    import lambent
    from lambent.frame.exr import decode, encode

    path, out = folder / "mutant.exr", folder / "out.exr"
    compression = files.pick(rng, files.COMPRESSIONS)
    storage = files.pick(rng, list(files.STORAGES))
    case = f"{compression}, {storage}"
    path.write_bytes(files.exr(rng, compression, storage, files.pick(rng, files.ORDERS)))
    if rng.random() < 0.5:
        clean = lambent.denoise(path, model="box", passes="beauty", alpha=False)
        lambent.write(out, clean, overwrite=True)
        changed = {(0, name) for name in "RGB"}
    else:
        exr = decode(path)
        part = exr.parts[int(rng.integers(len(exr.parts)))]
        name = files.pick(rng, list(part.channels))
        new = (part.channels[name].data * 0.5).astype(part.channels[name].data.dtype)
        encode(out, exr, {(part.index, name): new}, overwrite=True)
        changed = {(part.index, name)}
    lost, words = lost_between(path, out, changed)
    twins = [OpenEXR.File(str(p), separate_channels=True).parts for p in (path, out)]
    for n, (old, new) in enumerate(zip(*twins, strict=True)):
        for name, channel in old.channels.items():
            count = differing(channel.pixels, new.channels[name].pixels)
            if (n, name) not in changed and count:
                lost, words = lost + count, f"{words} OpenEXR: part {n} {name}"
    return lost, f"{case}: {words}" if lost else ""


# ------------------------------------------------------------------- pictures

#: A step of a Radiance HDR at most, relative to the largest channel of the pixel.
RGBE = 1 / 128


def try_picture(rng: np.random.Generator, folder: Path) -> Lost:
    """A mutant is read and written again; what loses nothing must give the same values."""
    from lambent.frame.files import read, write

    name, content = files.picture_mutant(rng)
    path, out = folder / f"mutant_{name}", folder / f"out_{name}"
    for old in folder.glob("mutant_*"):
        old.unlink()
    path.write_bytes(content)
    frame = read(path)
    arrays = [layer.data for layer in frame.all_layers()]
    write(out, frame, overwrite=True)
    if out.suffix == ".jpg":
        return 0, ""
    back = [layer.data for layer in read(out).all_layers()]
    if len(back) != len(arrays):
        return sum(a.nbytes for a in arrays), "layers are missing"
    scaled = out.suffix == ".hdr" and not content.count(b"EXPOSURE=1.0\n")
    lost = sum(
        # over an exposure they are not what RGBE can hold, and come back rounded as it rounds
        int((np.abs(a - b) > RGBE * a.max(2, keepdims=True)).sum()) if scaled else differing(a, b)
        for a, b in zip(arrays, back, strict=True)
        if np.isfinite(a).all() and (a >= 0).all()  # others are clipped, with a note
    )
    return lost, "values differ" if lost else ""


# ------------------------------------------------------------------- archives


def try_model(rng: np.random.Generator, folder: Path) -> Lost:
    """A crafted model denoises a picture, or is refused."""
    import lambent

    path = folder / "mutant.lambent"
    path.write_bytes(files.crafted_model(rng))
    noisy = np.random.default_rng(0).random((24, 24, 3), np.float32)
    clean = lambent.denoise(noisy, model="dncnn", weights=str(path))
    assert clean.colour.shape == noisy.shape
    return 0, ""


def try_solution(rng: np.random.Generator, folder: Path) -> Lost:
    """A crafted solution is opened and shown, or refused."""
    from lambent.transport.solution import open_solution, view

    path = folder / "mutant.lambent"
    path.write_bytes(files.crafted_solution(rng, (folder / "../room.lambent").read_bytes()))
    solution = open_solution(path)
    repr(solution)
    frame = view(solution, scene=folder / "../room.xml", size=(8, 6), spp=1, features="none")
    assert frame.colour.shape == (6, 8, 3)
    return 0, ""


TRIES: dict[str, Callable[[np.random.Generator, Path], Lost]] = {
    "exr": try_exr,
    "roundtrips": try_roundtrip,
    "pictures": try_picture,
    "models": try_model,
    "solutions": try_solution,
}


def answer(kind: str, seed: int, number: int, folder: Path) -> dict[str, object]:
    end, lost, words = "accepted", 0, ""
    try:
        lost, words = TRIES[kind](generator(seed, kind, number), folder)
    except LambentError as error:
        end, words = "clean", f"{type(error).__name__}: {error}"
        if kind == "roundtrips":
            lost = 1  # a sound file was refused
    except BaseException:  # whatever it is, it is no error of ours, and the next try goes on
        end, words = "bug", traceback.format_exc()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {"end": end, "lost": lost, "words": words, "peak": peak}


def main() -> None:
    kind, seed, folder, memory = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4])
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what C code prints must not get in between
    answers.write("ready\n")
    for line in sys.stdin:
        answers.write(json.dumps(answer(kind, seed, int(line), folder)) + "\n")


if __name__ == "__main__":
    main()
