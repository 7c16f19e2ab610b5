"""The task of denoising photographs: clean pictures in, Gaussian noise added, `networks.dncnn` out.

Zhang et al. 2017, sec. IV-A: patches of clean pictures, flipped and turned, with noise of one
level (``sigma_low`` = ``sigma_high``) or of a level drawn anew for each patch (blind). Pictures
come from folders of PNG and JPEG files, or from a data set of `lambent dataset make`, whose
targets are made into photographs.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from lambent.errors import FileError, OptionError
from lambent.filters.denoiser import create
from lambent.frame.atomic import atomic
from lambent.frame.frame import Frame
from lambent.frame.layer import FloatImage
from lambent.frame.tonemap import inverse_srgb, srgb
from lambent.learn.cache import cached
from lambent.learn.held_out import is_held_out
from lambent.learn.networks import dncnn
from lambent.learn.recipe import TrainRecipe
from lambent.learn.task import Exportable, Learnable, ShippedTask
from lambent.progress import Progress
from lambent.training.ahead import ahead
from lambent.training.task import Pictures

#: Noise levels, in 255ths, that a blind model is validated at.
CHECKED = (15.0, 25.0, 50.0)
_ENDINGS = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class PhotoOptions:
    """The table ``[options]`` of a recipe with ``task = "photo"``.

    ``sigma_low``, ``sigma_high``: noise in 255ths. ``colour``: three channels or grey. ``grey``:
    share of the patches that are grey in all three, with the same noise in each, as a grey picture
    is read: a network that has seen colours alone takes such noise for a texture. ``depth``,
    ``width``, ``norm``, ``residual``, ``small_start``: of the network. ``patch``: side of a patch
    in pixels.
    """

    sigma_low: float = 0.0
    sigma_high: float = 55.0
    colour: bool = True
    grey: float = 0.25
    depth: int = 20
    width: int = 64
    norm: bool = True
    residual: bool = True
    small_start: bool = True
    patch: int = 50

    def __post_init__(self) -> None:
        if self.sigma_low > self.sigma_high:
            raise OptionError("sigma_low lies above sigma_high")


_RANGES = (
    ("sigma_low", 0.0, 255.0),
    ("sigma_high", 0.1, 255.0),
    ("grey", 0.0, 1.0),
    ("depth", 3, 64),
    ("width", 1, 1024),
    ("patch", 8, 512),
)


@dataclass(frozen=True)
class Photograph:
    """``pixels`` ``(H, W, 3)`` of 8 bits, and the name of the file or scene."""

    name: str
    pixels: NDArray[np.uint8]


@dataclass(frozen=True)
class Patch:
    """A patch of display values ``(C, P, P)``, with noise and without."""

    noisy: FloatImage
    clean: FloatImage


def photo_task(recipe: TrainRecipe, place: Path, progress: Progress | None = None) -> PhotoTask:
    """The task with the pictures of a recipe. Raises `OptionError` without any, `FileError`."""
    if not recipe.data:
        raise OptionError(
            "the recipe names no data",
            remedy='add a line: data = ["FOLDER"], of pictures or made by lambent dataset make',
        )
    pictures: list[Photograph] = []
    for folder in map(Path, recipe.data):
        if (folder / "manifest.json").exists():
            pictures += _rendered(folder, place, progress)
        else:
            pictures += photographs(folder)
    return PhotoTask(recipe, pictures)


class PhotoTask(ShippedTask):
    """Learn to take Gaussian noise off photographs: `Task` for `DnCNN`.

    Some are held out, by their names, so that crops of one scene are all on one side.
    Raises `OptionError` for options that make no sense and too few pictures.
    """

    def __init__(self, recipe: TrainRecipe, pictures: Sequence[Photograph]) -> None:
        self.recipe = recipe
        self.options: PhotoOptions = PHOTO.options_from(recipe.options)
        side = self.options.patch
        fit = [p for p in pictures if min(p.pixels.shape[:2]) >= side]
        held = [p for p in fit if is_held_out(p.name, recipe.held_out)]
        kept = [p for p in fit if not is_held_out(p.name, recipe.held_out)]
        if not kept or (recipe.held_out and not held):
            raise OptionError(
                f"{len(fit)} pictures of at least {side} pixels a side are too few",
                remedy="name a folder with more, take a smaller patch, or set held_out = 0",
            )
        self.held = _spread([_planes(p.pixels, self.options.colour) for p in held or kept])
        self.pictures = [_planes(p.pixels, self.options.colour) for p in kept]
        sizes = np.array([p.shape[1] * p.shape[2] for p in self.pictures], np.float64)
        self._chance = sizes / sizes.sum()

    def network(self) -> nn.Module:
        """A fresh network as the options have it."""
        o = self.options
        channels = 3 if o.colour else 1
        return dncnn.DnCNN(channels, o.depth, o.width, o.norm, o.residual, o.small_start)

    def batches(self, first: int, rank: int, world: int) -> Generator[list[Patch], None, None]:
        """Patches of this process's share of each batch."""
        numbers = range(rank, self.recipe.batch, world)
        return ahead(lambda step: [self.patch(step, n) for n in numbers], first)

    def patch(self, step: int, number: int) -> Patch:
        """Patch ``number`` of the batch of ``step``."""
        rng = np.random.default_rng((self.recipe.seed, step, number))
        picture = self.pictures[int(rng.choice(len(self.pictures), p=self._chance))]
        side = self.options.patch
        y, x = (int(rng.integers(n - side + 1)) for n in picture.shape[1:])
        cut = np.rot90(picture[:, y : y + side, x : x + side], int(rng.integers(4)), (1, 2))
        cut = cut[:, :, ::-1] if rng.random() < 0.5 else cut
        clean: FloatImage = np.ascontiguousarray(cut, np.float32) / np.float32(255)
        sigma = rng.uniform(self.options.sigma_low, self.options.sigma_high) / 255
        noise = rng.standard_normal(clean.shape, np.float32) * np.float32(sigma)
        if self.options.colour and rng.random() < self.options.grey:
            clean = np.repeat(clean.mean(axis=0, keepdims=True), 3, axis=0)
            noise = np.repeat(noise[:1], 3, axis=0)
        return Patch(clean + noise, clean)

    def loss(self, model: nn.Module, batch: list[Patch]) -> tuple[Tensor, dict[str, Tensor]]:
        """Half the squared error of a patch; the convolutions in bf16."""
        noisy, clean = (
            torch.from_numpy(np.stack([getattr(p, name) for p in batch]))
            .to(self.device)
            .to(memory_format=torch.channels_last)
            for name in ("noisy", "clean")
        )
        with torch.autocast(noisy.device.type, torch.bfloat16):
            found = model(noisy)
        return dncnn.loss(found, clean), {}

    @torch.no_grad()
    def score(self, model: nn.Module) -> tuple[dict[str, float], Pictures]:
        """PSNR in dB on the held-out pictures, in float32.

        ``score``: their mean as a root-mean-square error in 255ths.
        """
        o = self.options
        blind = o.sigma_low < o.sigma_high
        found: dict[str, float] = {}
        shown: dict[str, FloatImage] = {}
        for sigma in CHECKED if blind else (o.sigma_high,):
            values = []
            for number, picture in enumerate(self.held[: self.recipe.checked]):
                clean = np.asarray(picture / np.float32(255), np.float32)
                rng = np.random.default_rng((7, number, int(sigma)))
                noisy = clean + rng.standard_normal(clean.shape, np.float32) * (sigma / 255)
                noisy = noisy.astype(np.float32)
                x = model(torch.from_numpy(noisy[None]).to(self.device))[0].float().cpu().numpy()
                values.append(psnr(x, clean))
                if number < 3:
                    row = np.concatenate([noisy, x, clean], 2).transpose(1, 2, 0)
                    shown[f"sigma {sigma:g}, {number}"] = inverse_srgb(np.clip(row, 0, 1))
            found[f"psnr {sigma:g}"] = float(np.mean(values))
        found["score"] = float(255 * 10 ** (-np.mean(list(found.values())) / 20))
        return found, shown

    def exportable(self, model: nn.Module) -> Exportable:
        """The network with its batch normalisation folded, and what it reads."""
        assert isinstance(model, dncnn.DnCNN)
        channels = 3 if self.options.colour else 1
        about = {
            "channels": channels,
            "margin": self.options.depth,
            "options": asdict(self.options),
        }
        return Exportable(dncnn.folded(model), (torch.zeros(1, channels, 64, 64),), "pixels", about)

    def says(self, scores: Mapping[str, float]) -> str:
        """For the card: the score in words."""
        levels = [name.split()[1] for name in scores if name.startswith("psnr")]
        values = ", ".join(f"{scores[f'psnr {s}']:.2f} dB at sigma {s}" for s in levels)
        return f"PSNR {values}, on held-out pictures of its own data"

    def calibration(self) -> list[FloatImage]:
        """Noisy patches to measure the ranges of activations on."""
        return [self.patch(0, n).noisy for n in range(64)]

    def about_data(self) -> list[dict[str, Any]]:
        """For the card: the folders, and how many pictures were learned from in all."""
        names = ", ".join(Path(folder).name for folder in self.recipe.data)
        return [{"name": names, "pictures": len(self.pictures)}]


