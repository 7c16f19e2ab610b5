"""A data set as plain arrays, so that training never waits for an EXR to be unpacked.

A cached still is one file of half floats, ``(23 L + 7, H, W)``: for each of its L noise levels the
planes of `denoise.inputs.signals_of`, then those of `denoise.lobes` that it lacks, in the order of
`STORED`; then the target's colour, the deviation of its mean, and its diffuse part. Colours are at
the target's exposure (`frame.exposure.block_exposure`), where a half float holds 6e-8 to 65504.
``index.json`` says what is where. The cache is a folder that can be deleted at any time: it is made
again from the data set, and grows with it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lambent.dataset.item import Still
from lambent.dataset.reader import Dataset, open_dataset
from lambent.denoise.inputs import LAYERS, Signals, signals_of
from lambent.denoise.lobes import LOBES, lobes_of
from lambent.errors import LambentError, OptionError
from lambent.frame.atomic import atomic
from lambent.frame.exposure import block_exposure
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.role import Role, Stat
from lambent.learn.recipe import TrainRecipe
from lambent.progress import Progress
from lambent.settings import read_json

#: Layers of a level in the file, after its three channels of colour.
STORED = {name: count for name, count in LAYERS.items() if name != "history"} | dict(LOBES)
PLANES_OF = 3 + sum(STORED.values())
TARGET_PLANES = 7
#: What changes the files changes this.
VERSION = 2
#: Layers in units of radiance: stored at the target's exposure.
_RADIANCE = ("colour_std", "diffuse", "diffuse_std", "specular_std")
_MOST = 6e4


@dataclass(frozen=True)
class Cached:
    """One still of the cache. ``spp`` of its levels; ``layers`` of each level that are there."""

    file: Path
    spp: tuple[int, ...]
    layers: tuple[tuple[str, ...], ...]
    scene: str
    exposure: float

    def load(self, lobes: bool = False) -> tuple[list[Signals], FloatImage, FloatImage]:
        """The levels, the target ``(3, H, W)``, the deviation of its mean ``(1, H, W)``.

        With ``lobes`` the levels have the layers of `denoise.lobes.LOBES` too, and the target is
        ``(6, H, W)``: colour, and the diffuse part of it.
        """
        memory = np.load(self.file, mmap_mode="r")
        levels = []
        for k, there in enumerate(self.layers):
            planes = np.asarray(memory[k * PLANES_OF : (k + 1) * PLANES_OF], np.float32)
            found, at = {}, 3
            for name, count in STORED.items():
                if name in there and (lobes or name not in LOBES):
                    found[name] = planes[at : at + count]
                at += count
            levels.append(Signals(planes[:3], found, float(self.spp[k])))
        target = np.asarray(memory[-TARGET_PLANES:], np.float32)
        return levels, target[[0, 1, 2, 4, 5, 6] if lobes else slice(0, 3)], target[3:4]


def cached(
    folder: Path,
    place: Path,
    progress: Progress | None = None,
    workers: int | None = None,
    unpack: bool = True,
) -> list[Cached]:
    """The stills of the data set in ``folder``, in the cache below ``place``; made if missing.

    Without ``unpack``: only those that are in the cache by now (another process fills it).
    Raises `FileError` and `DamagedFileError` as reading the data set does.
    """
    data = open_dataset(folder)
    home = place / _name(data)
    home.mkdir(parents=True, exist_ok=True)
    index = home / "index.json"
    known: dict[str, list[dict[str, Any]]] = {}
    if index.exists():
        known = read_json(index, "index of an unpacked data set", f"remove {home}")
    lines = [data.line(i) for i in range(len(data))]
    todo = [i for i, line in enumerate(lines) if line["file"] not in known] if unpack else []
    try:
        for done, (file, entries) in enumerate(_made(folder, home, todo, workers)):
            known[file] = entries
            if progress is not None:
                progress(done + 1, len(todo), "unpacking the data set")
    finally:
        if todo:
            with atomic(index, overwrite=True) as handle:
                handle.write(json.dumps(known).encode())
    found = []
    for line in lines:
        for entry in known.get(line["file"], ()):
            found.append(
                Cached(
                    home / entry["file"],
                    tuple(entry["spp"]),
                    tuple(tuple(names) for names in entry["layers"]),
                    f"{data.recipe.name}/{line.get('seed', line['index'])}",
                    entry["exposure"],
                )
            )
    return found


def stills_of(
    recipe: TrainRecipe,
    place: Path,
    progress: Progress | None = None,
    unpack: bool = True,
) -> list[Cached]:
    """The stills of all data of a training recipe; without ``unpack``, those cached by now.

    Raises `OptionError` without data, and what reading data sets raises.
    """
    if not recipe.data:
        raise OptionError(
            "the recipe names no data",
            remedy='add a line: data = ["FOLDER"], made by lambent dataset make',
        )
    return [
        still
        for folder in recipe.data
        for still in cached(Path(folder), place, progress, unpack=unpack)
    ]


# ------------------------------------------------------------------- private


def _name(data: Dataset) -> str:
    text = f"{data.folder.resolve()} {data.recipe.essence} {VERSION}"
    return f"{data.recipe.name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


def _made(
    folder: Path, home: Path, todo: list[int], workers: int | None
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    if not todo:
        return
    pieces = [(folder, home, todo[i : i + 8]) for i in range(0, len(todo), 8)]
    # threads, since a process with PyTorch's and Dr.Jit's threads must not fork; unpacking is
    # mostly done outside the interpreter
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            for part in pool.map(_unpack, pieces):
                yield from part
        finally:
            pool.shutdown(cancel_futures=True)


def _unpack(job: tuple[Path, Path, list[int]]) -> list[tuple[str, list[dict[str, Any]]]]:
    folder, home, numbers = job
    data = open_dataset(folder)
    found = []
    for i in numbers:
        line, item = data.line(i), data.item(i)
        stem = Path(line["file"]).stem
        entries = []
        for k, still in enumerate(item.stills):
            name = f"{line['what']}-{stem}-{k}.npy"
            entries.append({"file": name, **_store(home / name, still)})
        found.append((line["file"], entries))
    return found


def _store(path: Path, still: Still) -> dict[str, Any]:
    """Write a still; what its entry says of it."""
    factor = block_exposure(still.target.colour)
    levels = [_with_lobes(signals_of(frame), frame) for frame in still.levels]
    planes = []
    for level in levels:
        planes.append(level.colour * np.float32(factor))
        for name, count in STORED.items():
            layer = level.layers.get(name)
            if layer is None:
                layer = np.zeros((count, *level.colour.shape[1:]), np.float32)
            planes.append(layer * np.float32(factor) if name in _RADIANCE else layer)
    planes += [_target(still.target) * np.float32(factor)]
    memory = np.clip(np.concatenate(planes), -_MOST, _MOST).astype(np.float16)
    partial = path.with_suffix(f".{os.getpid()}.part.npy")  # another run may unpack it, too
    np.save(partial, memory)
    os.replace(partial, path)
    return {
        "spp": [int(frame.spp or 0) for frame in still.levels],
        "layers": [sorted(level.layers) for level in levels],
        "exposure": factor,
    }


def _target(frame: Frame) -> FloatImage:
    variance = frame.get(Role.COLOUR, Stat.VARIANCE)
    if variance is None:
        raise LambentError(
            "a target has no variance", remedy="make the data set again: lambent dataset make"
        )
    deviation = np.sqrt(variance.mean(axis=2, keepdims=True))
    diffuse = frame.get(Role.DIFFUSE)
    if diffuse is None:  # no lobes in this data set: nothing that needs them can be trained on it
        diffuse = np.zeros_like(frame.colour)
    return np.concatenate([frame.colour, deviation, diffuse], axis=2).transpose(2, 0, 1)


def _with_lobes(signals: Signals, frame: Frame) -> Signals:
    return replace(signals, layers={**signals.layers, **lobes_of(frame)})
