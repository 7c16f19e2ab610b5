"""Random Cycles scenes to learn from, rendered by a Blender that stays alive.

Starting Blender takes a second or two and a scene about 0.2 s, so a `CyclesWorker` keeps one
Blender over many scenes, and one order renders every picture of a view: Cycles keeps what it built
of the scene, and a picture of 128 x 128 pixels costs about 0.05 s beside its samples.

Each noise level is rendered in two blocks with seeds of their own (one for a single sample), the
target in four or more; `frames.joined` makes mean, variance and half buffers of them. All blocks of
a view are independent, so that no noisy frame shares noise with its target.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from lambent.errors import EngineError, OptionError
from lambent.frame.files import read
from lambent.frame.frame import Frame
from lambent.frame.role import Role, Stat
from lambent.progress import Progress
from lambent.render.cycles.find import Blender
from lambent.render.cycles.frames import joined, passes_of, with_lobes, world_normal
from lambent.render.cycles.process import BlenderProcess, Refusal

#: The package that builds the scenes, in Blender's Python.
BUILDER = Path(__file__).parent / "inside"
KINDS = ("room", "still life", "court", "land", "tangle", "stage")
#: What a random view keeps: roles (with their variances), not Cycles' many single passes.
_KEPT = (
    Role.COLOUR, Role.ALPHA, Role.ALBEDO, Role.NORMAL, Role.DEPTH, Role.POSITION, Role.MOTION,
    Role.DIFFUSE, Role.SPECULAR, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO, Role.DIRECT,
    Role.INDIRECT, Role.EMISSION,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class RandomView:
    """What one camera saw of a random scene at one time.

    ``noisy``: a frame for each level asked for, few samples first as given; ``target``: the same
    view with many samples. Each frame has its spp; colour and averaged features have variances
    from 2 spp on, and colour has half buffers. Normals are in world space, motion leads to the
    previous frame (x right, y down; channels 2, 3 to the next). ``frame`` counts from 1 within a
    clip. ``to_world``: camera to world, 4 × 4, rows. ``window``: the part of the whole picture
    that was rendered (left, top, right, bottom in shares). ``seconds``: what rendering took.
    """

    seed: int
    kind: str
    camera: str
    frame: int
    noisy: tuple[Frame, ...]
    target: Frame
    window: tuple[float, float, float, float]
    to_world: tuple[tuple[float, ...], ...]
    seconds: float


class CyclesWorker:
    """A Blender that renders random scenes one after another; a context manager.

    ``restart_every`` scenes Blender is started afresh, which bounds its memory.
    """

    def __init__(
        self, blender: Blender | None = None, device: str = "cpu", restart_every: int = 200
    ) -> None:
        self._process = BlenderProcess(blender)
        self._device = device
        self._restart_every = restart_every
        self._scenes = 0

    def __enter__(self) -> CyclesWorker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End Blender."""
        self._process.close()

    @property
    def version(self) -> str:
        """Blender's version, for manifests. Starts Blender if need be."""
        self._process.start()
        return self._process.version

    def render_random(
        self,
        seed: int,
        *,
        spp_list: Sequence[int] = (1, 4, 16, 64),
        size: tuple[int, int] = (128, 128),
        frames: int = 1,
        reference_spp: int = 256,
        reference_blocks: int = 4,
        cameras: int = 1,
        kind: str | None = None,
        crop: float | None = None,
        progress: Progress | None = None,
    ) -> list[RandomView]:
        """Views of the random scene of a seed: ``cameras`` × ``frames`` of them, by camera.

        ``spp_list``: noise levels; ``reference_spp``: samples of the target, in
        ``reference_blocks`` blocks. ``size``: width and height of what is rendered; ``crop``: the
        share of the picture's width that this shows (None: drawn for each camera). ``kind``: one
        of `KINDS`. The same arguments give the same views, on the same Blender bit for bit.
        Raises `OptionError`, `EngineError`.
        """
        _check(seed, spp_list, size, frames, reference_spp, reference_blocks, cameras, kind, crop)
        if self._scenes >= self._restart_every:
            self.close()
            self._scenes = 0
        self._scenes += 1
        scene = {"seed": seed, "kind": kind, "cameras": cameras, "frames": frames, "crops": crop}
        levels = [_halved(spp) for spp in spp_list]
        levels.append(_split(reference_spp, reference_blocks))
        views = []
        for n in range(cameras):
            for frame in range(1, frames + 1):
                views.append(self._view(scene, n, frame, levels, size, progress))
        return views

    def _view(
        self, scene: dict[str, Any], n: int, frame: int, levels: list[list[int]],
        size: tuple[int, int], progress: Progress | None,
    ) -> RandomView:  # fmt: skip
        scratch = self._process.scratch
        pictures: list[dict[str, Any]] = []
        for k, blocks in enumerate(levels):
            for b, samples in enumerate(blocks):
                name = f"{scene['seed']} {n} {frame} {k} {b}"
                pictures.append(
                    {"samples": samples, "seed": zlib.crc32(name.encode()) & 0x7FFFFFFF,
                     "path": str(scratch / f"{k}_{b}.exr"), "frame": frame}
                )  # fmt: skip
        order = {
            "do": "build", "builder": str(BUILDER), "scene": scene, "view": n,
            "size": list(size), "passes": "light", "device": self._device,
            "pictures": pictures,
        }  # fmt: skip
        try:
            facts = self._process.order(order, progress)
        except Refusal as refusal:
            raise EngineError(f"the scene of seed {scene['seed']}: {refusal.message}") from refusal
        done = []
        paths = iter(pictures)
        for blocks in levels:
            parts = [_kept(read(next(paths)["path"], spp=samples), facts) for samples in blocks]
            done.append(joined(parts))
        for picture in pictures:
            (scratch / picture["path"]).unlink()
        return RandomView(
            seed=scene["seed"],
            kind=facts["kind"],
            camera=facts["camera"],
            frame=frame,
            noisy=tuple(done[:-1]),
            target=done[-1],
            window=tuple(facts["windows"][n]),
            to_world=tuple(tuple(row) for row in facts["to_world"]),
            seconds=sum(facts["seconds"]),
        )