def psnr(x: FloatImage, clean: FloatImage) -> float:
    """10 log10(1 / MSE) in dB of display values, ``x`` held to [0, 1] as on a screen."""
    error = np.clip(x, 0, 1).astype(np.float64) - clean
    return float(-10 * np.log10(max(float(np.mean(error**2)), 1e-12)))


def photographs(folder: Path) -> list[Photograph]:
    """The PNG and JPEG files of a folder, by name. Raises `FileError`."""
    from PIL import Image, UnidentifiedImageError

    if not folder.is_dir():
        raise FileError(
            "there is no such folder of pictures", file=folder, remedy="name one with PNG or JPEG"
        )
    found = []
    visible = (p for p in folder.iterdir() if not p.name.startswith("."))  # macOS: "._a.jpg"
    for path in sorted(p for p in visible if p.suffix.lower() in _ENDINGS):
        try:
            with Image.open(path) as image:
                pixels = np.asarray(image.convert("RGB"), np.uint8)
        except (UnidentifiedImageError, OSError) as error:
            raise FileError(f"is not a picture: {error}", file=path, remedy="remove it") from None
        found.append(Photograph(path.name, pixels))
    if not found:
        raise FileError("holds no PNG or JPEG", file=folder, remedy="name another folder")
    return found


PHOTO = Learnable(PhotoOptions, _RANGES, dncnn.DnCNN, photo_task)


