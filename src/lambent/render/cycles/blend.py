"""A .blend file, rendered by Cycles, as a frame with every feature.

The file is opened as it is, without its scripts. Changed are only the switches that a noisy frame
with features needs (`inside.settings`), each told in the frame's notes; the file itself is never
written. The picture is a multi-layer EXR of Blender's own, read like any other one, plus the split
of light that Mitsuba frames have (`frames.with_lobes`).

With ``halves`` the samples are rendered in two passes with seeds of their own, and the frame gets
half buffers of the colour and variances of what Cycles averages.
"""

from __future__ import annotations

import gzip
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from lambent.device import check_device
from lambent.errors import DamagedFileError, EngineError, FileError, OptionError, UnknownNameError
from lambent.frame.atomic import atomic, check_target
from lambent.frame.files import read, write
from lambent.frame.frame import Frame
from lambent.frame.windows import Windows
from lambent.progress import Progress
from lambent.render.cycles.frames import joined, with_lobes
from lambent.render.cycles.process import BlenderProcess, Refusal

_GZIP, _ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
#: The file's own version: ``BLENDER-v405`` up to 4.x, ``BLENDER17-01v0500`` from 5.0 on.
_HEAD = re.compile(rb"BLENDER(?:[-_][vV](\d)(\d\d)|\d\d-\d\d[vV](\d\d)(\d\d))")


def render_blend(
    path: str | os.PathLike[str],
    *,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    spp: int = 64,
    size: tuple[int, int] | None = None,
    frame: int | None = None,
    camera: str | None = None,
    seed: int = 0,
    depth: int | None = None,
    time: float | None = None,
    device: str = "auto",
    halves: bool = False,
    cryptomatte: bool = False,
    passes: str = "all",
    progress: Progress | None = None,
    process: BlenderProcess | None = None,
) -> Frame:
    """The frame that Cycles renders of a .blend file, noisy, with all passes.

    ``output``: an EXR to write, whole or not at all; without it nothing is written. ``size``:
    width and height (None: the file's). ``frame``: number on the file's timeline (None: where it
    was saved). ``depth``: most bounces (None: the file's). ``time``: seconds after which a picture
    ends with fewer samples. ``device``: auto, cpu or cuda. ``halves``: half buffers and variances,
    in a new EXR with Lambent's names. ``passes``: all, or light (no UV, mist, ids, occlusion).
    ``process``: a Blender that is running already, which then stays alive.

    Raises `FileError`, `DamagedFileError`, `OutputError`, `OptionError`, `UnknownNameError` (a
    camera that the scene does not have), `EngineError` (no Blender, or it failed).
    """
    frames = render_blend_frames(
        path, None if frame is None else [frame], output=output, overwrite=overwrite, spp=spp,
        size=size, camera=camera, seed=seed, depth=depth, time=time, device=device, halves=halves,
        cryptomatte=cryptomatte, passes=passes, progress=progress, process=process,
    )  # fmt: skip
    (only,) = [made for _, made in frames]
    return only


def render_blend_frames(
    path: str | os.PathLike[str],
    frames: Iterable[int] | None,
    *,
    output: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    spp: int = 64,
    size: tuple[int, int] | None = None,
    camera: str | None = None,
    seed: int = 0,
    depth: int | None = None,
    time: float | None = None,
    device: str = "auto",
    halves: bool = False,
    cryptomatte: bool = False,
    passes: str = "all",
    progress: Progress | None = None,
    process: BlenderProcess | None = None,
) -> Iterator[tuple[int, Frame]]:
    """Frames of a .blend by number, one after another from one Blender (see `render_blend`).

    ``####`` in ``output`` becomes the number. None renders where the file was saved. Each frame has
    a seed of its own, so that noise does not stand still.
    """
    path = Path(path)
    check_blend(path)
    _check_options(spp, size, depth, time, device, passes, halves)
    numbers: list[int | None] = [None] if frames is None else list(frames)
    targets = [None if output is None else numbered(output, n, len(numbers)) for n in numbers]
    for target in targets:
        if target is not None:
            check_target(target, overwrite)
    order = {
        "do": "blend", "blend": str(path.resolve()), "camera": camera, "size": size and list(size),
        "depth": depth, "time": time, "device": device, "cryptomatte": cryptomatte,
        "passes": passes, "codec": "ZIP",
    }  # fmt: skip
    blender = process or BlenderProcess()
    try:
        for number, target in zip(numbers, targets, strict=True):
            spots = _pictures(blender.scratch, spp, seed, number, halves)
            try:
                facts = blender.order({**order, "pictures": spots}, progress)
            except Refusal as refusal:
                raise _error(path, refusal, blender.version) from refusal
            yield facts["frame"], _frame(facts, spots, target, overwrite)
    finally:
        if process is None:
            blender.close()


def numbered(output: str | os.PathLike[str], number: int | None, count: int) -> Path:
    """``shot.####.exr`` with a number in the place of the marks. Raises `OptionError`."""
    text = os.fspath(output)
    marks = re.findall(r"#+", Path(text).name)
    if number is None or not marks:
        if count > 1:
            raise OptionError(
                f"'{text}' is one name for {count} frames", remedy="put #### into it: shot.####.exr"
            )
        return Path(text)
    return Path(text).with_name(
        Path(text).name.replace(marks[-1], f"{number:0{len(marks[-1])}d}", 1)
    )