def render_random(seed: int, **options: Any) -> list[RandomView]:
    """The views of one random scene (`CyclesWorker.render_random`); Blender starts and ends.

    For many scenes keep a `CyclesWorker`.
    """
    with CyclesWorker() as worker:
        return worker.render_random(seed, **options)


def _kept(frame: Frame, facts: dict[str, Any]) -> Frame:
    """The roles of a frame, decoded, with light split and normals in the world."""
    frame = world_normal(with_lobes(frame), facts["to_world"])
    layers = [frame.layers[role, Stat.MEAN] for role in _KEPT if frame.has(role)]
    emission = passes_of(frame).get("Emission")
    if emission is not None and not frame.has(Role.EMISSION):
        layers.append(emission)
    for layer in layers:
        _ = layer.data
    return frame.replace(layers={layer.key: layer for layer in layers}, extras={}, origin=None)


def _halved(spp: int) -> list[int]:
    return [1] if spp == 1 else [spp - spp // 2, spp // 2]


def _split(spp: int, blocks: int) -> list[int]:
    return [spp // blocks + (n < spp % blocks) for n in range(blocks)]


def _check(
    seed: int, spp_list: Sequence[int], size: tuple[int, int], frames: int, reference_spp: int,
    blocks: int, cameras: int, kind: str | None, crop: float | None,
) -> None:  # fmt: skip
    if not spp_list or min(spp_list) < 1:
        raise OptionError(f"samples per pixel start at 1: spp_list is {list(spp_list)}")
    if blocks < 2 or reference_spp < blocks:
        raise OptionError(
            f"a target of {reference_spp} spp in {blocks} blocks has no variance",
            remedy="take 2 blocks or more, with a sample each",
        )
    if min(size) < 8 or frames < 1 or cameras < 1:
        raise OptionError(f"nothing to render: size {size}, {frames} frames, {cameras} cameras")
    if kind is not None and kind not in KINDS:
        raise OptionError(f"there is no kind of scene '{kind}'", remedy=f"take {', '.join(KINDS)}")
    if crop is not None and not 0.01 < crop <= 1.0:
        raise OptionError(f"a crop shows between 0.01 and 1 of the picture, not {crop}")