# ------------------------------------------------------------------- private


def _planes(picture: NDArray[np.uint8], colour: bool) -> NDArray[np.uint8]:
    """``(3, H, W)``, or luma ``(1, H, W)`` as Rec. 601 has it (what grey test sets are made by)."""
    if colour:
        return np.ascontiguousarray(picture.transpose(2, 0, 1))
    luma = picture.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    return np.rint(luma)[None].astype(np.uint8)


def _spread(pictures: list[NDArray[np.uint8]]) -> list[NDArray[np.uint8]]:
    """The same ones, so ordered that the first few come from all over."""
    order = np.random.default_rng(0).permutation(len(pictures))
    return [pictures[i] for i in order]


def _rendered(folder: Path, place: Path, progress: Progress | None) -> list[Photograph]:
    """The targets of a data set as photographs, made once and kept in the cache.

    A target still has noise of its own, which a photograph for training must not have: it is
    denoised (OIDN, its strongest form) and made half as large, which sharpens it again and takes
    off what is left, then tone-mapped.
    """
    stills = cached(folder, place, progress)
    store = stills[0].file.parent / "pictures.npz" if stills else None
    names = [still.file.name for still in stills]
    if store is not None and store.exists():
        with np.load(store) as known:
            if known["names"].tolist() == names:
                return [
                    Photograph(still.scene, pixels)
                    for still, pixels in zip(stills, known["pictures"], strict=True)
                ]
    oidn = create("oidn-best")
    found = []
    for number, still in enumerate(stills):
        levels, target, _ = still.load()
        guides: dict[str, Any] = {
            name: np.ascontiguousarray(levels[-1].layers[name].transpose(1, 2, 0))
            for name in ("albedo", "normal")
            if name in levels[-1].layers
        }
        frame = Frame.from_arrays(colour=np.ascontiguousarray(target.transpose(1, 2, 0)), **guides)
        clean = oidn(frame, "beauty").colour
        height, width = clean.shape[0] // 2, clean.shape[1] // 2
        halves = clean[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3)
        # targets are at an exposure that puts their middle near 0.18, where `tonemap` wants it
        found.append((srgb(halves.mean((1, 3))) * 255 + 0.5).astype(np.uint8))
        if progress is not None:
            progress(number + 1, len(stills), "making photographs of the targets")
    if store is not None:
        with atomic(store, overwrite=True) as handle:
            np.savez(handle, names=np.array(names), pictures=np.stack(found))
    return [Photograph(still.scene, p) for still, p in zip(stills, found, strict=True)]