def check_blend(path: Path) -> tuple[int, int] | None:
    """The version of Blender that saved a file, where it can be seen without unpacking.

    Raises `FileError` (missing, a folder), `DamagedFileError` (not a .blend).
    """
    if not path.exists():
        raise FileError("there is no such file", file=path, remedy="check the path")
    if path.is_dir():
        raise FileError("is a directory", file=path, remedy="name a .blend in it")
    try:
        with path.open("rb") as handle:
            head = handle.read(17)
        if head.startswith(_GZIP):
            with gzip.open(path) as packed:
                head = packed.read(17)
    except (OSError, EOFError) as error:
        raise DamagedFileError(f"cannot be read: {error}", file=path) from error
    if head.startswith(_ZSTD):
        return None  # the usual packing since 3.0; Blender will tell
    match = _HEAD.match(head)
    if match is None:
        what = "is empty" if not head else "is not a .blend: its first bytes are not Blender's"
        raise DamagedFileError(what, file=path, remedy="save it again from Blender")
    major, minor = (int(g) for g in match.groups() if g is not None)
    return major, minor


# ------------------------------------------------------------------------------------------- parts


def _check_options(
    spp: int, size: tuple[int, int] | None, depth: int | None, time: float | None, device: str,
    passes: str, halves: bool,
) -> None:  # fmt: skip
    if spp < 1 or (halves and spp < 2):
        least = 2 if halves else 1
        raise OptionError(f"{spp} samples per pixel: at least {least}", remedy="raise --spp")
    if size is not None and (min(size) < 4 or max(size) > 65536):
        raise OptionError(f"a picture of {size[0]}x{size[1]} cannot be rendered")
    if depth is not None and not 0 <= depth <= 1024:
        raise OptionError(f"a path has 0 to 1024 bounces, not {depth}")
    if time is not None and not time > 0:
        raise OptionError(f"a time limit of {time} s leaves no time")
    check_device(device)
    if passes not in ("all", "light"):
        raise OptionError(f"there is no set of passes '{passes}'", remedy="take all or light")


def _pictures(
    scratch: Path, spp: int, seed: int, number: int | None, halves: bool
) -> list[dict[str, Any]]:
    counts = [spp - spp // 2, spp // 2] if halves else [spp]
    pictures = []
    for k, samples in enumerate(counts):
        # Odd factors keep the seeds of frames, halves and neighbouring seeds apart.
        mixed = (seed * 0x9E3779B1 + (number or 0) * 0x85EBCA6B + k * 0x27D4EB2F) & 0x7FFFFFFF
        picture: dict[str, Any] = {
            "samples": samples,
            "seed": mixed,
            "path": str(scratch / f"{k}.exr"),
        }
        if number is not None:
            picture["frame"] = number
        pictures.append(picture)
    return pictures


def _frame(
    facts: dict[str, Any], pictures: list[dict[str, Any]], target: Path | None, overwrite: bool
) -> Frame:
    spp = [int(n) for n in facts["samples"]]
    notes = list(dict.fromkeys(facts["notes"]))
    asked = sum(p["samples"] for p in pictures)
    if sum(spp) < asked:
        notes.append(f"The time was up after {sum(spp)} of {asked} samples per pixel.")
    files = [Path(picture["path"]) for picture in pictures]
    if len(files) == 1 and target is not None:
        with atomic(target, overwrite) as out, files[0].open("rb") as source:
            shutil.copyfileobj(source, out, 1 << 20)
        made = with_lobes(read(target, spp=spp[0]))
    else:
        made = joined([with_lobes(_loaded(f, n)) for f, n in zip(files, spp, strict=True)])
        made = _placed(made, facts["region"])
        if target is not None:
            write(target, made, overwrite=overwrite)
    for file in files:
        file.unlink()
    return made.noted(*notes)


def _placed(frame: Frame, region: list[int] | None) -> Frame:
    """With the windows of a render region (see ``inside.settings``): Blender writes none."""
    windows = Windows.of_size(frame.width, frame.height)
    if region is None or frame.windows not in (None, windows):
        return frame
    left, below, width, height = region
    top = height - below - frame.height
    box = left, top, left + frame.width - 1, top + frame.height - 1
    return frame.replace(windows=Windows(box, Windows.of_size(width, height).display))


def _loaded(path: Path, spp: int) -> Frame:
    """A frame whose file may go: everything is decoded."""
    frame = read(path, spp=spp)
    for layer in frame.all_layers():
        _ = layer.data
    return frame


def _error(path: Path, refusal: Refusal, version: str) -> Exception:
    """The error that a person should see for a refusal of Blender's side."""
    kind, known = refusal.kind, refusal.facts.get("known", [])
    if kind == "camera":
        return UnknownNameError("camera", refusal.message, known, file=path)
    if kind == "which camera":
        remedy = f"name one with --camera: {', '.join(known)}"
        return OptionError(f"{refusal.message}", file=path, remedy=remedy)
    if kind == "no camera":
        return FileError(refusal.message, file=path, remedy="add one in Blender and save")
    if kind == "newer":
        return EngineError(
            refusal.message, file=path,
            remedy="take a newer Blender (LAMBENT_BLENDER names one), or save for this one",
        )  # fmt: skip
    if kind == "blend":
        remedy = f"open it in Blender and save it again (this is Blender {version})"
        return DamagedFileError(
            f"Blender cannot open it: {refusal.message}", file=path, remedy=remedy
        )
    if kind == "device":
        remedy = "use --device cpu, or check the NVIDIA driver"
        return EngineError(refusal.message, file=path, remedy=remedy)
    return EngineError(refusal.message, file=path)
